"""
A time budget that holds for all that is called in a block: every trace in it ends in time with the rays that it has.

It is asked where interrupts are asked, between two launches of the kernel or two passes. What has begun to count always
goes on to its first launch, so that there is a result. Of many things that are done one after the other, see
`TimeShares`, those come to nothing for which there is no time: they are not begun, and the result names them.
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
    End what the block traces after a time; an end that has been set around it stays where it comes first.

    Parameters
    ----------
    seconds : float or None
        None: nothing changes.
    since : float, optional
        When they began to count, by `time.perf_counter`; by default now.

    Raises
    ------
    MistrayError
        If it is no time.
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


def left() -> float:
    """Return the time left of the budget, s; infinite where there is none, and below 0 where it is used up."""
    return _end.get() - time.perf_counter()


def time_is_up() -> bool:
    """Whether it is used up; never where there is none."""
    return left() <= 0


def can_draw() -> bool:
    """Whether there is time for one more figure of a report."""
    return left() >= FIGURE


def searched() -> float:
    """
    Share of its rays that a search may take which sets a trace up, 1/8 … 1, a power of 2; 1 without a budget.

    Such a search, as that for targets, takes seconds. With fewer rays its result is coarser, which costs accuracy of
    the trace, and no correctness.
    """
    return 2.0 ** math.floor(math.log2(min(max(left() / FULL, THINNEST), 1.0)))


def fewer_rays(rays: int) -> int:
    """Return a number of rays of a search, or the fewer that the time allows, see `searched`."""
    return math.ceil(searched() * rays)


class TimeShares:
    """
    Equal shares of the time that is left, for things that are done one after the other.

    What a thing takes beyond its share, such as the tables of a field, counts for those that come after it, and there
    is not one more for which the time is too short.

    Parameters
    ----------
    count : int
        Things to do.
    after : float
        What is to be done later for each thing, as a part of what it takes beyond its share.
    """

    def __init__(self, count: int, after: float = 0.0) -> None:
        self._count, self._after, self._done = count, after, 0
        self._beyond = 0.0  # s, of the last one

    def enough(self) -> bool:
        """Whether there is time for one more; always for the first."""
        return not self._done or self._left() >= LEAST + self._each

    @property
    def _each(self) -> float:
        return (1 + self._after) * self._beyond

    def _left(self) -> float:
        return left() - self._done * self._after * self._beyond

    @contextlib.contextmanager
    def one(self) -> Iterator[None]:
        """The block in which a thing is done, with its share of the time."""
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
    """Return things in an order whose every beginning is spread over all: ends first, then what halves the gaps."""
    last = len(things) - 1
    step = 1 << max(last, 1).bit_length()
    order: dict[int, None] = dict.fromkeys((0, last) if things else ())
    while step > 1:
        step //= 2
        order |= dict.fromkeys(range(0, last + 1, step))
    return [things[k] for k in order]


def not_traced(names: Sequence[str], count: int, what: str) -> str:
    """
    The sentence about what has not been traced, because the time was up.

    Parameters
    ----------
    names : sequence of str
        Of what has not been traced.
    count : int
        How many things were requested.
    what : str
        What they are, in the plural.
    """
    listed = f"{', '.join(names[:NAMED])}{', …' if len(names) > NAMED else ''}"
    return f"not traced, for the time was up: {len(names)} of {count} {what} ({listed})"
