"""
Samples from which start maps are learned: after Russian roulette, and shared between neighbouring cells.

A sample of weight w < w_min survives with the probability q = w/w_min and then has the weight w/q = w_min.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

SAMPLES_OF_MAP, SAMPLES_LENT = 8000, 2000  # samples of a cell for itself, and for each of its neighbours
SHARE_LENT = 0.3  # weight of the samples of each neighbour, relative to that of a cell's own


class MapSamples(NamedTuple):
    """
    Samples of the start points of forward rays that reach the detector, weighted by their light.

    Attributes
    ----------
    cell : (s,) int
    points : (s, 4) float64
        Points in the unit cube of the cell, see `mistray.sampling.plane_wave.wave_rays`.
    weights : (s,) float64
        Light that each sample represents.
    squares : (s,) float64
        Contribution of each sample to ∫ E[F²] over the start points; F is the contribution of a ray from there.
    """

    cell: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    squares: np.ndarray

    @classmethod
    def of(cls, parts: Sequence[MapSamples]) -> MapSamples:
        """Return several sets of samples joined into one."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def times(self, factor: np.ndarray | float) -> MapSamples:
        """Return the samples with their light multiplied by `factor`."""
        return self._replace(weights=self.weights * factor, squares=self.squares * np.square(factor))

    def of_rays(self, rays: np.ndarray | float) -> MapSamples:
        """Return the samples with weights as if each stood for `rays` times as many rays of the same light."""
        return self._replace(weights=self.weights * rays, squares=self.squares * rays)

    def some(self, chosen: np.ndarray) -> MapSamples:
        """Return the subset of samples that a boolean mask selects."""
        return MapSamples(*(values[chosen] for values in self))

    def after_roulette(self, count: int, rng: np.random.Generator) -> MapSamples:
        """Return about `count` samples of each cell: all strong ones, and weak ones by Russian roulette."""
        # Roulette threshold of each cell
        limit = np.zeros(int(self.cell.max(initial=0)) + 1)
        for number, here in _of_each(self.cell):
            limit[number] = _threshold(self.weights[here], count)
        limits = limit[self.cell]
        # Roulette: a weak sample survives with q = w/w_min
        held = rng.random(len(limits)) * limits < self.weights
        return self.some(held).of_rays(np.maximum(limits[held] / self.weights[held], 1))

    def with_those_beside(self, shape: tuple[int, int]) -> MapSamples:
        """
        Return the samples of each cell together with those of its neighbours, whose light enters at similar places.

        A narrow entrance that no ray of a cell has met may be met in another; both then start rays there. Russian
        roulette limits the number of samples.

        Parameters
        ----------
        shape : tuple of int
            Numbers of field angles and azimuths of the grid; azimuths are periodic.
        """
        rng = np.random.default_rng(len(self.cell))
        total = np.bincount(self.cell, self.weights, shape[0] * shape[1]).astype(np.float64)
        lent = self.after_roulette(SAMPLES_LENT, rng)
        row, column = np.divmod(lent.cell, shape[1])
        parts = [self.after_roulette(SAMPLES_OF_MAP, rng)]
        for up, on in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            if on and shape[1] == 1:
                continue
            to = (row + up) * shape[1] + (column + on) % shape[1]
            there = (row + up >= 0) & (row + up < shape[0])
            there &= total[np.where(there, to, 0)] > 0
            # Borrowed samples are normalised to the light of the cell that borrows
            scale = SHARE_LENT * total[to[there]] / total[lent.cell[there]]
            parts.append(lent.some(there)._replace(cell=to[there]).times(scale))
        return MapSamples.of(parts)


def _of_each(cell: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the cells that occur, with the indices of their samples in order."""
    order = np.argsort(cell, kind="stable")
    numbers, first = np.unique(cell[order], return_index=True)
    yield from zip(numbers.tolist(), np.split(order, first)[1:], strict=True)


def _threshold(weights: np.ndarray, count: int) -> float:
    """Return the roulette threshold w_min for which about `count` samples survive."""
    if len(weights) <= count:
        return 0.0
    order = np.sort(weights)[::-1]
    rest = order.sum() - np.concatenate([[0.0], np.cumsum(order)[:-1]])
    # With k samples above it, w_min is the weight of the rest over count - k
    k = np.arange(count)
    limit = rest[k] / (count - k)
    return float(limit[np.argmax(limit >= order[k])])
