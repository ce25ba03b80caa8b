"""Report page, tables and pictures of `mistray pst`, all written into one folder or none."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from mistray.analyses.pst.causes import (
    GHOSTS,
    REFLECTS,
    STRAIGHT_SHOTS,
    MainCause,
    breaks,
    cause_frame,
    field_edge,
    main_cause,
)
from mistray.analyses.pst.figures import pst_causes, pst_curve, pst_irradiance, pst_map
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.tables import (
    DEFINITIONS,
    DENOMINATOR,
    breaks_table,
    cell_frame,
    curve_frame,
    curve_table,
    heading,
    name_of,
    path_frame,
    paths_table,
    pst_record,
    shown_classes,
)
from mistray.files.irradiance_files import IrradianceMap
from mistray.ranges import FINITE, Each, Several
from mistray.time_budget import can_draw
from mistray.toolkit.figures.figure import Figure as Drawing
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import FigurePart, Hover, Items, NotePart, Report, Section
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section, terms, thousands, version_settings
from mistray.toolkit.tables.frames import flat
from mistray.toolkit.tables.text import ABSENT, number, plain_sentences, with_error

CURVE = "PST of all light, of the stray light and of each class; below, relative standard errors."
CAUSES = "Where the stray light comes from: first surface that scatters it; ghosts are light only reflected."
PLACES = Several(Each(FINITE, 2), least=0)
MAP = "PST over field angle and azimuth; the point of a map is the direction in which the light travels."
DETECTOR = "Irradiance on the detector from a distant source of 1 W/mm² across its beam, each on its own scale."


def draw(pst: Pst, title: str = "", maps_at: Sequence[tuple[float, float]] = ()) -> dict[str, bytes]:
    """
    Return all pictures of a PST as PNG bytes, by file name.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    title : str
        Name of the optical system.
    maps_at : sequence of (float, float)
        Field angles and azimuths of the maps of the detector, degrees.

    Returns
    -------
    dict
        pst.png; pst_causes.png if there are paths; pst_map.png with several azimuths; irradiance_<angle>deg.png, or
        irradiance_<angle>deg_<azimuth>deg.png with several azimuths. Within a time budget only as many as time allows.
    """
    drawn: dict[str, Callable[[], Drawing]] = {"pst.png": lambda: pst_curve(pst, title)}
    if pst.path_rows is not None:
        drawn["pst_causes.png"] = lambda: pst_causes(pst, title)
    if pst.grid.shape[1] > 1:
        drawn["pst_map.png"] = lambda: pst_map(pst, title)
    for place in PLACES.check("maps_at", maps_at):
        drawn[f"{map_name(pst, *place)}.png"] = functools.partial(pst_irradiance, pst, *place)
    return {name: as_png(figure()) for name, figure in drawn.items() if can_draw()}


def map_name(pst: Pst, field_deg: float, azimuth_deg: float) -> str:
    """Return the file name, without suffix, of the irradiance map for a source direction in degrees."""
    return f"irradiance_{field_deg:g}deg{f'_{azimuth_deg:g}deg' if pst.grid.shape[1] > 1 else ''}"


def irradiance_maps(pst: Pst, maps_at: Sequence[tuple[float, float]], command: str) -> dict[str, IrradianceMap]:
    """
    Return irradiance maps of the detector, W/mm² for 1 W/mm² across the beam, by file name without suffix.

    `maps_at` are field angles and azimuths, degrees; `command` is a command line to be kept with them.
    """
    return {
        map_name(pst, *at): IrradianceMap(
            *pst.irradiance(*at),
            pst.extent_mm,
            {"command": command, "angle_deg": at[0], "azimuth_deg": at[1], "source_W_mm2": 1.0},
        )
        for at in PLACES.check("maps_at", maps_at)
    }


def csv_tables(pst: Pst) -> dict[str, pd.DataFrame]:
    """
    Return the CSV tables of a PST as DataFrames, by file name.

    The table pst.csv has a row for each field angle, and pst_paths.csv one for each path of each cell. With several
    azimuths pst_cells.csv has a row for each angle and azimuth.
    """
    tables = {"pst.csv": curve_frame(pst)}
    if pst.grid.shape[1] > 1:
        tables["pst_cells.csv"] = cell_frame(pst)
    if pst.path_rows is not None:
        tables["pst_paths.csv"] = path_frame(pst)
    return tables


def write_pst(
    pst: Pst,
    directory: str | Path,
    title: str = "scene",
    command: str = "",
    paths_shown: int = 4,
    maps_at: Sequence[tuple[float, float]] = (),
) -> list[Path]:
    """
    Write the tables of `csv_tables`, the pictures of `draw`, pst.json and report.html.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    directory : str or Path
        Created if it is missing, with its parents; other files in it are left alone.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.
    paths_shown : int
        Number of strongest stray paths of each angle in the report and in pst.json.
    maps_at : sequence of (float, float)
        See `draw`.

    Returns
    -------
    list of Path
        The files written.

    Examples
    --------
    >>> pst = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> files = mistray.report.write_pst(pst, "pst", title="Lens and window")
    >>> [file.name for file in files]
    ['pst.csv', 'pst_paths.csv', 'pst.json', 'pst.png', 'pst_causes.png', 'report.html']
    """
    return write_report(pst_report(pst, title, command, paths_shown, maps_at), directory)


def pst_report(
    pst: Pst,
    title: str = "scene",
    command: str = "",
    paths_shown: int = 4,
    maps_at: Sequence[tuple[float, float]] = (),
) -> Report:
    """Return the report of a PST; for the arguments see `write_pst`."""
    pictures = draw(pst, title, maps_at)
    detector = [FigurePart(png, "", name[:-4]) for name, png in pictures.items() if name.startswith("irradiance_")]
    has_paths = pst.path_rows is not None and paths_shown > 0
    sections = [Section("curve", "Curve", [curve_figure(pst, title)], "Curve")]
    if has_paths:
        found, parts = breaks(pst), [causes_figure(pst, title)]
        bends = [NotePart("Breaks of the curve of stray light", "h3"), breaks_table(found)] if found else []
        sections.append(Section("causes", "Causes", [*parts, *bends], "Causes"))
    if "pst_map.png" in pictures:
        drawn = FigurePart(pictures["pst_map.png"], MAP, "PST over field angle and azimuth")
        sections.append(Section("map", "Map", [drawn], "Map"))
    if detector:
        sections.append(Section("detector", "Detector", [NotePart(DETECTOR), *detector], "Detector"))
    sections.append(Section("table", "Table", [NotePart(f"{DEFINITIONS[pst.convention]}."), curve_table(pst)], "Table"))
    if has_paths:
        text = f"The {paths_shown} strongest stray paths of each angle; {DENOMINATOR}. "
        text += "All that were kept are in pst_paths.csv."
        sections.append(Section("paths", "Paths", [NotePart(text), paths_table(pst, paths_shown)], "Paths"))
    definition, run = heading(pst).splitlines()
    return Report(
        "Point source transmittance",
        title,
        [*sections, settings_section(pst_facts(pst), command, terms("pst"), link="Definitions and settings")],
        lead=[NotePart(Markup("{}.<br>{}.").format(definition, run), "sub"), Items(pst_verdict(pst), "verdict")],
        warnings=pst.notes,
        tab="PST",
        scripts=("report", "hover"),
        csv=csv_tables(pst),
        json={"pst.json": {"title": title, "command": command} | pst_record(pst, paths_shown)},
        result=pst,
        files=pictures,
    )


def pst_facts(pst: Pst) -> dict[str, Any]:
    """Return settings and facts of a PST computation, such as convention, method and versions, for its report."""
    shown: dict[str, Any] = {"convention": pst.convention, "method": pst.method}
    for key, value in pst.facts.items():
        if isinstance(value, dict):
            shown |= {f"{key}: {name}": item for name, item in value.items()}
        elif key != "notes":
            shown[key] = thousands(value) if key in ("rays", "segments") else value
    return shown | version_settings()


def pst_verdict(pst: Pst) -> list[str]:
    """
    Return sentences on the PST and stray light by angle, its main cause, and the stray light without that cause.

    Without light one sentence says so, and without a main cause the sentences on it are left out.
    """
    found = None if pst.is_dark else main_cause(pst)
    return [_finding(pst), *([] if found is None else _change(found))]


def _change(found: MainCause) -> list[str]:
    percent = with_error(found.percent, 1)
    of = Markup("{} % of the stray light from a uniform sky").format(percent)
    if found.cause == GHOSTS:
        first = Markup("Change first what reflects the <b>ghosts</b>: they are {}.").format(of)
    elif found.cause == STRAIGHT_SHOTS:
        first = Markup("Block the <b>straight shots</b> first: {} is neither scattered nor reflected.").format(of)
    else:
        deed = "reflected" if found.cause.endswith(REFLECTS) else "first scattered"
        name = found.cause.removesuffix(REFLECTS)
        first = Markup("Change <b>{}</b> first: {} is {} there.").format(name, of, deed)
    values = (with_error(found.stray, 1), with_error(found.left, 1) if found.left.value else "0")
    return [first, f"Without that light the stray PST at {found.field_deg:g}° falls from {values[0]} to {values[1]}."]


def pst_verdict_record(pst: Pst) -> dict[str, Any]:
    """Return the verdict and its numbers as JSON-serialisable values."""
    record: dict[str, Any] = {"sentences": plain_sentences(pst_verdict(pst)), "main_cause": None}
    found = None if pst.is_dark else main_cause(pst)
    if found is not None:
        record["main_cause"] = flat(
            {
                "cause": found.cause,
                "percent_of_stray": found.percent,
                "field_deg": found.field_deg,
                "pst_stray": found.stray,
                "pst_left": found.left,
            }
        )
    return record


def _finding(pst: Pst) -> str:
    """
    Return a sentence on the PST at the first angle, the edge of the field, and the stray PST beyond it.

    Without an edge the stray PST is that of all angles. Without light the sentence says so.
    """
    if pst.is_dark:
        return "No light was seen at any angle."
    angles, stray = pst.field_deg, pst.estimates("stray")
    first = Markup("PST({:g}°) = <b>{}</b>").format(angles[0], with_error(pst.estimates()[0]))
    edge = field_edge(pst)
    if edge is not None:
        first += f", edge of the field at {edge:.1f}°"
    outside = angles > (edge if edge is not None else -1.0)
    lit = pst.stray > 0
    if not (outside & lit).any():
        return first + "."
    shown = (outside & lit).nonzero()[0][[0, -1]]
    values = [f"{with_error(stray[i])} at {angles[i]:g}°" for i in shown]
    where = "beyond it" if edge is not None else "over all angles"
    return first + f". Stray light {where}: {' to '.join(dict.fromkeys(values))}."


def curve_figure(pst: Pst, title: str = "") -> FigurePart:
    """Return the picture of the PST curve, whose values appear under the pointer."""
    curves = {"all light": pst.estimates(), "stray light": pst.estimates("stray")}
    curves |= {name_of(group): pst.estimates(group) for group in shown_classes(pst)}
    texts = ([(name, with_error(at) if at.value else ABSENT) for at in curve] for name, curve in curves.items())
    values = list(zip(*texts, strict=True))
    hover = Hover("data-curve", list(pst.field_deg), [f"PST at {angle:g}°" for angle in pst.field_deg], values)
    return FigurePart(functools.partial(pst_curve, pst, title), CURVE, hover=hover)


def causes_figure(pst: Pst, title: str = "") -> FigurePart:
    """Return the picture of the causes of stray light, with their shares in percent shown under the pointer."""
    values = [
        [(str(name), f"{number(float(share), 3)} %") for name, share in row.items() if share > 0]
        for _, row in cause_frame(pst).iterrows()
    ]
    titles = [f"stray light at {angle:g}°" for angle in pst.field_deg]
    hover = Hover("data-causes", list(pst.field_deg), titles, values)
    return FigurePart(functools.partial(pst_causes, pst, title), CAUSES, hover=hover)
