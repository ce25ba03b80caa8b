"""Picture of a validation: each row's difference divided by the largest that agrees, source by source."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mistray.analyses.validate.result import AGREES, DIFFERS, KNOWN
from mistray.toolkit.figures.figure import Figure, bar_axes
from mistray.toolkit.figures.palette import BLUE, ORANGE, VERMILION

if TYPE_CHECKING:
    from mistray.analyses.validate.result import ComparedRow, Validation

FARTHEST = 3.0  # in units of the allowed difference; what is farther stands there
COLOURS = {AGREES: BLUE, KNOWN: ORANGE, DIFFERS: VERMILION}
SPREAD = 0.5  # of the points of a pack across its line


def differences_figure(found: Validation, title: str = "") -> Figure:
    """
    Draw the difference of each row with a verdict over the largest that agrees, a line per source.

    Ratios beyond ±3 stand at ±3, and so do rows where only one side finds light.
    """
    packs = [one.pack for one in found.packs]
    made, axes = Figure.of_panels(8.6, 1.6 + 0.34 * max(len(packs), 3))
    axes.axvspan(-1, 1, color="#e8f1e4", zorder=0)
    for verdict, colour in COLOURS.items():
        places, values = [], []
        for line, pack in enumerate(packs):
            rows = found.of(pack)
            for k, row in enumerate(rows):
                if row.verdict == verdict:
                    places.append(line + SPREAD * ((k + 0.5) / len(rows) - 0.5))
                    values.append(_place(row))
        if values:
            axes.plot(np.clip(values, -FARTHEST, FARTHEST), places, "o", ms=4, color=colour, mew=0, label=verdict)
    bar_axes(axes, len(packs))
    axes.set_yticks(range(len(packs)), packs, fontsize=8)
    axes.invert_yaxis()
    axes.set(xlim=(-FARTHEST - 0.2, FARTHEST + 0.2), xlabel="(ours - published) / allowed")
    if axes.get_legend_handles_labels()[0]:
        made.legend(loc="outside upper right", fontsize=8, frameon=False, ncols=3)
    return made.headed(
        title,
        small_print=f"rows in the green band agree; differences beyond {FARTHEST:g} and lost light stand at the ends",
    )


def _place(row: ComparedRow) -> float:
    """
    Return the difference of a row over the allowed one.

    It is -∞ where only the source finds light, and ∞ where the source finds none.
    """
    if math.isnan(row.of_allowed):
        return math.inf if math.isnan(row.published.value) else -math.inf
    return row.of_allowed
