"""Plots with values for the pointer: the places are those of the points that the SVG draws."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from mistray.report.html.hover import hover_figure


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
