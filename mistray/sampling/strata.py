"""Strata of start rays: sampling techniques, each with a fixed number of the rays of every batch."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.settings import BATCHES
from mistray.surfaces.upload import upload


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
        Stratum of each ray.
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
        self.group = batch * count + self.number
        shares_of = numbers / np.maximum(sizes, 1)[:, None]
        self.parts = [dr.gather(mi.Float64, upload(mi.Float64, part.copy()), batch) for part in shares_of.T]

    def closed(self, weight: mi.Float64, zone: mi.UInt32, zones: int) -> mi.Float:
        """
        Return ray weights scaled so that their mean over each batch is exactly 1.

        Parameters
        ----------
        weight : mi.Float64
            Weights of expectation 1.
        zone : mi.UInt32
            Zone of each ray; 0 matters most. The last zone is scaled alone. Where it has too few rays for that, the
            zone before it is scaled as well, and so on.
        zones : int
            Number of zones.
        """
        sums = dr.zeros(mi.Float64, BATCHES * zones)
        dr.scatter_reduce(dr.ReduceOp.Add, sums, weight, self._batch * zones + zone)
        flux = np.array(sums).reshape(BATCHES, zones)
        rays = self._sizes
        scale, done = np.ones_like(flux), np.zeros(BATCHES, dtype=bool)
        # The outermost zones whose factor lies between 1/2 and 2 make up for all noise, so that zone 0 is rarely scaled
        for first in range(zones - 1, -1, -1):
            outside = flux[:, first:].sum(axis=1)
            factor = (rays - flux[:, :first].sum(axis=1)) / np.where(outside > 0, outside, np.inf)
            fits = ~done & ((np.abs(np.log2(np.maximum(factor, 1e-300))) < 1) | ((first == 0) & (outside > 0)))
            scale[fits, first:] = factor[fits, None]
            done |= fits
        return mi.Float(weight * dr.gather(mi.Float64, upload(mi.Float64, scale), self._batch * zones + zone))
