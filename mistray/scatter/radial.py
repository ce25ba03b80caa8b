"""Profile of a lobe as a table: a piecewise power law that can be evaluated and sampled exactly.

Nodes lie uniformly in log r, 64 to the octave over 27 octaves; between two nodes log f is linear in log r. For the
profiles in use the relative error of the table is below 1e-4, but for `Phong`, which states its own. Sampling picks a
ring between two nodes by the alias method (A. J. Walker, ACM Trans. Math. Softw. 3, 253 (1977)) and inverts the power
law within it. So the density is that of the table to the rounding, whatever the profile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from mistray.errors import MistrayError

R_MAX = 2.0  # the largest distance of two unit vectors
PER_OCTAVE, OCTAVES = 64, 27
RINGS = PER_OCTAVE * OCTAVES  # and the disc within the first node
LEAST, MOST = 1e-30, 1e30  # least and largest value of a profile, 1/sr, that the tables of a trace can hold
FLOOR = 1e-30  # relative to the largest value: smaller values are negligible, and their logarithm stays finite
ALMOST_LOG = 1e-3  # exponents of r nearer to -2 than this are integrated as if they were -2


@dataclass(frozen=True, eq=False)
class RadialTable:
    """
    Table of a profile f(r), 1/sr, over the distance r of direction cosines, 0 ≤ r ≤ 2.

    Attributes
    ----------
    log2_values : (RINGS + 1,) float64
        Values of log2 f at the nodes r = 2^(k/64 - 26).
    total : float
        Integral of 2π r f(r) over the table.
    probability : (RINGS + 1,) float64
        Probabilities to keep a cell of the alias table; cell 0 is the disc in the first node, cell k + 1 the ring from
        node k.
    alias : (RINGS + 1,) int
        Cell that is used if a cell is not kept.
    """

    log2_values: np.ndarray
    total: float
    probability: np.ndarray
    alias: np.ndarray

    @classmethod
    def of(cls, profile: Callable[[np.ndarray], np.ndarray], r_max: float = R_MAX) -> RadialTable:
        """
        Return the table of a lobe's radial profile, 1/sr, over r in direction cosines; negligible beyond `r_max`.

        Raises
        ------
        MistrayError
            If a value is negative, NaN or infinite, or the largest is not within `LEAST` … `MOST`.
        """
        nodes = node_radii()
        with np.errstate(all="ignore"):  # what is not finite is refused
            values = np.where(nodes <= r_max, np.asarray(profile(nodes), dtype=np.float64), 0.0)
        least, largest = float(np.min(values)), float(np.max(values))
        if not (least >= 0 and LEAST <= largest <= MOST):
            raise MistrayError(
                f"scatter profile: its values run from {least:g} to {largest:g} 1/sr; give a BSDF > 0 whose "
                f"largest value is within {LEAST:g} … {MOST:g}"
            )
        return _table(np.log2(np.maximum(values, FLOOR * largest)).tobytes())

    def value(self, r: np.ndarray) -> np.ndarray:
        """Return the profile f, 1/sr, at distances r, (m,); it is constant below the first node."""
        with np.errstate(divide="ignore"):
            place = np.clip((np.log2(r / R_MAX) + OCTAVES) * PER_OCTAVE, 0, RINGS)
        return np.asarray(2.0 ** np.interp(place, np.arange(RINGS + 1), self.log2_values))

    def times_r2(self) -> RadialTable:
        """Return the table of r² f(r), for moments of the lobe; its `total` and alias table are still those of f."""
        return replace(self, log2_values=self.log2_values + 2 * np.log2(node_radii()))

    def within(self, r: np.ndarray) -> np.ndarray:
        """Return the integral of 2π r f within each radius r, (m,): the flux per unit of incident flux."""
        nodes = node_radii()
        before = np.concatenate([[0.0], np.cumsum(ring_flux(nodes[:-1], self.log2_values))])
        before += np.pi * nodes[0] ** 2 * 2.0 ** self.log2_values[0]
        r = np.clip(r, 0, R_MAX)
        place = np.clip((np.log2(np.maximum(r, nodes[0]) / R_MAX) + OCTAVES) * PER_OCTAVE, 0, RINGS)
        ring = np.minimum(place.astype(int), RINGS - 1)
        slope = (self.log2_values[ring + 1] - self.log2_values[ring]) * PER_OCTAVE
        part = _power_law(nodes[ring], self.log2_values[ring], slope, (place - ring) / PER_OCTAVE)
        return np.where(r < nodes[0], np.pi * r**2 * 2.0 ** self.log2_values[0], before[ring] + part)


def node_radii() -> np.ndarray:
    """Return the radii of the nodes, (RINGS + 1,), in direction cosines."""
    return np.asarray(R_MAX * 2.0 ** (np.arange(RINGS + 1) / PER_OCTAVE - OCTAVES))


def ring_flux(inner: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """
    Return the integrals of 2π r f over the rings between nodes, (RINGS,).

    `inner` are the inner radii of the rings, and `logs`, (RINGS + 1,), is log2 f at all nodes, f in 1/sr.
    """
    return _power_law(inner, logs[:-1], np.diff(logs) * PER_OCTAVE, np.full(len(inner), 1 / PER_OCTAVE))


def _power_law(r: np.ndarray, log2_f: np.ndarray, slope: np.ndarray, octaves: np.ndarray) -> np.ndarray:
    """Return the integral of 2π r f from r to r · 2^octaves for f, 1/sr, that grows as r^slope from 2^log2_f at r."""
    exponent = slope + 2
    flat = np.abs(exponent) < ALMOST_LOG
    safe = np.where(flat, 1.0, exponent)
    growth = np.where(flat, np.log(2) * octaves, np.expm1(np.log(2) * safe * octaves) / safe)
    return np.asarray(2 * np.pi * 2.0**log2_f * r**2 * growth)


@lru_cache(maxsize=256)
def _table(log2_values: bytes) -> RadialTable:
    """Return the radial table for log2 f at the nodes (bytes of float64), cached since many surfaces share a model."""
    logs, nodes = np.frombuffer(log2_values), node_radii()
    flux = np.concatenate([[np.pi * nodes[0] ** 2 * 2.0 ** logs[0]], ring_flux(nodes[:-1], logs)])
    return RadialTable(logs, float(flux.sum()), *_alias_table(flux / flux.sum()))


def _alias_table(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Walker's alias table of a discrete distribution, (n,): probability to keep each cell, and its alias."""
    count = len(shares)
    scaled = shares * count
    probability, alias = np.ones(count), np.arange(count)
    small, large = list(np.flatnonzero(scaled < 1)), list(np.flatnonzero(scaled >= 1))
    while small and large:
        low, high = small.pop(), large[-1]
        probability[low], alias[low] = scaled[low], high
        scaled[high] -= 1 - scaled[low]
        if scaled[high] < 1:
            small.append(large.pop())
    return probability, alias
