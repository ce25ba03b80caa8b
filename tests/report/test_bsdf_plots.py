"""Pictures of scatter models: what their axes hold."""

from __future__ import annotations

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.report.figures.bsdf import bsdf_figure, particles_figure
from mistray.scatter.abg import ABg
from mistray.scatter.paint import Paint
from mistray.scatter.scan import scan

ANGLES = (0.0, 30.0, 60.0)


def labels(axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_models() -> None:
    figure = bsdf_figure(scan(ABg(0.0025, 0.001, 1.8), ANGLES), "ABg", knee=0.0215)
    left, right = figure.axes
    scales = [scale for axes in (left, right) for scale in (axes.get_xscale(), axes.get_yscale())]
    assert scales == ["log", "log", "linear", "log"]
    assert labels(left) == ["all angles of incidence"]  # one curve, for it depends on |β - β0| alone
    assert labels(right) == ["0°: TIS 4.134 %", "30°: TIS 3.936 %", "60°: TIS 3.258 %"]
    r, f = left.lines[0].get_data()
    np.testing.assert_allclose(f, 0.0025 / (0.001 + np.asarray(r) ** 1.8), rtol=1e-12)
    for line, angle in zip(right.lines, ANGLES, strict=True):
        theta, f = line.get_data()
        assert theta[np.argmax(f)] == pytest.approx(angle, abs=1e-6)
        assert np.max(f) == pytest.approx(2.5)
    assert left.get_xlim() == (1e-3, 2)
    assert any("knee 0.0215" in text.get_text() for text in left.texts)
    # One that grows away from the normal is drawn for each angle; a Lambertian one is a straight line
    left, _ = bsdf_figure(scan(Paint(0.04, b0=0.05, l=0.1, s=-3, n=1.5), ANGLES), "paint").axes
    assert labels(left) == ["0°", "30°", "60°"]
    assert any(line.get_linestyle() == "--" for line in left.lines)
    left, right = bsdf_figure(scan(Paint(0.3), ANGLES), "paint").axes
    assert labels(left) == ["all angles of incidence"]
    low, high = right.get_ylim()
    assert low < 0.3 / np.pi < high
    with pytest.raises(MistrayError, match="one or more angles"):
        bsdf_figure([], "none")


def test_particles() -> None:
    left, right = particles_figure(300).axes
    (own,) = [line for line in left.lines if line.get_label() == "level 300"]
    diameter, count = own.get_data()
    assert count[0] == pytest.approx(10 ** (0.926 * np.log10(300) ** 2), rel=1e-9)
    assert (diameter[-1], count[-1]) == (pytest.approx(300), pytest.approx(1))  # one particle of the level's diameter
    assert "level 300: 0.02531 %" in labels(right)  # area of the spheres
    (standard,) = [line for line in right.lines if line.get_label() == "formula of the standard"]
    levels, area = standard.get_data()
    assert 10 ** np.interp(np.log10(396), np.log10(levels), np.log10(area)) == pytest.approx(0.10085, rel=1e-3)
    assert "formula of the standard" not in labels(particles_figure(300, 0.383).axes[1])
