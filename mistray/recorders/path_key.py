"""
Key of a path: a rolling 64-bit hash of its events, each a surface and the kind of interaction there.

Two different paths share a key with a probability of about paths²/2^65, 2e-11 for 30 000 paths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.sampler import mixed_word
from mistray.recorders.start_rays import StartRays

# Scatter events of a path are counted in one word: all of them, those at random, those at surfaces that transmit; bits
# say whether one of them was not diffraction, and whether the last was at an opaque surface
COUNT_MASK, RANDOM_SHIFT, OPTICAL_SHIFT, NOT_DIFFRACTED, AT_WALL = 0x3FF, 10, 20, 1 << 30, 1 << 31
PATH_CLASSES = 1024  # path classes
NO_EVENT = 0xFFFFFFFF  # before the first one of a path
FIRST_KEY = 0x9E3779B97F4A7C15
MULTIPLIER = 0xFF51AFD7ED558CCD


EventReader = Callable[[mi.UInt32, mi.Bool], mi.UInt32]
"""``read(k, mask)`` gives event k of a path, surface << EVENT_BITS | what."""


def extend_key(key: mi.UInt64, code: mi.UInt32) -> mi.UInt64:
    """
    Return the 64-bit key of a path after one more event.

    Its multiply-xorshift steps are those of SplitMix64 and MurmurHash3.
    """
    key = (key ^ mi.UInt64(code + 1)) * mi.UInt64(MULTIPLIER)
    return key ^ (key >> 29)


def mixed_events(event: EventReader, first: mi.UInt32, end: mi.UInt32, before: mi.UInt32, active: mi.Bool) -> mi.UInt32:
    """
    Return `before` plus the hashes of events `first` … `end` - 1; the order of the events has no effect.

    The sum is hashed again to get the path class.
    """

    # A sum, so that the order of the events does not matter
    def add(k: mi.UInt32, total: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
        going = active & (k < end)
        return k + 1, total + dr.select(going, mixed_word(event(k, going) + 1), 0)

    begin = mi.UInt32(first), mi.UInt32(before)
    return dr.while_loop(begin, lambda k, _: active & (k < end), add, mode="symbolic", label="path class")[1]


def path_class_of(event: EventReader, length: mi.UInt32, start: StartRays, active: mi.Bool) -> mi.UInt32:
    """
    Return the path class, an integer below `PATH_CLASSES`: a hash of the events of a path.

    It does not depend on the order of the events, so that forward and backward rays come to the same class.

    Parameters
    ----------
    event : callable
        See `EventReader`.
    length : mi.UInt32
        Number of events, without the absorption at the end.
    start : StartRays
        Start rays; those that go on from within a tree hold the sum over the events before.
    active : mi.Bool
        Lanes that take part.
    """
    none = dr.zeros(mi.UInt32, dr.width(active))
    total = mixed_events(event, start.given("depth", none), length, start.given("path_class", none), active)
    return (total ^ (total >> 15)) % PATH_CLASSES


def scatters_done(word: mi.UInt32) -> list[mi.UInt32]:
    """Return a path's numbers of scatter events from its packed word: all, not aimed, and not at opaque surfaces."""
    return [(word >> shift) & COUNT_MASK for shift in (0, RANDOM_SHIFT, OPTICAL_SHIFT)]


def after_scatter(word: mi.UInt32, aim: mi.Bool, optical: mi.Bool, diffracted: mi.Bool) -> mi.UInt32:
    """
    Return the packed word of a path's scatter events, see `COUNT_MASK`, after one more event.

    `aim`, `optical` and `diffracted` say whether it was aimed, was not at an opaque surface, and was diffraction.
    """
    # One word holds all three counts, so that a node stores a single integer
    count = 1 + dr.select(aim, 0, 1 << RANDOM_SHIFT) + dr.select(optical, mi.UInt32(1 << OPTICAL_SHIFT), 0)
    # `AT_WALL` is of the last event only; `NOT_DIFFRACTED` stays once it is set
    word = ((word & ~mi.UInt32(AT_WALL)) + count) | dr.select(diffracted, 0, mi.UInt32(NOT_DIFFRACTED))
    return word | dr.select(optical, 0, mi.UInt32(AT_WALL))


def padded(lists: Sequence[Sequence[int] | np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return event lists as one array, padded with 0 at their ends, (p, k) uint32, and their lengths, (p,)."""
    lengths = np.array([len(one) for one in lists], dtype=np.int64)
    events = np.zeros((len(lists), int(lengths.max(initial=1))), dtype=np.uint32)
    for row, one in zip(events, lists, strict=True):
        row[: len(one)] = one
    return events, lengths


def host_keys(events: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """
    Return the 64-bit path key of each event list, computed on the host.

    Parameters
    ----------
    events : (p, k) uint32
        Event lists, padded at their ends.
    lengths : (p,) int
        Number of events of each.

    Returns
    -------
    (p,) uint64
        Keys, as `extend_key` yields them from `FIRST_KEY` and the events in turn.
    """
    keys = np.full(len(events), FIRST_KEY, dtype=np.uint64)
    for k in range(events.shape[1]):
        longer = (keys ^ (events[:, k].astype(np.uint64) + np.uint64(1))) * np.uint64(MULTIPLIER)
        keys = np.where(k < lengths, longer ^ (longer >> np.uint64(29)), keys)
    return keys


def joined_lists(*lists: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the union of sets of event lists, (p, k), their lengths, (p,), and the row in it of each given list."""
    longest = max(events.shape[1] for events, _ in lists)
    events = np.concatenate([np.pad(one, ((0, 0), (0, longest - one.shape[1]))) for one, _ in lists])
    lengths = np.concatenate([own for _, own in lists])
    _, chosen, place = np.unique(host_keys(events, lengths), return_index=True, return_inverse=True)
    return events[chosen], lengths[chosen], place
