"""Picture of a budget of roughness and cleanliness."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from mistray.analyses.budget.result import Budget
from mistray.toolkit.figures.figure import Figure, bar_axes
from mistray.toolkit.figures.palette import BLUE, GREY, VERMILION
from mistray.toolkit.tables.text import number


def budget_figure(result: Budget, title: str = "") -> Figure:
    """
    Draw chosen values before and after, by parameter, beside the percentage of a metric that depends on each.

    Of several metrics it is the one with the largest share.
    """
    kinds = list(dict.fromkeys(chosen.parameter for chosen in result.chosen))
    counts = [sum(chosen.parameter == kind for chosen in result.chosen) for kind in kinds]
    height, ratios = 1.4 + 0.6 * len(kinds) + 0.24 * sum(counts), [count + 2 for count in counts]
    how: dict[str, Any] = {"squeeze": False, "height_ratios": ratios, "width_ratios": (2, 1), "sharey": "row"}
    figure, grid = Figure.of_panels(10.4, height, len(kinds), 2, **how)
    for (left, right), kind in zip(grid, kinds, strict=True):
        shown = [chosen for chosen in result.chosen if chosen.parameter == kind]
        places = np.arange(len(shown))[::-1]
        for place, chosen in zip(places, shown, strict=True):
            left.plot(
                [chosen.best, chosen.worst], [place, place], color="#e3e3e3", lw=4, solid_capstyle="butt", zorder=1
            )
            left.plot([chosen.before, chosen.after], [place, place], color=GREY, lw=1, zorder=2)
            left.plot(chosen.before, place, ls="", marker="o", mfc="white", color=GREY, ms=5, zorder=3)
            left.plot(
                chosen.after, place, ls="", marker="D" if chosen.at_bound else "o", color=VERMILION, ms=5, zorder=4
            )
            worst = [max(shares) for shares in (chosen.shares_before, chosen.shares_after)]
            right.barh(place + 0.2, 100 * worst[0], height=0.36, color="#c9ced4")
            right.barh(place - 0.2, 100 * worst[1], height=0.36, color=BLUE)
        left.set_xscale("log")
        left.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        left.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        left.xaxis.set_minor_formatter(NullFormatter())
        left.set_yticks(places, [", ".join(chosen.surfaces) for chosen in shown], fontsize=8)
        unit = shown[0].unit
        left.set_xlabel(f"{kind}{f' [{unit}]' if unit not in ('', '1') else ''}")
        right.set_xlabel("share of the metric [%]")
        for axes in (left, right):
            bar_axes(axes, len(shown))
    handles = [
        Line2D([], [], ls="", ms=5, marker="o", mfc="white", color=GREY, label="before"),
        Line2D([], [], ls="", ms=5, marker="o", color=VERMILION, label="after"),
        Line2D([], [], ls="", ms=5, marker="D", color=VERMILION, label="after, at the end of its range"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3, fontsize=8, frameon=False)
    before, after = result.cost
    return figure.headed(title, f"cost {number(before, 3)} → {number(after, 3)}")
