"""Picture of a gradient: the largest derivatives."""

from __future__ import annotations

from mistray.metrics.gradient import Gradient
from mistray.toolkit.figures.bars import magnitude_bars
from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.tables.gradients import derivatives


def gradient_figure(found: Gradient, title: str = "") -> Figure:
    """
    Return a figure of the largest derivatives as bars with errors, in metric per unit of the parameter.

    At most `mistray.toolkit.figures.bars.BARS` of them are drawn, on a log10 scale; the colour is that of their sign.
    Derivatives that are 0 or not finite are left out. The heading begins with `title`.
    """
    made = magnitude_bars(derivatives(found), "size of the derivative [metric per unit of the parameter]")
    return made.headed(title, "derivatives", "blue: above 0, orange: below 0; bars of one standard error")
