"""Targets: their points, areas and edges, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mistray import MistrayError
from mistray.kernel.targets import AimSet, Target

pytestmark = pytest.mark.quick

CENTRE, U, V = np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.5, 0.0]), np.array([0.3, 1.0, 0.4])
SAMPLES = np.random.default_rng(0).random((40_000, 2))
# Mean of a² over the shape: radius²/4 of a disc with a hole, 1/3 of -1 … 1, and 1/6 of a triangle of unit legs; places
# that lie on it, and others
SHAPES = [
    ("ellipse", 0.0, np.pi, 0.25, [(0, 0), (0.7, 0.7), (-0.99, 0)], [(0.72, 0.72), (1.01, 0)]),
    ("ellipse", 0.6, 0.64 * np.pi, 0.25 * (1 + 0.36), [(0.61, 0), (0, -0.99)], [(0.59, 0), (0, 0), (1.01, 0)]),
    ("parallelogram", 0.0, 4.0, 1 / 3, [(0, 0), (0.99, -0.99)], [(1.01, 0), (0, -1.01)]),
    ("triangle", 0.0, 0.5, 1 / 6, [(0.01, 0.01), (0.49, 0.5)], [(0.51, 0.5), (-0.01, 0.2), (0.2, -0.01)]),
]


def coordinates(points: np.ndarray) -> np.ndarray:
    solved, residual, *_ = np.linalg.lstsq(np.stack([U, V], axis=1), (points - CENTRE).T, rcond=None)
    assert np.max(residual) < 1e-20
    return solved


@pytest.mark.parametrize(("shape", "hole", "area", "square", "inner", "outer"), SHAPES)
def test_points_are_uniform_on_the_target(shape, hole, area, square, inner, outer):
    """Second moments within 5 standard errors (false alarm 1e-5 for all)."""
    target = Target(shape, CENTRE, U, V, hole=hole)
    assert target.area == pytest.approx(area * np.linalg.norm(np.cross(U, V)), rel=1e-12)
    points = target.points(SAMPLES)
    a, b = coordinates(points)
    for x in (a, b):
        assert abs(np.mean(x**2) - square) < 5 * np.std(x**2) / np.sqrt(len(x))
    assert np.all(target.holds(CENTRE + (1 - 1e-9) * (points - CENTRE)) | (np.hypot(a, b) < hole * (1 + 1e-6)))
    np.testing.assert_allclose(np.abs((points - CENTRE) @ target.normal), 0, atol=1e-14)
    for places, on in ((inner, True), (outer, False)):
        assert np.all(target.holds(CENTRE + np.array(places) @ np.stack([U, V])) == on)
    assert not target.holds(np.full((1, 3), np.nan))[0]


TARGET: dict[str, Any] = {"shape": "ellipse", "centre": CENTRE, "u": U, "v": V, "share": 0.5}
HALF = Target(**TARGET)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: Target(**TARGET | {"shape": "hexagon"}), "shape is 'hexagon'"),
        (lambda: Target(**TARGET | {"centre": [0.0, np.nan, 0.0]}), "centre is"),
        (lambda: Target(**TARGET | {"u": [1.0, 2.0]}), "u is"),
        (lambda: Target(**TARGET | {"v": 2 * U}), "has no area"),
        (lambda: Target(**TARGET | {"hole": 1.0}), "hole is 1"),
        (lambda: Target(**TARGET | {"shape": "triangle", "hole": 0.5}), "only an ellipse"),
        (lambda: Target(**TARGET | {"share": 0.0}), "share is 0"),
        (lambda: AimSet((HALF,), 1), r"add up to 0\.5"),
        (lambda: AimSet((HALF, HALF), 0), "0 aimed rays"),
    ],
)
def test_impossible_targets(made: Callable[[], Any], words: str) -> None:
    with pytest.raises(MistrayError, match=words):
        made()
