"""Pieces of HTML that tables are made of: cells, and pictures within them."""

from __future__ import annotations

import base64
import math
from html import escape

from mistray.estimate import Estimate
from mistray.toolkit.tables.text import ABSENT, with_error


def cell(text: str, kind: str = "") -> str:
    """A cell of text; `kind` is its CSS class."""
    return f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>"


def number_cell(estimate: Estimate, note: str = "") -> str:
    """A cell that shows the value, below it the error and a note, and sorts by the value."""
    if not math.isfinite(estimate.value):
        return cell(ABSENT)
    value, _, error = with_error(estimate).partition(" ± ")
    below = f"<small>{escape(note)}</small>" if note else ""
    return f'<td data-v="{estimate.value:.9g}">{value}<small>± {error}</small>{below}</td>'


def image(png: bytes, text: str, title: str = "") -> str:
    """An <img> that holds the picture itself."""
    hover = f' title="{escape(title)}"' if title else ""
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}" alt="{escape(text)}"{hover}>'
