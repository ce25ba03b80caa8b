"""One-sided derivatives where a beam exactly fills a rim, from differences of traces with equal random numbers.

Let d(h) and d(h/2) be the difference quotients of the metric over a step and over half of it. 2 d(h/2) - d(h) is free
of the error in proportion to h (L. F. Richardson, 1911), as is the boundary kernel of `mistray.gradients.edges`. Half
of the correction counts as an error beside the noise. So does the change by a single ray more or less: if no ray
crosses the rim, the derivative is 0 to that precision.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np

from mistray.estimate import Estimate
from mistray.gradients.full.full_rims import FullRims
from mistray.metrics.observation import Observation
from mistray.metrics.parameters import Parameter
from mistray.metrics.scene_values import changed
from mistray.recorders.sampled import Sampled

UNMOVED = ("coating", "share", "scatter")  # kinds of parameters that do not move rays


@dataclass(frozen=True)
class FullKey:
    """
    Parameter that moves a rim which a beam just fills, so that derivatives on its two sides differ.

    Attributes
    ----------
    rim : str
        Name of the rim in words.
    step : float
        Step of the parameter, in its unit, that moves the rim by `FullRims.reach` relative to the beam.
    """

    rim: str
    step: float


class OneSided(NamedTuple):
    """
    Derivatives of a metric on either side of a parameter's value, in its unit per unit of the parameter.

    Attributes
    ----------
    below, above : Estimate
        Derivatives for a falling and for a rising value; their errors include the noise and the step.
    """

    below: Estimate
    above: Estimate

    def __str__(self) -> str:
        below, above = (f"{side.value:+.5e} ± {side.se:.1e}" for side in self)
        return f"below {below}, above {above}"


def full_keys(chosen: Mapping[str, Parameter], full: Iterable[FullRims]) -> dict[str, FullKey]:
    """
    Return, by key, the parameters that move a rim relative to a beam that just fills it.

    `full` are the filled rims of each source. Of several rims, the result names the one with the smallest step.
    """
    alike = {(id(rims.source.emitter), tuple(rims.source.direction), *rims.names): rims for rims in full}
    found = {}
    for key, p in chosen.items():
        moves = []
        for rims in alike.values() if p.kind not in UNMOVED else ():
            share, rim = rims.moved_by(p.owner, p.name, p.tolerance)
            if share:
                moves.append(FullKey(rim, rims.reach * p.tolerance / share))
        if moves:
            found[key] = min(moves, key=lambda one: one.step)
    return found


def one_sided(metric: Any, steps: Mapping[str, float], chosen: Mapping[str, Parameter]) -> dict[str, OneSided]:
    """
    Return the derivatives of a metric below and above the values of parameters.

    Parameters
    ----------
    metric : Metric
        Metric to differentiate.
    steps : mapping of str to float
        Step of each parameter, in its unit, by key.
    chosen : mapping of str to Parameter
        Parameters by key.

    Returns
    -------
    dict
        Derivatives by key.
    """
    params, (here, rays) = mi.traverse(metric.scene), _seen(metric)
    found = {}
    for key, step in steps.items():
        sides = []
        for sign in (-1.0, 1.0):
            whole, half = (_slope(metric, params, chosen[key], here, sign * share * step) for share in (1.0, 0.5))
            value = half.scaled(2.0) - whole
            made_up, one_ray = 0.5 * float(half.value - whole.value), abs(float(here.value) / rays / step)
            sides.append(Estimate(float(value.value), float(np.hypot(np.hypot(value.se, made_up), one_ray))))
        found[key] = OneSided(*sides)
    return found


def _slope(metric: Any, params: Any, p: Parameter, here: Sampled, step: float) -> Sampled:
    """
    Return the difference quotient of the metric over a step of a parameter (in its unit), with its noise by batch.

    `here` is the metric before the step, with its noise; `params` are those of the scene, and restored afterwards.
    """
    with changed(params, {p.key: p.value + step}):
        return (_seen(metric)[0] - here).scaled(1.0 / step)


def _seen(metric: Any) -> tuple[Sampled, int]:
    """Return a metric's value with its noise by batch, and the number of start rays of its smallest trace."""
    observations = metric.observe()
    value, noise = metric.differentiate(observations)
    # A PST fills no rim: its rays start at the detector or in the whole sky
    rays = min(one.trace.rays_planned for one in observations if isinstance(one, Observation))
    return Sampled(np.array(value), noise.apart), rays
