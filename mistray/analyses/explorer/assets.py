"""Files of the front end, which the local page and the widget share."""

from __future__ import annotations

from functools import cache
from importlib.resources import files


@cache
def asset(name: str) -> str:
    """
    The text of one of them.

    ``explore.js`` begins with what reports draw with too, so that both draw alike.
    """
    text = files("mistray.analyses.explorer").joinpath("front_end", name).read_text(encoding="utf-8")
    if name != "explore.js":
        return text
    drawing = files("mistray.toolkit.pages").joinpath("assets", "drawing.js").read_text(encoding="utf-8")
    return f"{drawing}\n{text}"
