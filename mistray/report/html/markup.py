"""Pieces of HTML: sections, tables, figures."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from html import escape
from typing import Any

from mistray.analysis.estimate import Estimate
from mistray.report.tables.text import ABSENT, with_error
from mistray.trace.forward import versions


def section(anchor: str, title: str, body: str) -> str:
    """A section with a heading that links can lead to."""
    return f'<section><h2 id="{anchor}">{title}</h2>{body}</section>'


def data_table(
    name: str, header: Sequence[tuple[str, ...]], rows: Sequence[Sequence[str]], sortable: bool = True
) -> str:
    """Table from header entries (text, unit[, class]) and rows of finished cells."""
    heads = []
    for text, unit, *kind in header:
        style = f' class="{kind[0]}"' if kind else ""
        below = f"<small>{escape(unit)}</small>" if unit else ""
        heads.append(f'<th scope="col"{style}>{escape(text)}{below}</th>')
    body = "".join(f"<tr>{''.join(row)}</tr>\n" for row in rows)
    kind_of_table = ' class="sortable"' if sortable else ""
    return (
        f'<div class="wide"><table id="{name}"{kind_of_table}><thead><tr>{"".join(heads)}</tr></thead>'
        f"<tbody>\n{body}</tbody></table></div>"
    )


def cell(text: str, kind: str = "") -> str:
    """A cell of text; `kind` is its CSS class."""
    return f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>"


def filter_box(table: str, placeholder: str, label: str) -> str:
    """A field that filters the rows of the table with this id; `label` is read out by screen readers."""
    return (
        f'<p><input class="filter" data-table="{table}" placeholder="{escape(placeholder)}" '
        f'aria-label="{escape(label)}"></p>'
    )


def number_cell(estimate: Estimate, note: str = "") -> str:
    """A cell that shows the value, below it the error and a note, and sorts by the value."""
    if not math.isfinite(estimate.value):
        return cell(ABSENT)
    value, _, error = with_error(estimate).partition(" ± ")
    below = f"<small>{escape(note)}</small>" if note else ""
    return f'<td data-v="{estimate.value:.9g}">{value}<small>± {error}</small>{below}</td>'


def figure(content: str, caption: str = "") -> str:
    """A picture, with a caption below it if there is one."""
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{content}{below}</figure>"


def image(png: bytes, text: str, title: str = "") -> str:
    """An <img> that holds the picture itself."""
    hover = f' title="{escape(title)}"' if title else ""
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}" alt="{escape(text)}"{hover}>'


def version_settings() -> dict[str, str]:
    """Versions of the packages that made the numbers, as settings of a report."""
    return {f"version of {name}": version for name, version in versions().items()}


def setting_text(value: Any) -> str:
    """A setting as text."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return ", ".join(setting_text(item) for item in value)
    return "–" if value is None else str(value)


def thousands(value: Any) -> str:
    """A whole number with a space before every three digits."""
    return f"{int(value):,}".replace(",", " ") if value is not None else ABSENT
