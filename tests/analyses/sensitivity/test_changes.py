"""Changes that lower a metric: closed forms of the linear model, bounds, noise, and a search by brute force."""

import math

import mitsuba as mi
import numpy as np
import pytest
from scipy.optimize import minimize

import mistray
from mistray.analyses.sensitivity.changes import Ranges, best_together, least_effort, single_changes
from mistray.analyses.sensitivity.rows import LineNumbers, lines_of
from mistray.metrics.parameters import parameters

pytestmark = pytest.mark.quick


def ranges(slope, value=None, low=None, high=None, tolerance=None, se=None) -> Ranges:
    n = len(slope)

    def given(numbers, default: float) -> np.ndarray:
        return np.full(n, default) if numbers is None else np.array(numbers, dtype=float)

    return Ranges(given(value, 0), given(low, -np.inf), given(high, np.inf), given(tolerance, 1), np.array(slope),
                  given(se, 0))  # fmt: skip


def test_alone_and_together() -> None:
    """ln M falls by ln 10 after Δ = -ln 10 / s, against s; less at a bound; noise proposes nothing."""
    up, down = single_changes(ranges([2.0, -0.5], value=[1.0, 3.0]), 10.0)
    assert (up.value, up.factor, up.reached) == (pytest.approx(1 - math.log(10) / 2), pytest.approx(10), True)
    assert (down.value, down.reached) == (pytest.approx(3 + math.log(10) / 0.5), True)
    # From 0.02 down to 0 with s = 40 is a factor of e^0.8, from 3 up to 4 with s = -1.5 one of e^1.5
    both = single_changes(ranges([40.0, -1.5], value=[0.02, 3.0], low=[0.0, 0.0], high=[1.0, 4.0]), 10.0)
    assert [c.value for c in both] == [0.0, 4.0]
    assert [c.factor for c in both] == pytest.approx([math.exp(0.8), math.exp(1.5)])
    assert not any(c.reached for c in both)
    (change,) = single_changes(ranges([2.0], value=[1.0], se=[1.0]), 10.0)
    assert (change.value, change.factor, change.reached) == (1.0, 1.0, False)
    # Without bounds x_i ~ w_i² (Lagrange); with bounds against a numerical minimum; and out of reach
    weight = np.array([1.0, 2.0, 3.0])
    assert least_effort(weight, np.full(3, np.inf), 7.0) == pytest.approx(7 * weight**2 / 14)
    weight, most, goal = np.array([1.0, 2.0, 3.0, 0.5]), np.array([9.0, 0.7, 1.1, 9.0]), 2.5
    found = minimize(
        lambda x: np.sum((x / weight) ** 2), goal * np.ones(4) / 4, bounds=[(0, m) for m in most],
        constraints={"type": "eq", "fun": lambda x: x.sum() - goal}, options={"ftol": 1e-14},
    )  # fmt: skip
    assert least_effort(weight, most, goal) == pytest.approx(found.x, abs=1e-6)
    assert least_effort(np.ones(2), np.array([0.5, 0.25]), 3.0) == pytest.approx([0.5, 0.25])
    # The three with the largest change per tolerance, unless they have nothing to give or are not known
    given = ranges([1.0, 5.0, 3.0, 2.0], tolerance=[10.0, 0.1, 1.0, 2.0])
    found = best_together(given, 10.0)
    assert [c.number for c in found] == [0, 3, 2]
    assert math.prod(c.factor for c in found) == pytest.approx(10)
    assert sum(given.slope[c.number] * c.value for c in found) == pytest.approx(-math.log(10))
    given = ranges([9.0, 8.0, 1.0, 1.0, 1.0], value=[0.001, 0.0, 1.0, 1.0, 1.0], low=[0.0] * 5, tolerance=[1.0] * 5)
    found = best_together(given, 10.0)
    assert sorted(c.number for c in found) == [2, 3, 4]
    assert all(c.reached for c in found)
    found = best_together(ranges([1.0, 1.0, 1.0, 1.0], value=[0.5, 0.1, 0.3, 0.2], low=[0.0] * 4), 10.0)
    assert [(c.number, c.value, c.reached) for c in found] == [(0, 0.0, False), (2, 0.0, False), (3, 0.0, False)]
    assert math.prod(c.factor for c in found) == pytest.approx(math.exp(1.0))
    assert best_together(ranges([1.0, 2.0], se=[1.0, 2.0]), 10.0) == ()


def test_a_range_ends_before_what_its_model_refuses() -> None:
    """A paint without a glossy lobe refuses the reflectance 0, and with it one at which it scatters more than all."""
    at = mi.ScalarTransform4f().translate
    paint = {"type": "paint", "id": "black_paint", "reflectance": 0.04}
    glossy = {"type": "paint", "id": "glossy", "reflectance": 0.04, "b0": 0.5}
    wall, black = {"type": "asphere", "semi_diameter": 5.0}, {"type": "interface", "R": 0.0}
    scene = mistray.load(
        {
            "type": "scene",
            "beam": {"type": "collimated", "radius": 1.0},
            "wall": wall | {"bsdf": black | {"p": paint}},
            "other": wall | {"to_world": at([0, 0, 5]), "bsdf": black | {"p": glossy}},
            "detector": wall | {"to_world": at([0, 0, -5]), "bsdf": black, "sensor": {"type": "irradiancemeter"}},
        }
    )
    params = mi.traverse(scene)
    known = parameters(scene, params)
    keys = [key for key in known if key.endswith("reflectance")]
    lines = lines_of(scene, params, known, keys)
    value = np.array([float(np.ravel(line.parameter.value)[line.entry]) for line in lines])
    ones = np.ones(len(lines))
    wide = Ranges(value, 0 * ones, ones, ones, ones, ones)
    found = LineNumbers(lines, wide, ones, ones, ones, ones, ones[None]).accepted(params, wide, lambda: None)
    ends = {line.parameter.key: (found.low[k], found.high[k]) for k, line in enumerate(lines)}
    assert len(ends) == 2
    assert next(end for key, end in ends.items() if key.startswith(("black", "wall"))) == (pytest.approx(4e-5), 1.0)
    low, high = next(end for key, end in ends.items() if key.startswith(("glossy", "other")))
    assert low == 0.0
    assert 0.04 < high < 1.0
    np.testing.assert_allclose([float(np.ravel(params[key])[0]) for key in keys], 0.04, rtol=1e-6)
