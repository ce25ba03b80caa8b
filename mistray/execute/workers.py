"""Other processes that can do parts of a piece of work; `mistray.cluster` has those of a cluster.

Whoever has work that falls into parts asks `current_workers` and hands a `Task` over. A part is done the same whoever
does it, and its result is taken once, so that the number of workers, and workers that die, do not change a number.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from typing import Any, Protocol

from mistray.errors import MistrayError


class Task(Protocol):
    """Work that falls into parts; what it holds can be pickled, or is a scene from `mistray.load`: that travels too."""

    def make(self) -> Any:
        """What all parts need; made once by each worker."""

    def do(self, made: Any, part: Any) -> Any:
        """The result of one part, picklable."""


class Job(Protocol):
    """Parts of one task that have been handed over."""

    def submit(self, part: Any) -> None:
        """Hand over one more part, hashable."""

    def result(self, part: Any) -> Any:
        """Wait for a part that has been handed over, and take its result; it is forgotten here then."""

    def results(self) -> Iterator[tuple[Any, Any]]:
        """All parts that have been handed over with their results, as they come."""


class Workers(Protocol):
    """
    Processes that do parts of tasks.

    All of it raises `mistray.errors.UnfinishedError` when there is nobody left to do the work, and the `MistrayError`
    of a part that fails.
    """

    def count(self) -> int:
        """How many there are now, at least 1."""

    def job(self, task: Task) -> contextlib.AbstractContextManager[Job]:
        """Begin a task; parts that are not done at the end of the block are called off."""


_current: ContextVar[Workers | None] = ContextVar("workers", default=None)


def current_workers() -> Workers | None:
    """The workers of the block that we are in, None outside of one."""
    return _current.get()


def refuse_workers_in_time() -> None:
    """Refuse a time budget where workers trace, before anything is timed."""
    if current_workers() is not None:
        raise MistrayError("seconds is given and workers trace, whose parts are not timed; leave out one of the two")


@contextlib.contextmanager
def working_with(workers: Workers) -> Iterator[None]:
    """Let traces and the like of the block go through workers."""
    before = _current.set(workers)
    try:
        yield
    finally:
        _current.reset(before)


@contextlib.contextmanager
def do_parts(workers: Workers, task: Task, parts: Sequence[Any]) -> Iterator[Iterator[tuple[Any, Any]]]:
    """All parts of a task with their results, as they come; at the end of the block the others are called off."""
    with workers.job(task) as job:
        for part in parts:
            job.submit(part)
        yield job.results()
