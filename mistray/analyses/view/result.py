"""Scene in three dimensions, shown in Jupyter and written as an HTML file."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from markupsafe import Markup

from mistray.replace_file import replace_file
from mistray.toolkit.drawings.cut_open import OpenSurface
from mistray.toolkit.drawings.path_polylines import RayLine


class View:
    """
    Scene drawn in three dimensions.

    Attributes
    ----------
    figure : plotly.graph_objects.Figure
        Drawing: a ``mesh3d`` for each surface, and for each path one ``scatter3d`` whose rays are parted by NaN.
    surfaces : list of OpenSurface
        Parts of the surfaces that the cut leaves.
    rays : list of RayLine
        Drawn rays, for `mistray.report.write_rays`.
    title, note : str
        Heading of the page, and a line that describes its content.

    Examples
    --------
    >>> view = mistray.view(mistray.load("lens_and_window"))
    >>> view.title, len(view.surfaces)
    ('scene', 13)
    >>> view.write("view.html").name
    'view.html'
    """

    def __init__(self, figure: Any, surfaces: list[OpenSurface], rays: list[RayLine], title: str, note: str) -> None:
        self.figure, self.surfaces, self.rays = figure, surfaces, rays
        self.title, self.note = title, note

    def html(self, command: str = "") -> str:
        """Return a self-contained HTML page with plotly.js, dark or light; `command` is quoted at its foot."""
        from mistray.toolkit.pages.render import stylesheet

        return self._page(stylesheet("colours"), command)

    def _page(self, colours: str, command: str = "") -> str:
        """Return the HTML page; `colours` is the style sheet of its colours, `command` is quoted at its foot."""
        from mistray.analyses.view.drawing import LINES_OF_PAGE
        from mistray.toolkit.pages.render import template

        body = self.figure.to_html(
            full_html=False,
            include_plotlyjs=True,
            div_id="view",
            default_height="100%",
            config={"displaylogo": False, "scrollZoom": True, "responsive": True},
        )
        said = {"title": self.title, "note": self.note, "command": command}
        return template("view.html", **said, body=body, css=Markup(colours), follows=LINES_OF_PAGE) + "\n"

    def write(self, path: str | Path, command: str = "") -> Path:
        """Write the page of `html` to a file, complete or not at all; raise `MistrayError` if that fails."""
        return replace_file(path, self.html(command), "view")

    def _repr_html_(self) -> str:
        """
        Return the page as HTML in a frame of its own, isolated from other scripts of the notebook.

        It is light, since a notebook has a theme of its own.
        """
        from mistray.toolkit.pages.render import stylesheet

        light = stylesheet("colours").partition("@media")[0]
        return (
            f'<iframe srcdoc="{escape(self._page(light))}" title="{escape(self.title)}" '
            'style="width: 100%; height: 640px; border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"View({self.title!r}, {len(self.surfaces)} surfaces, {len(self.rays)} rays)"
