"""Results that take seconds and depend on their arguments alone: computed once, and read from the cache on disk."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from mistray.cache.fingerprint import code_fingerprint, key_of
from mistray.cache.folder import open_cache
from mistray.cache.store import Cache
from mistray.errors import MistrayError

LOG = logging.getLogger("mistray.cache")
Found = TypeVar("Found")


def kept(
    facts: Mapping[str, Any], compute: Callable[[], Found], write: Callable[[Found], Any], read: Callable[[Any], Found]
) -> Found:
    """
    Return a result from the cache on disk, or compute it and store it there.

    The code is part of the key, so that a stored result equals a computed one. If the cache cannot be read or written,
    or its folder or size is not valid, the result is computed every time; the log reports that once in a process.

    Parameters
    ----------
    facts : mapping
        Kind of result, and everything that it depends on, as JSON values.
    compute : callable
        Function that computes the result.
    write : callable
        Function from the result to JSON values.
    read : callable
        Function from these back to the result; it raises ValueError, TypeError or KeyError for others.
    """
    try:
        given = open_cache()
    except MistrayError as error:
        _tell(str(error))
        return compute()
    if given is None:
        return compute()
    cache = _cache(given.folder, given.limit_bytes)
    key = key_of({**facts, "code": code_fingerprint()})
    found = cache.get(key, lambda content: read(json.loads(content)))
    if found is None:
        found = compute()
        cache.put(key, json.dumps(write(found)).encode())
    for problem in cache.problems:
        _tell(problem)
    return found


@lru_cache(maxsize=64)
def _tell(problem: str) -> None:
    """Report a problem in the log, once in a process."""
    LOG.warning(problem)


@lru_cache(maxsize=8)
def _cache(folder: Path, limit_bytes: int) -> Cache:
    """Return the disk cache in a folder, one object per process so that a folder that fails is not tried again."""
    return Cache(folder, limit_bytes)


def forget() -> None:
    """Forget which folders failed and which problems were reported, as in a new process; for tests."""
    _cache.cache_clear()
    _tell.cache_clear()
