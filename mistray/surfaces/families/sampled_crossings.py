"""Crossings of lines with a surface F = 0 on the host: changes of sign between samples, then bisection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

HALVINGS = 52  # bisections of the interval between two samples: all digits of float64


def sampled_crossings(
    residual: Callable[[np.ndarray], np.ndarray],
    o: np.ndarray,
    d: np.ndarray,
    reach: float,
    samples: int,
    most: int,
    met: np.ndarray | bool = True,
    bends: np.ndarray | None = None,
) -> np.ndarray:
    """
    Return the distances of at most `most` crossings of lines with a surface, (n, most), mm; NaN for none.

    Parameters
    ----------
    residual : callable
        F, (n,), at points (n, 3), mm.
    o, d : (n, 3) float64
        Points, mm, and unit directions of the lines.
    reach : float
        Radius of a ball about the origin that holds the surface, mm.
    samples, most : int
        Samples of the part of a line in the ball, and crossings that a line may have.
    met : (n,) bool
        Whether lines may meet the surface at all; by default all may.
    bends : (n, k) float64, optional
        Distances along the lines, mm, at which F may have a kink; they are samples, too. NaN: none.
    """
    found = np.full((len(o), most), np.nan)
    middle = -np.einsum("ij,ij->i", o, d)
    off2 = np.einsum("ij,ij->i", o, o) - middle**2
    rays = np.flatnonzero((off2 < reach**2) & met)
    half = np.sqrt(reach**2 - off2[rays])
    t = middle[rays, None] + half[:, None] * np.linspace(-1, 1, samples)
    if bends is not None:
        t = np.sort(np.concatenate([t, np.clip(np.nan_to_num(bends[rays]), t[:, :1], t[:, -1:])], axis=1))

    def value(t: np.ndarray, rays: np.ndarray) -> np.ndarray:
        q = o[rays][:, None] + t[..., None] * d[rays][:, None]
        return residual(q.reshape(-1, 3)).reshape(t.shape)

    f = value(t, rays)
    row, place = np.nonzero(np.sign(f[:, :-1]) * np.sign(f[:, 1:]) <= 0)
    low, high, before = t[row, place], t[row, place + 1], f[row, place]
    some = (before != 0) | (place == 0)  # a sample on the surface ends the interval before it
    row, low, high, before = row[some], low[some], high[some], before[some]
    for _ in range(HALVINGS):
        half_way = 0.5 * (low + high)
        first = np.sign(value(half_way[:, None], rays[row])[:, 0]) == np.sign(before)
        low, high = np.where(first, half_way, low), np.where(first, high, half_way)
    number = np.arange(len(row)) - np.searchsorted(row, row)
    kept = number < most
    found[rays[row[kept]], number[kept]] = 0.5 * (low + high)[kept]
    return found
