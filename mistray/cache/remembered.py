"""Results that are kept in memory for later traces of the same scene, a bounded number of each kind."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TypeVar

MOST_KNOWN = 64  # results of a kind that are kept: a scene is traced at many fields and wavelengths
Key = TypeVar("Key", bound=Hashable)
Found = TypeVar("Found")


def remembered(known: dict[Key, Found], key: Key, search: Callable[[], Found]) -> Found:
    """Return the cached result of a search under its `key`, or search now; the cache keeps `MOST_KNOWN` results."""
    if key not in known:
        while len(known) >= MOST_KNOWN:
            known.pop(next(iter(known)))
        known[key] = search()
    return known[key]
