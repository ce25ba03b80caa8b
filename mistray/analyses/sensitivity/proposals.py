"""Proposed design changes: which parameters a designer may change, and traces that check the changes."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np

from mistray.estimate import Estimate
from mistray.metrics.changes.first_surfaces import Entering, FirstLight
from mistray.metrics.changes.gaps import Contacts, Gap
from mistray.metrics.metric import Metric, transmission
from mistray.metrics.parameters import SHAPE_KINDS, Parameter, parameters
from mistray.metrics.scene_values import changed
from mistray.metrics.steps import Steps
from mistray.metrics.views import added_light, light_since

SEEDS = 4
LEAST_SEEDS = 2  # a standard error needs them
IMAGE_RAYS = 4000


def structure(scene: Any) -> set[str]:
    """Return the ids of opaque surfaces other than mirrors and the detector: the mechanical structure."""
    return {
        shape.id()
        for shape in scene.shapes()
        if getattr(shape.bsdf(), "opaque", False) and not shape.bsdf().mirror and not shape.is_sensor()
    }


def free_keys(scene: Any, known: Mapping[str, Parameter]) -> list[str]:
    """
    Return the keys of parameters that can be changed without redesigning the lens.

    These are scatter; coatings and ideal R, but not those of mirrors; and the shape, rims and position of surfaces that
    are neither optics nor the detector: stops, vanes, tubes. An ideal T, glasses and the shapes of optics are not among
    them.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    known : mapping of str to Parameter
        Parameters that can be differentiated, by key.
    """
    mirrors = {shape.id() for shape in scene.shapes() if getattr(shape.bsdf(), "mirror", False)}
    rigid = structure(scene)
    found = []
    for key, parameter in known.items():
        shapes = set(parameter.shapes)
        if (
            parameter.kind == "scatter"
            or (parameter.kind == "coating" and not shapes & mirrors)
            or (parameter.kind == "share" and parameter.name == "R" and not shapes & mirrors)
            or (parameter.kind in SHAPE_KINDS and shapes <= rigid)
        ):
            found.append(key)
    return found


@dataclass(frozen=True)
class TracedChange:
    """
    Effect of new parameter values on metric and image, from traces before and after.

    Attributes
    ----------
    traced : Estimate
        Factor by which the metric is smaller; infinite if nothing is left of it.
    image : Estimate or None
        Power of the direct image over that before, at the sources' own field, in the light of the metric's first trace;
        None if there is no direct image.
    gaps : tuple of Gap
        Surfaces that meet before and are apart after, see `mistray.metrics.changes.gaps`.
    entering : mapping of str to tuple of Entering
        Surfaces that light newly meets first, by field angle in words.
    seeds : int
        Number of seeds traced, at most `SEEDS`.
    """

    traced: Estimate
    image: Estimate | None
    gaps: tuple[Gap, ...] = ()
    entering: Mapping[str, tuple[Entering, ...]] = field(default_factory=dict)
    seeds: int = SEEDS


def traced_change(
    metric: Metric, params: Mapping[str, Any], values: Mapping[str, np.ndarray], advance: Steps
) -> TracedChange | None:
    """
    Return the effect of new values of parameters, traced before and after with the same rays, on seeds of their own.

    Parameters
    ----------
    metric : Metric
        Metric of the scene.
    params : mi.SceneParameters
        Parameters of the metric's scene, which are restored afterwards.
    values : mapping of str to (entries,) float
        New values by key.
    advance : Steps
        Called after each trace of the metric: 2 `SEEDS` times, or fewer if the time ends. No seed but the first
        is begun without time for it.

    Returns
    -------
    TracedChange or None
        None if there is no time for two seeds.
    """
    first = metric.independent_seed
    light = metric.views[0].light
    image = transmission(metric.scene, rays=IMAGE_RAYS, max_reflections=0, max_scatters=0, **light)
    pairs, images = list[tuple[float, float]](), list[tuple[float, float]]()
    contacts, gaps = Contacts(metric.scene), tuple[Gap, ...]()
    lights: list[dict[str, FirstLight]] = [{}, {}]
    known = parameters(metric.scene, params)
    paths = any(known[key].kind in SHAPE_KINDS for key in values if key in known)

    def look(seed: int, number: int) -> float:
        seen = metric.observe(seed=seed, paths=paths)
        for one in seen:
            lights[number] = added_light(lights[number], one.first_light())
        return float(dr.detach(metric.evaluate(seen))[0])

    longest = 0.0
    for seed in range(first, first + SEEDS):
        if advance.left < longest * max(LEAST_SEEDS - len(pairs), 1):
            break
        began = time.perf_counter()
        before, direct = look(seed, 0), image.value(seed=seed)
        advance()
        with changed(params, values):
            gaps = contacts.opened(metric.scene)
            pairs.append((before, look(seed, 1)))
            images.append((image.value(seed=seed), direct))
        advance()
        longest = max(time.perf_counter() - began, longest)
    if len(pairs) < LEAST_SEEDS:
        return None
    kept = _quotient(np.array(images)) if np.all(np.array(images)[:, 1] > 0) else None
    return TracedChange(_quotient(np.array(pairs)), kept, gaps, light_since(*lights), len(pairs))


def _quotient(pairs: np.ndarray) -> Estimate:
    """
    Return the ratio of the means of both columns, (n, 2), with the standard error of a ratio of means.

    If the second mean is 0, the ratio is infinite and its error NaN.
    """
    above, below = pairs.T
    if not below.mean() > 0:
        return Estimate(math.inf, math.nan)
    ratio = float(above.mean() / below.mean())
    return Estimate(ratio, float((above - ratio * below).std(ddof=1) / below.mean() / math.sqrt(len(pairs))))
