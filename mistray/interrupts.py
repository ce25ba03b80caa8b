"""
Handling of Ctrl-C and SIGTERM: signals are remembered, so that none is lost, and critical blocks end first.

Python handles a signal only between two bytecode steps. A kernel that runs or is compiled is one step of several
seconds, and C++ code that calls back may drop the exception. So the first signal is also recorded: `check` raises again
what was dropped, and a block of `later` may end first.
"""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

AGAIN = 0.3  # s within which signals are one: a terminal and a parent process send both
PATIENCE = 0.7  # s that a block of `later` has at most, where it asks `end_overdue`

_count = _held = _importing = 0
_first = math.inf  # when the first signal came
_last = -math.inf  # and the last one


def note(*_: Any) -> None:
    """Record a signal, and raise unless it is delayed: `importing` delays all signals, `later` only the first one.

    Signals less than `AGAIN` seconds apart count as one.

    Raises
    ------
    KeyboardInterrupt
        If the signal is not delayed.
    """
    global _count, _first, _last
    now = time.monotonic()
    if now - _last < AGAIN:
        return
    _count, _last = _count + 1, now
    _first = min(_first, now)
    if not _importing and (not _held or _count > 1):
        raise KeyboardInterrupt


def requested() -> bool:
    """True if a signal (Ctrl-C or SIGTERM) has arrived since the handler was installed or `forget` was called."""
    return _count > 0


def check() -> None:
    """
    Raise a recorded interrupt that got lost; do nothing within `later`, whose block polls by itself.

    Raises
    ------
    KeyboardInterrupt
        If a signal has come, outside `later`.
    """
    if _count and not _held:
        raise KeyboardInterrupt


def end_overdue() -> None:
    """
    Raise KeyboardInterrupt in a block of `later` whose signal has waited too long; its unfinished work is lost.

    Raises
    ------
    KeyboardInterrupt
        If a signal has waited for longer than `PATIENCE`.
    """
    if time.monotonic() - _first > PATIENCE:
        raise KeyboardInterrupt


def forget() -> None:
    """Forget all signals received so far."""
    global _count, _first, _last
    _count, _first, _last = 0, math.inf, -math.inf


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """
    Delay all signals of a command until a library is imported, because a half-imported one would abort the process.

    Raises
    ------
    KeyboardInterrupt
        If a signal has come; raised at the end of the block.
    """
    global _importing
    _importing += 1
    try:
        yield
    finally:
        _importing -= 1
    check()


@contextlib.contextmanager
def later() -> Iterator[None]:
    """
    Delay the first Ctrl-C within a block, which polls `requested` and ends when it can; a second one raises.

    If Python's own handler is installed, as in a script, ours replaces it within the block. Outside the main thread, or
    with the handler of another program, nothing changes.
    """
    global _held
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = signal.getsignal(signal.SIGINT) is note
    if not ours and signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # the handler of somebody else stays
        return
    if not ours:
        forget()
        signal.signal(signal.SIGINT, note)
    _held += 1
    try:
        yield
    finally:
        _held -= 1
        if not ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            if not _held:
                forget()
