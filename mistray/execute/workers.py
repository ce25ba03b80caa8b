"""
Interface of worker processes that compute parts of a task; `mistray.cluster` has those of a cluster.

Code whose work has independent parts asks `current_workers` and hands over a `Task`. The result of a part does not
depend on the worker and is used once, so that neither the number of workers nor their failures change a number.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import Any, Protocol

from mistray.errors import MistrayError, UnfinishedError


class Task(Protocol):
    """Interface of work with independent parts; its attributes can be pickled, or are scenes from `mistray.load`."""

    def make(self) -> Any:
        """Return the state that all parts need; each worker calls this before its first part."""

    def do(self, made: Any, part: Any) -> Any:
        """Compute one part and return its result, which can be pickled. `made` is the state from `make`."""


class Job(Protocol):
    """Interface of a running task: parts are submitted to workers, and their results returned."""

    def submit(self, part: Any) -> None:
        """Submit one more part, a hashable object, to the workers."""

    def result(self, part: Any) -> Any:
        """Wait for one submitted part and return its result, which the job then forgets."""

    def results(self) -> Iterator[tuple[Any, Any]]:
        """Yield each submitted part with its result, in the order in which parts finish."""


class Workers(Protocol):
    """
    Interface of a group of processes that do parts of tasks.

    All methods raise `mistray.errors.UnfinishedError` when no worker is left, and the `MistrayError` of a part that
    fails.
    """

    def count(self) -> int:
        """Return the current number of worker processes, at least 1."""

    def job(self, task: Task) -> contextlib.AbstractContextManager[Job]:
        """Begin a task whose `Job` the block gets; parts that are not done at the end of the block are cancelled."""


# A context variable, so that threads and nested blocks have workers of their own
_current: ContextVar[Workers | None] = ContextVar("workers", default=None)


def current_workers() -> Workers | None:
    """Return the workers of the enclosing `working_with` block; None outside such a block."""
    return _current.get()


def refuse_workers_in_time() -> None:
    """Raise `MistrayError` if workers are in use, as their parts cannot keep a time budget."""
    if current_workers() is not None:
        raise MistrayError("seconds is given and workers trace, whose parts are not timed; leave out one of the two")


@contextlib.contextmanager
def working_with(workers: Workers) -> Iterator[None]:
    """Use workers for all traces and other tasks inside the block."""
    before = _current.set(workers)
    try:
        yield
    finally:
        _current.reset(before)


@contextlib.contextmanager
def do_parts(workers: Workers, task: Task, parts: Sequence[Any]) -> Iterator[Iterator[tuple[Any, Any]]]:
    """
    Submit all parts of a task; the block gets an iterator of (part, result).

    Parts that are unfinished at the end of the block are cancelled.
    """
    with workers.job(task) as job:
        # All at once, so that no worker is idle while results are read
        for part in parts:
            job.submit(part)
        yield job.results()


def passes_by_workers(
    workers: Workers, task: Task, passes: Mapping[Any, Any], what: str, done: Callable[[Any, Any], None]
) -> dict[Any, Any]:
    """
    Let workers do the passes of a task, and return the sums of each pass by its name, in the order of `passes`.

    Parameters
    ----------
    workers : Workers
        Processes that do the work.
    task : Task
        Task whose passes are done.
    passes : mapping
        Passes by names, under which their sums are returned.
    what : str
        Plural noun for the passes, for messages.
    done : callable
        Called with each pass and its sums.

    Raises
    ------
    UnfinishedError
        If the workers are gone; ``partial`` has the sums of the passes that are finished.
    """
    found: dict[Any, Any] = {}
    names = {one: name for name, one in passes.items()}
    try:
        with do_parts(workers, task, list(passes.values())) as results:
            for one, sums in results:
                found[names[one]] = sums
                done(one, sums)
    except UnfinishedError as error:
        # The caller can continue with the finished passes
        error.partial = found
        error.args = (f"{error}; {len(found)} of {len(passes)} {what} are finished and kept",)
        raise
    return {name: found[name] for name in passes}
