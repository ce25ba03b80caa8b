"""Pairs of a way of the light and a cell of directions that one of both directions of tracing counts."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.path_key import extend_key, host_extend
from mistray.surfaces.upload import upload

SLOTS_OF_PAIR = 4  # the table stays so empty that a search ends soon


class WayTable:
    """
    Numbers of pairs of a way and a cell in device memory, which a kernel only reads.

    Parameters
    ----------
    keys : (p,) uint64
        Of the event lists, in the order of the rays that will ask; see `mistray.recorders.path_key.host_keys`.
    cells : (p,) int
        Numbers of the cells. The pairs differ from each other.
    """

    def __init__(self, keys: np.ndarray, cells: np.ndarray) -> None:
        self.count = len(keys)
        size = 1 << max(4, (SLOTS_OF_PAIR * self.count - 1).bit_length())
        places, numbers = np.zeros(size, dtype=np.uint64), np.zeros(size, dtype=np.uint32)
        for number, pair in enumerate(host_extend(keys, cells).tolist()):
            slot = (pair >> 32) & (size - 1)
            while places[slot]:
                slot = (slot + 1) & (size - 1)
            places[slot], numbers[slot] = pair, number
        self._mask = dr.opaque(mi.UInt32, size - 1)
        self._places, self._numbers = upload(mi.UInt64, places), upload(mi.UInt32, numbers)

    def find(self, key: mi.UInt64, cell: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """Number of the pair of a way and a cell, and whether the table has it."""
        pair = extend_key(key, cell)

        def probe(slot, going, found):  # type: ignore[no-untyped-def]
            there = dr.gather(mi.UInt64, self._places, slot, going)
            found |= going & (there == pair)
            going = going & (there != pair) & (there != 0)
            return dr.select(going, (slot + 1) & self._mask, slot), going, found

        slot, _, found = dr.while_loop(
            (mi.UInt32(pair >> 32) & self._mask, mi.Bool(active), mi.Bool(False)),
            lambda *v: v[1],
            probe,
            labels=("slot", "going", "found"),
            mode="symbolic",
        )
        return dr.gather(mi.UInt32, self._numbers, slot, found), active & found
