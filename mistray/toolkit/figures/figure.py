"""Base class of all figures. Their texts hold names from files, and so no text is set as a formula."""

from __future__ import annotations

import re
import warnings
from typing import Any, Literal, Self

from matplotlib import figure
from matplotlib.axes import Axes
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter

from mistray.errors import MistrayWarning
from mistray.toolkit.typeset import NO_BREAK, typeset

COLOUR_BAR = "<colorbar>"  # label that Matplotlib gives to its axes
_GLYPH = re.compile(r"Glyph (?P<code>\d+) \(\\N\{(?P<name>[^}]*)\}\) missing")


def legend_label(name: str) -> str:
    """Return a name as a legend label, with a space before an underscore, at which Matplotlib would omit it."""
    return f" {name}" if name.startswith("_") else name


def plain_axes(
    axes: Axes,
    grid: Literal["both", "x"] = "both",
    below: bool = False,
    left: bool = True,
    legend: bool = False,
    **said: Any,
) -> None:
    """
    Format axes without a box.

    Parameters
    ----------
    axes : Axes
        Axes to draw in.
    grid : {"both", "x"}
        Lines of the thin grid that are drawn.
    below : bool
        Whether the grid, then of a lighter grey, lies below bars and markers.
    left : bool
        Whether the line of the y axis is drawn.
    legend : bool
        Whether a legend of the labelled curves is drawn within the axes.
    **said
        Keywords of `Axes.set`: xlabel, ylabel, xscale, xlim …
    """
    axes.set(**said)
    axes.grid(True, axis=grid, color="#e3e3e3" if below else "#dddddd", lw=0.6)
    if below:
        axes.set_axisbelow(True)
    axes.spines[["top", "right", *([] if left else ["left"])]].set_visible(False)
    if legend:
        axes.legend(fontsize=8, frameon=False)


def bar_axes(axes: Axes, bars: int) -> None:
    """Format axes for `bars` horizontal bars, one above the other at y = 0, 1, 2, …."""
    plain_axes(axes, "x", below=True, left=False, ylim=(-0.8, bars - 0.2))
    axes.tick_params(axis="y", length=0)


class Figure(figure.Figure):
    """
    Figure of Matplotlib that shows every text as it is written.

    Matplotlib sets text between two ``$`` as a formula, and fails if it is none. Names of surfaces, coatings and files
    may contain any character. Powers of ten beside a logarithmic axis are Matplotlib's own texts and remain unchanged.
    """

    _laid_out = True

    @classmethod
    def of_panels(
        cls, width: float, height: float, rows: int = 1, columns: int = 1, dpi: int = 120, **panels: Any
    ) -> tuple[Self, Any]:
        """
        Return a figure of a size in inches and its panels, which do not overlap.

        The panels are in `rows` and `columns`: a single Axes, or an array. `dpi` is the resolution, pixels per inch,
        and `panels` are keywords of `subplots`.
        """
        made = cls(figsize=(width, height), dpi=dpi, layout="constrained")
        return made, made.subplots(rows, columns, **panels)

    def headed(self, title: str, text: str = "", small_print: str = "", right: bool = False) -> Self:
        """
        Write a heading above all panels, on the left, and return the figure.

        Parameters
        ----------
        title, text : str
            Name of the optical system, and what the figure shows.
        small_print : str
            Text in small print below the panels; empty: there is none.
        right : bool
            Whether the small print is on the right, else centred.
        """
        self.suptitle(f"{title}{': ' if title and text else ''}{text}", fontsize=10, x=0.02, ha="left")
        return self.small_print(small_print, right) if small_print else self

    def small_print(self, text: str, right: bool = False) -> Self:
        """Write a text in small print below the panels, centred or with `right` on the right, and return the figure."""
        self.supxlabel(text, fontsize=7.5, color="#555555", **({"x": 0.99, "ha": "right"} if right else {}))
        return self

    def in_pyplot(self) -> tuple[Axes, ...]:
        """Make the figure the current one of pyplot, and return the axes of its panels, but not of colour bars."""
        from matplotlib import pyplot  # takes a backend, which files need not

        pyplot.figure(FigureClass=lambda *_, **__: self)  # type: ignore[arg-type]  # a function that returns a figure
        return tuple(axes for axes in self.axes if axes.get_label() != COLOUR_BAR)

    def savefig(self, *args: Any, **options: Any) -> None:
        """Write the figure, and warn in one line of characters that its font lacks."""
        self._laid_out = False
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            super().savefig(*args, **options)
        missing: dict[str, None] = {}
        for warning in caught:
            glyph = _GLYPH.match(str(warning.message))
            if glyph is None:
                warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
            else:
                missing[f"'{chr(int(glyph['code']))}' ({glyph['name']})"] = None
        if missing:
            warnings.warn(
                f"picture: its font has no {', '.join(missing)}, a box stands there; use other letters in names, or "
                "another font.family of Matplotlib",
                MistrayWarning,
                stacklevel=1,
            )

    def draw(self, renderer: Any) -> None:
        """
        Draw the figure with all names as plain text; Matplotlib calls this for every file format.

        If there is a layout engine, the first call only places everything.
        """
        axes = [axis for panel in self.axes for axis in (panel.xaxis, panel.yaxis)]
        numbers = set()
        for axis in axes:
            labels = axis.get_ticklabels(which="both")
            if not isinstance(axis.get_major_formatter(), FixedFormatter | FuncFormatter):
                numbers |= {*labels, axis.get_offset_text()}
        for text in self.findobj(Text):
            if text not in numbers:
                text.set_parse_math(False)
                text.set_text(typeset(text.get_text()).replace(NO_BREAK, " "))
        layout = self.get_layout_engine()
        if not self._laid_out and layout is not None:
            # To write a file, Matplotlib draws twice, the first time only to place everything: that is all it needs
            self._laid_out = True
            layout.execute(self)
        else:
            super().draw(renderer)
