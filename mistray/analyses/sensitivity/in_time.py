"""Gradient of a metric from as many of its rays as a time limit allows."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

from mistray.errors import MistrayError
from mistray.gradients.table_gradient import GradientRequest
from mistray.metrics.gradient import Gradient, gradient_where_smooth
from mistray.metrics.metric import Metric
from mistray.metrics.parameters import Parameter
from mistray.metrics.steps import Steps

FIRST_RAYS = 4000  # whose time says how many more can be taken
LOADING = 8  # times fewer before them, which load the kernels
LARGEST_STEP = 16.0
LEAST_STEP = 2.0  # a shorter one is not worth what it takes
SAFETY = 0.8


@dataclass(frozen=True)
class Taken:
    """
    Gradient of a metric, with the fraction of rays used and the time taken.

    Attributes
    ----------
    metric : Metric
        Metric with the rays used, and the plans of its pilots.
    times : float
        Rays used over those of the metric that was asked for, at most 1.
    found : Gradient
        Gradient by parameter.
    seconds : float
        Time of the metric and its gradient, s.
    look : float
        Time of the metric alone, s.
    """

    metric: Metric
    times: float
    found: Gradient
    seconds: float
    look: float


def gradient_in_time(
    metric: Metric,
    chosen: Mapping[str, Parameter],
    request: GradientRequest,
    steps: Steps,
    part: float,
    looks: int,
    before: Taken | None,
) -> Taken:
    """
    Return a gradient from all rays of a metric, or from fewer if time is short, but always from some.

    A few rays are traced first, and their time determines how many more are possible. Traces are never ended early,
    because later results compared with this gradient must use the same rays.

    Parameters
    ----------
    metric, chosen, request
        Arguments of `mistray.metrics.gradient.gradient_where_smooth`.
    steps : Steps
        Counter of steps that has the time left.
    part : float
        Fraction of that time for the gradient and the traces that follow.
    looks : int
        Number of traces of the metric that follow.
    before : Taken or None
        Gradient of a saved run, which is kept if there is no time for many more rays; None for a new run.

    Raises
    ------
    MistrayError
        If the last attempt that there is time for fails.
    """
    if before is not None and before.times >= 1:
        return before
    if not steps.limited:
        return _taken(metric, chosen, request, 1.0)
    first = min(FIRST_RAYS / (metric.times * max(view.rays(metric.scene) for view in metric.views)), 1.0)
    best, failed = before, None
    tried = None if before is None else (before.times, before.seconds + looks * before.look)
    while (times := _next(tried, first, part * steps.left)) is not None:
        began = time.perf_counter()
        try:
            best, failed = _taken(metric, chosen, request, times), None
            tried = times, best.seconds + looks * best.look
        except MistrayError as error:  # too few rays for a number that divides by their light, say
            best, failed, tried = None, error, (times, time.perf_counter() - began)
    if best is None:
        assert failed is not None  # one was tried
        raise failed
    return best


def _next(tried: tuple[float, float] | None, first: float, left: float) -> float | None:
    """
    Return the next factor on the number of rays for a gradient; None if there is no time for more.

    Parameters
    ----------
    tried : (float, float) or None
        Last factor, and the time that it takes, s; None before the first.
    first : float
        Factor above which the time grows with the rays; fewer rays mostly load kernels.
    left : float
        Time left, s.
    """
    if tried is None:
        return first / LOADING
    times, seconds = tried
    if times >= 1 or seconds > left:
        return None
    more = LOADING if times < first else min(SAFETY * left / seconds, LARGEST_STEP)
    return min(times * more, 1.0) if more >= LEAST_STEP else None


def _taken(metric: Metric, chosen: Mapping[str, Parameter], request: GradientRequest, times: float) -> Taken:
    """Return the gradient of a metric with `times` its number of rays, and the time that it took, s."""
    began = time.perf_counter()
    metric = metric if times == 1 else metric.with_rays_times(times * metric.times)
    seen = metric.observe()
    look = time.perf_counter() - began
    found = gradient_where_smooth(metric, seen, chosen, request)
    return Taken(metric, times, found, time.perf_counter() - began, look)
