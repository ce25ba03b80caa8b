"""Base class of results: text on one line, a table and a picture in notebooks, and a plot."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import resolve_name
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mistray.estimate import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KeyNumber = Estimate | float | int | str


class Result:
    """
    Base class of the results of traces and analyses: their text, table and figure in a Python session.

    A class names the functions that return its table and its figure, each with its module as in a relative import:
    ``class Losses(Result, table=".page:loss_table", figure=".figures:loss_figure")``. They are imported on first use.
    A result with methods ``tables`` and ``figures``, see `mistray.toolkit.plain_page.Tabled`, shows the first of each.

    Attributes
    ----------
    scene_name : str
        Name of the scene file, or of its folder if the file is called scene.xml; empty if it is not known.
    shown_by : dict of str to str
        Functions of the table and of the figure, such as ``"losses.page:loss_table"``.
    """

    scene_name: str = ""
    shown_by: ClassVar[dict[str, str]] = {}

    def __init_subclass__(cls, *, table: str = "", figure: str = "", **others: Any) -> None:
        super().__init_subclass__(**others)
        given = {"table": table, "figure": figure}
        package = cls.__module__.rpartition(".")[0]
        cls.shown_by = cls.shown_by | {what: resolve_name(name, package) for what, name in given.items() if name}

    def of_scene(self, name: str) -> Self:
        """Store the name of the scene in the result and return the result."""
        object.__setattr__(self, "scene_name", name)  # many are frozen
        return self

    def key_numbers(self) -> Mapping[str, KeyNumber]:
        """
        Return the numbers that a reader looks for first, with their standard errors.

        Keys are names with units, such as ``"power [W]"``. That of a whole number is the plural of what is counted.
        """
        return {}

    def __repr__(self) -> str:
        from mistray.toolkit.summary import one_line

        return one_line(self)

    def _repr_html_(self) -> str:
        """Return an HTML summary for notebooks: key numbers, the first rows of the table, and the figure."""
        from mistray.toolkit.summary import html_summary

        return html_summary(self)

    def plot(self, title: str = "") -> Axes | tuple[Axes, ...]:
        """
        Draw the main figure of the result, in a new figure of pyplot.

        Parameters
        ----------
        title : str
            Heading of the figure; by default the name of the scene.

        Returns
        -------
        Axes or tuple of Axes
            Axes of Matplotlib, a tuple if the figure has several panels; without those of colour bars.

        Raises
        ------
        MistrayError
            If the result has no figure.
        """
        from mistray.toolkit.summary import plotted

        return plotted(self, title)

    def save(self, path: str | Path) -> Path:
        """
        Write the result to one file, an archive of JSON and NumPy arrays, which `mistray.load_result` loads.

        A trace and others from which rays are traced again hold their scene, with the files that it names.

        Parameters
        ----------
        path : str or Path
            File to write, such as ``"thermal.zip"``. An existing file is replaced; it stays on an error.

        Returns
        -------
        Path
            File written.

        Raises
        ------
        MistrayError
            If the result holds an object of a class of your own, such as a recorder, or the file cannot be written.
        """
        from mistray.toolkit.saved_result import save_result

        return save_result(self, path)
