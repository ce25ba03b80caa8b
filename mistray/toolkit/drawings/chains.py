"""Connections of two points along the fewest line segments, such as the edges of a lens from rim to rim."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-5  # of the distance of the points from the origin, within which ends meet


def route(start: Array, end: Array, steps: Sequence[Array]) -> list[tuple[int, bool]] | None:
    """
    Return the way from a start to an end point along the fewest line segments.

    Parameters
    ----------
    start, end : (2,) float
        Points, mm.
    steps : sequence of (2, 2) float
        Segments that may be walked either way, mm.

    Returns
    -------
    list of (int, bool), or None
        Index of each segment, and whether it is walked from its start to its end; None if no way leads there.
    """
    near = TOLERANCE * max(float(np.abs(start).max()), float(np.abs(end).max()), 1e-9)
    ways: list[tuple[Array, list[tuple[int, bool]]]] = [(start, [])]
    left = set(range(len(steps)))
    while ways:
        longer = []
        for place, way in ways:
            if np.abs(place - end).max() <= near:
                return way
            for number in sorted(left):
                for here, there in ((0, 1), (1, 0)):
                    if number in left and np.abs(steps[number][here] - place).max() <= near:
                        left.discard(number)
                        longer.append((steps[number][there], [*way, (number, here == 0)]))
        ways = longer
    return None


def chain(start: Array, end: Array, steps: Sequence[Array]) -> Array:
    """
    Return the ends of the segments of `route`, in the order of the way; parameters are described there.

    Returns
    -------
    (n, 2) float
        Points after `start`, mm, the last within rounding of `end`; empty if no way leads there.
    """
    found = route(start, end, steps) or []
    return np.array([steps[number][int(forwards)] for number, forwards in found]).reshape(-1, 2)
