"""Samples of where light gets in, that maps are made of: those that are kept, and those that cells lend each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

SAMPLES_OF_MAP, SAMPLES_LENT = 8000, 2000  # of a cell
SHARE_LENT = 0.3  # weight of the samples of each cell beside, over that of a cell's own


class MapSamples(NamedTuple):
    """
    Where light that arrives would start with it.

    Attributes
    ----------
    cell : (s,) int
    points : (s, 4) float64
        Of the unit cube of the cell, see `mistray.sampling.plane_wave.wave_rays`.
    weights : (s,) float64
        Light that each stands for.
    squares : (s,) float64
        What each stands for of ∫ E[F²] over the start points, F being what a ray from there brings.
    """

    cell: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    squares: np.ndarray

    @classmethod
    def of(cls, parts: Sequence[MapSamples]) -> MapSamples:
        """All of several."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def times(self, factor: np.ndarray | float) -> MapSamples:
        """Those of so many times the light."""
        return self._replace(weights=self.weights * factor, squares=self.squares * np.square(factor))

    def of_rays(self, rays: np.ndarray | float) -> MapSamples:
        """Those of so many times the rays."""
        return self._replace(weights=self.weights * rays, squares=self.squares * rays)

    def some(self, chosen: np.ndarray) -> MapSamples:
        """Those that a mask chooses."""
        return MapSamples(*(values[chosen] for values in self))

    def thinned(self, count: int, rng: np.random.Generator) -> MapSamples:
        """Of each cell about so many: the strong ones, and of the weak ones some that stand for others."""
        limit = np.zeros(int(self.cell.max(initial=0)) + 1)
        for number, here in _of_each(self.cell):
            limit[number] = _threshold(self.weights[here], count)
        limits = limit[self.cell]
        held = rng.random(len(limits)) * limits < self.weights
        return self.some(held).of_rays(np.maximum(limits[held] / self.weights[held], 1))

    def with_those_beside(self, shape: tuple[int, int]) -> MapSamples:
        """
        Samples of each cell, thinned, and of the cells beside it: their light mostly gets in at the same places.

        A way in that is narrow, and that no ray of a cell has met, is met in another; both then start rays there.

        Parameters
        ----------
        shape : tuple of int
            Field angles and azimuths of the grid; azimuths go round.
        """
        rng = np.random.default_rng(len(self.cell))
        total = np.bincount(self.cell, self.weights, shape[0] * shape[1]).astype(np.float64)
        few = self.thinned(SAMPLES_LENT, rng)
        row, column = np.divmod(few.cell, shape[1])
        parts = [self.thinned(SAMPLES_OF_MAP, rng)]
        for up, on in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            if on and shape[1] == 1:
                continue
            to = (row + up) * shape[1] + (column + on) % shape[1]
            there = (row + up >= 0) & (row + up < shape[0])
            there &= total[np.where(there, to, 0)] > 0
            scale = SHARE_LENT * total[to[there]] / total[few.cell[there]]
            parts.append(few.some(there)._replace(cell=to[there]).times(scale))
        return MapSamples.of(parts)


def _of_each(cell: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """The cells that occur, and the places of their samples in order."""
    order = np.argsort(cell, kind="stable")
    numbers, first = np.unique(cell[order], return_index=True)
    yield from zip(numbers.tolist(), np.split(order, first)[1:], strict=True)


def _threshold(weights: np.ndarray, count: int) -> float:
    """Weight below which one of several stands for all, so that about `count` are left."""
    if len(weights) <= count:
        return 0.0
    order = np.sort(weights)[::-1]
    rest = order.sum() - np.concatenate([[0.0], np.cumsum(order)[:-1]])
    # With k strong ones the limit is the rest over what is left of the count
    k = np.arange(count)
    limit = rest[k] / (count - k)
    return float(limit[np.argmax(limit >= order[k])])
