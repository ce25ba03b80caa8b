"""Front-end files (HTML, CSS, JavaScript) shared by the explorer's local page and notebook widget."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

PAGE = ":root:has(main.mistray-explorer)"


@cache
def asset(name: str) -> str:
    """
    Return the text of a front-end file.

    ``explore.js`` is returned after the drawing code of reports, so that both draw alike, and ``explore.css`` after
    their colours.
    """
    text = files("mistray.analyses.explorer").joinpath("front_end", name).read_text(encoding="utf-8")
    if name == "explore.js":
        return f"{_of_reports('drawing.js')}\n{text}"
    if name == "explore.css":
        # A notebook has a theme of its own, and the explorer in it stays light
        light, dark = f"{PAGE}, .mistray-explorer", f"{PAGE}, main.mistray-explorer"
        return _of_reports("colours.css").replace(":root", light, 1).replace(" :root {", f" {dark} {{") + text
    return text


def _of_reports(name: str) -> str:
    """Return the text of a file that reports are made of."""
    return files("mistray.toolkit.pages").joinpath("assets", name).read_text(encoding="utf-8")
