"""Passes of a task whose sums stay separate, done by workers, with progress and lost workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from mistray.errors import UnfinishedError
from mistray.execute.workers import Task, Workers, do_parts

Name = TypeVar("Name")
Pass = TypeVar("Pass")


def passes_by_workers(
    workers: Workers, task: Task, passes: Mapping[Name, Pass], what: str, done: Callable[[Pass, Any], None]
) -> dict[Name, Any]:
    """
    Let workers do the passes of a task, and return the sums of each pass by its name, in the order of `passes`.

    Parameters
    ----------
    workers : Workers
    task : Task
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
    found: dict[Name, Any] = {}
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
