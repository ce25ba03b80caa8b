"""A page names figures that a time budget leaves no time for."""

from __future__ import annotations

import importlib
import itertools
import re
import warnings
from pathlib import Path

import pandas as pd
import pytest

import mistray
from mistray.report import write_all
from mistray.report.figures.figure import Figure as Drawing
from mistray.report.html.render import html_page
from mistray.report.model import FigurePart, Report, Section
from mistray.time_budget import FIGURE, within

ghosts_output = importlib.import_module("mistray.report.ghosts_output")


@pytest.mark.parametrize("fields", [0, 2])
def test_a_page_shows_the_fields_that_there_was_time_for(
    fields: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = mistray.ghosts(mistray.load("singlet_window_detector"), [0, 2, 4], rays=200)
    # Time is asked for twice a field, before and after its pictures
    left = itertools.chain([1e6] * 2 * fields, itertools.repeat(0.0))
    monkeypatch.setattr(ghosts_output, "left", lambda: next(left))
    with within(1000), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        files = {path.name for path in write_all(report, tmp_path)}
    shown = {name for name in files if name.startswith("ghosts_")}
    assert len(shown) == fields
    assert {"report.html", "levels.png", *(f"layout_{name[7:]}" for name in shown)} <= files
    assert set(pd.read_csv(tmp_path / "summary.csv").field_deg) == {0, 2, 4}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert len(set(re.findall(r'id="(field-[\d_]+)"', page))) == fields


def drawing() -> Drawing:
    """A line."""
    made = Drawing()
    made.subplots().plot([0, 1])
    return made


def test_a_figure_is_drawn_or_named() -> None:
    report = Report("Page", "scene", [Section("a", "Curve", [FigurePart(drawing, "A <curve>.")], "Curve")])
    whole = html_page(report)
    assert whole.count("<figcaption>A &lt;curve&gt;.</figcaption>") == 1
    with within(FIGURE / 2):
        cut = html_page(report)
    assert "A &lt;curve&gt;." in cut
    assert "<figcaption>" not in cut
    assert len(cut) < len(whole) - 1000  # the SVG
