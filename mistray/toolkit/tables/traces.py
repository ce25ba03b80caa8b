"""Tables of traces: paths, energy ledger, flux at surfaces, recorded rays."""

from __future__ import annotations

from mistray.estimate import Estimate
from mistray.toolkit.pages.model import Table, Value, columns
from mistray.toolkit.tables.frames import chosen
from mistray.toolkit.tables.text import number
from mistray.trace.energy import Energy, FluxReport
from mistray.trace.history import RayHistory
from mistray.trace.paths import PathTable
from mistray.trace.result import Trace

RAY_COLUMNS = {
    "ray": "ray",
    "node": "node",
    "intercept": "<event",
    "surface": "<surface",
    "x_mm": "x [mm]",
    "y_mm": "y [mm]",
    "z_mm": "z [mm]",
    "opl_mm": "optical path [mm]",
    "flux_W": "flux [W]",
}


def trace_table(trace: Trace) -> Table:
    """Return the table of the paths of a trace, the strongest first, or without paths its energy ledger."""
    return paths_table(trace.paths) if trace.has_paths else energy_table(trace.energy)


def paths_table(paths: PathTable) -> Table:
    """Return the table of paths: id, name, kind, power absorbed by the detectors, W, percent of all light, rays."""
    names = ("path_id", "label", "kind", "power_W", "power_se_W", "percent", "rays")
    values = zip(*(paths.column(name).tolist() for name in names), strict=True)
    rows: list[list[Value]] = [
        [path_id, label, kind, Estimate(power, se), number(percent, 3), rays]
        for path_id, label, kind, power, se, percent, rays in values
    ]
    heads = columns("id", "<path", "<kind", "power [W absorbed]", "of all light [%]", "rays")
    return Table(heads, rows, empty="no path reaches a detector")


def ledger(energy: Energy) -> dict[str, Estimate]:
    """
    Return the parts of the launched flux by destination, W: detectors, surfaces, media, outside and cuts.

    Each group has its largest part first; parts that are 0 are left out. The errors of cuts are NaN.
    """
    unknown = float("nan")
    groups = (
        {f"detected by {name}": Estimate(*flux) for name, flux in energy.detected.items()},
        {f"absorbed by {name}": Estimate(*flux) for name, flux in energy.absorbed.items()},
        {f"absorbed in {name}": Estimate(*flux) for name, flux in energy.absorbed_in.items()},
        {"escaped": Estimate(energy.escaped_W, energy.escaped_se_W)},
        {f"cut by {reason}": Estimate(flux, unknown) for reason, flux in energy.cut.items()},
    )
    return {
        name: flux
        for group in groups
        for name, flux in sorted(group.items(), key=lambda item: -item[1].value)
        if flux.value
    }


def energy_table(energy: Energy) -> Table:
    """Return the energy ledger of a trace as a table: flux, W, by destination, and percent of the launched flux."""
    rows: list[list[Value]] = [
        [name, flux, number(100 * flux.value / energy.launched_W, 4)] for name, flux in ledger(energy).items()
    ]
    return Table(columns("<where the flux went", "flux [W]", "of launched [%]"), rows)


def flux_table(found: FluxReport) -> Table:
    """Return the table of incident and absorbed flux, W, at surfaces that rays meet, the largest absorbed first."""
    rows: list[list[Value]] = [
        [row.id, row.hits, Estimate(row.incident_W, row.incident_se_W), Estimate(row.absorbed_W, row.absorbed_se_W)]
        for row in sorted(found, key=lambda row: -row.absorbed_W)
        if row.hits
    ]
    return Table(columns("<surface", "hits", "incident [W]", "absorbed [W]"), rows, empty="no ray meets a surface")


def rays_table(rays: RayHistory) -> Table:
    """Return the table of the start and events of recorded rays: surface, position and optical path, mm, flux, W."""
    return chosen(rays.to_pandas(), RAY_COLUMNS)
