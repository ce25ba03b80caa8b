"""Numbers of a trace with what each batch of start rays adds to their errors.

Start rays lie evenly within a batch, and batches are independent: a sum over the start rays has the error that the
spread of its batches says, however often one start ray branches and whatever two sums have in common. To first order
every number that is computed from sums has an error of the same kind (delta method), and numbers of one trace know how
far they vary together, so that the error of their quotient is that of a quotient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]

ERROR_RAYS = 10  # that an error should stand on: the variance of the variance is below 0.1 then
ROUNDING = 1e-6  # of numbers of rays of equal weight


@dataclass(frozen=True)
class Sampled:
    """
    Numbers and their noise.

    Attributes
    ----------
    value : (…) float64
    apart : (…, b) float64
        What each batch, or each group of consecutive batches, adds to the error of the value: independent numbers of
        mean 0, the sum of whose squares is the square of the standard error. Batches of independent runs may share a
        place, and so may those of traces with the same seed at two field angles, whose start rays are alike: what they
        have in common is seen, and where there is nothing, their squares add.
    """

    value: Numbers
    apart: Numbers

    @classmethod
    def of(cls, by_batch: Numbers, rays: Numbers) -> Sampled:
        """
        A sum over batches of start rays.

        Parameters
        ----------
        by_batch : (…, b) float64
            Sums of the batches.
        rays : (b,) float64
            Start rays of the batches.
        """
        value = by_batch.sum(axis=-1)
        used = max(int(np.count_nonzero(rays)), 2)
        apart = np.multiply(value[..., None], -rays / rays.sum(), out=np.empty_like(by_batch))
        apart += by_batch
        apart *= np.sqrt(used / (used - 1))
        return cls(value, apart)

    @property
    def se(self) -> Numbers:
        """Standard error, (…)."""
        return np.asarray(np.sqrt(np.sum(np.square(self.apart), axis=-1)))

    @property
    def by_batch(self) -> Numbers:
        """The value by batch, as if all had as many start rays, (…, b)."""
        count = self.apart.shape[-1]
        return np.asarray(self.value[..., None] / count + np.sqrt((count - 1) / count) * self.apart)

    def grouped(self, count: int) -> Sampled:
        """The same with the noise by so many groups of batches; `count` divides their number."""
        batches = self.apart.shape[-1]
        together = self.apart.reshape(*self.value.shape, count, -1).sum(axis=-1)
        return Sampled(self.value, together * np.sqrt((batches - 1) / batches * count / max(count - 1, 1)))

    def __getitem__(self, chosen: Any) -> Sampled:
        return Sampled(self.value[chosen], self.apart[chosen])

    def __add__(self, other: Sampled) -> Sampled:
        a, b = _alike(self, other)
        return Sampled(a.value + b.value, a.apart + b.apart)

    def __sub__(self, other: Sampled) -> Sampled:
        return self + other.scaled(-1.0)

    def scaled(self, factor: float) -> Sampled:
        """The numbers times one that has no error."""
        return Sampled(self.value * factor, self.apart * factor)

    def over(self, other: Sampled) -> Sampled:
        """Quotient; NaN where the other is 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = _alike(self, other)
            below = np.where(b.value == 0, np.nan, b.value)
            value = np.asarray(a.value / below)
            return Sampled(value, (a.apart - value[..., None] * b.apart) / below[..., None])

    def total(self) -> Sampled:
        """Sum over the first axis."""
        return Sampled(self.value.sum(axis=0), self.apart.sum(axis=0))


def _alike(*numbers: Sampled) -> list[Sampled]:
    """Numbers with their noise by as many groups of batches."""
    count = min(one.apart.shape[-1] for one in numbers)
    return [one if one.apart.shape[-1] == count else one.grouped(count) for one in numbers]


def batch_error(by_batch: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Standard error of a sum over batches (last axis) of `rays` start rays each, from the spread of their means."""
    return Sampled.of(by_batch, rays).se


def error_rays(
    rays: Numbers, light: Numbers, squares: Numbers, fourths: Numbers, pool: Callable[[Numbers], Numbers]
) -> Numbers:
    """
    Number of rays that each error stands on.

    An error is itself an estimate. Its relative variance is Σw⁴/(Σw²)² of the weights w of the rays, the "variance of
    the variance", which should be below 0.1 (R. A. Forster et al., "Ten new checks to assess the statistical quality of
    Monte Carlo solutions in MCNP", LA-UR-94-0000, 1994). Its inverse is the number of rays that the error stands on.
    A sum may lack its rare large weights by chance, so that the value and its error are too small together. So each is
    also judged by the weights of all sums of its kind, over the mean of each.

    Parameters
    ----------
    rays, light, squares, fourths : (…) float64
        Number of rays, and sums of their weights and of the second and fourth powers of these.
    pool : callable
        Sums numbers (…) over all that are of the kind of each, (…).

    Returns
    -------
    (…) float64
        0 where there is no light.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        own = squares**2 / fourths
        sure = rays >= ERROR_RAYS  # of fewer rays the largest weight over the mean is bounded by their number
        each = (rays, squares * (rays / light) ** 2, fourths * (rays / light) ** 4)
        count, second, fourth = (pool(np.nan_to_num(np.where(sure, values, 0.0))) for values in each)
        pooled = np.where(fourth > 0, rays * second**2 / (count * fourth), np.inf)
    return np.nan_to_num(np.minimum(own, pooled), nan=0.0)


def few_rays(found: Numbers) -> npt.NDArray[np.bool_]:
    """Whether `error_rays` are too few for an error."""
    return np.asarray(found < ERROR_RAYS * (1 - ROUNDING))
