"""Progress bars and elapsed times that a terminal shows while a command is at work."""

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
    Show the elapsed time of a block without countable steps in a line on stderr; only on a terminal, after 1 s.

    Parameters
    ----------
    what : str
        Description of the work, such as "loading phone_camera".
    quiet : bool
        Whether to show no line.
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
    Show a tqdm bar on stderr within a block and yield it; yield None with --quiet, or if stderr is not a terminal.

    Set its ``n`` and its texts, then call ``refresh``. ``update`` draws nothing within 0.1 s of the last drawing, so a
    long step could be shown with the text of the step before it.

    Parameters
    ----------
    options : Namespace
        Arguments of the command, with ``quiet``.
    form : str
        Format of the bar, ``bar_format`` of tqdm.
    what : str
        Description of the work.
    total : float
        Value of ``n`` for a full bar.
    """
    if options.quiet or not _is_terminal():
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=what, total=total, bar_format=form, leave=False, file=sys.stderr, dynamic_ncols=True) as bar:
        yield bar


@contextlib.contextmanager
def progress_bar(options: argparse.Namespace) -> Iterator[Callable[[float, float], None] | None]:
    """
    Show a progress bar on a terminal within a block; yield the function (done, total) that advances it.

    With --quiet, or if stderr is not a terminal, yield None.
    """
    with terminal_bar(options, "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}") as bar:
        planned = 0.0

        def advance(done: float, total: float) -> None:
            nonlocal planned
            assert bar is not None
            bar.n = max(done / total, bar.n if total == planned else 0.0)
            planned = total
            bar.refresh()

        yield None if bar is None else advance
