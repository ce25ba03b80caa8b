"""Changes that lower a metric: closed forms of the linear model, bounds, noise, and a search by brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from mistray.optimize.tolerances.changes import Ranges, best_together, least_effort, single_changes


def ranges(slope, value=None, low=None, high=None, tolerance=None, se=None) -> Ranges:
    n = len(slope)

    def given(numbers, default: float) -> np.ndarray:
        return np.full(n, default) if numbers is None else np.array(numbers, dtype=float)

    return Ranges(given(value, 0), given(low, -np.inf), given(high, np.inf), given(tolerance, 1), np.array(slope),
                  given(se, 0))  # fmt: skip


class TestAlone:
    def test_within_the_range(self) -> None:
        """ln M falls by ln 10 after Δ = -ln 10 / s, in the direction against s."""
        up, down = single_changes(ranges([2.0, -0.5], value=[1.0, 3.0]), 10.0)
        assert (up.value, up.factor, up.reached) == (pytest.approx(1 - math.log(10) / 2), pytest.approx(10), True)
        assert (down.value, down.reached) == (pytest.approx(3 + math.log(10) / 0.5), True)

    def test_at_the_bound(self) -> None:
        """From 0.02 down to 0 with s = 40 is a factor of e^0.8, from 3 up to 4 with s = -1.5 one of e^1.5."""
        both = single_changes(ranges([40.0, -1.5], value=[0.02, 3.0], low=[0.0, 0.0], high=[1.0, 4.0]), 10.0)
        assert [c.value for c in both] == [0.0, 4.0]
        assert [c.factor for c in both] == pytest.approx([math.exp(0.8), math.exp(1.5)])
        assert not any(c.reached for c in both)

    def test_noise_proposes_nothing(self) -> None:
        (change,) = single_changes(ranges([2.0], value=[1.0], se=[1.0]), 10.0)
        assert (change.value, change.factor, change.reached) == (1.0, 1.0, False)


class TestTogether:
    def test_least_effort_without_bounds(self) -> None:
        """Lagrange: x_i ~ w_i²."""
        weight = np.array([1.0, 2.0, 3.0])
        assert least_effort(weight, np.full(3, np.inf), 7.0) == pytest.approx(7 * weight**2 / 14)

    def test_least_effort_with_bounds(self) -> None:
        """Against a numerical minimum."""
        weight, most, goal = np.array([1.0, 2.0, 3.0, 0.5]), np.array([9.0, 0.7, 1.1, 9.0]), 2.5
        found = minimize(
            lambda x: np.sum((x / weight) ** 2), goal * np.ones(4) / 4, bounds=[(0, m) for m in most],
            constraints={"type": "eq", "fun": lambda x: x.sum() - goal}, options={"ftol": 1e-14},
        )  # fmt: skip
        assert least_effort(weight, most, goal) == pytest.approx(found.x, abs=1e-6)

    def test_out_of_reach(self) -> None:
        assert least_effort(np.ones(2), np.array([0.5, 0.25]), 3.0) == pytest.approx([0.5, 0.25])

    def test_the_three_with_the_least_effort(self) -> None:
        """Of four without bounds the three with the largest change per tolerance, which need not be the largest s."""
        given = ranges([1.0, 5.0, 3.0, 2.0], tolerance=[10.0, 0.1, 1.0, 2.0])
        found = best_together(given, 10.0)
        assert [c.number for c in found] == [0, 3, 2]
        assert math.prod(c.factor for c in found) == pytest.approx(10)
        slope_times_change = sum(given.slope[c.number] * c.value for c in found)
        assert slope_times_change == pytest.approx(-math.log(10))

    def test_bounds_decide(self) -> None:
        """The best by tolerance have nothing to give, so that others are taken."""
        given = ranges([9.0, 8.0, 1.0, 1.0, 1.0], value=[0.001, 0.0, 1.0, 1.0, 1.0], low=[0.0] * 5, tolerance=[1.0] * 5)
        found = best_together(given, 10.0)
        assert sorted(c.number for c in found) == [2, 3, 4]
        assert all(c.reached for c in found)

    def test_nothing_reaches(self) -> None:
        given = ranges([1.0, 1.0, 1.0, 1.0], value=[0.5, 0.1, 0.3, 0.2], low=[0.0] * 4)
        found = best_together(given, 10.0)
        assert [(c.number, c.value, c.reached) for c in found] == [(0, 0.0, False), (2, 0.0, False), (3, 0.0, False)]
        assert math.prod(c.factor for c in found) == pytest.approx(math.exp(1.0))

    def test_no_known_derivative(self) -> None:
        assert best_together(ranges([1.0, 2.0], se=[1.0, 2.0]), 10.0) == ()
