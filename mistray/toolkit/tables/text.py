"""Text of numbers with their errors, and of tables of fixed width."""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from mistray.estimate import Estimate
from mistray.toolkit.pages.model import (
    FigurePart,
    Fold,
    Items,
    Link,
    Map,
    Noted,
    NotePart,
    PagePart,
    StyledCell,
    Table,
    Terms,
    Value,
)

MOST_DECIMALS = 6
ROUNDING = 1e-13  # relative; what sums of float64 leave of an error that is 0
ABSENT = "–"


def with_error(number: Estimate, digits: int = 2) -> str:
    """
    Return a number and its standard error as text, "9.3548e-05 ± 1.2e-08".

    The error has ``digits`` digits and the value ends at the same place. A number that is not finite is "–"; an unknown
    error is "± ?".

    Examples
    --------
    >>> mistray.report.with_error(mistray.analysis.Estimate(9.35478e-5, 1.23e-8))
    '9.3548e-05 ± 1.2e-08'
    """
    value, se = number
    if not math.isfinite(value):
        return ABSENT
    if not math.isfinite(se):
        return f"{value:.4g} ± ?"
    if se <= ROUNDING * abs(value):
        return f"{value:.6g} ± 0"
    if value == 0:
        return f"0 ± {se:.{digits - 1}e}"
    places = _exponent(value) - _exponent(se) + digits - 1
    decimals = min(max(places, 0), 9)
    fixed = max(digits - 1 - _exponent(se), 0)
    if -4 < _exponent(value) < 5 and se < abs(value) and fixed <= MOST_DECIMALS:
        return f"{value:.{fixed}f} ± {se:.{fixed}f}"
    return f"{value:.{decimals}e} ± {se:.{digits - 1}e}"


def number(value: float, digits: int = 5) -> str:
    """Return a number without error as text; "–" if it is not finite."""
    return f"{value:.{digits}g}" if math.isfinite(value) else ABSENT


def table_text(table: Table, most: int | None = None) -> str:
    """
    Return a table of a report as text of fixed width, with a line of units below the headings, if there are any.

    Parameters
    ----------
    table : Table
        Table to print.
    most : int, optional
        Largest number of rows, before a last one for the rest (default: ``table.most``).
    """
    if not table.rows:
        return table.empty
    heads = [[column.head for column in table.columns], [c.unit and f"[{c.unit}]" for c in table.columns]]
    heads = heads if any(heads[1]) else heads[:1]
    cells = [[cell_text(value) for value in row] for row in table.rows_in_text(most)]
    widths = [max(map(len, own)) for own in zip(*heads, *cells, strict=True)]
    sides = ["<" if column.style == "t" else ">" for column in table.columns]
    lines = [
        "  ".join(f"{cell:{side}{width}}" for cell, side, width in zip(line, sides, widths, strict=True)).rstrip()
        for line in (*heads, *cells)
    ]
    lines.insert(len(heads), "  ".join("-" * width for width in widths))
    return "\n".join(lines)


def cell_text(value: Value) -> str:
    """Return a cell of a table as text."""
    if isinstance(value, Noted):
        value = value.number
    if isinstance(value, Estimate):
        return with_error(value)
    if isinstance(value, StyledCell | Link):
        return value.text
    return value.summary if isinstance(value, Fold) else str(value)


def parts_text(parts: Sequence[PagePart]) -> str:
    """Return tables, notes and lists as text, and pictures as their captions."""
    texts = []
    for part in parts:
        if isinstance(part, Table):
            texts.append(table_text(part))
        elif isinstance(part, NotePart):
            texts.append(part.text)
        elif isinstance(part, Items):
            texts += part.texts
        elif isinstance(part, Terms):
            texts += [f"{term}: {text}" for term, text in part.pairs]
        elif isinstance(part, FigurePart):
            texts.append(f"(picture: {part.caption or part.text})")
        elif isinstance(part, Map):
            texts.append(f"(map: {part.title}, {part.values.min():.3g} to {part.values.max():.3g} {part.unit})")
    return "\n".join(texts)


def first_of(texts: Sequence[str], most: int, between: str = ", ") -> str:
    """Return the first `most` texts joined by `between`, and how many more there are."""
    more = len(texts) - most
    return between.join(texts[:most]) + (f" and {more} more" if more > 0 else "")


def plain_sentences(texts: Sequence[str]) -> list[str]:
    """Return the sentences of a verdict without markup, and with ordinary blanks."""
    return [(text.striptags() if isinstance(text, Markup) else text).replace("\u00a0", " ") for text in texts]


def _exponent(value: float) -> int:
    return math.floor(math.log10(abs(value)))
