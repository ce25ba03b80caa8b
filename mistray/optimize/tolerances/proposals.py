"""Proposals of changed designs: which parameters a designer may change, and traces that check what comes of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mistray.analysis.estimate import Estimate
from mistray.optimize.metrics.metric import Metric, transmission
from mistray.optimize.parameters import Parameter
from mistray.optimize.scene_values import changed

SEEDS = 4
APART = 1000  # from the seed of the gradient to the first of these
IMAGE_RAYS = 4000
SHAPE_KINDS = ("curvature", "conic", "asphere", "rim", "position", "tilt")


def structure(scene: Any) -> set[str]:
    """Ids of the surfaces that are neither optics nor the detector: opaque, and no mirrors."""
    return {
        shape.id()
        for shape in scene.shapes()
        if getattr(shape.bsdf(), "opaque", False) and not shape.bsdf().mirror and not shape.is_sensor()
    }


def free_keys(scene: Any, known: Mapping[str, Parameter]) -> list[str]:
    """
    Keys of the parameters that can be changed without making another lens of it.

    These are coatings and ideal R but of mirrors, scatter, and the shape, rims and place of surfaces that are neither
    optics nor the detector: stops, vanes, tubes. An ideal T, glasses and the shapes of optics are not among them.

    Parameters
    ----------
    scene : mi.Scene
    known : mapping of str to Parameter
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


def traced_change(
    metric: Metric, params: Mapping[str, Any], values: Mapping[str, np.ndarray], advance: Callable[[], None]
) -> tuple[Estimate, Estimate | None]:
    """
    What new values of parameters do, traced before and after with the same rays, on seeds of their own.

    Parameters
    ----------
    metric : Metric
    params : mi.SceneParameters
        Of its scene, which is as it was afterwards.
    values : mapping of str to (entries,) float
    advance : callable
        Called 2 `SEEDS` times, after each of the traces of the metric.

    Returns
    -------
    factor : Estimate
        Times that the metric is smaller; infinite where nothing is left of it.
    image : Estimate or None
        Power of the direct image over that before, at the sources' own field; None where there is none.
    """
    first = int((metric.settings or {}).get("seed") or 0) + APART
    image = transmission(
        metric.scene, rays=IMAGE_RAYS, max_reflections=0, max_scatters=0, wavelength_nm=metric.wavelength_nm,
        weights=metric.weights,
    )  # fmt: skip
    pairs, images = [], []
    for seed in range(first, first + SEEDS):
        before, direct = metric.value(seed=seed), image.value(seed=seed)
        advance()
        with changed(params, values):
            pairs.append((before, metric.value(seed=seed)))
            images.append((image.value(seed=seed), direct))
        advance()
    return _quotient(np.array(pairs)), _quotient(np.array(images)) if np.all(np.array(images)[:, 1] > 0) else None


def _quotient(pairs: np.ndarray) -> Estimate:
    """The mean of the first over that of the second column, with the error of a quotient of means."""
    above, below = pairs.T
    if not below.mean() > 0:
        return Estimate(math.inf, math.nan)
    ratio = float(above.mean() / below.mean())
    return Estimate(ratio, float((above - ratio * below).std(ddof=1) / below.mean() / math.sqrt(len(pairs))))
