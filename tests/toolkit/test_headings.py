"""The heading of a column stands in one place: in the row that has the column."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import mistray

ANALYSES = Path(mistray.__file__).parent / "analyses"
DECLARES = ("column", "derived.column")  # what a column of a row is declared with
HEADS = ("columns", "Column.of")  # what makes columns of a table from texts


def declared_heads(tree: ast.Module) -> Iterator[str]:
    """The headings with a unit that rows of a module declare."""
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and ast.unparse(call.func) in DECLARES:
            yield from (text for keyword in call.keywords if keyword.arg == "head" for text in texts(keyword.value))


def heads_of_tables(tree: ast.Module) -> Iterator[str]:
    """The texts with a unit that tables of a module have as headings, or that stand in a collection."""
    for node in ast.walk(tree):
        is_heads = isinstance(node, ast.Call) and ast.unparse(node.func) in HEADS
        if is_heads or isinstance(node, ast.Dict | ast.List | ast.Tuple):
            yield from (text for child in ast.iter_child_nodes(node) for text in texts(child))


def texts(node: ast.AST) -> Iterator[str]:
    """The text that an expression is, if it ends in a unit in brackets; without the sign of a flush left column."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.endswith("]"):
        yield node.value.removeprefix("<")


def test_no_table_repeats_a_heading_of_a_row() -> None:
    """What a row of an analysis declares, such as "power [W absorbed]", no other table of the analysis says again."""
    declared: dict[str, set[str]] = defaultdict(set)
    said: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for path in sorted(ANALYSES.rglob("*.py")):
        place, tree = path.relative_to(ANALYSES), ast.parse(path.read_text(encoding="utf-8"))
        declared[place.parts[0]] |= set(declared_heads(tree))
        said[place.parts[0]] += [(str(place), text) for text in heads_of_tables(tree)]
    assert sum(map(len, declared.values())) > 20
    again = [f"{name}: '{text}'" for own, found in said.items() for name, text in found if text in declared[own]]
    assert not again, f"{again}: take the column of the row, with table(kind, rows, only=…)"
