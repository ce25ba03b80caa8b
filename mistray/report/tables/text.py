"""Numbers with their errors as text, and tables of fixed width."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mistray.analysis.estimate import Estimate

MOST_DECIMALS = 6
ABSENT = "–"


def with_error(number: Estimate, digits: int = 2) -> str:
    """
    A number and its standard error as text, "9.3548e-05 ± 1.2e-08".

    The error has ``digits`` digits and the value ends at the same place. A number that is not finite is "–", an error
    that is not known shows as "± ?".
    """
    value, se = number
    if not math.isfinite(value):
        return ABSENT
    if not math.isfinite(se):
        return f"{value:.4g} ± ?"
    if se <= 0:
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
    """A number without error as text; "–" if it is not finite."""
    return f"{value:.{digits}g}" if math.isfinite(value) else ABSENT


def text_table(columns: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]], left: Sequence[int] = ()) -> str:
    """
    Fixed-width table with a line of units below the header, if there are any.

    Parameters
    ----------
    columns : sequence of (str, str)
        Header and unit of each column.
    rows : sequence of sequence of str
        Cells.
    left : sequence of int
        Numbers of the columns that are flush left; all others are flush right.
    """
    heads = [[text for text, _ in columns], [f"[{unit}]" if unit else "" for _, unit in columns]]
    heads = heads if any(heads[1]) else heads[:1]
    widths = [max(len(line[k]) for line in [*heads, *rows]) for k in range(len(columns))]

    def join(line: Sequence[str]) -> str:
        cells = [
            cell.ljust(w) if k in left else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        ]
        return "  ".join(cells).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([*[join(line) for line in heads], rule, *[join(row) for row in rows]])


def _exponent(value: float) -> int:
    return math.floor(math.log10(abs(value)))
