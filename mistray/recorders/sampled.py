"""Numbers of a trace with what each batch of start rays adds to their errors.

Start rays lie evenly within a batch, and batches are independent: a sum over the start rays has the error that the
spread of its batches says, however often one start ray branches and whatever two sums have in common. To first order
every number that is computed from sums has an error of the same kind (delta method), and numbers of one trace know how
far they vary together, so that the error of their quotient is that of a quotient.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]


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
        expected = value[..., None] * (rays / rays.sum())
        return cls(value, np.sqrt(used / (used - 1)) * (by_batch - expected))

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
