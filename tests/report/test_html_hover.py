"""Plots with values for the pointer: the places are those of the points that the SVG draws."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from report.fake_pst import fake_pst

from mistray.report.html.hover import hover_figure
from mistray.report.html.render import html_parts
from mistray.report.pst_output import causes_figure, curve_figure


def data_of(html: str) -> dict:
    return json.loads(re.search(r'<script type="application/json"[^>]*>(.*?)</script>', html)[1])


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_places_are_those_of_the_drawn_points(scale):
    x = [1.0, 2.0, 5.0, 9.0]
    figure = Figure(figsize=(7.3, 4.1), dpi=137, layout="constrained")
    above, _ = figure.subplots(2, 1, sharex=True)
    above.set_xscale(scale)
    above.plot(x, [1, 3, 2, 1e3], marker="o")
    above.set_ylabel("a long\nlabel")
    html = hover_figure("data-a", figure, above, x, ["t"] * 4, [[("v", "1 < 2")]] * 4, "what it is")
    data = data_of(html)
    markers = re.findall(r'<use xlink:href="#[^"]*" x="([\d.]+)" y="([\d.]+)" style="fill: #1f77b4', html)
    drawn = [tuple(map(float, pair)) for pair in markers]
    assert len(drawn) == 4
    np.testing.assert_allclose(data["x"], [place for place, _ in drawn], atol=0.05)
    left, top, right, bottom = data["area"]
    assert all(left < place < right and top < height < bottom for place, height in drawn)
    view = [float(v) for v in re.search(r'viewBox="([^"]*)"', html)[1].split()]
    np.testing.assert_allclose(data["view"], view, atol=1e-3)
    assert "1 \\u003c 2" in html
    assert 'tabindex="0"' in html


def test_curve_has_the_values_of_the_table():
    pst = fake_pst(dark_from_deg=70.0)
    data = data_of(html_parts([curve_figure(pst, "camera")]))
    assert data["titles"][14] == "PST at 28°"
    total, se = (values[14] for values in pst.curve())
    values = dict(data["values"][14])
    assert float(values["all light"].split(" ± ")[0]) == pytest.approx(total, abs=0.6 * se)
    assert set(values) >= {"all light", "stray light", "ghost", "single scatter"}
    assert dict(data["values"][-1])["all light"] == "–"
    assert len(data["x"]) == len(data["values"]) == len(pst.field_deg)
    assert np.all(np.diff(data["x"]) > 0)
    causes = data_of(html_parts([causes_figure(fake_pst(), "camera")]))["values"]
    shares = [sum(float(text.split()[0]) for _, text in values) for values in causes]
    np.testing.assert_allclose(shares, 100, rtol=0.02)
