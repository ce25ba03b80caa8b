"""Front-end files (HTML, CSS, JavaScript) shared by the explorer's local page and notebook widget."""

from __future__ import annotations

from functools import cache
from importlib.resources import files


@cache
def asset(name: str) -> str:
    """
    Return the text of a front-end file.

    ``explore.js`` is returned after the drawing code of reports, so that both draw alike.
    """
    text = files("mistray.analyses.explorer").joinpath("front_end", name).read_text(encoding="utf-8")
    if name != "explore.js":
        return text
    drawing = files("mistray.toolkit.pages").joinpath("assets", "drawing.js").read_text(encoding="utf-8")
    return f"{drawing}\n{text}"
