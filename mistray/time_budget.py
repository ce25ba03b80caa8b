"""
A time budget that holds for all that is called in a block: every trace in it ends in time with the rays that it has.

It is asked where interrupts are asked, between two launches of the kernel or two passes. What has begun to count always
goes on to its first launch, so that there is a result.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from contextvars import ContextVar

from mistray.ranges import SECONDS

_end: ContextVar[float] = ContextVar("end", default=math.inf)  # by `time.perf_counter`


@contextlib.contextmanager
def within(seconds: float | None) -> Iterator[None]:
    """
    End what the block traces after a time; an end that has been set around it stays where it comes first.

    Parameters
    ----------
    seconds : float or None
        None: nothing changes.

    Raises
    ------
    MistrayError
        If it is no time.
    """
    end = math.inf if seconds is None else time.perf_counter() + SECONDS.check("seconds", seconds)
    before = _end.set(min(_end.get(), end))
    try:
        yield
    finally:
        _end.reset(before)


@contextlib.contextmanager
def share(part: float) -> Iterator[None]:
    """Give the block a part of the time that is left, 0 … 1."""
    now = time.perf_counter()
    before = _end.set(now + part * (_end.get() - now))
    try:
        yield
    finally:
        _end.reset(before)


def is_limited() -> bool:
    """Whether there is a budget."""
    return math.isfinite(_end.get())


def time_is_up() -> bool:
    """Whether it is used up; never where there is none."""
    return time.perf_counter() >= _end.get()
