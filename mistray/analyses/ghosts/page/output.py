"""Files of a ghost analysis: all of them are written into a directory, or none."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from mistray.analyses.ghosts.colour import ColourPictures
from mistray.analyses.ghosts.figures.ghost_images import ghost_image, levels_against_field, montage
from mistray.analyses.ghosts.page.fields import mapped_paths
from mistray.analyses.ghosts.page.light_maps import light_map_figures, light_map_files
from mistray.analyses.ghosts.page.passing import passing_maps
from mistray.analyses.ghosts.page.record import record
from mistray.analyses.ghosts.page.report import ghosts_report
from mistray.analyses.ghosts.page.surface_maps import surface_map_figures, surface_map_files
from mistray.analyses.ghosts.path_sort_text import path_sort_text
from mistray.analyses.ghosts.request import MAIN_TABLES, GhostTables, Look
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.tables.ghosts_csv import csv_tables, further_tables
from mistray.analyses.ghosts.verdict import brightest_field, most_stray
from mistray.files.irradiance_files import LUX, IrradianceMap
from mistray.files.ray_sets import RaySet
from mistray.time_budget import coarse_first, is_limited, left
from mistray.toolkit.drawings.section_layout import layout
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.formats import pdf_name
from mistray.toolkit.pages.model import Report
from mistray.toolkit.pages.output import write_files, write_report
from mistray.toolkit.pages.pdf import pdf_bytes

PATHS_SORTED = 1000  # paths in a path-sort file

# Time of the page for each field, and of what shows all fields together, in that of the pictures of one field
PAGE, OVERVIEW = 0.55, 0.8
FIELD = 3.0  # s, what the pictures of one field take at least


def draw(report: GhostReport, look: Look | None = None) -> tuple[dict[str, bytes], GhostReport]:
    """
    Draw a ghost analysis as PNG pictures, and return them with the fields that they show.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    look : Look, optional
        Settings of the colour pictures; without them there are none.

    Returns
    -------
    pictures : dict
        PNG bytes by file name: overview.png, overview_common.png, levels.png and, for each field,
        ghosts_<field>deg.png and layout_<field>deg.png. With recorded light on surfaces surface_maps_<field>deg.png,
        with maps of parts of the light light_maps_<field>deg.png, and with a look colour_<field>deg.png.
    shown : GhostReport
        Report on the fields drawn: all, or within a time budget as many as it allows, the worst first. If it allows
        none, levels.png is the only picture.
    """
    pictures = {"levels.png": as_png(levels_against_field(report))}  # first, so that the first field is not slower
    drawn: list[float] = []
    took = FIELD  # s, the pictures of one field
    for field in _in_order(report):
        rest = PAGE * (1 + len(drawn)) + OVERVIEW
        if left() < (1 + rest) * took:
            break
        began = time.perf_counter()
        mapped_paths(report, field)  # before the pictures, whose maps then come from the same run of the rays
        own = {
            f"ghosts_{field:g}deg.png": as_png(ghost_image(report, field), of_maps=True),
            f"layout_{field:g}deg.png": as_png(layout(report, field)),
        }
        took = max(took, time.perf_counter() - began)
        if left() < rest * took:
            break
        pictures |= own
        drawn.append(field)
    shown = report.of({field: report[field] for field in report if field in drawn})
    if not drawn:
        return pictures, shown
    pictures["overview.png"] = as_png(montage(shown), of_maps=True)
    pictures["overview_common.png"] = as_png(montage(shown, common=True), of_maps=True)
    pictures |= {name: as_png(figure) for name, figure in surface_map_figures(shown).items()}
    pictures |= {name: as_png(figure) for name, figure in light_map_figures(shown).items()}
    if look is not None:
        colours = ColourPictures(shown, look)
        pictures |= {f"colour_{field:g}deg.png": as_png(colours.figure(field)) for field in shown}
    return pictures, shown


def _in_order(report: GhostReport) -> list[float]:
    """Return the field angles, degrees, in the order in which pictures are drawn; short of time, the worst first."""
    if not is_limited():
        return list(report)
    worst = [field for field in (most_stray(report), brightest_field(report)) if field is not None]
    return list(dict.fromkeys([*worst, *coarse_first(list(report))]))


def write_png(report: GhostReport, directory: str | Path, look: Look | None = None) -> list[Path]:
    """
    Write the pictures of `draw` as PNG files into a directory.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    directory : str or Path
        Created if it is missing.
    look : Look, optional
        See `draw`.

    Returns
    -------
    list of Path
        The files written.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> files = mistray.report.write_png(report, "pictures")
    >>> [file.name for file in files[:3]]
    ['levels.png', 'ghosts_0deg.png', 'layout_0deg.png']
    """
    return write_files(draw(report, look)[0], directory)


def write_all(
    report: GhostReport,
    directory: str | Path,
    title: str = "scene",
    command: str = "",
    per_wavelength: bool = False,
    look: Look | None = None,
    pdf: bool = False,
) -> list[Path]:
    """
    Write CSV, ghosts.json, PNG, path-sort files (of the `PATHS_SORTED` strongest paths) and report.html.

    All or none are written, see `mistray.toolkit.pages.output.write_report`. Files of the same names are replaced, and
    files that only an earlier report had are removed; other files are left alone. Within a time budget, see `draw`,
    fields that are not drawn appear in the tables alone; if none can be drawn, the page has the tables and the
    levels.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    directory : str or Path
        Created if it is missing, with its parents.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.
    per_wavelength : bool
        Add tables of each wavelength, in the report and as CSV.
    look : Look, optional
        Settings of the colour pictures; without them there are none.
    pdf : bool
        Whether report.pdf is written as well.

    Returns
    -------
    list of Path
        The files written.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> files = mistray.report.write_all(report, "ghosts", title="Cooke triplet")
    >>> sorted(file.name for file in files if file.suffix == ".csv")
    ['energy.csv', 'paths.csv', 'stray_levels.csv', 'summary.csv', 'surfaces.csv']
    """
    made = page(report, GhostTables(per_wavelength=per_wavelength, colour=look is not None, look=look), title, command)
    if pdf:
        made = replace(made, files={**made.files, pdf_name(made.page): pdf_bytes(made)})
    return write_report(made, directory)


def page(report: GhostReport, shown: GhostTables = MAIN_TABLES, title: str = "scene", command: str = "") -> Report:
    """
    Return the report with its tables, pictures and path-sort files; `shown` names the optional ones of them.

    The other arguments are those of `write_all`. Within a time budget, see `draw`, it shows as many fields as time
    allows.
    """
    tables = csv_tables(report, shown.per_wavelength) | further_tables(report, shown)
    pictures, drawn = draw(report, shown.developed)
    sorts = {f"path_sort_{field:g}deg.txt": path_sort_text(report[field], PATHS_SORTED) for field in drawn}
    rays = tables["rays_at.csv"].groupby("field_deg") if shown.rays_at else ()
    return replace(
        ghosts_report(report, title, command, pictures, shown.per_wavelength, drawn),
        csv=tables,
        json={"ghosts.json": {"title": title, "command": command} | record(report, shown)},
        files={**pictures, **sorts},
        in_full=True,
        maps=_maps(report),
        rays={f"rays_at_{field:g}deg": RaySet.of_table(own) for field, own in rays if own.flux_W.sum() > 0},
    )


def _maps(report: GhostReport) -> dict[str, IrradianceMap]:
    """Return irradiance, W/mm², or illuminance, lx, on detectors, probes and walls, by file name without suffix."""
    maps = {f"irradiance_{field:g}deg": IrradianceMap.of(t) for field, t in report.items()}
    if report.photometric:
        maps |= {f"illuminance_{field:g}deg": IrradianceMap.of(t, LUX) for field, t in report.items()}
    for more in (passing_maps, surface_map_files, light_map_files):
        maps |= more(report, maps)
    return maps
