"""Progress that a terminal shows while a command is at work."""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

FIRST_SECOND = 1.0  # s, after which what is still at work says so


def _is_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()  # None: closed from the start


@contextlib.contextmanager
def working(what: str, quiet: bool = False) -> Iterator[None]:
    """
    A line on stderr with the time that passes, for what has no steps to count; only on a terminal, after a second.

    Parameters
    ----------
    what : str
        What is done, such as "loading phone_camera".
    quiet : bool
        No line.
    """
    if quiet or not _is_terminal():
        yield
        return
    ended, began = threading.Event(), time.time()

    def show_time() -> None:
        if ended.wait(FIRST_SECOND):
            return
        from tqdm import tqdm

        with tqdm(desc=what, bar_format="{desc} … {elapsed}", leave=False, file=sys.stderr) as line:
            line.start_t = began
            while not ended.wait(FIRST_SECOND / 2):
                line.refresh()

    clock = threading.Thread(target=show_time, daemon=True)
    clock.start()
    try:
        yield
    finally:
        ended.set()
        clock.join()


@contextlib.contextmanager
def terminal_bar(
    options: argparse.Namespace, form: str, what: str = "tracing", total: float = 1.0
) -> Iterator[Any | None]:
    """
    A tqdm bar on stderr; None with --quiet, and where stderr is no terminal.

    Set its ``n`` and its texts, and let it ``refresh``: ``update`` draws nothing within 0.1 s of the time before, so
    that the step that takes long would stand under the text of the one before it.

    Parameters
    ----------
    options : Namespace
        Has ``quiet``.
    form : str
        What tqdm calls bar_format.
    what : str
        What is done.
    total : float
        ``n`` of a full bar.
    """
    if options.quiet or not _is_terminal():
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=what, total=total, bar_format=form, leave=False, file=sys.stderr, dynamic_ncols=True) as bar:
        yield bar


@contextlib.contextmanager
def progress_bar(options: argparse.Namespace) -> Iterator[Callable[[float, float], None] | None]:
    """A bar on stderr when that is a terminal: a function of what is done and what there is to do."""
    with terminal_bar(options, "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}") as bar:
        planned = 0.0

        def advance(done: float, total: float) -> None:
            nonlocal planned
            assert bar is not None
            bar.n = max(done / total, bar.n if total == planned else 0.0)
            planned = total
            bar.refresh()

        yield None if bar is None else advance
