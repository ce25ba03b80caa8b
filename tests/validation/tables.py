"""Tables of the validation reports: written between markers of a Markdown file, and read back by the tests."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[2] / "docs" / "validation"


def number(value: float, se: float | None = None, digits: int = 4) -> str:
    """A number with four digits; with a standard error, two digits of that and as many decimals of the value."""
    if not math.isfinite(value):
        return "–"
    if se is None:
        text = f"{value:.{digits}g}"
        return f"{value:,.0f}" if "e+" in text else text
    if se == 0 or not math.isfinite(se):
        return number(value)
    decimals = 1 - int(f"{se:.1e}".partition("e")[2])
    if abs(value) < 1e-3 or abs(value) >= 1e6:
        exponent = math.floor(math.log10(abs(value)))
        scale, places = 10.0**exponent, max(decimals + exponent, 0)
        return f"({value / scale:.{places}f} ± {se / scale:.{places}f})e{exponent}"
    decimals = max(decimals, 0)
    return f"{value:.{decimals}f} ± {se:.{decimals}f}"


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = [list(header), *[list(row) for row in rows]]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]

    def line(row: Sequence[str]) -> str:
        return "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"

    return "\n".join([line(cells[0]), "|" + "|".join("-" * (w + 2) for w in widths) + "|", *map(line, cells[1:])])


class _Cells(dict[str, Any]):
    """Values of a row; "a±b" is the number a with the standard error b."""

    def __missing__(self, key: str) -> str:
        value, se = key.split("±")
        return number(self[value], self[se])


def table(header: str, cells: str, rows: Iterable[Mapping[str, Any]]) -> str:
    """A Markdown table of headings and formats of a row's values, parted by " | "; {a±b} is a number with its error."""
    return markdown(header.split(" | "), [cells.format_map(_Cells(row)).split(" | ") for row in rows])


def write(file: str, tables: dict[str, str]) -> None:
    """Put each table between its markers ``<!-- name -->`` and ``<!-- end -->``; every marker must have its table."""
    path = DOCS / file
    text = path.read_text(encoding="utf-8")
    names = re.findall(r"<!-- (\w+) -->\n", text)
    if set(names) - {"end"} != set(tables):
        raise ValueError(f"{path}: it has places for {sorted(set(names) - {'end'})}, not for {sorted(tables)}")
    for name, table in tables.items():
        text = re.sub(rf"(<!-- {name} -->\n).*?(<!-- end -->)", rf"\g<1>\n{table}\n\n\g<2>", text, flags=re.DOTALL)
    path.write_text(text, encoding="utf-8")


def read(file: str, name: str) -> list[dict[str, str]]:
    text = (DOCS / file).read_text(encoding="utf-8")
    match = re.search(rf"<!-- {name} -->\n(.*?)<!-- end -->", text, re.DOTALL)
    assert match, f"{file} has no table '{name}'"
    lines = [[cell.strip() for cell in line.strip(" |").split(" |")] for line in match[1].strip().splitlines()]
    return [dict(zip(lines[0], cells, strict=True)) for cells in lines[2:]]


def value(cell: str) -> tuple[float, float]:
    """Value and standard error, 0 if there is none, of a cell that `number` wrote."""
    match = re.fullmatch(r"\(?([-\d.,e+]+)(?: ± ([\d.]+))?\)?(?:e(-?\d+))?", cell)
    assert match, f"'{cell}' is no number"
    scale = 10.0 ** int(match[3] or 0)
    return float(match[1].replace(",", "")) * scale, float(match[2] or 0) * scale
