"""
Time budget for a block: every trace in it ends in time with the rays that it has.

The budget is checked where interrupts are checked, between two kernel launches or passes. A trace that has begun always
completes its first launch, so that there is a result. If several items are traced in sequence, see `TimeShares`, items
without time left are not begun, and the result names them.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from typing import TypeVar

from mistray.ranges import SECONDS

LEAST = 0.25  # s, the shortest share: a trace takes about as long whatever its rays
FULL = 64.0  # s: with as much left, or without a budget, a search that sets a trace up takes all of its rays
FIGURE = 2.0  # s, what a figure of a report takes
THINNEST = 1 / 8  # of them, however short the time is
NAMED = 6  # of what has not been traced, in a sentence

Thing = TypeVar("Thing")

_end: ContextVar[float] = ContextVar("end", default=math.inf)  # by `time.perf_counter`


@contextlib.contextmanager
def within(seconds: float | None, since: float | None = None) -> Iterator[None]:
    """
    End the traces of a block after a time; an earlier end set around the block takes precedence.

    Parameters
    ----------
    seconds : float or None
        Time budget, s; None changes nothing.
    since : float, optional
        Start of the budget, by `time.perf_counter`, s; by default now.

    Raises
    ------
    MistrayError
        If `seconds` is out of range.
    """
    began = time.perf_counter() if since is None else since
    end = math.inf if seconds is None else began + SECONDS.check("seconds", seconds)
    before = _end.set(min(_end.get(), end))
    try:
        yield
    finally:
        _end.reset(before)


@contextlib.contextmanager
def share(part: float) -> Iterator[None]:
    """Limit a block to a fraction, > 0 and ≤ 1, of the time that is left; not at all without a budget."""
    now = time.perf_counter()
    before = _end.set(now + part * (_end.get() - now))
    try:
        yield
    finally:
        _end.reset(before)


def is_limited() -> bool:
    """True if a time budget is set."""
    return math.isfinite(_end.get())


def left() -> float:
    """Return the remaining time of the budget, s; infinite without a budget, negative once it is used up."""
    return _end.get() - time.perf_counter()


def time_is_up() -> bool:
    """True if the time budget is used up; False without a budget."""
    return left() <= 0


def can_draw() -> bool:
    """True if the remaining time is enough for one more figure of a report."""
    return left() >= FIGURE


def searched() -> float:
    """
    Return the fraction of its rays that a search before a trace may use, by the time left.

    It is 1 from 64 s or without a budget, 1/2 from 32 s, 1/4 from 16 s, else 1/8.

    Such a search, for example for targets, takes seconds. With fewer rays its result is coarser. The trace is then less
    accurate, but still correct.
    """
    return 2.0 ** math.floor(math.log2(min(max(left() / FULL, THINNEST), 1.0)))


def fewer_rays(rays: int) -> int:
    """Return `rays` reduced to the number for a search before a trace when time is short, see `searched`."""
    return math.ceil(searched() * rays)


class TimeShares:
    """
    Equal shares of the remaining time, for items that are traced one after the other.

    Time that an item takes beyond its share, such as the tables of a field, is also reserved for later items. An item
    for which the time is too short is not begun.

    Parameters
    ----------
    count : int
        Number of items.
    after : float
        Later work for each item, as a fraction of the time that it takes beyond its share.
    """

    def __init__(self, count: int, after: float = 0.0) -> None:
        self._count, self._after, self._done = count, after, 0
        self._beyond = 0.0  # s, of the last one

    def enough(self) -> bool:
        """True if there is time for one more item; always True for the first."""
        return not self._done or self._left() >= LEAST + self._each

    @property
    def _each(self) -> float:
        return (1 + self._after) * self._beyond

    def _left(self) -> float:
        return left() - self._done * self._after * self._beyond

    @contextlib.contextmanager
    def one(self) -> Iterator[None]:
        """Limit a block, which traces one item, to its share of the time, at least 0.25 s, and to the whole budget."""
        began = time.perf_counter()
        seconds = max(self._left() / max(self._count - self._done, 1) - self._each, LEAST)
        before = _end.set(min(_end.get(), began + seconds))
        try:
            yield
        finally:
            _end.reset(before)
        self._done += 1
        self._beyond = max(time.perf_counter() - began - seconds, 0.0)


def coarse_first(things: Sequence[Thing]) -> list[Thing]:
    """Return items reordered to cover their range evenly from the start: the ends first, then midpoints of gaps."""
    last = len(things) - 1
    step = 1 << max(last, 1).bit_length()
    order: dict[int, None] = dict.fromkeys((0, last) if things else ())
    while step > 1:
        step //= 2
        order |= dict.fromkeys(range(0, last + 1, step))
    return [things[k] for k in order]


def not_traced(names: Sequence[str], count: int, what: str) -> str:
    """
    Return a sentence that says which items were not traced because the time was up.

    Parameters
    ----------
    names : sequence of str
        Names of the items that were not traced.
    count : int
        Number of requested items.
    what : str
        Kind of items, in the plural.
    """
    listed = f"{', '.join(names[:NAMED])}{', …' if len(names) > NAMED else ''}"
    return f"not traced, for the time was up: {len(names)} of {count} {what} ({listed})"
