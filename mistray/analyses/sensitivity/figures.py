"""Pictures of a sensitivity analysis: the ranking as bars, and the Monte Carlo of perturbed systems."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mistray.analyses.sensitivity.draws import PERCENTILES
from mistray.analyses.sensitivity.propagation import Contribution
from mistray.analyses.sensitivity.result import Sensitivity
from mistray.analyses.sensitivity.rows import SensitivityRow
from mistray.toolkit.figures.figure import Figure, bar_axes, plain_axes
from mistray.toolkit.figures.palette import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, YELLOW

KIND_COLOURS = {
    "coating": BLUE,
    "share": SKY,
    "scatter": VERMILION,
    "index": PURPLE,
    "curvature": GREEN,
    "conic": GREEN,
    "asphere": GREEN,
    "rim": ORANGE,
    "position": BROWN,
    "tilt": YELLOW,
}
NAMES = {"share": "R, T", "conic": "curvature", "asphere": "curvature"}
BARS = 20
SURE = 2.0  # standard errors from 0 below which a bar is faded
FADED = 0.35  # its opacity


def ranking_figure(result: Sensitivity, title: str = "", count: int = BARS) -> Figure:
    """
    Draw the change of the metric per tolerance as bars, percent, and the shares of the variance beside them.

    The `count` largest are drawn, without those of no effect.
    """
    rows = {row.label: row for row in result.rows}
    shown = [item for item in result.spread.contributions[:count] if item.change.value != 0]
    shown = shown or list(result.spread.contributions[:1])
    kinds = [rows[item.members[0]].kind for item in shown]
    height = 1.6 + 0.27 * len(shown)
    figure, (left, right) = Figure.of_panels(10.4, height, 1, 2, sharey=True, width_ratios=(2.4, 1))
    places = np.arange(len(shown))[::-1]
    for place, item, kind in zip(places, shown, kinds, strict=True):
        change, se = 100 * item.change.value, 100 * item.change.se
        style = {"color": KIND_COLOURS.get(kind, GREY), "height": 0.72}
        alpha = 1.0 if abs(change) > SURE * se else FADED
        left.barh(place, change, alpha=alpha, **style)
        left.errorbar(change, place, xerr=se, color=BLACK, lw=0.9, capsize=2)
        outwards = 1 if change >= 0 else -1
        left.annotate(
            f"{change:+.2g} %", (change + outwards * se, place), xytext=(4 * outwards, 0), textcoords="offset points",
            ha="left" if change >= 0 else "right", va="center", fontsize=7.5, color="#333333",
        )  # fmt: skip
        share, error = 100 * item.share.value, 100 * item.share.se
        if math.isfinite(share):
            right.barh(place, share, alpha=alpha, **style)
            right.errorbar(share, place, xerr=error, color=BLACK, lw=0.9, capsize=2)
    left.set_yticks(places, [_label(item, rows[item.members[0]]) for item in shown], fontsize=8)
    left.axvline(0, color=BLACK, lw=0.8)
    left.margins(x=0.16)
    left.set_xlabel("change of the metric per tolerance [%]")
    right.set(xlim=(0, None), xlabel="share of the variance [%]")
    for axes in (left, right):
        bar_axes(axes, len(shown))
    colours = {NAMES.get(kind, kind): KIND_COLOURS.get(kind, GREY) for kind in kinds}
    figure.legend(
        handles=[Patch(color=colour, label=name) for name, colour in colours.items()], loc="outside upper right",
        ncols=len(colours), fontsize=8, frameon=False,
    )  # fmt: skip
    return figure.headed(title, result.name, "error bars: one standard error; faded: less than two of them from 0")


def draws_figure(result: Sensitivity, title: str = "") -> Figure:
    """Draw the metrics of perturbed systems as a histogram with the linear model, and traced against predicted."""
    draws = result.draws
    assert draws is not None
    figure, (left, right) = Figure.of_panels(10.4, 4.0, 1, 2)
    logs = draws.logs
    bins = max(8, min(40, round(2 * math.sqrt(len(logs)))))
    left.hist(draws.ratios, bins=bins, color=SKY, edgecolor="white", lw=0.4)
    sigma = result.spread.deviation.value
    if sigma > 0:
        x = np.linspace(
            min(draws.ratios.min(), math.exp(-3 * sigma)), max(draws.ratios.max(), math.exp(3 * sigma)), 300
        )
        width = float(np.ptp(draws.ratios)) / bins
        density = np.exp(-0.5 * (np.log(x) / sigma) ** 2) / (x * sigma * math.sqrt(2 * math.pi))
        left.plot(x, len(logs) * width * density, color=BLACK, lw=1.2)
    for percent in PERCENTILES:
        left.axvline(draws.percentile(percent).value, color=VERMILION, lw=1.0, ls="-" if percent == 50 else "--")
    left.set(xlabel="metric over that of the nominal system", ylabel="systems")
    handles = [
        Line2D([], [], color=BLACK, label="linear propagation"),
        Line2D([], [], color=VERMILION, ls="--", label=", ".join(f"{p:g}" for p in PERCENTILES) + " %"),
    ]
    left.legend(handles=handles, fontsize=8, frameon=False)
    ends = 100 * np.array([min(logs.min(), draws.predicted.min()), max(logs.max(), draws.predicted.max())])
    right.plot(ends, ends, color=GREY, lw=0.8)
    right.plot(100 * draws.predicted, 100 * logs, ls="", marker="o", ms=3, color=BLUE)
    right.set(xlabel="100 ln(metric / nominal), linear model", ylabel="100 ln(metric / nominal), traced")
    for axes in (left, right):
        plain_axes(axes, below=True)
    return figure.headed(title, f"{len(logs)} perturbed systems")


def _label(item: Contribution, row: SensitivityRow) -> str:
    if len(item.members) > 1:
        return f"{item.name}  ({len(item.members)} together)"
    return f"{row.label}  ±{row.tolerance:.3g}{f' {row.unit}' if row.unit not in ('', '1') else ''}"
