"""Table of MIS-weighted ray throughput by path and cell of directions, in units of a start ray's flux."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.recorders.ledger import claim, read_lists, write_list
from mistray.recorders.path_key import MULTIPLIER, joined_lists
from mistray.settings import BATCHES

# Most slots that are probed: a path that finds none is not listed
MOST_PROBES = 24
# By its own choice Dr.Jit gives each thread a copy of a small array, whose size is a literal of the kernel; another
# number of cells would compile anew
REDUCE = dr.ReduceMode.Local


class PathsByCell(dict[str, np.ndarray]):
    """
    Paths with the sums of their MIS-weighted throughput in each cell of directions; empty: there are none.

    The keys ``events``, (p, k) uint32, and ``lengths``, (p,), hold the event lists of p paths, in the order in which
    rays meet the events. The other keys hold e entries, (e,), one for each path and cell with hits. They are ``path``
    and ``cell``, indices; ``hits``, the number of rays; and ``weight``, (e, BATCHES), the sums of their throughput by
    batch of start rays, in units of a start ray's flux.
    """

    def __add__(self, other: PathsByCell) -> PathsByCell:
        """Return the union of two tables, with the sums of equal paths and cells added up."""
        if not self or not other:
            return self or other
        # Paths are identified by their keys, and entries by path and cell
        events, lengths, place = joined_lists(*((one["events"], one["lengths"]) for one in (self, other)))
        path = place[np.concatenate([self["path"], other["path"] + len(self["lengths"])])]
        cell = np.concatenate([self["cell"], other["cell"]])
        pairs, place = np.unique(np.stack([path, cell], axis=1), axis=0, return_inverse=True)
        sums = {}
        for name in ("hits", "weight"):
            # A table holds an entry once
            sums[name] = np.zeros((len(pairs), *self[name].shape[1:]))
            sums[name][place.ravel()[: len(self["path"])]] = self[name]
            sums[name][place.ravel()[len(self["path"]) :]] += other[name]
        return PathsByCell(events=events, lengths=lengths, path=pairs[:, 0], cell=pairs[:, 1], **sums)


class PathSums:
    """
    Table of the contributions of rays by path and cell of directions, in device memory of a fixed size.

    Paths that find no room are left out; the sums of the cells include them all the same.

    Parameters
    ----------
    paths, entries : int
        Slots for paths, and for pairs of a path and a cell; powers of two.
    max_events : int
        Largest number of events of a path.
    cells : int
        Number of cells of directions.

    Raises
    ------
    MistrayError
        If there are more pairs of a path and a cell than 32 bits can number.
    """

    def __init__(self, paths: int, entries: int, max_events: int, cells: int) -> None:
        if paths * cells >= 2**32:
            raise MistrayError(
                f"{paths} paths in {cells} cells are too many to number; ask for fewer angles or azimuths"
            )
        self.max_events, self.cells = max_events, cells
        self._path_mask, self._entry_mask = dr.opaque(mi.UInt32, paths - 1), dr.opaque(mi.UInt32, entries - 1)
        self._row = dr.opaque(mi.UInt32, cells)  # opaque, so that it makes no new kernel
        self.keys = dr.zeros(mi.UInt64, paths)
        self.lengths = dr.zeros(mi.UInt32, paths)
        self.events = dr.zeros(mi.UInt32, paths * max_events)
        self.entries = dr.zeros(mi.UInt32, entries)
        self.hits = dr.zeros(mi.Float64, entries)
        self.sums = dr.zeros(mi.Float64, entries * BATCHES)
        dr.make_opaque(self.keys, self.lengths, self.events, self.entries, self.hits, self.sums)

    def record(
        self,
        key: mi.UInt64,
        length: mi.UInt32,
        read: Callable[[mi.UInt32, mi.Bool], mi.UInt32],
        cell: mi.UInt32,
        batch: mi.UInt32,
        weight: mi.Float,
        active: mi.Bool,
    ) -> None:
        """
        Add rays' `weight`, see `PathsByCell`, to the sums of their paths, cells and batches of start rays.

        Rays that find no slot are left out. `key` identifies each path, and `read(k, mask)` returns its event
        k < `length`.
        """
        # Find or claim the slot of the path
        slot, found, new = claim(
            self.keys, key, mi.UInt32(key >> 32) & self._path_mask, self._path_mask, MOST_PROBES, active
        )
        dr.scatter(self.lengths, length, slot, new)
        write_list(self.events, slot * self.max_events, length, read, new)
        # Find or claim the entry of the path in its cell; 0 marks a free entry
        number = slot * self._row + cell + 1
        start = mi.UInt32((mi.UInt64(number) * mi.UInt64(MULTIPLIER)) >> 32) & self._entry_mask
        entry, found, _ = claim(self.entries, number, start, self._entry_mask, MOST_PROBES, found)
        # By batch, since one start ray may bring several rays of a path: they are not independent
        place = entry * BATCHES + batch
        dr.scatter_reduce(dr.ReduceOp.Add, self.hits, mi.Float64(1), entry, found, REDUCE)
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, mi.Float64(weight), place, found, REDUCE)

    def read(self) -> PathsByCell:
        """Return the paths and their sums by cell on the host; `MistrayError` if a list does not match its key."""
        slots, _, events, lengths = read_lists("paths", self.keys, self.lengths, self.events)
        # Entries: slots become indices of the paths
        entries = np.array(self.entries)
        used = np.flatnonzero(entries)
        number = entries[used].astype(np.int64) - 1
        place = np.zeros(len(self.keys), dtype=np.int64)
        place[slots] = np.arange(len(slots))
        return PathsByCell(
            events=events,
            lengths=lengths,
            path=place[number // self.cells],
            cell=number % self.cells,
            hits=self.hits.numpy()[used],
            weight=self.sums.numpy().reshape(-1, BATCHES)[used],
        )
