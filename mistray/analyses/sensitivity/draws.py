"""Monte Carlo of manufactured systems: every parameter is drawn within its tolerance, one trace per system."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.sensitivity.finished import Finished
from mistray.analyses.sensitivity.rows import SensitivityRow, shifted_values, whole_values
from mistray.errors import MistrayError, errors_of
from mistray.estimate import Estimate
from mistray.execute.workers import current_workers, passes_by_workers
from mistray.metrics.metric import Metric
from mistray.metrics.scene_values import assign
from mistray.metrics.steps import Steps
from mistray.scene.check import check_overlaps

PERCENTILES = (5.0, 50.0, 95.0)
RESAMPLES = 400  # of the draws, for the errors of percentiles
LEAST_SYSTEMS = 2  # for a standard deviation
MOST_REJECTED = 20  # systems whose surfaces cross, for each that is traced
OFF_AXIS = ("x", "y", "tilt_x", "tilt_y", "tilt_z")


@dataclass(frozen=True)
class Draws:
    """
    Metrics of randomly perturbed systems, relative to the nominal one.

    Attributes
    ----------
    ratios : (draws,) float64
        Metric over that of the nominal system, traced with the same rays.
    predicted : (draws,) float64
        Logarithm of this ratio by the linear model.
    nominal : float
        Metric of the nominal system, in its unit.
    rejected : int
        Number of systems drawn again because surfaces crossed each other.
    requested : int
        Number of systems requested; more than there are ratios if the time was up.
    """

    ratios: np.ndarray
    predicted: np.ndarray
    nominal: float
    rejected: int = 0
    requested: int = 0

    @property
    def logs(self) -> np.ndarray:
        """Natural logarithm of the ratios, (draws,)."""
        return np.asarray(np.log(self.ratios))

    @property
    def deviation(self) -> Estimate:
        """Standard deviation of ln(metric), with its standard error for a normal distribution."""
        count = len(self.ratios)
        value = float(self.logs.std(ddof=1))
        return Estimate(value, value / math.sqrt(2 * (count - 1)))

    @property
    def mean(self) -> Estimate:
        """Mean of the metric over that of the nominal system; its difference from 1 is a second-order effect."""
        return Estimate(float(self.ratios.mean()), float(self.ratios.std(ddof=1)) / math.sqrt(len(self.ratios)))

    @property
    def predicted_deviation(self) -> float:
        """Standard deviation of ln(metric) by the linear model for the same draws."""
        return float(self.predicted.std(ddof=1))

    @property
    def unexplained(self) -> float:
        """
        Share of the variance of ln(metric) that the linear model does not explain.

        It is 0 if the model is exact, and above 1 if the model is worse than a constant.
        """
        residual = self.logs - self.predicted
        variance = float(self.logs.var())
        return float(residual.var() / variance) if variance > 0 else 0.0

    def percentile(self, percent: float) -> Estimate:
        """Return a percentile of the metric over nominal, with a standard error from resampling the draws."""
        generator = np.random.default_rng(0)
        picks = generator.integers(0, len(self.ratios), (RESAMPLES, len(self.ratios)))
        return Estimate(
            float(np.percentile(self.ratios, percent)),
            float(np.percentile(self.ratios[picks], percent, axis=1).std(ddof=1)),
        )


def draw_systems(
    metric: Metric,
    params: Mapping[str, Any],
    rows: Sequence[SensitivityRow],
    groups: Sequence[tuple[str, Sequence[int]]],
    count: int,
    seed: int,
    advance: Steps,
    finished: Finished,
) -> Draws | None:
    """
    Return the metrics of traced systems whose parameters are drawn from normal distributions.

    Their standard deviation is the tolerance, and they are clipped to the physical range.

    All are traced with the same rays, so that differences are due to the parameters alone. If R + T of an ideal coating
    would exceed 1, what is drawn of them is reduced. A system in which optical surfaces cross, with the displacements
    off the axis and the tilts of the nominal one, cannot be put together and is drawn again.

    Parameters
    ----------
    metric : Metric
        Metric of the scene.
    params : mi.SceneParameters
        Parameters of its scene, which are restored afterwards.
    rows : sequence of SensitivityRow
        Parameters with their derivatives.
    groups : sequence of (str, sequence of int)
        Name of each group, and indices of its rows, which are drawn together.
    count : int
        Number of systems, at least 2.
    seed : int
        Seed of the draws.
    advance : Steps
        Called after each system; no system is begun that would take longer than the time left.
    finished : Finished
        Finished part; its systems are not traced again, and new ones are added to it.

    Returns
    -------
    Draws or None
        None if there was no time for two systems.

    Raises
    ------
    MistrayError
        If a system is impossible or has no light, which the message names, or too many have surfaces that cross.
    """
    lines = [row.line for row in rows]
    generator = np.random.default_rng(seed)
    places = np.arange(len(rows))
    for _, members in groups:
        places[list(members)] = members[0]
    value, low, high, tolerance = (
        np.array([getattr(row, name) for row in rows]) for name in ("value", "low", "high", "tolerance")
    )
    slope = np.array([row.change.value for row in rows]) / tolerance
    given = whole_values(params, lines)
    predicted: list[float] = []
    rejected = 0

    def systems() -> Iterator[dict[str, np.ndarray]]:
        """Yield the parameter values of systems whose surfaces do not cross, already set in the scene."""
        nonlocal rejected
        while len(predicted) < count and (len(predicted) < len(finished.systems) or advance.left > longest):
            drawn = np.clip(value + tolerance * generator.standard_normal(len(rows))[places], low, high)
            drawn = _possible(rows, drawn, params)
            values = shifted_values(given, lines, drawn.tolist())
            with errors_of(f"perturbed system {len(predicted) + 1}"):
                fits = _put(metric.scene, params, values, given)
            if not fits:
                rejected += 1
                if rejected > MOST_REJECTED * (len(predicted) + 1):
                    raise MistrayError(
                        f"{rejected} of {rejected + len(predicted)} perturbed systems have surfaces that cross; give "
                        "smaller tolerances"
                    )
                continue
            predicted.append(float(slope @ (drawn - value)))
            yield values

    # Of the very rays that all systems are traced with
    longest, nominal = _timed(metric.value)
    workers, before = current_workers(), len(finished.systems)
    try:
        if workers is None:
            for number, _ in enumerate(systems()):
                if number >= before:
                    took, traced = _timed(partial(_checked, number, metric.value))
                    longest = max(longest, took)
                    finished.add(traced)
                advance()
        else:
            drawn_systems = list(systems())
            assign(params, given)
            task = _SystemsTask(metric, given, drawn_systems)
            numbers = {number: number for number in range(before, len(drawn_systems))}
            for traced in passes_by_workers(workers, task, numbers, "systems", lambda *_: advance()).values():
                finished.add(traced)
    finally:
        assign(params, given)
        finished.save()
    if len(predicted) < LEAST_SYSTEMS:
        return None
    ratios = np.array(finished.systems[: len(predicted)]) / nominal
    return Draws(ratios, np.array(predicted), nominal, rejected, count)


def _timed(trace: Callable[[], float]) -> tuple[float, float]:
    """Return the duration of a call of `trace`, s, and its result."""
    began = time.perf_counter()
    result = trace()
    return time.perf_counter() - began, result


def _checked(number: int, trace: Callable[[], float]) -> float:
    """Return the metric of system `number` by a trace; raise `MistrayError` unless it is finite and greater than 0."""
    with errors_of(f"perturbed system {number + 1}"):
        traced = trace()
    if not (math.isfinite(traced) and traced > 0):
        raise MistrayError(f"perturbed system {number + 1}: the metric is {traced:g}; give more rays")
    return traced


@dataclass(frozen=True, eq=False)
class _SystemsTask:
    """Task in which workers trace perturbed systems; `given` has the nominal parameter values by key."""

    metric: Metric
    given: Mapping[str, np.ndarray]
    systems: Sequence[Mapping[str, np.ndarray]]

    def make(self) -> Any:
        """Return the parameters of the scene, ``mi.traverse(scene)``, some of which the perturbed systems change."""
        return mi.traverse(self.metric.scene)

    def do(self, made: Any, part: int) -> float:
        """Trace the system of index `part`, restore the nominal parameters, and return the metric of the system."""
        try:
            _put(self.metric.scene, made, self.systems[part], self.given)
            return _checked(part, self.metric.value)
        finally:
            assign(made, self.given)


def _put(scene: Any, params: Any, values: Mapping[str, np.ndarray], given: Mapping[str, np.ndarray]) -> bool:
    """
    Set parameters in a scene; return False if surfaces cross before they are moved across their axes or tilted.

    `given` has the nominal values, with which off-axis displacements and tilts begin.
    """
    aside = {key: value for key, value in values.items() if key.rsplit(".", 1)[-1] in OFF_AXIS}
    assign(params, {**values, **{key: given[key] for key in aside}})
    try:
        check_overlaps(scene)
    except MistrayError:
        return False
    if aside:
        assign(params, aside)
    return True


def _possible(rows: Sequence[SensitivityRow], drawn: np.ndarray, params: Mapping[str, Any]) -> np.ndarray:
    """Return drawn parameter values in which R and T of ideal coatings are reduced so that R + T ≤ 1."""
    found = drawn.copy()
    numbers = {row.line.keys[0]: k for k, row in enumerate(rows) if row.kind == "share"}
    for owner in {key.rsplit(".", 1)[0] for key in numbers}:
        keys = f"{owner}.R", f"{owner}.T"
        shares = [found[numbers[key]] if key in numbers else float(params[key][0]) for key in keys]
        if sum(shares) <= 1:
            continue
        for key, share, other in zip(keys, shares, reversed(shares), strict=True):
            if key in numbers:  # the other one stays as it is where it is not drawn
                both = all(item in numbers for item in keys)
                found[numbers[key]] = share / sum(shares) if both else 1 - other
    return found
