"""The Phong model: its lobe, its total at all angles, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.physics import phong
from mistray.scatter.evaluate import bsdf
from mistray.scatter.phong import Phong
from mistray.scatter.total import lobe_total

TABLE = 3e-4  # relative, of the total: near 90° the profile bends between the nodes of the radial table


def total(exponent: float, theta: float) -> float:
    """Integral of cos^n α cos θs over the hemisphere, by a grid about the centre of the lobe; NumPy alone."""
    alpha = 0.5 * math.pi * (np.arange(4000) + 0.5) / 4000
    psi = 2 * math.pi * (np.arange(720) + 0.5)[:, None] / 720
    cos_s = math.cos(theta) * np.cos(alpha) + math.sin(theta) * np.sin(alpha) * np.cos(psi)
    values = np.cos(alpha) ** exponent * np.maximum(cos_s, 0) * np.sin(alpha)
    return float(values.sum() * 0.5 * math.pi / 4000 * 2 * math.pi / 720)


@pytest.mark.parametrize("exponent", [1.0, 2.7, 16.0, 300.0])
def test_total(exponent: float) -> None:
    cos_i = np.array([1.0, 0.7, 0.1])
    for lobe in Phong(0.05, exponent).lobes(550.0, 1.0, 1.5, True):
        n = 1.0 if lobe.event == "reflection" else 1.5
        expected = [0.05 * total(exponent, math.asin(math.sqrt(1 - c * c) / n)) for c in cos_i]
        assert phong.tis(0.05, exponent) == pytest.approx(expected[0], rel=1e-4)
        np.testing.assert_allclose(lobe_total(lobe, cos_i, 1.0, 1.5), expected, rtol=TABLE)


def test_reciprocal_in_reflection() -> None:
    """f(a → b) = f(b → a), for directions in any azimuth."""
    model = Phong(0.4, 7.3).lobes(550.0, 1.0, 1.5, True)
    for a, b, phi in ((0.2, 1.4, 0.3), (1.5, 0.0, 0.0), (0.9, 0.8, 2.9)):
        found = []
        for i, s in ((a, b), (b, a)):
            out = np.array([math.sin(s) * math.cos(phi), math.sin(s) * math.sin(phi), math.cos(s)])
            found.append(float(bsdf(model, "reflection", math.cos(i), out[None], 1.0, 1.5, 1.0)[0]))
        assert found[0] == pytest.approx(found[1], rel=1e-12)


def test_beyond_a_right_angle_there_is_none() -> None:
    r = np.array([0.0, 1.0, math.sqrt(2), 1.6, 2.0])
    np.testing.assert_allclose(phong.bsdf(r, 0.4, 3.0), [0.4, 0.4 / 8, 0, 0, 0], atol=1e-15)


def test_events() -> None:
    assert Phong(0.0, 16.0).lobes(550.0, 1.0, 1.5, True) == ()
    assert [lobe.event for lobe in Phong(0.1, 16.0, event="reflection").lobes(550.0, 1.0, 1.5, True)] == ["reflection"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((-0.1, 2.0), "b0 is -0.1"), ((0.1, 0.5), "exponent is 0.5; it must lie"), ((0.1, math.inf), "exponent is")],
)
def test_refuses(arguments: tuple[float, float], message: str) -> None:
    with pytest.raises(MistrayError, match=message):
        Phong(*arguments)


def test_advice() -> None:
    assert Phong(0.1, 16.0).advice() is None
    assert "TIS is 1.05" in str(Phong(3.0, 16.0).advice())  # 6π/18
