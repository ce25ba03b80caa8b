"""Sums of contributions by path and by cell of directions."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.recorders.ledger import claim, write_list
from mistray.recorders.path_key import MULTIPLIER, host_keys

# Most slots that are probed: a path that finds none is not listed
MOST_PROBES = 24
HIT_SUMS = 3  # sums of a path in a cell: hits, weight, squared weight


class PathSums:
    """
    Contributions of rays by path and cell, in device memory of a fixed size.

    Paths that find no room are left out; the sums of the cells include them all the same.

    Parameters
    ----------
    paths, entries : int
        Slots for paths, and for pairs of a path and a cell; powers of two.
    max_events : int
        Longest event list.
    cells : int
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
        self.sums = dr.zeros(mi.Float64, entries * HIT_SUMS)
        dr.eval(self.keys, self.lengths, self.events, self.entries, self.sums)

    def record(
        self,
        key: mi.UInt64,
        length: mi.UInt32,
        read: Callable[[mi.UInt32, mi.Bool], mi.UInt32],
        cell: mi.UInt32,
        weight: mi.Float,
        active: mi.Bool,
    ) -> None:
        """Add a ray that ends after the events `read(k, mask)`, k < length."""
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
        w = mi.Float64(weight)
        for k, value in enumerate((mi.Float64(1), w, w * w)):
            dr.scatter_reduce(dr.ReduceOp.Add, self.sums, value, entry * HIT_SUMS + k, found)

    def read(self) -> dict[str, np.ndarray]:
        """
        Return the sums on the host.

        Returns
        -------
        dict
            ``events`` (p, k) uint32 and ``lengths`` (p,) of the paths, in the order of the rays; ``path``, ``cell``
            (e,) int and ``hits``, ``weight``, ``squares`` (e,) float64 of the entries.

        Raises
        ------
        MistrayError
            If an event list does not hash to its key.
        """
        # Paths, checked against their keys as those of a ledger
        keys = np.array(self.keys)
        slots = np.flatnonzero(keys)
        lengths = np.array(self.lengths)[slots].astype(np.int64)
        events = np.array(self.events).reshape(-1, self.max_events)[slots][:, : int(lengths.max(initial=0))]
        wrong = int(np.count_nonzero(host_keys(events, lengths) != keys[slots]))
        if wrong:
            raise MistrayError(f"paths: {wrong} of {len(slots)} event lists do not match their key; please report this")
        # Entries: slots become indices of the paths
        entries = np.array(self.entries)
        used = np.flatnonzero(entries)
        number = entries[used].astype(np.int64) - 1
        place = np.zeros(len(keys), dtype=np.int64)
        place[slots] = np.arange(len(slots))
        hits, weight, squares = np.array(self.sums).reshape(-1, HIT_SUMS)[used].T
        return {
            "events": events,
            "lengths": lengths,
            "path": place[number // self.cells],
            "cell": number % self.cells,
            "hits": hits,
            "weight": weight,
            "squares": squares,
        }


def join_sums(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return two path tables, see `PathSums.read`, as one; an empty dictionary has no paths."""
    if not first or not second:
        return first or second
    # Paths are identified by their keys, and entries by path and cell
    longest = max(first["events"].shape[1], second["events"].shape[1])
    events = np.concatenate(
        [np.pad(one["events"], ((0, 0), (0, longest - one["events"].shape[1]))) for one in (first, second)]
    )
    lengths = np.concatenate([first["lengths"], second["lengths"]])
    _, chosen, place = np.unique(host_keys(events, lengths), return_index=True, return_inverse=True)
    path = place[np.concatenate([first["path"], second["path"] + len(first["lengths"])])]
    cell = np.concatenate([first["cell"], second["cell"]])
    pairs, place = np.unique(np.stack([path, cell], axis=1), axis=0, return_inverse=True)
    sums = {
        name: np.bincount(place.ravel(), np.concatenate([first[name], second[name]]), len(pairs))
        for name in ("hits", "weight", "squares")
    }
    return {"events": events[chosen], "lengths": lengths[chosen], "path": pairs[:, 0], "cell": pairs[:, 1], **sums}
