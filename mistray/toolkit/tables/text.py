"""Text of numbers with their errors, and of tables of fixed width."""

from __future__ import annotations

import math
import re
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
    without_groups,
)

SIGNIFICANT = 5  # digits of a value at most: errors below them are not worth a place
FIXED = range(-2, 5)  # powers of ten of numbers that are written without an exponent
ABSENT = "–"


def with_error(number: Estimate, digits: int = 2) -> str:
    """
    Return a number and its standard error as printed, such as "9.3548e-05 ± 1.2e-08".

    The error has ``digits`` digits. The value ends at the same decimal place, but has at most `SIGNIFICANT` digits. An
    error that rounds to 0 at the value's last place is left out: "1.0000e-04". An exact value, of error 0, has no zeros
    at its end: "1.0e-04" or "0.5". An error that is not finite is "± ?"; a value that is not finite is "–" alone.

    Examples
    --------
    >>> mistray.report.with_error(mistray.analysis.Estimate(9.35478e-5, 1.23e-8))
    '9.3548e-05 ± 1.2e-08'
    """
    value, se = number.value + 0.0, number.se  # 0 has no sign
    if not math.isfinite(value):
        return ABSENT
    if not math.isfinite(se):
        return f"{_exact(value, SIGNIFICANT - 1)} ± ?"
    size = _exponent(value, SIGNIFICANT) if value else _exponent(se, digits)
    last = max(_exponent(se, digits) - digits, size - SIGNIFICANT) + 1 if se else size - SIGNIFICANT + 1
    if not se:
        return _exact(value, SIGNIFICANT)
    if se <= 0.5 * 10.0**last:
        return f"{value:.{SIGNIFICANT - 1 - size}f}" if size in FIXED else f"{value:.{SIGNIFICANT - 1}e}"
    largest = max(size, _exponent(se, digits))
    if largest in FIXED:
        decimals = max(-last, 0)
        shown = f"{round(value, -last):.{decimals}f}" if value else "0"
        return f"{shown} ± {round(se, -last):.{decimals}f}"
    shown = f"{value:.{max(size - last, 0)}e}" if value else "0"
    return f"{shown} ± {se:.{max(_exponent(se, digits) - last, 0)}e}"


def number(value: float, digits: int = 5) -> str:
    """Return a number without error as printed, with `digits` significant digits; "–" if it is not finite."""
    return f"{value:.{digits}g}" if math.isfinite(value) else ABSENT


def table_text(table: Table, most: int | None = None) -> str:
    """
    Return a table of a report as text of fixed width, with a line of units below the headings, if there are any.

    A table without rows gives its `Table.empty`.

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
    """
    Return a cell of a table as printed: a value with its error, without the note on it; else its text.

    A link is printed without its target, and a fold as its summary.
    """
    if isinstance(value, Noted):
        value = value.number
    if isinstance(value, Estimate):
        return with_error(value)
    if isinstance(value, StyledCell | Link):
        return value.text
    return value.summary if isinstance(value, Fold) else str(value)


def parts_text(parts: Sequence[PagePart]) -> str:
    """Return tables, notes and lists as text, also those in groups and folds; pictures and maps are a line each."""
    texts = []
    for part in without_groups(parts):
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
    """Return the first `most` strings joined by `between`, followed by "and … more" if there are more."""
    more = len(texts) - most
    return between.join(texts[:most]) + (f" and {more} more" if more > 0 else "")


def plain_sentences(texts: Sequence[str]) -> list[str]:
    """Return the sentences of a verdict without markup; plain strings stay as they are."""
    return [text.striptags() if isinstance(text, Markup) else text for text in texts]


def _exact(value: float, digits: int) -> str:
    """
    Return a number rounded to `digits` significant digits, without zeros at its end: "0.5".

    With an exponent one decimal always remains: "1.0e-04".
    """
    if not value or _exponent(value, digits) in FIXED:
        return f"{value:.{digits}g}"
    return re.sub(r"(\.\d+?)0+e", r"\1e", f"{value:.{digits - 1}e}")


def _exponent(value: float, digits: int) -> int:
    """Return the power of ten of the first digit of a number that is rounded to `digits` digits."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])
