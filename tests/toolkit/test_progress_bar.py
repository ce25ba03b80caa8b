"""Progress bars of Python sessions: on a terminal, in a notebook, and where nobody looks."""

from __future__ import annotations

import io
import sys
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import Captured, Patch
from refusals import refused

import mistray


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def looked_at(monkeypatch: Patch) -> Terminal:
    """The terminal that is now stderr; a fixture is too early, as pytest sets stderr once more before the test."""
    made = Terminal()
    monkeypatch.setattr(sys, "stderr", made)
    return made


@pytest.mark.parametrize(
    ("states", "share"),
    [
        ([(1, 4), (2, 4)], 50),
        ([(3, 4), (1, 4)], 75),  # a bar does not go back
        ([(3, 4), (1, 10)], 10),  # unless the plan is another one
        ([(SimpleNamespace(share_done=0.25),)], 25),
        ([("scatter", SimpleNamespace(share_done=0.25))], 25),
        ([(2, "objects", 0.3)], 30),
        ([(object(), object())], 0),
        ([()], 0),
        ([(0, 0)], 0),
    ],
)
def test_states_of_all_functions(monkeypatch: Patch, states: list[Any], share: int) -> None:
    terminal = looked_at(monkeypatch)
    with mistray.ProgressBar("PST") as bar:
        for state in states:
            bar(*state)
        assert terminal.getvalue().rpartition("\r")[2].startswith(f"PST: {share:3}%")
    assert terminal.getvalue().endswith(" \r")  # the line is free again


def test_a_trace(monkeypatch: Patch) -> None:
    terminal = looked_at(monkeypatch)
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
