"""Display of a result in a Python session: one line, a summary for notebooks, and its figure."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.result import KeyNumber, Result
from mistray.toolkit.pages.model import Column, FigurePart, Link, NotePart, PagePart, Table, Terms
from mistray.toolkit.pages.parts import thousands
from mistray.toolkit.rows import table
from mistray.toolkit.tables.text import ABSENT, number, with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mistray.toolkit.figures.figure import Figure
    from mistray.toolkit.plain_page import Rows

MOST_LETTERS = 120  # of the line
MOST_OF_NAME = 32  # of the name of the scene in it
MOST_ROWS = 10  # of the table


def one_line(result: Result) -> str:
    """
    Return class, scene and key numbers of a result in one line of at most `MOST_LETTERS` letters.

    The last numbers are left out if they do not fit in, and the line is cut if it is still too long.
    """
    name = " ".join(result.scene_name.split())
    parts = [name if len(name) <= MOST_OF_NAME else f"{name[: MOST_OF_NAME - 1]}…"] if name else []
    parts += [" ".join(_text(*pair).split()) for pair in result.key_numbers().items()]
    left_out: list[str] = []
    while True:
        line = f"{type(result).__name__}({', '.join([*parts, *left_out])})"
        if len(line) <= MOST_LETTERS:
            return line
        if len(parts) <= 1:
            return f"{line[: MOST_LETTERS - 2]}…)"
        parts, left_out = parts[:-1], ["…"]


def _text(name: str, value: KeyNumber) -> str:
    """Return a key number with its name and unit, for the one-line summary of a result."""
    if isinstance(value, str):
        return f"{name}: {value}"
    if isinstance(value, int):
        return f"{thousands(value)} {name.removesuffix('s') if value == 1 else name}"
    head = Column.of(name)
    shown = _value(value)
    return f"{head.head} {shown}" if shown == ABSENT or head.unit in ("", "1") else f"{head.head} {shown} {head.unit}"


def _value(value: KeyNumber) -> str:
    if isinstance(value, Estimate):
        return with_error(value)
    return number(value, 4) if isinstance(value, float) else thousands(value) if isinstance(value, int) else value


def html_summary(result: Result) -> str:
    """Return a heading, the key numbers, the first rows of the table, and the figure of a result as HTML."""
    from markupsafe import Markup

    from mistray.toolkit.pages.render import html_parts, stylesheet, template

    return template(
        "summary.html",
        css=Markup(stylesheet("summary")),
        kind=type(result).__name__,
        scene=result.scene_name,
        body=Markup(html_parts(list(_parts(result)))),
    )


def _parts(result: Result) -> Iterator[PagePart]:
    """Yield key numbers, first rows of the table, and figure of a result as parts of an HTML summary."""
    numbers = result.key_numbers()
    yield Terms([_pair(*pair) for pair in numbers.items()])
    found = main_table(result)
    if found is not None:
        left = len(found.rows) - MOST_ROWS
        rows = [[cell.text if isinstance(cell, Link) else cell for cell in row] for row in found.rows[:MOST_ROWS]]
        if rows:
            yield replace(found, rows=rows, name="", sortable=False, filter=None, fold="")
        elif found.empty:
            yield NotePart(found.empty, "note")
        if left > 0:
            yield NotePart(f"… and {left} more rows", "note")
    if has_figure(result):
        yield FigurePart(lambda: main_figure(result), text=f"figure of {one_line(result)}")


def _pair(name: str, value: KeyNumber) -> tuple[str, str]:
    head = Column.of(name)
    return head.head, f"{_value(value)} {head.unit if head.unit != '1' else ''}".rstrip()


def main_table(result: Result) -> Table | None:
    """Return the table shown in the summary of a result; None if it has none."""
    if "table" in result.shown_by:
        shown: Table = _function(result, "table")(result)
        return shown
    tables: Mapping[str, Rows] = result.tables() if hasattr(result, "tables") else {}
    return next((table(*rows) for rows in tables.values()), None)


def has_figure(result: Result) -> bool:
    """True if a result has a figure."""
    return "figure" in result.shown_by or bool(getattr(result, "figures", dict)())


def main_figure(result: Result, title: str = "") -> Figure:
    """
    Return the figure shown in the summary of a result that has one, see `has_figure`. Its heading begins with `title`.

    A result without a figure of its class shows the first of its `figures`, which has its own heading.
    """
    if "figure" in result.shown_by:
        drawn: Figure = _function(result, "figure")(result, title)
    else:
        drawn = next(iter(result.figures().values()))()  # type: ignore[attr-defined]
    return drawn


def _function(result: Result, what: str) -> Any:
    """Return the function by which a result's class shows its table or figure; `what` is "table" or "figure"."""
    module, _, name = result.shown_by[what].partition(":")
    return getattr(importlib.import_module(module), name)


def plotted(result: Result, title: str = "") -> Axes | tuple[Axes, ...]:
    """
    Draw the figure of a result with pyplot and return the axes of its panels, several as a tuple.

    The heading begins with `title`; empty: the name of its scene. Raise `MistrayError` if the result has no figure.
    """
    if not has_figure(result):
        raise MistrayError(f"{type(result).__name__} has no figure; use its numbers, see help({type(result).__name__})")
    panels = main_figure(result, title or result.scene_name).in_pyplot()
    return panels[0] if len(panels) == 1 else panels
