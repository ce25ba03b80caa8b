"""What the reports write into a directory, complete or not at all; and everything that a ghost analysis writes."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd

from mistray.analysis.ghosts import GhostReport
from mistray.errors import MistrayError
from mistray.replace_file import FREE, NO_ROOM, claim_files, draft_folder, replace_files, written
from mistray.report.colour import ColourPictures, Look
from mistray.report.figures.layout import layout
from mistray.report.figures.plots import as_png, common_range, ghost_image, levels_against_field, montage
from mistray.report.html.fields import mapped_paths
from mistray.report.html.ghosts import html_text
from mistray.report.rays.path_sort import path_sort_text
from mistray.report.tables.ghosts_csv import write_csv

PATHS_SORTED = 1000  # paths in a path-sort file
PROBE = 1 << 16  # bytes for which there must be room


def draw(report: GhostReport, look: Look | None = None) -> dict[str, bytes]:
    """
    All pictures as PNG, by file name.

    Parameters
    ----------
    report : GhostReport
    look : Look, optional
        Draw colour pictures, too, like this.

    Returns
    -------
    dict
        overview.png, levels.png and, for each field, ghosts_<field>deg.png and layout_<field>deg.png; with a look also
        colour_<field>deg.png.
    """
    limits = common_range(report)
    pictures = {"overview.png": as_png(montage(report)), "levels.png": as_png(levels_against_field(report))}
    for field in report:
        pictures[f"ghosts_{field:g}deg.png"] = as_png(ghost_image(report, field, limits))
        pictures[f"layout_{field:g}deg.png"] = as_png(layout(report, field))
    if look is not None:
        colours = ColourPictures(report, look)
        pictures |= {f"colour_{field:g}deg.png": as_png(colours.figure(field)) for field in report}
    return pictures


def write_png(report: GhostReport, directory: str | Path, look: Look | None = None) -> list[Path]:
    """
    Write the pictures of `draw`.

    Parameters
    ----------
    report : GhostReport
    directory : str or Path
        Must exist.
    look : Look, optional
        See `draw`.

    Returns
    -------
    list of Path
        The files written.
    """
    return _write(draw(report, look), Path(directory))


def write_all(
    report: GhostReport,
    directory: str | Path,
    title: str = "scene",
    command: str = "",
    per_wavelength: bool = False,
    look: Look | None = None,
) -> list[Path]:
    """
    Write CSV, PNG, path-sort files (of the `PATHS_SORTED` strongest paths) and report.html.

    All files are made in a temporary directory, in the target or, where that is still to be made, beside it, and moved
    at the end, so that a failure leaves nothing half-written. Files of the same names are replaced, others are left
    alone.

    Parameters
    ----------
    report : GhostReport
    directory : str or Path
        Made if it is missing, with the directories above it.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.
    per_wavelength : bool
        Add tables of each wavelength, in the report and as CSV.
    look : Look, optional
        Add colour pictures, developed like this.

    Returns
    -------
    list of Path
        The files written.
    """
    target = writable_directory(directory)
    with _told(directory), draft_folder(_nearest_directory(target)) as draft:
        for field in report:
            mapped_paths(report, field)  # before the pictures, whose maps then come from the same run of the rays
        pictures = draw(report, look)
        drafts = [*write_csv(report, draft, per_wavelength), *_write(pictures, draft)]
        for field in report:
            path = draft / f"path_sort_{field:g}deg.txt"
            path.write_text(path_sort_text(report[field], PATHS_SORTED), encoding="utf-8")
            drafts.append(path)
        page = html_text(report, title, command, pictures, per_wavelength)
        drafts += _write({"report.html": page.encode()}, draft)
        target.mkdir(parents=True, exist_ok=True)
        claim_files(target / path.name for path in drafts)
        files = [path.replace(target / path.name) for path in drafts]
        written.extend(files)
        return files


def writable_directory(directory: str | Path) -> Path:
    """
    Check, without making anything, that a directory can be written, so that a long trace does not end in an error.

    Raises
    ------
    MistrayError
        The path is a file, it may not be written, or there is no room.
    """
    with _told(directory):
        target = Path(directory).expanduser().resolve()
        if target.exists() and not target.is_dir():
            raise MistrayError(f"output directory '{directory}' is a file; name a directory")
        with tempfile.TemporaryFile(dir=_nearest_directory(target)) as probe:
            probe.write(bytes(PROBE))
    return target


def write_files(files: Mapping[str, str | bytes], directory: str | Path) -> list[Path]:
    """
    Write finished files by name into one directory, all of them or none.

    Parameters
    ----------
    files : mapping of str to str or bytes
        Contents by file name; files of the same names are replaced.
    directory : str or Path
        Made if it is missing, with the directories above it; other files in it are left alone.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    MistrayError
        See `writable_directory`.
    """
    target = writable_directory(directory)
    with _told(directory):
        target.mkdir(parents=True, exist_ok=True)
    return replace_files({target / name: content for name, content in files.items()})


def csv_text(table: pd.DataFrame) -> str:
    """A table as CSV without its index, numbers with nine digits."""
    return str(table.to_csv(index=False, lineterminator="\n", float_format="%.9g"))


@contextlib.contextmanager
def _told(directory: str | Path) -> Iterator[None]:
    """Say in one line why a directory cannot be written."""
    try:
        yield
    except OSError as error:
        remedy = f"{FREE}, or choose another" if error.errno in NO_ROOM else "choose another"
        raise MistrayError(f"output directory '{directory}' cannot be written ({error.strerror}); {remedy}") from None


def _nearest_directory(path: Path) -> Path:
    """The path, or the nearest one above it that exists."""
    return next(place for place in (path, *path.parents) if place.exists())


def _write(pictures: dict[str, bytes], directory: Path) -> list[Path]:
    for name, png in pictures.items():
        (directory / name).write_bytes(png)
    return [directory / name for name in pictures]
