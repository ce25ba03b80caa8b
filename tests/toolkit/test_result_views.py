"""What a Python session shows: of a result one line, a summary and a figure; progress bars, also where nobody looks."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import html_pages
import matplotlib
import pytest
import stubs
from command_line import Captured, Patch, on_a_terminal
from refusals import refused
from result_calls import CALLS, LONG, result_classes

import mistray
from mistray.estimate import Estimate
from mistray.result import Result
from mistray.toolkit.figures.bars import BARS, bars
from mistray.toolkit.summary import MOST_LETTERS, MOST_ROWS, main_figure

long = pytest.mark.long
COMPUTED = ("mistray.trace.", "mistray.analyses.", "mistray.metrics.")  # other modules have what is put in
# Classes of these that exported functions return and that are no results
OTHERS = {
    "View",  # has a three-dimensional picture of its own
    *("Metric", "PstMetric", "CombinedMetric"),  # are to be evaluated
    "DesignStudy",  # is an input
}
NO_FIGURE = {"StepExport", "SurfaceTransfer", "LineImage"}  # nothing of them is drawn
DRAWN_LONG = LONG | {"mistray.analysis.ghosts", "mistray.analysis.pst", "mistray.analysis.transfer"}


@pytest.fixture
def plots(monkeypatch: Patch) -> Iterator[None]:
    matplotlib.use("agg")
    yield
    importlib.import_module("matplotlib.pyplot").close("all")


def returned() -> dict[str, type]:
    """Classes of mistray that the exported functions return, by name."""
    found = {}
    for package in stubs.packages():
        module = importlib.import_module(package)
        for name in module.__all__:
            function = getattr(module, name)
            if inspect.isfunction(function):
                said = inspect.signature(function).return_annotation
                names = vars(importlib.import_module(function.__module__))
                kind = names.get(said) if isinstance(said, str) else said
                if isinstance(kind, type) and kind.__module__.startswith(COMPUTED):
                    found[kind.__name__] = kind
    return found


def every_result() -> list[type[Result]]:
    """All classes of results, once the modules of all exported names are imported."""
    returned()
    return sorted(result_classes(), key=lambda kind: kind.__name__)


@pytest.mark.core
def test_what_exported_functions_return_is_a_result() -> None:
    assert len(returned()) >= 20
    found = {name for name, kind in returned().items() if not issubclass(kind, Result)}
    assert found == OTHERS


@pytest.mark.core
@pytest.mark.parametrize("kind", every_result(), ids=lambda kind: kind.__name__)
def test_a_result_says_its_numbers_and_names_its_table_and_figure(kind: type[Result]) -> None:
    assert "key_numbers" in vars(kind)
    assert kind.__repr__ is Result.__repr__, "give the dataclass repr=False"
    assert {*kind.shown_by} == (set() if kind.__name__ in NO_FIGURE else {"table", "figure"})
    for place in kind.shown_by.values():
        module, _, name = place.partition(":")
        function = getattr(importlib.import_module(module), name)
        first, *others = inspect.signature(function).parameters.values()
        assert first.annotation == kind.__name__, place
        assert all(one.default is not one.empty for one in others), place


def check(result: Result) -> None:
    """One line without an address, a summary that is whole, and a figure."""
    line = repr(result)
    assert len(line) <= MOST_LETTERS
    assert not any(text in line for text in ("\n", " object at 0x", "nan"))
    assert line == f"{type(result).__name__}({line.partition('(')[2][:-1]})"
    html = result._repr_html_()
    assert html_pages.Page(html).open == []
    assert html.count("<tr>") <= MOST_ROWS + 1
    assert not any(text in html for text in ("<script", 'id=""', " object at 0x"))
    assert f"<strong>{type(result).__name__}</strong>" in html
    if type(result).__name__ in NO_FIGURE:
        with pytest.raises(mistray.MistrayError, match=f"^{type(result).__name__} has no figure; .*$"):
            result.plot()
        return
    assert (html.count("<figure>"), html.count("<svg")) == (1, 1)
    pyplot = importlib.import_module("matplotlib.pyplot")
    drawn = result.plot("A title")
    first = drawn[0] if isinstance(drawn, tuple) else drawn
    assert isinstance(first, matplotlib.axes.Axes)
    assert pyplot.gcf() is first.figure
    assert type(first.figure) is type(main_figure(result))


@pytest.mark.usefixtures("folder", "plots")
@pytest.mark.parametrize("name", [pytest.param(name, marks=long if name in DRAWN_LONG else ()) for name in CALLS])
def test_a_result_of_every_function(name: str) -> None:
    result = CALLS[name]()
    if isinstance(result, Result):
        check(result)
        parts = [getattr(result, name) for name in ("fields", "comparison") if hasattr(result, name)]
        for part in parts:
            check(part[0] if isinstance(part, tuple) else part)


@long
@pytest.mark.usefixtures("folder", "plots")
def test_parts_of_a_trace() -> None:
    t = mistray.trace(mistray.load("coated.xml"), rays=64)
    for part in (t, t.paths, t.energy, t.surfaces, t.history(0), t.history(0)[[]], t.on(t.detectors[0])):
        check(part)
    assert repr(t).startswith("Trace(coated, detected ")
    assert "paths: not kept" in repr(mistray.trace(mistray.load("coated.xml"), rays=64, ledger=False))


QUARTER = SimpleNamespace(share_done=0.25)


@pytest.mark.parametrize(
    ("states", "share"),
    [
        *(([(1, 4), (2, 4)], 50), ([("lenses", 1, 4)], 25), ([(2, "objects", 0.3)], 30)),
        ([(3, 4), (1, 4)], 75),  # a bar does not go back
        ([(3, 4), (1, 10)], 10),  # unless the plan is another one
        *(([state], 25) for state in ((QUARTER,), ("scatter", QUARTER), (QUARTER, object()))),  # a step and its start
        *(([state], 0) for state in ((object(), object()), (), (0, 0))),
    ],
)
def test_states_of_all_functions(monkeypatch: Patch, states: list[Any], share: int) -> None:
    terminal = on_a_terminal(monkeypatch)
    with mistray.ProgressBar("PST") as bar:
        for state in states:
            bar(*state)
        assert terminal.getvalue().rpartition("\r")[2].startswith(f"PST: {share:3}%")
    assert terminal.getvalue().endswith(" \r")  # the line is free again


def test_a_trace(monkeypatch: Patch) -> None:
    terminal = on_a_terminal(monkeypatch)
    mistray.trace(mistray.load("plate"), rays=1000, progress=mistray.ProgressBar())
    assert "tracing: 100%" in terminal.getvalue()
    assert "\n" not in terminal.getvalue()


def test_no_terminal(capsys: Captured) -> None:
    bar = mistray.ProgressBar()
    bar(1, 2)
    bar.close()
    assert capsys.readouterr() == ("", "")
    with refused("what", "ProgressBar"):
        mistray.ProgressBar(3)  # type: ignore[arg-type]


@pytest.mark.long
def test_a_notebook() -> None:
    """One bar that ends, not a line for each step, with widgets or without."""
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    code = """
import mistray
with mistray.ProgressBar("PST") as bar:
    for k in range(201):
        bar(k, 200)
"""
    hidden = "import sys\nsys.modules['ipywidgets'] = None\n"
    cells = [nbformat.v4.new_code_cell(text) for text in (hidden, code)]
    book = nbformat.v4.new_notebook(cells=cells)
    nbclient.NotebookClient(book, kernel_name="python3", timeout=60).execute()
    outputs = book.cells[1].outputs
    text = "".join(output["text"] for output in outputs)
    assert {output["name"] for output in outputs} == {"stderr"}
    assert text.rstrip("\n").count("\n") == 0
    assert "PST: 100%" in text
    assert "IProgress" not in text


def test_a_figure_says_how_much_it_leaves_out() -> None:
    t = mistray.trace(mistray.load("phone_camera"), rays=1000, field_deg=30.0, max_reflections=1)
    surfaces = sum(row.absorbed_W > 0 for row in t.surfaces)
    assert surfaces > BARS
    assert main_figure(t.surfaces).get_suptitle().endswith(f"; {surfaces - BARS} more surfaces are not drawn")
    assert re.search(r"; [0-9]+ more destinations are not drawn$", main_figure(t.energy).get_suptitle())


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_value_without_a_bar_leaves_the_others_theirs(value: float) -> None:
    """A search that darkens a term has no ratio for it; a factor below 0 makes no error below 0."""
    (axes,) = bars({"a": Estimate(-2.0, 0.1).times(-1), "b": Estimate(value, 0.1)}, ["b", "b"], "ratio").axes
    assert [bar.get_width() for bar in axes.patches] == [2.0, 0.0]
    assert (axes.get_xscale(), len(axes.texts)) == ("log", 0)
