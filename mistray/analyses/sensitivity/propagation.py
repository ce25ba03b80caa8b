"""Linear propagation of tolerances: spread of a metric among manufactured systems."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mistray.estimate import Estimate
from mistray.recorders.sampled import batch_error
from mistray.toolkit.rows import column


@dataclass(frozen=True)
class Contribution:
    """
    Contribution of one parameter, or of several that vary together, to the variance of ln(metric).

    `change` is that of ln(metric) when all of them change by one tolerance. `share` is a fraction of the variance.
    """

    name: str = column("label of the parameter, or the pattern that the group was asked for by")
    members: tuple[str, ...] = column("labels of the parameters")
    change: Estimate = column(
        "change of ln(metric) when all members change by one tolerance in the same sense", percent=True
    )
    share: Estimate = column("share of the variance, by noise perhaps above 1; NaN unless that is above 0")


@dataclass(frozen=True)
class MetricSpread:
    """
    Spread of ln(metric) over manufactured systems, to first order in the tolerances.

    Attributes
    ----------
    contributions : tuple of Contribution
        Contributions, the largest first.
    variance : Estimate
        Σ c² over the changes c of all contributions, minus the variance of their noise, which would add up otherwise.
    noise : float
        Variance of the noise, Σ se².
    """

    contributions: tuple[Contribution, ...]
    variance: Estimate
    noise: float

    @property
    def deviation(self) -> Estimate:
        """Standard deviation of ln(metric); if it is small, about the relative standard deviation of the metric."""
        value = math.sqrt(max(self.variance.value, 0.0))
        return Estimate(value, self.variance.se / (2 * value) if value > 0 else math.sqrt(self.variance.se))


def propagate(
    labels: Sequence[str],
    changes: np.ndarray,
    groups: Sequence[tuple[str, Sequence[int]]] = (),
) -> MetricSpread:
    """
    Return the variance of ln(metric), the sum of (s_i tol_i)² over independent parameters, and the share of each.

    Here s_i is d ln(metric)/d value, and tol_i the tolerance. Parameters that vary together count as one, with the sum
    of their s_i tol_i. The errors come from the batches of start rays, so that they include common noise of the
    derivatives, and of the metric by which all are divided.

    Parameters
    ----------
    labels : sequence of str
        Labels of the parameters.
    changes : (b, parameters) float64
        s_i tol_i, change of ln(metric) per tolerance, from each batch alone; the sum over the batches is the result.
    groups : sequence of (str, sequence of int)
        Names and member indices of groups that vary together; each parameter is in at most one.

    Returns
    -------
    MetricSpread
    """
    grouped = {number for _, members in groups for number in members}
    parts = [(name, tuple(members)) for name, members in groups]
    parts += [(label, (number,)) for number, label in enumerate(labels) if number not in grouped]
    batches = np.stack([changes[:, list(members)].sum(axis=1) for _, members in parts], axis=1)
    rays = np.ones(len(batches))
    total = batches.sum(axis=0)
    noise = batch_error(batches.T, rays)
    variance = float(np.sum(total**2 - noise**2))
    squares = 2 * batches * total  # of each batch to the errors of the squares
    spread = np.square(batch_error(squares.sum(axis=1), rays)) + 2 * np.sum(noise**4)  # the latter if mostly noise
    shares = np.full((2, len(parts)), math.nan)
    if variance > 0:
        share = np.maximum(total**2 - noise**2, 0.0) / variance
        # A square and the sum of all have errors in common, which cancel
        apart = batch_error((squares - np.outer(squares.sum(axis=1), share)).T, rays)
        faint = 2 * ((1 - share) ** 2 * noise**4 + share**2 * (np.sum(noise**4) - noise**4))
        shares = np.stack([share, np.sqrt(apart**2 + faint) / variance])
    found = [
        Contribution(
            name, tuple(labels[number] for number in members), Estimate(float(c), float(own)), Estimate(*share.tolist())
        )
        for (name, members), c, own, share in zip(parts, total, noise, shares.T, strict=True)
    ]
    found.sort(key=lambda item: -abs(item.change.value))
    return MetricSpread(tuple(found), Estimate(variance, math.sqrt(spread)), float(np.sum(noise**2)))
