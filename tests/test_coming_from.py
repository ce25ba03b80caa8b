"""Every command and every call that docs/coming_from.md names exists, with its arguments."""

from __future__ import annotations

import ast
import inspect
import re
import shlex
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

import mistray
from mistray.analysis import GhostReport, Pst
from mistray.cli import program
from mistray.prescription import Prescription
from mistray.trace import PathTable, Settings, Trace
from mistray.trace.history import RayHistory

COMING_FROM = (Path(__file__).parents[1] / "docs" / "coming_from.md").read_text(encoding="utf-8")
# What the names of the page stand for
ROOTS: dict[str, Any] = {"mistray": mistray, "t": Trace, "report": GhostReport, "p": Pst, "system": Prescription}
# What properties and calls on the page give, of which something is asked
PROPERTIES = {"t.paths": PathTable}
RESULTS = {"t.history": RayHistory}
# Names that are only assigned when an object is made
ATTRIBUTES = {"t.energy", "t.surfaces", "t.irradiance"}
FREE = {"scene", "params", "metric", "t", "optic", "model"}  # arguments that the page explains
SETTINGS = {setting.name for setting in fields(Settings)}


def rows() -> Iterator[list[str]]:
    for line in COMING_FROM.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")] if line.startswith("| ") else []
        if cells and cells[0] != "task":
            yield [cell.strip("| ") for cell in cells]


ROWS = list(rows())
SPANS = [span for row in ROWS for span in re.findall(r"`([^`]+)`", re.sub(r"\[`\w+`\]\([^)]*\)", "", row[-1]))]
COMMANDS = [span for span in SPANS if re.match(r"mistray \w", span)]
CALLS = [span for span in SPANS if re.match(r"(mistray|t|report|p|system)\.", span)]


def test_the_tables_are_whole_and_every_task_has_something_here() -> None:
    assert len(ROWS) > 30
    assert all(len(row) == 5 and all(row) for row in ROWS)
    assert len({row[0] for row in ROWS}) == len(ROWS)
    for row in ROWS:
        assert "`" in row[-1] or "](" in row[-1], row[0]
    assert set(SPANS) - set(COMMANDS) - set(CALLS) <= {"front", "back"}, "neither a command nor a call"


@pytest.mark.parametrize("line", COMMANDS)
def test_command_exists(line: str) -> None:
    program._parser().parse_args(shlex.split(line)[1:])


def resolve(node: ast.expr) -> tuple[str, Any]:
    """Dotted name of an expression, and the class, function or module it is."""
    if isinstance(node, ast.Call):
        name, _ = resolve(node.func)
        check_arguments(name, resolve(node.func)[1], node)
        return name, RESULTS.get(name)
    if isinstance(node, ast.Attribute):
        above, owner = resolve(node.value)
        name = f"{above}.{node.attr}"
        if name in ATTRIBUTES:
            assert node.attr in (inspect.getdoc(owner) or ""), f"{name} is not documented"
            return name, None
        assert hasattr(owner, node.attr), f"there is no {name}"
        return name, PROPERTIES.get(name, getattr(owner, node.attr))
    assert isinstance(node, ast.Name)
    return node.id, ROOTS[node.id]


def check_arguments(name: str, function: Any, call: ast.Call) -> None:
    signature = inspect.signature(function)
    bound = name.split(".")[0] != "mistray"
    places = [None] * (len(call.args) + bound)
    keywords = {str(word.arg): None for word in call.keywords}
    signature.bind(*places, **keywords)
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in signature.parameters.values()):
        assert set(keywords) <= set(signature.parameters) | SETTINGS, f"{name}: {sorted(keywords)}"
    for argument in call.args:
        assert not isinstance(argument, ast.Name) or argument.id in FREE


@pytest.mark.parametrize("text", CALLS)
def test_call_exists(text: str) -> None:
    resolve(ast.parse(text, mode="eval").body)
