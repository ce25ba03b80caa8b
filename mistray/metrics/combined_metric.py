"""Metrics that are functions of several other metrics of one scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.metrics.metric import Metric
from mistray.metrics.views import TraceView
from mistray.ranges import ByName, OfType

METRICS = ByName(OfType(Metric, "must be a mistray.Metric"), "{'ghosts': mistray.optimize.path_power(scene)}")


@dataclass(frozen=True)
class CombinedMetric(Metric):
    """
    Scalar figure computed from several other metrics of one scene; see `combine`.

    Attributes
    ----------
    parts : dict of str to Metric
        Other metrics by name; None counts as no metric. Further attributes are those of `Metric`.
    """

    parts: Mapping[str, Metric] | None = None

    def with_rays_times(self, times: float) -> Metric:
        """Return a copy that traces `times` the rays of the settings, see `Metric.with_rays_times`."""
        parts = {name: part.with_rays_times(times) for name, part in (self.parts or {}).items()}
        return replace(self, times=times, parts=parts)

    @property
    def views(self) -> list[TraceView]:
        """Traces that the combined metrics need, each once."""
        return list({view.key: view for part in (self.parts or {}).values() for view in part.views}.values())

    def values(self, observations: list[Any]) -> dict[str, Any]:
        """Return the value of each combined metric as a Dr.Jit scalar, by name, from the observations of `observe`."""
        seen = {view.key: observation for view, observation in zip(self.views, observations, strict=True)}
        return {
            name: mi.Float64(part.function([seen[view.key] for view in part.views]))
            for name, part in (self.parts or {}).items()
        }

    def part(self, name: str) -> Metric:
        """Return one of the combined metrics, by name, as a metric of the observations of all of them."""
        return Metric(self.scene, lambda observations: self.values(observations)[name], name=name)


def combine(
    metrics: Mapping[str, Metric], function: Callable[[dict[str, Any]], Any], unit: str = "", name: str = "merit"
) -> CombinedMetric:
    """
    Return a metric that is a function of several metrics, such as a merit of weighted terms.

    A trace that several of them need, with equal field, wavelengths and settings, is made once.

    Parameters
    ----------
    metrics : mapping of str to Metric
        Metrics of one scene, by name.
    function : callable
        Smooth function of a dict of Dr.Jit scalars by the same names, which returns one scalar.
    unit, name : str
        Unit and name of the result.

    Raises
    ------
    MistrayError
        If there is no metric, one is not a `Metric`, they belong to several scenes, or their `times` differ.

    Examples
    --------
    >>> scene = mistray.load("cooke_triplet")
    >>> terms = {
    ...     "ghosts": mistray.optimize.path_power(scene, "ghost", rays=5000),
    ...     "image": mistray.optimize.transmission(scene, rays=5000),
    ... }
    >>> merit = mistray.optimize.combine(terms, lambda values: values["ghosts"] / values["image"])
    >>> print(f"{merit.value():.4f}")
    0.0192
    """
    parts = METRICS.check("metrics", metrics)
    if not parts:
        raise MistrayError("combine() got no metric; give at least one")
    scenes = {id(metric.scene) for metric in parts.values()}
    if len(scenes) > 1:
        raise MistrayError(f"the metrics {', '.join(metrics)} are of {len(scenes)} scenes; make all from one scene")
    times = {key: metric.times for key, metric in parts.items()}
    if len(set(times.values())) > 1:
        told = ", ".join(f"{key} {value:g}" for key, value in times.items())
        raise MistrayError(f"the metrics trace unequal multiples of their rays: {told}; give all the same `times`")

    def of_parts(observations: list[Any]) -> Any:
        return function(combined.values(observations))

    first = next(iter(parts.values()))
    combined = CombinedMetric(first.scene, of_parts, unit=unit, name=name, times=first.times, parts=parts)
    return combined
