"""Parameter changes that lower a metric by a given factor, from a linear model of its logarithm."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

SIGNIFICANT = 3.0  # standard errors that a derivative must differ from 0 by
CANDIDATES = 12  # parameters whose combinations are tried
ROUNDING = 1e-9  # relative


@dataclass(frozen=True)
class ParameterChange:
    """
    New value of one parameter, and its effect on the metric.

    Attributes
    ----------
    number : int
        Index of the parameter.
    value : float
        New value, in the unit of the parameter: a bound if the factor cannot be reached, and the present value if the
        derivative does not differ significantly from 0.
    factor : float
        Factor by which the model lowers the metric; 1 if the derivative does not differ significantly from 0.
    reached : bool
        Whether the requested factor is reached, by this change alone or by all that are proposed together.
    """

    number: int
    value: float
    factor: float
    reached: bool


@dataclass(frozen=True)
class Ranges:
    """
    Values, ranges and tolerances of parameters, with the slopes of the metric, (n,) float64 each.

    Attributes
    ----------
    value, low, high : float64
        Values and physical ranges, in the units of the parameters; ranges may be infinite.
    tolerance : float64
        Tolerance, the measure of a change, greater than 0.
    slope, slope_se : float64
        d ln(metric) / d value and its standard error, per unit of the parameter.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    tolerance: np.ndarray
    slope: np.ndarray
    slope_se: np.ndarray

    def after(self, number: int, gain: float) -> float:
        """
        Return the value of the parameter of index `number`, in its unit, that lowers ln(metric) by `gain`.

        `gain` is greater than 0. If no value in the range does, return the bound at which the metric is lower.
        """
        slope, most = float(self.slope[number]), -float(self.gain[number])
        if gain >= most * (1 - ROUNDING):
            return float(self.low[number] if slope > 0 else self.high[number])
        return float(self.value[number]) - gain / slope

    @property
    def gain(self) -> np.ndarray:
        """
        Change of ln(metric), ≤ 0, (n,), with each parameter alone at the bound that lowers the metric.

        It is 0 where the slope is not significant.
        """
        room = np.where(self.slope > 0, self.value - self.low, self.high - self.value)
        known = np.abs(self.slope) > SIGNIFICANT * self.slope_se
        with np.errstate(invalid="ignore"):
            return np.where(known, -np.abs(self.slope) * np.maximum(room, 0.0), 0.0)


def single_changes(ranges: Ranges, factor: float) -> tuple[ParameterChange, ...]:
    """
    Return for each parameter the value that alone lowers the metric by `factor`.

    Where the range does not allow that, return the bound that lowers it most, and the present value if the slope is not
    significant.
    """
    goal = math.log(factor)
    found = []
    for number, gain in enumerate(ranges.gain):
        value = ranges.after(number, min(-gain, goal)) if gain < 0 else float(ranges.value[number])
        found.append(ParameterChange(number, value, math.exp(min(-gain, goal)), bool(-gain >= goal)))
    return tuple(found)


def best_together(ranges: Ranges, factor: float, count: int = 3) -> tuple[ParameterChange, ...]:
    """
    Return new values of at most `count` parameters that together lower the metric by `factor` with the least effort.

    The effort is Σ (Δ/tolerance)². If no combination reaches the factor, the result is the one that lowers the metric
    most, at bounds. All combinations of `CANDIDATES` parameters are tried: half of them have the largest change per
    tolerance, half the largest gain within their range.

    Parameters
    ----------
    ranges : Ranges
        Values, ranges and slopes of the parameters.
    factor : float
        Factor by which to lower the metric, greater than 1.
    count : int
        Number of parameters to change.

    Returns
    -------
    tuple of ParameterChange
        The largest first; the product of their factors is that of all together. Empty if no slope is significant.
    """
    goal = math.log(factor)
    gain = -ranges.gain
    per_tolerance = np.where(gain > 0, np.abs(ranges.slope) * ranges.tolerance, 0.0)
    by_tolerance, by_gain = (np.argsort(-scores, kind="stable") for scores in (per_tolerance, np.minimum(gain, goal)))
    half = CANDIDATES // 2
    order = dict.fromkeys([*by_tolerance[:half], *by_gain[:half], *by_tolerance])
    candidates = [int(k) for k in order if gain[k] > 0][:CANDIDATES]
    best: tuple[float, float, tuple[int, ...], np.ndarray] | None = None
    for members in itertools.combinations(candidates, min(count, len(candidates))):
        chosen = list(members)
        parts = least_effort(per_tolerance[chosen], gain[chosen], goal)
        effort = float(np.sum((parts / per_tolerance[chosen]) ** 2))
        missing = max(goal - float(parts.sum()), 0.0)
        missing = 0.0 if missing < ROUNDING * goal else missing
        if best is None or (missing, effort) < best[:2]:
            best = missing, effort, members, parts
    if best is None:
        return ()
    missing, _, members, parts = best
    found = []
    for number, part in sorted(zip(members, parts, strict=True), key=lambda item: -item[1]):
        if part > 0:
            found.append(ParameterChange(number, ranges.after(number, part), math.exp(part), missing == 0))
    return tuple(found)


def least_effort(weight: np.ndarray, most: np.ndarray, goal: float) -> np.ndarray:
    """
    Return reductions x of ln(metric), (n,), with Σ x = `goal` and 0 ≤ x ≤ `most`, that minimise Σ (x/`weight`)².

    Without bounds x is proportional to weight² (Lagrange). A part at its bound stays there and the others share the
    rest. If the bounds do not allow the goal, they are the result.
    """
    parts = np.zeros(len(weight))
    free = np.ones(len(weight), dtype=bool)
    while free.any():
        left = goal - parts[~free].sum()
        parts[free] = left * weight[free] ** 2 / np.sum(weight[free] ** 2)
        over = free & (parts > most)
        if not over.any():
            break
        parts[over] = most[over]
        free &= ~over
    return parts
