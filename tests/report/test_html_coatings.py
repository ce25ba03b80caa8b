"""The coatings in a report: bare glass by hand, and all light accounted for."""

from __future__ import annotations

import re

import pytest
from report.fake_trace import trace_at

import mistray
from mistray.analysis.ghosts import GhostReport
from mistray.report.ghosts.report import html_text
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def text():
    """The surfaces of a real scene under the light of a fake trace."""
    scene, t = mistray.load("plate"), trace_at(0.0)
    t.tables = [SurfaceTable(scene, 550.0)]
    return html_text(GhostReport(scene, {0.0: t}, t, {}), "plate")


def rows(text: str, table: str) -> list[dict[str, str]]:
    body = re.search(rf'<table id="{table}".*?</table>', text, re.DOTALL)[0]
    heads = [re.sub(r"<small>.*?</small>", "", head) for head in re.findall(r"<th [^>]*>(.*?)</th>", body, re.DOTALL)]
    lines = re.findall(r"<tr>(<td.*?)</tr>", body, re.DOTALL)
    return [dict(zip(heads, re.findall(r"<td[^>]*>(.*?)</td>", line, re.DOTALL), strict=True)) for line in lines]


def test_bare_glass(text):
    """n = 1.5: R = (0.5/2.5)² = 4 %."""
    front = next(row for row in rows(text, "t-surface-budget-0") if row["surface"] == "plate_front")
    assert (float(front["R"]), float(front["T"]), float(front["A"])) == pytest.approx((4, 96, 0), abs=1e-9)


def test_surfaces_alike_stand_together(text):
    table = rows(text, "t-coatings-0")
    assert any({"plate_front", "plate_rear"} <= set(row["surfaces"].split(", ")) for row in table)
    for row in table:
        shares = [float(row[name]) for name in ("R", "T", "TIS reflected", "TIS transmitted", "A")]
        assert sum(shares) == pytest.approx(100, abs=1e-6)


def test_section_can_be_reached(text):
    assert '<a href="#coatings">' in text
    assert '<h2 id="coatings">' in text
