"""Section on the irradiance on walls in the report of a ghost analysis, if the scene records any."""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from mistray.analyses.ghosts.result import GhostReport
from mistray.estimate import Estimate
from mistray.files.irradiance_files import LUX, IrradianceMap
from mistray.files.json_values import plain
from mistray.ids import free_name, plain_name
from mistray.recorders.flux_maps.surface_maps import SurfaceMap, SurfaceMaps
from mistray.toolkit.irradiance import highest_cell
from mistray.toolkit.pages.model import FigurePart, NotePart, PagePart, Section, Table, Value, columns

if TYPE_CHECKING:
    from mistray.toolkit.figures.figure import Figure as Drawing

DRAWN = 9  # surfaces in a picture, the brightest ones
ROWS_PRINTED = 8
NOTE = (
    "Light that meets surfaces, by place on them; what comes back counts again. The brightest cell is the largest of "
    "many numbers with noise: it is too high by a part of it."
)


def surface_maps_section(report: GhostReport) -> Section | None:
    """Return the section on light that surfaces received at each field, brightest first; None if nothing records it."""
    found = [(field, own) for field in report if (own := brightest(report, field))]
    if not found:
        return None
    parts: list[PagePart] = [NotePart(NOTE), _table(found)]
    for field, own in found:
        lit = [one for one in own[:DRAWN] if one.power[0] > 0]
        if lit:
            drawn = f"the {len(lit)} brightest of {len(own)} surfaces" if len(lit) < len(own) else "all surfaces"
            parts.append(FigurePart(functools.partial(_draw, lit), f"Field {field:g}°: {drawn}, unrolled."))
    return Section("walls", "Light on walls", parts, "Walls")


def surface_map_files(report: GhostReport, taken: Collection[str]) -> dict[str, IrradianceMap]:
    """
    Return irradiance maps of recorded surfaces, W/mm², by file name without suffix; none is in `taken`.

    If the report is photometric, illuminance maps, lx, are there as well.
    """
    files: dict[str, IrradianceMap] = {}
    for field, recorder in report.recorded(SurfaceMaps):
        lux = recorder.illuminance if report.photometric else {}
        for one in recorder.maps.values():
            base = f"irradiance_{plain_name(f'{recorder.name}_{one.surface}')}"
            name = free_name(base, f"_{field:g}deg", {*files, *taken})
            facts = plain({"surface": one.surface, "part": one.part, **_axes(one), **report[field].settings})
            files[name] = IrradianceMap(*one.irradiance, one.unrolled_mm, facts)
            if one.surface in lux:
                found = lux[one.surface]
                files[name.replace("irradiance", "illuminance", 1)] = IrradianceMap(*found, one.unrolled_mm, facts, LUX)
    return files


def surface_map_figures(report: GhostReport) -> dict[str, Drawing]:
    """Return drawings of up to nine surfaces of each field, the brightest ones, by file name."""
    own = {field: [one for one in brightest(report, field)[:DRAWN] if one.power[0] > 0] for field in report}
    return {f"surface_maps_{field:g}deg.png": _draw(lit) for field, lit in own.items() if lit}


def brightest(report: GhostReport, field: float) -> list[SurfaceMap]:
    """
    Return the maps of recorded surfaces at a field angle, degrees, by highest irradiance first.

    It is empty if nothing records them.
    """
    maps = [one for at, recorder in report.recorded(SurfaceMaps) if at == field for one in recorder.maps.values()]
    return sorted(maps, key=lambda one: -float(one.irradiance[0].max()))


def _axes(one: SurfaceMap) -> dict[str, object]:
    """Return names and ranges (mm or degrees) of the axes of a map and the areas of its cells, mm², by JSON key."""
    return {
        "across": one.across,
        f"across_{'deg' if one.across == 'azimuth' else 'mm'}": [one.across_borders[0], one.across_borders[-1]],
        "along": one.along,
        "along_mm": [one.along_mm[0], one.along_mm[-1]],
        "areas_mm2": one.areas,
    }


def _draw(maps: Sequence[SurfaceMap]) -> Drawing:
    # Printed tables come from the same section and need no Matplotlib
    from mistray.analyses.ghosts.figures.surface_maps import surface_maps_figure

    return surface_maps_figure(maps)


def _table(found: Sequence[tuple[float, Sequence[SurfaceMap]]]) -> Table:
    rows: list[list[Value]] = []
    for field, maps in found:
        for one in maps:
            cell, peak = highest_cell(*one.irradiance)
            place = [f"{v + 0.0:.4g}" for v in one.places[cell].round(9)]
            area = float(one.areas.sum()) * one.irradiance[0].shape[1]
            powers = Estimate(*one.power), Estimate(*one.absorbed_power), Estimate(*(part / area for part in one.power))
            rows.append([f"{field:g}", one.surface, *powers, peak, *place])
    heads = columns(
        "field [deg]", "<surface", "incident [W]", "absorbed [W]", "mean irradiance [W/mm²]", "brightest cell [W/mm²]",
        "at x [mm]", "at y [mm]", "at z [mm]",
    )  # fmt: skip
    rest = ["", f"{len(rows)} rows in all", *[""] * 7]
    return Table(heads, rows, "surface_maps", most=ROWS_PRINTED, rest=rest)
