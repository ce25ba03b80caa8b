"""HTML of table cells and of pictures within them."""

from __future__ import annotations

import base64
import math
from html import escape

from mistray.estimate import Estimate
from mistray.toolkit.tables.text import ABSENT, with_error
from mistray.toolkit.typeset import typeset, typeset_html, value_and_error

LONG_TEXT = 40  # letters from which on a cell may break its lines


def cell(text: str, kind: str = "") -> str:
    """
    Return the HTML of a table cell with text; `kind` is its CSS class.

    If the text is a number, the cell sorts by its value.
    """
    kind = f"{kind} long" if kind.split(" ")[0] == "t" and len(text) > LONG_TEXT else kind
    style = f' class="{kind}"' if kind else ""
    try:
        value = f' data-v="{float(text):.9g}"' if typeset(text) != text else ""
    except ValueError:
        value = ""
    return f"<td{style}{value}>{typeset_html(text)}</td>"


def number_cell(estimate: Estimate, note: str = "") -> str:
    """
    Return the HTML of a table cell with a value, its standard error and, below, a note.

    The cell sorts by the value. A value that is not finite is shown as "–", without a note.
    """
    if not math.isfinite(estimate.value):
        return cell(ABSENT)
    value, *below = [*value_and_error(with_error(estimate)), typeset_html(note)]
    small = "".join(f"<small>{text}</small>" for text in below if text)
    return f'<td data-v="{estimate.value:.9g}">{value}{small}</td>'


def image(png: bytes, text: str, title: str = "") -> str:
    """Return an <img> with an embedded PNG; `text` is its alternative text and `title` its hover text."""
    hover = f' title="{escape(title)}"' if title else ""
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}" alt="{escape(text)}"{hover}>'
