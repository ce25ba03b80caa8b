"""Monte Carlo estimates of a trace with their standard errors, from the deviation of each batch of start rays.

Start rays are stratified within a batch, and batches are independent. So the error of a sum over the start rays follows
from the spread of its batches, however often one start ray branches and however two sums are correlated. To first order
every value that is computed from sums has an error of the same kind (delta method). Values of one trace keep their
correlation, so that the error of a quotient of two of them is right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]

ERROR_RAYS = 10  # fewest effective rays of an error: the variance of the variance is below 0.1 then
ROUNDING = 1e-6  # relative, of effective numbers of rays of equal weight


@dataclass(frozen=True)
class Sampled:
    """
    Monte Carlo estimates with their noise, kept as the deviation of each batch of start rays.

    Attributes
    ----------
    value : (…) float64
        Estimates, in the unit that the owner states.
    apart : (…, b) float64
        Deviation of each batch, or each group of consecutive batches, from the mean: independent numbers of mean 0,
        the sum of whose squares is the square of the standard error. Batches of independent runs may share an index.
        So may those of traces with the same seed at two field angles, whose start rays are alike. If they are
        correlated, that enters the error; if not, their squares add.
    """

    value: Numbers
    apart: Numbers

    @classmethod
    def of(cls, by_batch: Numbers, rays: Numbers) -> Sampled:
        """
        Create an estimate and its noise from sums over batches of start rays; of a single batch the error is its sum.

        Parameters
        ----------
        by_batch : (…, b) float64
            Sums of the batches, in the unit of the estimate.
        rays : (b,) float64
            Number of start rays of each batch.
        """
        # apart_b = (x_b - x n_b/n) √(B/(B - 1)), B being the number of batches with rays
        value, used = by_batch.sum(axis=-1), int(np.count_nonzero(rays))
        if used < 2:  # a single batch has no spread
            return cls(value, by_batch.copy())
        apart = np.multiply(value[..., None], -rays / rays.sum(), out=np.empty_like(by_batch))
        apart += by_batch
        apart *= np.sqrt(used / (used - 1))
        return cls(value, apart)

    @property
    def se(self) -> Numbers:
        """Standard error of each estimate, (…), in the unit of `value`."""
        return np.asarray(np.sqrt(np.sum(np.square(self.apart), axis=-1)))

    @property
    def by_batch(self) -> Numbers:
        """Estimates split by batch, (…, b), as if all batches had equally many start rays; they add up to `value`."""
        count = self.apart.shape[-1]
        return np.asarray(self.value[..., None] / count + np.sqrt((count - 1) / count) * self.apart)

    def grouped(self, count: int) -> Sampled:
        """
        Return the estimates with the deviations of their batches merged into `count` groups.

        `count` divides the number of batches.
        """
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
        """Return the estimates and their noise multiplied by an exact factor."""
        return Sampled(self.value * factor, self.apart * factor)

    def over(self, other: Sampled) -> Sampled:
        """Return the quotient of two estimates with its noise, by the delta method; NaN where the divisor is 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = _alike(self, other)
            below = np.where(b.value == 0, np.nan, b.value)
            # Delta method: δ(a/b) = (δa - (a/b) δb)/b
            value = np.asarray(a.value / below)
            return Sampled(value, (a.apart - value[..., None] * b.apart) / below[..., None])

    def reshaped(self, *shape: int) -> Sampled:
        """Return the estimates with their noise in another array shape; one length may be -1."""
        return Sampled(self.value.reshape(shape), self.apart.reshape(*shape, self.apart.shape[-1]))

    def total(self, axis: int = 0) -> Sampled:
        """Return the sum over an axis of the estimates, with its noise; `axis` must not be negative."""
        return Sampled(self.value.sum(axis=axis), self.apart.sum(axis=axis))

    @property
    def with_se(self) -> tuple[Numbers, Numbers]:
        """Estimates and their standard errors, (…) each, in the same unit."""
        return self.value, self.se

    @property
    def whole(self) -> tuple[float, float]:
        """Sum of all estimates and its standard error, two floats in the unit of `value`."""
        total = self.reshaped(-1).total()
        return float(total.value), float(total.se)


def _alike(*numbers: Sampled) -> list[Sampled]:
    """Return estimates whose noise is merged to equally many groups of batches, so that they can be combined."""
    count = min(one.apart.shape[-1] for one in numbers)
    return [one if one.apart.shape[-1] == count else one.grouped(count) for one in numbers]


def batch_error(by_batch: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """
    Return the standard error of a sum over batches, the last axis of `by_batch`, in its unit.

    `rays` is the number of start rays of each batch, (b,).
    """
    return Sampled.of(by_batch, rays).se


def sum_of_runs(by_batch: Sequence[Numbers], runs: Sequence[Any]) -> tuple[Numbers, Numbers]:
    """
    Return sums over several runs together and their standard errors, (…) each, W.

    Parameters
    ----------
    by_batch : sequence of (…, b) float64
        Sums of the batches of each run, in units of a start ray's flux.
    runs : sequence of Run
        The runs, which have start rays of their own, so that their variances add.
    """
    parts = [Sampled.of(own, run.started).scaled(run.unit) for own, run in zip(by_batch, runs, strict=True)]
    return np.sum([one.value for one in parts], axis=0), np.sqrt(np.sum([np.square(one.se) for one in parts], axis=0))


def error_rays(
    rays: Numbers, light: Numbers, squares: Numbers, fourths: Numbers, pool: Callable[[Numbers], Numbers]
) -> Numbers:
    """
    Return the effective number of rays of each standard error, from moments of the ray weights.

    An error is itself an estimate. Its relative variance is Σw⁴/(Σw²)² of the weights w of the rays, the "variance of
    the variance", which should be below 0.1 (R. A. Forster, T. E. Booth and S. P. Pederson, "Ten new checks to assess
    the statistical quality of Monte Carlo solutions in MCNP", 8th International Conference on Radiation Shielding,
    1994). Its inverse is the effective number of rays of the error. A sum may lack its rare large weights by chance, so
    that both the value and its error are too small. So each is also judged by the weights of all sums of its kind,
    relative to the mean weight of each.

    Parameters
    ----------
    rays, light, squares, fourths : (…) float64
        Number of rays, and sums of their weights and of the second and fourth powers of the weights.
    pool : callable
        Function that adds up values, (…), over all sums of the same kind as each, (…).

    Returns
    -------
    (…) float64
        Effective number of rays; 0 where there is no light.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        own = squares**2 / fourths
        # With fewer rays, the largest weight over the mean is bounded by their number
        sure = rays >= ERROR_RAYS
        each = (rays, squares * (rays / light) ** 2, fourths * (rays / light) ** 4)
        count, second, fourth = (pool(np.nan_to_num(np.where(sure, values, 0.0))) for values in each)
        pooled = np.where(fourth > 0, rays * second**2 / (count * fourth), np.inf)
    return np.nan_to_num(np.minimum(own, pooled), nan=0.0)


def few_rays(found: Numbers) -> npt.NDArray[np.bool_]:
    """Return a mask of estimates whose effective ray number, from `error_rays`, is too small for a standard error."""
    return np.asarray(found < ERROR_RAYS * (1 - ROUNDING))
