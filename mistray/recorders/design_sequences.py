"""
Design sequences: the sequences of events by which light forms the direct image, and tests of paths against them.

A path is identified by the key of its events, see `mistray.recorders.path_key`, on the host and in the kernel alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.events import EVENT_BITS, EVENT_MASK, REFLECTED, TOTAL
from mistray.recorders.path_key import host_keys, padded
from mistray.surfaces.upload import upload

Sequences = tuple[tuple[int, ...], ...]
"""Event lists (surface << EVENT_BITS | what), in the order of the light, without the absorption at their ends."""


@dataclass(frozen=True)
class DesignSequences:
    """
    Event sequences by which light forms the intended image on each detector; all other light is stray light.

    Attributes
    ----------
    lists : mapping of int to Sequences
        Sequences by the surface index of the detector; a detector without any has no direct image.
    """

    lists: Mapping[int, Sequences] = field(default_factory=dict)

    def keys(self, detector: int, backward: bool = False) -> np.ndarray:
        """Return the path keys of a detector's sequences, (n,) uint64, ascending; with `backward`, of backward rays."""
        # Backward rays meet the events in reverse order, and the key depends on the order
        return np.unique(host_keys(*padded([one[::-1] if backward else one for one in self.lists.get(detector, ())])))

    def reflectors(self, detector: int) -> frozenset[int]:
        """Return the indices of the surfaces at which a detector's design sequences reflect, TIR included."""
        kinds = (REFLECTED, TOTAL)
        codes = {code for one in self.lists.get(detector, ()) for code in one}
        return frozenset(code >> EVENT_BITS for code in codes if code & EVENT_MASK in kinds)

    def direct(self, events: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """
        Return a mask of the paths that follow a design sequence of their detector and so form the direct image.

        Parameters
        ----------
        events : (p, k) uint32
            Event lists with the absorption in the detector at their ends, then padding.
        lengths : (p,) int
            Number of events of each, at least 1.

        Returns
        -------
        (p,) bool
            True for paths of the direct image.
        """
        found = np.zeros(len(events), dtype=bool)
        for detector, here in self._by_detector(events, lengths):
            found[here] = np.isin(host_keys(events[here], lengths[here] - 1), self.keys(detector))
        return found

    def reflects(self, events: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """
        Return a mask of events, (p, k) bool, at surfaces where a design sequence of the path's detector reflects.

        `events` and `lengths` are those of `direct`. Padding has no meaning in the mask.
        """
        found = np.zeros(events.shape, dtype=bool)
        for detector, here in self._by_detector(events, lengths):
            found[here] = np.isin(events[here] >> EVENT_BITS, list(self.reflectors(detector)))
        return found

    def _by_detector(self, events: np.ndarray, lengths: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the index of each detector that has sequences, and the indices, (n,), of the paths that end there."""
        ends = self.ends(events, lengths)
        return ((detector, np.flatnonzero(ends == detector)) for detector in self.lists)

    @staticmethod
    def ends(events: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Return the surface index of each path's last event, (p,) int: the detector that absorbs the light."""
        return np.asarray(events[np.arange(len(events)), np.maximum(lengths - 1, 0)] >> EVENT_BITS)


class DesignKeys:
    """
    Path keys of one detector's design sequences in device memory, for tests in the kernel.

    Parameters
    ----------
    sequences : DesignSequences
        Event sequences of the direct image.
    detector : int
        Surface index of the detector.

    Attributes
    ----------
    code : int
        Number of sequences, rounded up to a power of two, which distinguishes kernels that call `hold`; 0: none.
    """

    def __init__(self, sequences: DesignSequences, detector: int) -> None:
        self._host = [sequences.keys(detector, backward) for backward in (False, True)]
        self.code = 1 << (len(self._host[0]) - 1).bit_length() if len(self._host[0]) else 0

    @cached_property
    def _device(self) -> list[mi.UInt64]:
        # Padded to a power of two with the last key, so that numbers of sequences of one size class share a kernel
        return [upload(mi.UInt64, np.concatenate([k, np.full(self.code - len(k), k[-1])])) for k in self._host]

    def hold(self, key: mi.UInt64, backward: bool) -> mi.Bool:
        """
        Return a mask of path keys that are those of a design sequence; all False for a detector without sequences.

        `backward` says whether the keys are those of backward rays, which meet the events in reverse order.
        """
        # Without sequences there is no array to search
        if not self.code:
            return dr.full(mi.Bool, False, dr.width(key))
        keys = self._device[backward]
        # The keys ascend
        place = dr.binary_search(0, self.code - 1, lambda k: dr.gather(mi.UInt64, keys, k) < key)
        return dr.gather(mi.UInt64, keys, mi.UInt32(place)) == key
