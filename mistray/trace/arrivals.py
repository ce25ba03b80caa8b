"""Books of forward traces of many cells of directions at once: light that meets the detector, by way and cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.trace.ledger import BATCHES
from mistray.trace.sky import PathBook
from mistray.trace.way_table import WayTable


@dataclass(frozen=True)
class Arrival:
    """
    Rays that meet the detector.

    Attributes
    ----------
    key : mi.UInt64
        Of their ways, see `mistray.trace.ledger.extend_key`.
    length : mi.UInt32
        Number of events of the ways.
    read : callable
        Events of the ways, `read(k, mask)`, k < length.
    cell, batch, pixel : mi.UInt32
        Where the rays come from, their batch, and where they meet the detector.
    weight : mi.Float
        In units of a start ray.
    scatters : mi.UInt32
        See `mistray.trace.ledger.COUNT_MASK`.
    active : mi.Bool
    """

    key: mi.UInt64
    length: mi.UInt32
    read: Callable[[mi.UInt32, mi.Bool], mi.UInt32]
    cell: mi.UInt32
    batch: mi.UInt32
    weight: mi.Float
    scatters: mi.UInt32
    pixel: mi.UInt32
    active: mi.Bool


class ArrivalBook(Protocol):
    """What `mistray.trace.ray_tree.walk` tells of the rays that meet the detector."""

    def record(self, ray: Arrival) -> None:
        """Add rays that have met the detector."""


class FoundWays:
    """
    All ways that are met, by cell.

    Parameters
    ----------
    book : PathBook
    """

    def __init__(self, book: PathBook) -> None:
        self.book = book

    def record(self, ray: Arrival) -> None:
        """See `ArrivalBook`."""
        self.book.record(ray.key, ray.length, ray.read, ray.cell, ray.weight, ray.active)


class CountedWays:
    """
    The light of chosen ways in chosen cells.

    Parameters
    ----------
    table : WayTable
        With the keys of the ways in the order of the light.
    cells, pixels : int
        Number of cells, and of the pixels of a map of the detector for each; 0: no maps.
    """

    def __init__(self, table: WayTable, cells: int, pixels: int) -> None:
        self._table, self._pixels, self._cells = table, pixels, cells
        pairs = max(table.count, 1)
        self._sums = dr.zeros(mi.Float64, pairs * BATCHES)
        self._hits, self._squares = dr.zeros(mi.Float64, pairs), dr.zeros(mi.Float64, pairs)
        self._largest = dr.zeros(mi.UInt32, cells)  # bits of the largest weight of a scattered ray
        self._maps = dr.zeros(mi.Float64, 2 * cells * pixels) if pixels else None
        dr.eval(self._sums, self._hits, self._squares, self._largest, self._maps)

    def record(self, ray: Arrival) -> None:
        """See `ArrivalBook`."""
        number, found = self._table.find(ray.key, ray.cell, ray.active)
        w = mi.Float64(ray.weight)
        dr.scatter_reduce(dr.ReduceOp.Add, self._sums, w, number * BATCHES + ray.batch, found)
        dr.scatter_reduce(dr.ReduceOp.Add, self._hits, mi.Float64(1), number, found)
        dr.scatter_reduce(dr.ReduceOp.Add, self._squares, w * w, number, found)
        # The bits of positive floats are in the order of the floats
        bits = dr.reinterpret_array(mi.UInt32, ray.weight)
        dr.scatter_reduce(dr.ReduceOp.Max, self._largest, bits, ray.cell, found & (ray.scatters != 0))
        if self._maps is not None:
            place = 2 * (ray.cell * self._pixels + ray.pixel)
            for k, value in enumerate((w, w * w)):
                dr.scatter_reduce(dr.ReduceOp.Add, self._maps, value, place + k, found)

    def read(self) -> dict[str, np.ndarray]:
        """
        The sums on the host.

        Returns
        -------
        dict
            ``weights`` (p, BATCHES), ``hits`` and ``squares`` (p,) of the pairs, ``largest`` (cells,) and, if there are
            maps, ``maps`` (2, cells, pixels); in units of a start ray.
        """
        count = self._table.count
        found = {
            "weights": np.array(self._sums).reshape(-1, BATCHES)[:count],
            "hits": np.array(self._hits)[:count],
            "squares": np.array(self._squares)[:count],
            "largest": np.array(self._largest).view(np.float32).astype(np.float64),
        }
        if self._maps is not None:
            found["maps"] = np.moveaxis(np.array(self._maps).reshape(self._cells, self._pixels, 2), 2, 0)
        return found
