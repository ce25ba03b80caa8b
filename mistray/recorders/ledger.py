"""
Path ledger: an open-addressing hash table in device memory that the kernel fills.

The first ray that brings a new key, see `mistray.recorders.path_key`, claims a slot by compare-and-swap and writes the
event list there. `Ledger.decode` hashes every recorded list again and compares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.interrupts import end_overdue
from mistray.recorders.path_key import host_keys, joined_lists
from mistray.recorders.recorder import Memory, Recorder, Visit
from mistray.settings import BATCHES

# Sums of a slot and batch: rays, incident, absorbed, absorbed · x, absorbed · y, absorbed · (x² + y²), absorbed²,
# absorbed⁴, and in Stokes mode absorbed · (q, u, v)
SUMS, STOKES_SUMS = 8, 11
MOST_PROBES = 256  # slots of the table that are tried for a path
LARGE = 1 << 24  # entries of an array
FULL = 0.7  # of the slots, above which the search for a free one takes long
USUAL_PROBES = 4  # are enough for most paths while the table is not full


@dataclass
class DecodedPaths:
    """
    Paths of a ledger on the host: keys, event lists, and sums of flux by batch.

    Attributes
    ----------
    keys : (p,) uint64
        Key of each path, a hash of its events.
    slots : (p,) int
        Slot of each path in the table.
    events : (p, k) uint32
        Event lists, surface << EVENT_BITS | kind of event, padded with 0; the last is the absorption in the detector.
    lengths : (p,) int
        Number of events of each path.
    sums : (p, BATCHES, SUMS or STOKES_SUMS) float64
        Sums in units of the flux of one start ray, see `SUMS`.
    """

    keys: np.ndarray
    slots: np.ndarray
    events: np.ndarray
    lengths: np.ndarray
    sums: np.ndarray

    def take(self, chosen: np.ndarray) -> DecodedPaths:
        """Return the paths that indices or a boolean mask select, with their sums."""
        return DecodedPaths(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def __add__(self, other: DecodedPaths) -> DecodedPaths:
        """Return the union of two sets of paths, with the sums of common paths added; all slots are set to 0."""
        events, lengths, place = joined_lists((self.events, self.lengths), (other.events, other.lengths))
        sums = np.zeros((len(lengths), *self.sums.shape[1:]))
        sums[place[: len(self.keys)]] = self.sums
        sums[place[len(self.keys) :]] += other.sums
        return DecodedPaths(host_keys(events, lengths), np.zeros(len(lengths), dtype=np.int64), events, lengths, sums)


def claim(
    keys: Any,
    key: Any,
    start: mi.UInt32,
    mask: mi.UInt32,
    most_probes: int,
    active: mi.Bool,
    flag: mi.UInt32 | None = None,
) -> tuple[mi.UInt32, mi.Bool, mi.Bool]:
    """
    Find a key in an open-addressing table in device memory, or claim a free slot for it by compare-and-swap.

    Parameters
    ----------
    keys : mi.UInt64 or mi.UInt32
        Keys of the table, a power of two of slots; 0 marks a free one.
    key : same type
        Key to find; not 0.
    start : mi.UInt32
        Slot that is tried first.
    mask : mi.UInt32
        Number of slots less 1.
    most_probes : int
        Most slots that are tried.
    active : mi.Bool
        Lanes that search.
    flag : mi.UInt32, optional
        Index of the entry of `keys` that is set once a key has found no slot. Searches end early from then on, since
        in a full table each would be a long one. None: there is no such entry.

    Returns
    -------
    slot : mi.UInt32
        Slot of the key, valid if `found`.
    found, new : mi.Bool
        Whether the key has this slot, and whether it was claimed just now.
    """

    def probe(slot, going, found, new, tries):  # type: ignore[no-untyped-def]
        place, value, tried, full = slot, key, going, mi.Bool(False)
        # The flag is read and set by the same compare-and-swap: no other instruction may read what the kernel writes
        if flag is not None:
            asks, gives_up = tries == USUAL_PROBES, tries == most_probes
            place = dr.select(asks | gives_up, flag, slot)
            value = dr.select(asks, type(key)(0), dr.select(gives_up, type(key)(1), key))
            tried = going & ~asks & ~gives_up
        old, swapped = dr.scatter_cas(keys, type(key)(0), value, place, going)
        here = tried & (swapped | (old == key))
        found |= here
        new |= tried & swapped
        if flag is not None:
            full = gives_up | (asks & (old != 0))
        going = going & ~here & ~full & (tries + 1 < last)
        return dr.select(going & tried, (slot + 1) & mask, slot), going, found, new, tries + 1

    # One probe more sets the flag
    last = most_probes if flag is None else most_probes + 1
    slot, _, found, new, _ = dr.while_loop(
        (start, mi.Bool(active), mi.Bool(False), mi.Bool(False), mi.UInt32(0)),
        lambda *v: v[1],
        probe,
        labels=("slot", "going", "found", "new", "tries"),
        mode="symbolic",
    )
    return slot, active & found, active & new


def write_list(
    memory: mi.UInt32,
    first: mi.UInt32,
    length: mi.UInt32,
    read: Callable[[mi.UInt32, mi.Bool], mi.UInt32],
    active: mi.Bool,
) -> None:
    """
    Write each lane's event list, of `length` events, to device memory from index `first` on.

    `read(k, mask)` returns event k of each list.
    """

    def step(k):  # type: ignore[no-untyped-def]
        going = active & (k < length)
        dr.scatter(memory, read(k, going), first + k, going)
        return (k + 1,)

    dr.while_loop((dr.zeros(mi.UInt32, dr.width(first)),), lambda k: active & (k < length), step, mode="symbolic")


def read_lists(
    owner: str, keys: mi.UInt64, lengths: mi.UInt32, events: mi.UInt32
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the paths of a table in device memory: slots, keys, event lists and their lengths, on the host.

    Messages name the table `owner`. The arrays are those of `Ledger`, without flux.

    Returns
    -------
    slots, keys, events, lengths : array
        Slots in use, and of each the columns of `DecodedPaths`.

    Raises
    ------
    MistrayError
        If a recorded event list does not hash to its key: two paths collided or the kernel wrote garbage.
    """
    count = len(lengths)  # more keys than lists: flags follow them
    slots = np.flatnonzero(keys.numpy()[:count])
    own, number = keys.numpy()[slots], lengths.numpy()[slots].astype(np.int64)
    lists = events.numpy().reshape(count, -1)[slots, : int(number.max(initial=0))]
    wrong = int(np.count_nonzero(host_keys(lists, number) != own))
    if wrong:
        raise MistrayError(f"{owner}: {wrong} of {len(slots)} event lists do not match their key; please report this")
    return slots, own, lists, number


def _zeros(dtype: Any, size: int) -> Any:
    """
    Return a device array of `size` zeros; more than `LARGE` are written in parts.

    A large array takes seconds, since the system clears the pages that it hands out. In parts all threads share the
    work. An interrupt that has waited for too long raises `KeyboardInterrupt` between two parts.
    """
    if size <= LARGE:
        return dr.zeros(dtype, size)
    array = dr.empty(dtype, size)
    for first in range(0, size, LARGE):
        place = dr.arange(mi.UInt32, min(LARGE, size - first)) + dr.opaque(mi.UInt32, first)
        dr.scatter(array, dtype(0), place)
        dr.eval(array)
        dr.sync_thread()
        end_overdue()
    return array


class Ledger(Recorder):
    """
    Recorder of the path ledger: a hash table in device memory that holds the flux sums of each distinct path.

    Parameters
    ----------
    capacity : int
        Number of slots, a power of two. Memory: about 2 KiB a slot.
    max_events : int
        Largest number of events of a path.
    stokes : bool
        Whether the Stokes vectors are summed as well.
    """

    kernel_by = ("max_events", "terms")

    def __init__(self, capacity: int, max_events: int, stokes: bool = False) -> None:
        self.capacity, self.max_events = capacity, max_events
        self.terms = STOKES_SUMS if stokes else SUMS
        self.row = 1 << (self.terms - 1).bit_length()  # a power of two, one packet of Dr.Jit
        self.mask = dr.opaque(mi.UInt32, capacity - 1)
        self.keys = dr.zeros(mi.UInt64, capacity + 1)  # the last entry is set once a path has found no slot
        self.lengths = dr.zeros(mi.UInt32, capacity)
        self.events = _zeros(mi.UInt32, capacity * max_events)
        self.sums = _zeros(mi.Float64, capacity * BATCHES * self.row)
        dr.make_opaque(self.keys, self.lengths, self.events, self.sums)

    def clear_sums(self) -> None:
        """Reset the flux sums to zero but keep the paths, so that a second trace finds the same slots."""
        self.sums = _zeros(mi.Float64, self.capacity * BATCHES * self.row)
        dr.make_opaque(self.sums)

    def find(self, key: mi.UInt64, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool, mi.Bool]:
        """
        Return the table slot of each path key, a mask of keys that have a slot, and a mask of new keys.

        A new key claims a free slot, if there is one.
        """
        start = mi.UInt32(key >> 32) & self.mask
        return claim(self.keys, key, start, self.mask, MOST_PROBES, active, self.mask + 1)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add hits to the sums of their paths; later recorders see only hits whose path has a slot."""
        slot, found, new = self.find(visit.key, visit.counted)
        visit.slot, visit.counted = slot, found
        x, y = (mi.Float64(coordinate) for coordinate in visit.position)
        a = mi.Float64(visit.absorbed)
        terms = [mi.Float64(1), mi.Float64(visit.weight), a, a * x, a * y, a * (x * x + y * y)]
        terms += [a * a, a * a * a * a]
        if self.terms == STOKES_SUMS:
            terms += [a * mi.Float64(component) for component in visit.state["stokes"]]
        # One memory access for all terms takes a quarter of the time of one for each; zeros fill the packet
        terms += [mi.Float64(0)] * (self.row - self.terms)
        row = slot * BATCHES + visit.start.batch
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, mi.ArrayXf64(terms), row, found)
        dr.scatter(self.lengths, visit.depth + 1, slot, new)
        write_list(self.events, slot * self.max_events, visit.depth + 1, visit.event, new)

    def known(self, key: mi.UInt64, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """Return the slot of each path key, and a mask of keys that the table holds; no key is added."""

        def probe(slot, going, found, tries):  # type: ignore[no-untyped-def]
            there = dr.gather(mi.UInt64, self.keys, slot, going)
            found |= going & (there == key)
            going = going & (there != key) & (there != 0) & (tries + 1 < MOST_PROBES)
            return dr.select(going, (slot + 1) & self.mask, slot), going, found, tries + 1

        slot, _, found, _ = dr.while_loop(
            (mi.UInt32(key >> 32) & self.mask, mi.Bool(active), mi.Bool(False), mi.UInt32(0)),
            lambda *v: v[1],
            probe,
            labels=("slot", "going", "found", "tries"),
            mode="symbolic",
        )
        return slot, active & found

    @property
    def used(self) -> int:
        """Number of distinct paths in the table."""
        return int(dr.count(self.keys != 0)[0]) - self._lost

    @property
    def _lost(self) -> bool:
        """True if some path has found no slot, so that its flux is missing from the sums."""
        return int(self.keys[self.capacity]) != 0

    @property
    def full(self) -> bool:
        """True if more than `FULL` of the slots are taken, or a path has already found no slot."""
        return self._lost or self.used > FULL * self.capacity

    def decode(self) -> DecodedPaths:
        """Return the paths and their sums on the host; raise `MistrayError` if an event list does not match its key."""
        slots, keys, events, lengths = read_lists("ledger", self.keys, self.lengths, self.events)
        sums = self.sums.numpy().reshape(self.capacity, BATCHES, self.row)[slots, :, : self.terms]
        return DecodedPaths(keys, slots, events, lengths, sums)
