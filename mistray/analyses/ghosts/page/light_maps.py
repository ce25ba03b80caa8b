"""Section on maps of parts of the light in the report of a ghost analysis, if any were requested."""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from mistray.analyses.ghosts.maps.light_maps import LightMap
from mistray.analyses.ghosts.result import GhostReport
from mistray.files.irradiance_files import IrradianceMap
from mistray.files.json_values import plain
from mistray.ids import free_name, plain_name
from mistray.toolkit.pages.model import FigurePart, NotePart, PagePart, Section, Table, Value, columns

if TYPE_CHECKING:
    from mistray.toolkit.figures.figure import Figure as Drawing

DRAWN = 12  # maps in a picture
ROWS_PRINTED = 12
NAME_LETTERS = 48  # of a selection in the name of a file
NOTE = (
    "Parts of the light by place: what the detector absorbs of them, and what arrives at other surfaces. A part may be "
    "in another one. The brightest cell is the largest of many numbers with noise: it is too high by a part of it."
)


def light_maps_section(report: GhostReport) -> Section | None:
    """Return the section with the irradiance maps of parts of the light at each field; None if none were requested."""
    found = {field: report.light_maps[field] for field in report if field in report.light_maps}
    if not found:
        return None
    parts: list[PagePart] = [NotePart(NOTE), _table(found)]
    for field, maps in found.items():
        lit = _drawn(maps)
        if lit:
            drawn = f"{len(lit)} of {len(maps)} maps" if len(lit) < len(maps) else "all maps"
            parts.append(FigurePart(functools.partial(_draw, lit), f"Field {field:g}°: {drawn}."))
    return Section("light", "Parts of the light", parts, "Parts")


def light_map_files(report: GhostReport, taken: Collection[str]) -> dict[str, IrradianceMap]:
    """Return irradiance maps, W/mm², of parts of the light, by file name without suffix; none is in `taken`."""
    files: dict[str, IrradianceMap] = {}
    for field in report:
        detectors = set(report[field].detectors)
        for one in report.light_maps.get(field, ()):
            where = "" if one.surface in detectors else f"_{one.surface}"
            base = plain_name(f"{one.selection[:NAME_LETTERS]}{where}")
            name = free_name(f"irradiance_{base}", f"_{field:g}deg", {*files, *taken})
            facts = plain({"light": one.selection, "surface": one.surface, **report[field].settings})
            files[name] = IrradianceMap(one.irradiance, one.se, one.unrolled_mm, facts)
    return files


def light_map_figures(report: GhostReport) -> dict[str, Drawing]:
    """Return drawings of the irradiance maps of parts of the light, one per field, by file name."""
    own = {field: _drawn(report.light_maps.get(field, ())) for field in report}
    return {f"light_maps_{field:g}deg.png": _draw(lit) for field, lit in own.items() if lit}


def _drawn(maps: Sequence[LightMap]) -> list[LightMap]:
    """Return the maps with most light, twelve at most, in their original order."""
    lit = sorted((one for one in maps if one.power.value > 0), key=lambda one: -one.power.value)[:DRAWN]
    return [one for one in maps if any(one is other for other in lit)]


def _draw(maps: Sequence[LightMap]) -> Drawing:
    # Printed tables come from the same section and need no Matplotlib
    from mistray.analyses.ghosts.figures.surface_maps import Panel, panels_figure

    return panels_figure(
        [
            Panel(f"{one.selection}, on {one.surface}", one.irradiance, *axes)
            for one in maps
            for axes in [(one.across, one.along, one.across_borders, one.along_borders)]
        ],
        "each on a scale of its own; grey: less than the scale, or no ray",
    )


def _table(found: dict[float, list[LightMap]]) -> Table:
    rows: list[list[Value]] = []
    for field, maps in found.items():
        for one in maps:
            peak, across, along = one.peak
            unit = "°" if one.across == "azimuth" else " mm"
            place = f"{one.across} {across:.4g}{unit}, {one.along} {along:.4g} mm" if peak.value > 0 else "–"
            rows.append([f"{field:g}", one.selection, one.surface, one.power, peak, place])
    heads = columns("field [deg]", "<light", "<surface", "power [W]", "brightest cell [W/mm²]", "<at")
    rest = ["", f"{len(rows)} rows in all", *[""] * 4]
    return Table(heads, rows, "light_maps", most=ROWS_PRINTED, rest=rest)
