"""Bar charts of values with standard errors, one horizontal bar for each name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from mistray.estimate import Estimate
from mistray.toolkit.figures.figure import Figure, plain_axes
from mistray.toolkit.figures.palette import BLUE, VERMILION

BARS = 12
DECADES = 12.0  # below the longest bar, where bars end
LONGEST_NAME = 60  # letters beside a bar


def bars(values: Mapping[str, Estimate], colours: Sequence[str], label: str) -> Figure:
    """
    Return a figure of values and their standard errors as horizontal bars on a log10 scale, the first at the top.

    There is no bar for a value that is not above 0, or not finite.

    Parameters
    ----------
    values : mapping of str to Estimate
        Values by name.
    colours : sequence of str
        Colour of each bar.
    label : str
        Name of the values, with their unit.
    """
    made, axes = Figure.of_panels(8.6, 1.2 + 0.32 * max(len(values), 3))
    value = np.array([one.value if one.value > 0 and np.isfinite(one.value) else 0.0 for one in values.values()])
    error = np.nan_to_num([one.se for one in values.values()], posinf=0.0)
    names = [name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…" for name in values]
    named_bars(axes, names, value, [np.minimum(error, 0.9 * value), error], colours)
    if len(value) and value.max() > 0:
        axes.set_xscale("log")
        axes.set_xlim(max(value[value > 0].min() / 3, value.max() * 10.0**-DECADES), 2 * (value + error).max())
        axes.xaxis.set_major_locator(LogLocator(10, numticks=12))
    else:
        axes.text(0.5, 0.5, "nothing above 0", ha="center", va="center", transform=axes.transAxes)
    plain_axes(axes, "x", below=True, xlabel=label)
    return made


def not_drawn(count: int, what: str) -> str:
    """Return the end of a sentence on a figure that leaves out `count` items, such as "paths"; "" if it has all."""
    return f"; {count} more {what} are not drawn" if count else ""


def named_bars(axes: Axes, names: Sequence[str], values: np.ndarray, errors: Any, colours: Sequence[str]) -> None:
    """Draw horizontal bars with their errors, as `Axes.errorbar` takes them, and names beside, the first at the top."""
    places = range(len(names))
    axes.barh(places, values, color=colours, height=0.7)
    axes.errorbar(values, places, xerr=errors, fmt="none", ecolor="#333333", lw=0.9)
    axes.set_yticks(places, names, fontsize=8)
    axes.invert_yaxis()


def magnitude_bars(values: Mapping[str, Estimate], label: str) -> Figure:
    """
    Return a figure of the `BARS` largest magnitudes as horizontal bars on a log10 scale.

    Values below 0 are orange, others blue. Values that are 0 or not finite are left out. `label` is as in `bars`.
    """
    known = {name: one for name, one in values.items() if np.isfinite(one.value) and one.value}
    shown = dict(sorted(known.items(), key=lambda item: -abs(item[1].value))[:BARS])
    sizes = {name: Estimate(abs(one.value), one.se) for name, one in shown.items()}
    return bars(sizes, [BLUE if one.value > 0 else VERMILION for one in shown.values()], label)
