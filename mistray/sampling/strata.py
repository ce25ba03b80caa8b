"""
Strata of start rays: sampling techniques with fixed numbers of rays, and positions along a space-filling curve.

Along the curve neighbouring lanes trace similar trees, and errors fall faster.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.settings import BATCHES
from mistray.surfaces.upload import upload

BITS = 32  # bits of a position on the curve
FEW = 16  # rays of the last stratum in a batch, below which batches are closed together


class Strata:
    """
    Assignment of the rays of a pass to strata, in fixed proportions within every batch.

    Parameters
    ----------
    batch : mi.UInt32
        Batch of each ray, ascending.
    shares : sequence of float
        Fraction of the rays in each stratum.

    Attributes
    ----------
    number : mi.UInt32
        Index of the stratum of each ray.
    group : mi.UInt32
        batch · strata + stratum, ascending.
    parts : list of mi.Float64
        Fraction of the rays of a ray's batch in each stratum.
    """

    def __init__(self, batch: mi.UInt32, shares: Sequence[float]) -> None:
        # Number of rays of each batch in each stratum
        count, self._batch = len(shares), batch
        first = np.searchsorted(np.array(batch), np.arange(BATCHES + 1))
        self._sizes = sizes = np.diff(first)
        # The last of them, which is the source's own, gets what rounding leaves: it has rays in the smallest batch
        numbers = np.floor(np.outer(sizes, shares) / np.sum(shares)).astype(np.int64)
        numbers[:, -1] = sizes - numbers[:, :-1].sum(axis=1)
        # Stratum of each ray, by its place in the batch
        bounds = np.cumsum(numbers, axis=1)
        within = dr.arange(mi.UInt32, dr.width(batch)) - dr.gather(mi.UInt32, upload(mi.UInt32, first[:-1]), batch)
        self.number = dr.zeros(mi.UInt32, dr.width(batch))
        for k in range(count - 1):
            bound = dr.gather(mi.UInt32, upload(mi.UInt32, bounds[:, k].copy()), batch)
            self.number += dr.select(within >= bound, mi.UInt32(1), 0)
        self._few = int(numbers[:, -1].min()) < FEW
        self.group = batch * count + self.number
        shares_of = numbers / np.maximum(sizes, 1)[:, None]
        self.parts = [dr.gather(mi.Float64, upload(mi.Float64, part.copy()), batch) for part in shares_of.T]

    def closed(self, weight: mi.Float64, zone: mi.UInt32, zones: int) -> mi.Float:
        """
        Return ray weights scaled so that their mean over each batch is 1; a batch of weights 0 stays as it is.

        Small batches are scaled together: alone, the weights would be biased.

        Parameters
        ----------
        weight : mi.Float64
            Weights of expectation 1.
        zone : mi.UInt32
            Index of the zone of each ray; 0 matters most. The last zone is scaled alone. Where it has too few rays for
            that, the zone before it is scaled as well, and so on.
        zones : int
            Number of zones.
        """
        sums = dr.zeros(mi.Float64, BATCHES * zones)
        dr.scatter_reduce(dr.ReduceOp.Add, sums, weight, self._batch * zones + zone)
        flux, rays = np.array(sums).reshape(BATCHES, zones), self._sizes
        if self._few:  # the zones of one batch may have no ray, and zone 0 would make up for them
            flux, rays = (np.broadcast_to(each.sum(axis=0), each.shape) for each in (flux, rays))
        scale, done = np.ones_like(flux), np.zeros(BATCHES, dtype=bool)
        # The outermost zones whose factor lies between 1/2 and 2 make up for all noise, so that zone 0 is rarely scaled
        for first in range(zones - 1, -1, -1):
            outside = flux[:, first:].sum(axis=1)
            factor = (rays - flux[:, :first].sum(axis=1)) / np.where(outside > 0, outside, np.inf)
            fits = ~done & ((np.abs(np.log2(np.maximum(factor, 1e-300))) < 1) | ((first == 0) & (outside > 0)))
            scale[fits, first:] = factor[fits, None]
            done |= fits
        return mi.Float(weight * dr.gather(mi.Float64, upload(mi.Float64, scale), self._batch * zones + zone))


def stratified_points(group: mi.UInt32, rng: mi.PCG32) -> mi.Point2f:
    """
    Return random points of the unit square, stratified along a space-filling curve within each group of lanes.

    A group of n has one point in each of n equal parts of the curve. Neighbouring lanes trace similar trees, so that
    few of them idle. The points of a group lie more evenly than random ones. The error of a mean over n of them falls
    as n^-1 where the integrand is smooth, and as n^-3/4 where it has edges, such as those of a pupil. Groups are
    independent. The curve is Morton's with 2^32 cells. Three numbers of each generator are drawn.

    Parameters
    ----------
    group : mi.UInt32
        Group of each lane, ascending.
    rng : mi.PCG32
        Random number generator of each lane.
    """
    # First lane and size of each group, on the host
    groups = np.array(group)
    first = np.searchsorted(groups, np.arange(int(groups[-1]) + 2))
    begin, size = (dr.gather(mi.UInt32, upload(mi.UInt32, v), group) for v in (first[:-1], np.diff(first)))
    number = mi.Float64(dr.arange(mi.UInt32, len(groups)) - begin) + mi.Float64(rng.next_float32())
    return mi.Point2f(*curve_points(number / mi.Float64(size), 2, rng))


def curve_points(place: mi.Float64, dimensions: int, rng: mi.PCG32) -> list[mi.Float]:
    """
    Return points of the unit square or cube for positions along Morton's space-filling curve.

    Parameters
    ----------
    place : mi.Float64
        Position along the curve, 0 … 1; uniform positions give uniform points.
    dimensions : int
        Number of dimensions, 2 or 4.
    rng : mi.PCG32
        One generator per lane; each dimension draws one number, for the position within a cell.

    Returns
    -------
    list of mi.Float
        Coordinates, 0 … 1.
    """
    # A coordinate has every second, or every fourth, bit of the number of the cell
    cell = mi.UInt32(dr.minimum(place, 1 - 2.0 ** -(BITS + 1)) * 2.0**BITS)
    scale = 2.0 ** -(BITS // dimensions)
    return [
        (mi.Float(_every(mi.UInt32(cell >> k), dimensions)) + rng.next_float32()) * scale for k in range(dimensions)
    ]


def _every(v: mi.UInt32, stride: int) -> mi.UInt32:
    """Return every `stride`-th bit of a word, from the lowest on, packed side by side; `stride` is 2 or 4."""
    steps = {
        2: ((0, 0x55555555), (1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)),
        4: ((0, 0x11111111), (3, 0x03030303), (6, 0x000F000F), (12, 0x000000FF)),
    }[stride]
    for shift, mask in steps:
        v = (v | (v >> shift)) & mask if shift else v & mask
    return v
