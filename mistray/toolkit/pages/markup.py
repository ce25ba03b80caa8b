"""HTML of table cells and of pictures within them."""

from __future__ import annotations

import base64
import math
from html import escape

from mistray.estimate import Estimate
from mistray.toolkit.tables.text import ABSENT, with_error


def cell(text: str, kind: str = "") -> str:
    """Return the HTML of a table cell with text; `kind` is its CSS class."""
    return f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>"


def number_cell(estimate: Estimate, note: str = "") -> str:
    """Return a table cell with a value, its standard error and a note below, which sorts by the value."""
    if not math.isfinite(estimate.value):
        return cell(ABSENT)
    value, _, error = with_error(estimate).partition(" ± ")
    below = f"<small>{escape(note)}</small>" if note else ""
    return f'<td data-v="{estimate.value:.9g}">{value}<small>± {error}</small>{below}</td>'


def image(png: bytes, text: str, title: str = "") -> str:
    """Return an <img> with an embedded PNG; `text` is its alternative text and `title` its hover text."""
    hover = f' title="{escape(title)}"' if title else ""
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}" alt="{escape(text)}"{hover}>'
