"""The ten tasks of docs/tasks.md run and give what the page says; what docs/coming_from.md names exists."""

import ast
import contextlib
import inspect
import io
import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from oracles.layers import stack_powers

import mistray
from mistray import cli
from mistray.analysis import GhostReport, Pst
from mistray.cli import program
from mistray.prescription import Prescription
from mistray.trace import PathTable, Settings, Trace
from mistray.trace.history import RayHistory

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "tasks.md").read_text(encoding="utf-8")
TITLES = re.findall(r"(?m)^## \d+\. (.+)$", PAGE)
TEXTS = re.split(r"(?m)^## .+$", PAGE)[1:]
OUT = ROOT / "out"


def lines(text: str, language: str) -> list[str]:
    blocks = re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def numbers(printed: str, start: str) -> list[float]:
    """The numbers of the line of a table that begins so and goes on with a number and its error."""
    found = re.findall(rf"(?m)^ *{re.escape(start)} +(\d.* ± .*)$", printed)
    assert len(found) == 1, (start, printed)
    return [float(word) for word in found[0].split() if re.fullmatch(r"\d[\d.]*(e-?\d+)?", word)]


def imported(printed: str) -> None:
    lens = mistray.load(OUT / "phone.xml")
    coated = [shape.id() for shape in lens.shapes() if getattr(shape.bsdf(), "coating", None) is not None]
    assert {"L1_front", "L1_rear", "L5_front", "L5_rear"} <= set(coated)
    assert "next: mistray ghosts out/phone.xml" in printed


def worst_ghosts(printed: str) -> None:
    assert len(re.findall(r"L\d_\w+ → L\d_\w+", printed)) >= 3
    page = (OUT / "ghosts" / "report.html").read_text(encoding="utf-8")
    assert page.index("Most stray light arrives at") < page.index("<table")


def moved(printed: str) -> None:
    _, before, _, after, _, ratio, error = numbers(printed, "hood.z = -8")
    assert ratio == pytest.approx(after / before, rel=0.01)
    assert 1 - 3 * error < ratio < 1.5


def pst_at_30(printed: str) -> None:
    total, error, stray, _ = numbers(printed, "30")[:4]
    assert total == stray
    assert error < 0.15 * total


def polish(printed: str) -> None:
    table = printed[printed.index("first scattered by") :]
    assert {"10", "20", "30"} <= {line.split()[0] for line in table.splitlines() if line[:1].isspace() and line.strip()}
    assert re.search(r"L\d_\w+ \d+ %", table)


def exported(printed: str) -> None:
    assert "3 solids" in printed
    assert "2 beams, 6 paths" in printed
    text = (OUT / "triplet.step").read_text(encoding="ascii")
    assert text.startswith("ISO-10303-21;")
    assert all(f"PRODUCT('{lens}'" in text for lens in ("L1", "L2", "L3"))


def own_coating(printed: str) -> None:
    """The table reflects what the layers do that it was made of."""
    assert "own: L1_front" in printed
    scene = mistray.load(OUT / "own.xml")
    coatings = {shape.id(): getattr(shape.bsdf(), "coating", None) for shape in scene.shapes()}
    assert (type(coatings["L1_front"]).__name__, type(coatings["L1_rear"]).__name__) == ("CoatingTable", "Stack")
    table = pd.read_csv(OUT / "own.csv", comment="#").set_index(["wavelength_nm", "angle_deg"])
    (expected,), _ = stack_powers(1.0, [1.3837, 1.6561], [99.64, 80.0], 1.6938, 550.0, np.ones(1))  # N-LAK9
    assert table.loc[(550, 0)].R_s == pytest.approx(expected, abs=1e-4)


def own_bsdf(printed: str) -> None:
    """A table of a Lambertian paint scatters as the paint does."""
    paint = mistray.coat("plate_and_wall", {}, scatter={"screen": "paint reflectance=0.05"})
    p = mistray.pst(paint, [30.0], rays=20_000)
    stray, error = (float(curve[0]) for curve in p.curve("stray"))
    _, _, found, found_error = numbers(printed, "30")[:4]
    assert abs(found - stray) < 4 * (error**2 + found_error**2) ** 0.5


def compared(printed: str) -> None:
    ratio = re.findall(r"makes ghosts ([\d.]+) ± [\d.]+ times weaker", printed)
    assert float(*ratio) > 2


def handed_over(printed: str) -> None:
    del printed
    page = (OUT / "study" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=[\"']https?:", page)
    assert (OUT / "study" / "report.pdf").read_bytes().startswith(b"%PDF")


FACTS: list[Callable[[str], None]] = [
    imported, worst_ghosts, moved, pst_at_30, polish, exported, own_coating, own_bsdf, compared, handed_over,
]  # fmt: skip


def test_there_are_ten_and_each_is_short() -> None:
    assert len(TITLES) == len(TEXTS) == len(FACTS) == 10
    for text in TEXTS:
        commands, code = lines(text, "sh"), lines(text, "python")
        assert bool(commands) != bool(code)
        assert len(commands) <= 3
        assert len(code) <= 10


@pytest.mark.parametrize(("text", "facts"), list(zip(TEXTS, FACTS, strict=True)), ids=TITLES)
def test_a_task(text: str, facts: Callable[[str], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """The example in Python is run by tests/test_docs.py too; here its number is looked at."""
    monkeypatch.chdir(ROOT)
    OUT.mkdir(exist_ok=True)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        for line in lines(text, "sh"):
            words = shlex.split(line)
            force = ["--force"] if any("out/" in word for word in words) and words[1] != "pst" else []
            assert cli.main([*words[1:], *force]) == 0, line
        exec("\n".join(lines(text, "python")), {})
    facts(printed.getvalue())


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


def rows(heading: str) -> Iterator[list[str]]:
    """Cells of the tables whose first column has a heading."""
    table = ""
    for line in COMING_FROM.splitlines():
        cells = [cell.strip("| ") for cell in line.strip("|").split(" | ")] if line.startswith("| ") else []
        if cells and cells[0] in ("task", "word"):
            table = cells[0]
        elif cells and table == heading:
            yield cells


TASKS, WORDS = list(rows("task")), list(rows("word"))
ROWS = TASKS + WORDS
SPANS = [span for row in ROWS for span in re.findall(r"`([^`]+)`", re.sub(r"\[`\w+`\]\([^)]*\)", "", row[-1]))]
COMMANDS = [span for span in SPANS if re.match(r"mistray \w", span)]
CALLS = [span for span in SPANS if re.match(r"(mistray|t|report|p|system)\.", span)]


def test_the_tables_are_whole_and_every_task_has_something_here() -> None:
    assert len(TASKS) > 30
    assert len(WORDS) > 70
    assert all(len(row) == 5 and all(row) for row in TASKS)
    assert all(len(row) == 3 and all(row) for row in WORDS)
    assert len({row[0] for row in TASKS}) == len(TASKS)
    for row in TASKS:
        assert "`" in row[-1] or "](" in row[-1], row[0]
    assert set(SPANS) - set(COMMANDS) - set(CALLS) <= {"front", "back", "Prescription"}, "neither a command nor a call"


def test_every_program_of_the_title_has_its_words() -> None:
    title = COMING_FROM.partition("\n")[0]
    for program_ in re.findall(r"ASAP|FRED|TracePro|OpticStudio", title):
        assert f"## The words of {program_}\n" in COMING_FROM


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
