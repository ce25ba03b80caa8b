"""Pictures of traces: irradiance, paths, energy ledger, flux at surfaces, recorded rays."""

from __future__ import annotations

from mistray.estimate import Estimate
from mistray.recorders.path_events import DIRECT
from mistray.toolkit.figures.bars import BARS, bars, not_drawn
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLUE, GREEN, GREY, ORANGE, VERMILION
from mistray.toolkit.figures.plots import HOW_TO_READ, scaled_map
from mistray.toolkit.tables.traces import ledger
from mistray.trace.energy import Energy, FluxReport
from mistray.trace.history import RayHistory
from mistray.trace.paths import PathTable
from mistray.trace.result import Trace

CELLS = 512  # along the longer side of a map
LEDGER_COLOURS = {"detected": BLUE, "absorbed": GREY, "escaped": GREEN, "cut": ORANGE}


def trace_figure(trace: Trace, title: str = "") -> Figure:
    """
    Return a figure of the irradiance of all light on the detector, W/mm², on a log10 scale.

    The heading begins with `title`. A trace of several detectors raises `MistrayError`, see `Trace.on`.
    """
    x0, x1, y0, y1 = trace.extent
    made, axes = Figure.of_panels(5.6, 0.9 + 4.3 * max((y1 - y0) / (x1 - x0), 0.45), dpi=110)
    scaled_map(axes, trace.light, trace.extent, None, CELLS)
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    detector = ", ".join(trace.detectors[:1])
    return made.headed(title, f"irradiance of {detector}", f"log₁₀ irradiance [W/mm²]; {HOW_TO_READ}")


def paths_figure(paths: PathTable, title: str = "") -> Figure:
    """
    Return a figure of the power of the strongest paths, W, as bars with standard errors.

    At most `BARS` paths are drawn. The heading begins with `title`.
    """
    rows = paths[:BARS]
    powers = {f"{row.path_id}  {row.label}": Estimate(row.power_W, row.power_se_W) for row in rows}
    colours = [BLUE if row.kind == DIRECT else VERMILION for row in rows]
    made = bars(powers, colours, "power [W absorbed]")
    more = not_drawn(len(paths) - len(rows), "paths")
    return made.headed(title, "strongest paths", f"blue: direct image, orange: stray light{more}")


def energy_figure(energy: Energy, title: str = "") -> Figure:
    """
    Return a figure of the shares of the launched flux by destination, percent, as bars with standard errors.

    At most `BARS` destinations with flux are drawn. The heading begins with `title`.
    """
    flux = sorted((item for item in ledger(energy).items() if item[1].value > 0), key=lambda item: -item[1].value)
    shares = {name: one.times(100 / energy.launched_W) for name, one in flux[:BARS]}
    made = bars(shares, [LEDGER_COLOURS[name.split()[0]] for name in shares], "share of the launched flux [%]")
    return made.headed(title, f"energy ledger{not_drawn(len(flux) - len(shares), 'destinations')}")


def flux_figure(found: FluxReport, title: str = "") -> Figure:
    """
    Return a figure of the flux that surfaces absorb, W, as bars with standard errors.

    At most `BARS` surfaces that absorb flux are drawn. The heading begins with `title`.
    """
    rows = sorted((row for row in found if row.absorbed_W > 0), key=lambda row: -row.absorbed_W)
    fluxes = {row.id: Estimate(row.absorbed_W, row.absorbed_se_W) for row in rows[:BARS]}
    made = bars(fluxes, [GREY] * len(fluxes), "absorbed flux [W]")
    return made.headed(title, f"flux that surfaces absorb{not_drawn(len(rows) - len(fluxes), 'surfaces')}")


def rays_figure(rays: RayHistory, title: str = "") -> Figure:
    """
    Return a figure of recorded rays projected onto the plane of z and y, mm, with dots at their starts and events.

    The heading begins with `title`.
    """
    made, axes = Figure.of_panels(8.6, 4.2)
    for points in rays.rays:
        axes.plot(points[:, 2], points[:, 1], color=BLUE, lw=0.8, marker=".", ms=4)
    if not len(rays):
        axes.text(0.5, 0.5, "no rays", ha="center", va="center", transform=axes.transAxes)
    plain_axes(axes, below=True, xlabel="z [mm]", ylabel="y [mm]")
    axes.set_aspect("equal", adjustable="datalim")
    return made.headed(title, f"{len(rays)} rays, projected onto x = 0", "dots: events")
