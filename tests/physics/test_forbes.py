"""Forbes's polynomials without symmetry against their definition, and against optiland's recurrences."""

from __future__ import annotations

import math

import numpy as np
import peers
import pytest
from scipy.integrate import quad

from mistray.physics.sags.forbes import q2d, q2d_values
from mistray.physics.sags.terms import sag

pytestmark = pytest.mark.quick


@pytest.mark.parametrize("m", [1, 2, 3, 7, 20])
def test_gradients_are_orthonormal(m: int) -> None:
    """Mean products of gradients over the disc with the weight 1/√(u² - u⁴), by adaptive quadrature over u = sin t."""
    step = 1e-5

    def gradient(n: int, u: float) -> tuple[float, float]:
        def value(u: float) -> float:
            return float(u**m * q2d_values(np.array(u * u), m, n)[n])

        return (value(u + step) - value(u - step)) / (2 * step), m * value(u) / u

    for j, k in ((0, 0), (1, 1), (4, 4), (0, 1), (1, 3), (2, 4)):

        def product(t: float, j: int = j, k: int = k) -> float:
            a, b = gradient(j, math.sin(t)), gradient(k, math.sin(t))
            return 0.5 * 2 / math.pi * (a[0] * b[0] + a[1] * b[1])  # half: the mean of cos² and of sin²

        mean = quad(product, 1e-6, math.pi / 2, epsabs=1e-10)[0]
        assert mean == pytest.approx(float(j == k), abs=1e-6)


def test_the_first_ones() -> None:
    x = np.linspace(0, 1, 7)
    assert q2d_values(x, 1, 0)[0] == pytest.approx(np.ones(7))
    assert q2d_values(x, 2, 0)[0] == pytest.approx(np.full(7, math.sqrt(0.5)))
    assert (np.diff(q2d_values(x, 1, 1)[1]) < 0).all()  # the leading coefficient is negative
    assert q2d(x, 0 * x, {(2, 0): 3.0}, {(2, 0): 5.0}) == pytest.approx(3 * math.sqrt(0.5) * x**2)
    assert q2d(x, x, {(2, 0): 3.0}, {(2, 0): 5.0}) == pytest.approx(5 * math.sqrt(0.5) * 2 * x**2)


@pytest.mark.parametrize("letter", ["a", "b"])
@pytest.mark.parametrize("m", [1, 2, 3, 6, 11])
def test_the_same_as_optiland(letter: str, m: int) -> None:
    forbes, frame = peers.optiland("geometries.forbes.geometry"), peers.optiland("coordinate_system")
    x, y = np.random.default_rng(1).uniform(-7, 7, (2, 60))
    for n in (0, 1, 2, 3, 5, 9, 14):
        config = forbes.ForbesSurfaceConfig(radius=40.0, conic=-0.4, terms={(letter, m, n): 1.0}, norm_radius=10.0)
        theirs = forbes.ForbesQ2dGeometry(frame.CoordinateSystem(), config).sag(x, y)
        name = f"q2d_{'cos' if letter == 'a' else 'sin'}_{m}_{n}"
        ours = sag(x, y, {"curvature": 1 / 40, "conic": -0.4, name: 1.0, "q_radius": 10.0})
        assert ours == pytest.approx(theirs, abs=1e-12)
