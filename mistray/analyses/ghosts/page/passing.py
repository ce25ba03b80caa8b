"""Section on probes and far fields in the report of a ghost analysis, if the scene has any."""

from __future__ import annotations

import functools
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from mistray.analyses.ghosts.result import GhostReport
from mistray.estimate import Estimate
from mistray.files.irradiance_files import LUX, IrradianceMap
from mistray.files.json_values import plain
from mistray.ids import free_name, plain_name
from mistray.recorders.flux_maps.far_field import FarField
from mistray.recorders.flux_maps.probe import Probe
from mistray.toolkit.irradiance import highest_cell
from mistray.toolkit.pages.model import FigurePart, Map, NotePart, PagePart, Section, Table, Value, columns

if TYPE_CHECKING:
    from mistray.toolkit.figures.figure import Figure as Drawing

RINGS_PRINTED = 6
NOTE = (
    "Light that crosses a probe along its normal, and light that leaves the scene by direction. The brightest pixel "
    "and the highest radiance are the largest of many numbers with noise: they are too high by a part of it."
)


def passing_section(report: GhostReport) -> Section | None:
    """Return the section on light at probes and far fields at each field angle; None if the scene has none."""
    parts: list[PagePart] = []
    probes, fields = list(report.recorded(Probe)), list(report.recorded(FarField))
    if not probes and not fields:
        return None
    if probes:
        parts += [_probes(probes), *(_map(field, probe) for field, probe in probes)]
    if fields:
        parts += [_rings(fields)]
        for name in dict.fromkeys(one.name for _, one in fields):
            of_name = [(field, one) for field, one in fields if one.name == name]
            parts.append(FigurePart(functools.partial(_draw, name, of_name), f"Far field '{name}'."))
    return Section("probes", "Probes and far fields", [NotePart(NOTE), *parts], "Probes")


def passing_maps(report: GhostReport, taken: Collection[str]) -> dict[str, IrradianceMap]:
    """
    Return the irradiance on probes, W/mm², by file name without suffix; none is in `taken`.

    If the report is photometric, the illuminance, lx, is there as well.
    """
    maps: dict[str, IrradianceMap] = {}
    for field, probe in report.recorded(Probe):
        name = free_name(f"irradiance_{plain_name(probe.name)}", f"_{field:g}deg", {*maps, *taken})
        facts = plain({"probe": probe.name, **report[field].settings})
        maps[name] = IrradianceMap(*probe.irradiance, probe.extent, facts)
        if report.photometric:
            maps[name.replace("irradiance", "illuminance", 1)] = IrradianceMap(
                *probe.illuminance, probe.extent, facts, LUX
            )
    return maps


def _draw(name: str, found: list[tuple[float, FarField]]) -> Drawing:
    # Printed tables come from the same section and need no Matplotlib
    from mistray.analyses.ghosts.figures.far_field import far_field_figure

    return far_field_figure(name, found)


def _probes(found: list[tuple[float, Probe]]) -> Table:
    rows: list[list[Value]] = []
    for field, probe in found:
        brightest, peak = highest_cell(*probe.irradiance)
        x0, x1, y0, y1 = probe.extent
        power, area, shape = Estimate(*probe.power), (x1 - x0) * (y1 - y0), probe.irradiance[0].shape
        place = [
            f"{low + (k + 0.5) * (high - low) / count:.4g}"
            for k, low, high, count in zip(reversed(brightest), (x0, y0), (x1, y1), reversed(shape), strict=True)
        ]
        radiance: Value = "–"
        if probe.directions > 1:
            _, radiance = highest_cell(*probe.radiance)
        rows.append([f"{field:g}", probe.name, power, power.times(1 / area), peak, *place, radiance])
    heads = columns(
        "field [deg]", "<probe", "power [W]", "mean irradiance [W/mm²]", "brightest pixel [W/mm²]", "at x [mm]",
        "at y [mm]", "highest radiance [W/(mm² sr)]",
    )  # fmt: skip
    table = Table(heads, rows, "probes")
    return table if any(probe.directions > 1 for _, probe in found) else table.without("highest radiance")


def _map(field: float, probe: Probe) -> Map:
    title = f"Irradiance at '{probe.name}', field {field:g}°"
    return Map(probe.irradiance[0], probe.extent, title, name=f"{probe.name} {field:g} deg")


def _rings(found: list[tuple[float, FarField]]) -> Table:
    rows: list[list[Value]] = []
    for field, one in found:
        value, se = one.intensity
        edges = one.edges_deg
        for row, column in np.ndindex(value.shape):
            turns = [f"{360 * (column + k) / one.azimuths:g}" for k in (0, 1)]
            cell = [f"{edges[row]:g}", f"{edges[row + 1]:g}", *turns]
            rows.append([f"{field:g}", one.name, *cell, Estimate(float(value[row, column]), float(se[row, column]))])
    heads = columns(
        "field [deg]", "<far field", "from [deg]", "to [deg]", "azimuth from [deg]", "azimuth to [deg]",
        "intensity [W/sr]",
    )  # fmt: skip
    rest = ["", f"{len(rows)} cells in all", *[""] * 5]
    return Table(heads, rows, "far_fields", most=RINGS_PRINTED, rest=rest, fold="Radiant intensity by cell")
