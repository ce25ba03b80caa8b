"""A page names figures that a time budget leaves no time for."""

from __future__ import annotations

from mistray.report.figures.figure import Figure as Drawing
from mistray.report.html.render import html_page
from mistray.report.model import Figure, Report, Section
from mistray.time_budget import FIGURE, within


def drawing() -> Drawing:
    """A line."""
    made = Drawing()
    made.subplots().plot([0, 1])
    return made


def test_a_figure_is_drawn_or_named() -> None:
    report = Report("Page", "scene", [Section("a", "Curve", [Figure(drawing, "A <curve>.")], "Curve")])
    whole = html_page(report)
    assert whole.count("<figcaption>A &lt;curve&gt;.</figcaption>") == 1
    with within(FIGURE / 2):
        cut = html_page(report)
    assert "A &lt;curve&gt;." in cut
    assert "<figcaption>" not in cut
    assert len(cut) < len(whole) - 1000  # the SVG
