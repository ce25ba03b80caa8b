"""Passes of a task whose sums stay separate, done here or by workers, with time budget, progress and lost workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from mistray.errors import UnfinishedError
from mistray.execute.workers import Task, Workers, current_workers, do_parts
from mistray.time_budget import TimeShares, coarse_first, is_limited

Name = TypeVar("Name")
Pass = TypeVar("Pass")


def execute_passes(
    task: Task, passes: Mapping[Name, Pass], made: Any, what: str, done: Callable[[Pass, Any], None]
) -> dict[Name, Any]:
    """
    Do the passes of a task, here in their order, or by workers if there are any.

    Parameters
    ----------
    task : Task
    passes : mapping
        Passes by names, under which their sums are returned. Here each has an equal share of the remaining time. If a
        time budget is too short for all, those that are done are spread over all.
    made : object
        Result of `Task.make` in this process.
    what : str
        Plural noun for the passes, for messages.
    done : callable
        Called with each pass and its sums.

    Raises
    ------
    UnfinishedError
        If the workers are gone; ``partial`` has the sums of the passes that are finished.
    """
    workers = current_workers()
    if workers is not None:
        return passes_by_workers(workers, task, passes, what, done)
    # With a time budget coarse steps over all passes come first, so that those that are done are spread evenly
    found: dict[Name, Any] = {}
    shares = TimeShares(len(passes))
    for name in coarse_first(list(passes)) if is_limited() else passes:
        if not shares.enough():
            break
        with shares.one():
            found[name] = sums = task.do(made, passes[name])
        done(passes[name], sums)
    return {name: found[name] for name in passes if name in found}


def passes_by_workers(
    workers: Workers, task: Task, passes: Mapping[Name, Pass], what: str, done: Callable[[Pass, Any], None]
) -> dict[Name, Any]:
    """Let workers do the passes of a task, see `execute_passes`; return the sums in the order of the passes."""
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
