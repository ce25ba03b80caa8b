"""Samples of where light gets in, that maps are made of: those that are kept, and those that cells lend each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

SAMPLES_OF_MAP, SAMPLES_LENT = 16000, 4000  # of a cell
SHARE_LENT = 0.3  # weight of the samples of each cell beside, over that of a cell's own

MapSamples = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Cells (s,), points (s, 4) and weights (s,), see `mistray.sampling.sharing.start_map.StartMap.of`."""


def thinned(samples: MapSamples, count: int, rng: np.random.Generator) -> MapSamples:
    """Of each cell about so many samples: the strong ones, and of the weak ones some that stand for others."""
    cell, points, weights = samples
    limit = np.zeros(int(cell.max(initial=0)) + 1)
    for number, here in _of_each(cell):
        limit[number] = _threshold(weights[here], count)
    held = rng.random(len(cell)) * limit[cell] < weights
    return cell[held], points[held], np.maximum(weights, limit[cell])[held]


def beside(shape: tuple[int, int], samples: MapSamples) -> MapSamples:
    """
    Samples of each cell, thinned, and of the cells beside it: their light mostly gets in at the same places.

    A way in that is narrow, and that no ray of a cell has met, is met in another; both then start rays there.

    Parameters
    ----------
    shape : tuple of int
        Field angles and azimuths of the grid; azimuths go round.
    samples : MapSamples
    """
    rng = np.random.default_rng(len(samples[0]))
    cell, points, weights = thinned(samples, SAMPLES_LENT, rng)
    row, column = np.divmod(cell, shape[1])
    total = np.bincount(samples[0], samples[2], shape[0] * shape[1]).astype(np.float64)
    parts = [thinned(samples, SAMPLES_OF_MAP, rng)]
    for up, on in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        if on and shape[1] == 1:
            continue
        there = (row + up >= 0) & (row + up < shape[0])
        to = (row[there] + up) * shape[1] + (column[there] + on) % shape[1]
        scale = SHARE_LENT * total[to] / np.maximum(total[cell[there]], np.finfo(float).tiny)
        lent = scale > 0
        parts.append((to[lent], points[there][lent], (weights[there] * scale)[lent]))
    cells, places, brought = (np.concatenate(column) for column in zip(*parts, strict=True))
    return cells, places, brought


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
