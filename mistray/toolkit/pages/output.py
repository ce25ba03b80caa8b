"""Writing of reports into a folder, completely or not at all."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd

from mistray.errors import MistrayError
from mistray.replace_file import FREE, NO_ROOM, replace_files
from mistray.replace_folder import replacing_folder
from mistray.toolkit.pages.model import Report

PROBE = 1 << 16  # bytes for which there must be room


def writable_directory(directory: str | Path) -> Path:
    """
    Return the absolute path of a folder, checked to be writable before a long trace. It is not created.

    Raises
    ------
    MistrayError
        If the path is empty, a file, in a circle of links or not writable, or its disk is full.

    Examples
    --------
    >>> mistray.report.writable_directory("results").name
    'results'
    """
    with told(directory):
        if not str(directory):
            raise MistrayError("output directory '' has no name; name a directory, or '.' for the current one")
        target = Path(os.path.realpath(Path(directory).expanduser()))
        if any(place.is_symlink() for place in (target, *target.parents)):  # what is left of a circle of links
            raise MistrayError(f"output directory '{directory}' is a link that leads to itself; name a directory")
        if target.exists() and not target.is_dir():
            raise MistrayError(f"output directory '{directory}' is a file; name a directory")
        with tempfile.TemporaryFile(dir=nearest_directory(target)) as probe:
            probe.write(bytes(PROBE))
    return target


def write_files(files: Mapping[str, str | bytes], directory: str | Path) -> list[Path]:
    """
    Write finished files by name into one folder, all or none; see `mistray.replace_folder`.

    Parameters
    ----------
    files : mapping of str to str or bytes
        Contents by file name; files of the same names are replaced.
    directory : str or Path
        Folder, created with its parents if missing; other files in it are left unchanged.

    Returns
    -------
    list of Path
        Written files.

    Raises
    ------
    MistrayError
        If the folder or a file cannot be written, see `writable_directory`, or may not be replaced.
    """
    target = writable_directory(directory)
    with told(directory), replacing_folder(target):
        return replace_files({target / name: content for name, content in files.items()})


def write_report(report: Report, directory: str | Path, scene: str = "") -> list[Path]:
    """
    Write the tables of a report as CSV, its values as JSON, its pictures and its page, all or none.

    Parameters
    ----------
    report : Report
        Report to write.
    directory : str or Path
        Folder, created with its parents if missing; other files in it are left unchanged.
    scene : str
        Text of a scene.xml to write as well; empty: none.

    Returns
    -------
    list of Path
        Written files; the scene is first, the page last.

    Raises
    ------
    MistrayError
        If the folder or a file cannot be written, or may not be replaced. Also if a table in a section that a user
        added has no name, or one that is taken.
    """
    from mistray.toolkit.pages.own_sections import with_own_sections
    from mistray.toolkit.pages.render import html_page

    report = with_own_sections(report)
    files: dict[str, str | bytes] = {"scene.xml": scene} if scene else {}
    files |= {name: csv_text(table, report.in_full) for name, table in report.csv.items()}
    files |= {name: json.dumps(values, indent=1, allow_nan=False) + "\n" for name, values in report.json.items()}
    return write_files({**files, **report.files, report.page: html_page(report)}, directory)


def csv_text(table: pd.DataFrame, in_full: bool = False) -> str:
    """Return a table as CSV without its index, numbers with all digits if `in_full`, else with nine."""
    return str(table.to_csv(index=False, lineterminator="\n", float_format=None if in_full else "%.9g"))


@contextlib.contextmanager
def told(directory: str | Path) -> Iterator[None]:
    """Turn an `OSError` in a `with` block into a `MistrayError` that says why the folder cannot be written."""
    try:
        yield
    except OSError as error:
        remedy = f"{FREE}, or choose another" if error.errno in NO_ROOM else "choose another"
        raise MistrayError(f"output directory '{directory}' cannot be written ({error.strerror}); {remedy}") from None


def nearest_directory(path: Path) -> Path:
    """Return an absolute path itself if it exists, else its nearest existing parent."""
    return next(place for place in (path, *path.parents) if place.exists())
