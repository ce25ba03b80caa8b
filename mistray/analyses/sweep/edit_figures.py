"""Picture of a sweep of PSTs: the stray PST in each configuration, and its ratio to that of the original."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from mistray.analyses.pst.figures import SYMBOLS
from mistray.analyses.sweep.edit_ranking import EditRanking
from mistray.analyses.sweep.figures import COLOURS, LEGEND, MARKERS
from mistray.analyses.sweep.pst_sweep import PstSweep
from mistray.toolkit.figures.bars import BARS, magnitude_bars
from mistray.toolkit.figures.figure import Figure, legend_label, plain_axes
from mistray.toolkit.figures.palette import BLACK

MARGIN = 0.04  # of the range of angles, beyond its ends
DECADE, LEAST_RATIO = 10.0, 0.05


def pst_sweep_figure(found: PstSweep, title: str = "") -> Figure:
    """
    Draw the stray PST of each configuration, and its ratio to the original scene, against field angle, with errors.

    A single field angle is drawn against the configuration. Errors are standard errors.

    Parameters
    ----------
    found : PstSweep
        PST of each configuration.
    title : str
        Name of the optical system.
    """
    figure, (left, right) = Figure.of_panels(10.4, 4.4, 1, 2)
    first, *others = found.configurations
    angles, one_angle = found.field_deg, len(found.field_deg) == 1
    places = np.arange(len(found.configurations), dtype=np.float64)
    looks = chain([(BLACK, "o")], zip(cycle(COLOURS[:-1]), cycle(MARKERS[1:]), strict=False))
    drawn = [1.0]
    right.axhline(1.0, color=BLACK, lw=1.0)
    for place, name, (colour, marker) in zip(places, found.configurations, looks, strict=False):
        across = np.array([place]) if one_angle else angles
        style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 4, "lw": 1.0, "capsize": 2}
        value, se = found.pst[name].curve("stray")
        lit = value > 0
        left.errorbar(across[lit], value[lit], yerr=se[lit], label=legend_label(name), **style)
        if name != first:
            changes = [found.changed(name, float(angle)) for angle in angles]
            ratios = np.array([change.ratio for change in changes])
            drawn += ratios[np.isfinite(ratios)].tolist()
            right.errorbar(across, ratios, yerr=[change.ratio_se for change in changes], **style)
    for axes in (left, right):
        plain_axes(axes, below=True, xlabel="configuration" if one_angle else "field angle θ [deg]")
        if one_angle:
            axes.set_xticks(places, found.configurations, rotation=30, ha="right", fontsize=8)
            axes.set_xlim(-0.5, places[-1] + 0.5)
        else:  # angles at which no light was seen belong to what was traced
            axes.set_xlim(angles[0] - MARGIN * np.ptp(angles), angles[-1] + MARGIN * np.ptp(angles))
    if any((pst.curve("stray")[0] > 0).any() for pst in found.pst.values()):
        left.set_yscale("log")
    _scale_ratios(right, drawn)
    left.set_ylabel(f"stray {SYMBOLS[found.pst[first].convention].partition(' = ')[0]} [1]")
    right.set_ylabel("after/before [1]")
    handles, labels = left.get_legend_handles_labels()
    if not one_angle and 1 < len(handles) <= LEGEND:
        figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    at = f" at {angles[0]:g}°" if one_angle else ""
    dark = any((pst.curve("stray")[0] == 0).any() for pst in found.pst.values())
    unseen = "; without a marker: no light was seen" if dark else ""
    how = f"error bars: one standard error; of after/before: that of runs with the same random numbers{unseen}"
    text = f"stray PST{at} as it is and in {len(others)} configuration{'s' * (len(others) != 1)}"
    return figure.headed(title, text, how)


def edit_ranking_figure(found: EditRanking, title: str = "") -> Figure:
    """
    Draw the change of the PST by one step of the first `BARS` edits as bars, percent.

    The field angle is that at which the largest of these changes occurs.
    """
    edits = found.edits[:BARS]
    sizes = [max((abs(edit.change[k].value) for edit in edits), default=0.0) for k in range(len(found.field_deg))]
    at = int(np.argmax(sizes))
    steps = {f"{edit.label}  {edit.step:.3g} {edit.unit}".rstrip(): edit.change[at].times(100) for edit in edits}
    made = magnitude_bars(steps, f"change of the PST at {found.field_deg[at]:g}° by one step [%]")
    return made.headed(title, "edits", "blue: the PST grows, orange: it falls; bars of one standard error")


def _scale_ratios(axes: Axes, ratios: Sequence[float]) -> None:
    """Make the axis of ratios logarithmic if they span a decade, else widen it about 1, so that noise stays small."""
    low, high = min(ratios), max(ratios)
    if low > 0 and high / low > DECADE:
        axes.set_yscale("log")
        return
    bottom, top = axes.get_ylim()
    axes.set_ylim(min(bottom, 1 - LEAST_RATIO), max(top, 1 + LEAST_RATIO))
