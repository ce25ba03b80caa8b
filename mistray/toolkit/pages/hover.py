"""Plots that show values at the mouse pointer: the figure as SVG, with numbers by position along x."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.figures.plots import as_svg
from mistray.toolkit.pages.embedded import json_script
from mistray.toolkit.typeset import typeset, typeset_html

POINTS_PER_INCH = 72  # units of Matplotlib's SVG files
Value = tuple[str, str]


def hover_figure(
    name: str,
    figure: Figure,
    axes: Axes,
    x: Sequence[float],
    titles: Sequence[str],
    values: Sequence[Sequence[Value]],
    caption: str = "",
    text: str = "",
) -> str:
    """
    Return HTML of a figure that shows values at the pointer and by arrow keys; on paper it is the figure alone.

    Parameters
    ----------
    name : str
        HTML id of the data of the plot.
    figure : Figure
        Matplotlib figure.
    axes : Axes
        Axes of the figure on which a line marks the chosen place.
    x : sequence of float
        Places, in units of the x axis.
    titles : sequence of str
        Heading of each place.
    values : sequence of sequence of (str, str)
        Pairs of a name and a value, for each place.
    caption : str
        Caption below the figure.
    text : str
        Description for screen readers (default: the caption).
    """
    svg = as_svg(figure, text or caption)  # lays the figure out, so that places are known only now
    width, height = (POINTS_PER_INCH * size for size in figure.get_size_inches())
    scale = POINTS_PER_INCH / figure.dpi
    bottom = axes.get_ylim()[0]
    places = [float(scale * axes.transData.transform((value, bottom))[0]) for value in x]
    box = axes.get_window_extent()
    area = [scale * box.x0, height - scale * box.y1, scale * box.x1, height - scale * box.y0]
    data = {
        "x": [round(place, 2) for place in places],
        "view": [0, 0, float(width), float(height)],
        "area": [round(float(edge), 2) for edge in area],
        "titles": list(titles),
        "values": [[[name, typeset(value)] for name, value in each] for each in values],
    }
    below = f"<figcaption>{typeset_html(caption)}</figcaption>" if caption else ""
    return (
        f'<figure><div class="hover" tabindex="0" role="group" aria-label="plot; arrow keys show its values">{svg}'
        f'<div class="tip" role="status" hidden></div>{json_script(name, data)}</div>{below}</figure>'
    )
