"""Pictures of thermal self-emission: irradiance on the detector by emitter, and narcissus over the detector."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import LogLocator

from mistray.analyses.thermal.result import ThermalReport
from mistray.toolkit.figures.bars import named_bars, not_drawn
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

SHOWN, FAINTEST = 12, 1e-8  # bars; share of the strongest below which there is none
CURVES = 6
CURVE_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY)
KIND_COLOURS = {"surface": BLUE, "medium": GREEN}
COLD_COLOUR = ORANGE


def thermal_figure(report: ThermalReport, title: str = "") -> Figure:
    """
    Draw the irradiance on the detector, W/mm², by emitter as bars, with lines for the total and the imaged scene.

    Up to 12 emitters are shown, without those below 1e-8 of the largest; the small print says how many others emit.
    """
    least = FAINTEST * max((e.irradiance_W_mm2.value for e in report.emitters), default=0.0)
    emitters = [e for e in report.emitters if e.irradiance_W_mm2.value > 0]
    lit = [e for e in emitters if e.irradiance_W_mm2.value > least][:SHOWN]
    made, axes = Figure.of_panels(8.6, 1.4 + 0.32 * max(len(lit), 3))
    values = np.array([e.irradiance_W_mm2.value for e in lit])
    colours = [COLD_COLOUR if e.temperature_K < report.temperature_K else KIND_COLOURS[e.kind] for e in lit]
    errors = np.array([e.irradiance_W_mm2.se for e in lit])
    named_bars(axes, [e.name for e in lit], values, np.minimum(errors, 0.9 * values), colours)
    for value, colour, text in (
        (report.total_W_mm2.value, VERMILION, "all self-emission"),
        (report.image_W_mm2.value, "#555555", f"image of a blackbody at {report.scene_K:g} K"),
    ):
        if value > 0:
            axes.axvline(value, color=colour, lw=1.2, ls="--", label=f"{text}: {value:.3g} W/mm²")
    if len(lit):
        axes.set_xscale("log")
        axes.set_xlim(values.min() / 3)
        axes.xaxis.set_major_locator(LogLocator(10, numticks=12))
    band = f"{report.band_um[0]:g} to {report.band_um[1]:g} µm"
    plain_axes(axes, "x", below=True, xlabel=f"irradiance on the detector, {band} [W/mm²]")
    if axes.get_legend_handles_labels()[0]:
        made.legend(loc="outside upper right", fontsize=8, frameon=False, ncols=2)
    how = "bars of one standard error; blue: surfaces, green: media, orange: what is colder than the rest"
    return made.headed(title, small_print=how + not_drawn(len(emitters) - len(lit), "emitters"))


def narcissus_figure(report: ThermalReport, title: str = "") -> Figure:
    """
    Draw the narcissus-induced temperature difference, mK, of up to 6 surfaces.

    The small print says how many others there are. The abscissa is the distance from the middle of the detector, mm.
    """
    made, axes = Figure.of_panels(8.6, 4.2)
    edges = np.array(report.zones_mm)
    middles = 0.5 * (edges[1:] + edges[:-1])
    for number, back in enumerate(report.returned[:CURVES]):
        values, errors = np.array(back.by_zone_K).T
        colour = CURVE_COLOURS[number % len(CURVE_COLOURS)]
        axes.stairs(1e3 * values, edges, color=colour, lw=1.4, baseline=None, label=back.surface)
        axes.errorbar(middles, 1e3 * values, 1e3 * errors, fmt="none", ecolor=colour, lw=0.9)
    axes.set(xlim=edges[[0, -1]], ylim=(0, None))
    plain_axes(axes, below=True, xlabel="distance from the middle of the detector [mm]", ylabel="NITD [mK]")
    made.legend(loc="outside right upper", fontsize=8, frameon=False)
    how = "what is cold by one reflection, in zones of equal areas; bars of one standard error"
    return made.headed(title, small_print=how + not_drawn(len(report.returned[CURVES:]), "surfaces"))
