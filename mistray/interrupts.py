"""
Ctrl-C and SIGTERM, remembered: what a library swallows is requested again, and what must not be torn apart ends first.

Python tells of a signal between two of its steps. A kernel that runs or is compiled is one step of several seconds, and
C++ code that calls back may drop the exception. So the first signal is noted as well: `check` raises what was dropped,
and a block of `later` is left at its own pace.
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
    """Handle a signal: remember it, and raise unless a block of `later` is to end first; the second one always raises.

    Raises
    ------
    KeyboardInterrupt
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
    """Whether a signal has come since the handler was put in place."""
    return _count > 0


def check() -> None:
    """
    Raise again what was dropped on its way; nothing within `later`, which tells by itself.

    Raises
    ------
    KeyboardInterrupt
    """
    if _count and not _held:
        raise KeyboardInterrupt


def end_overdue() -> None:
    """
    End a block of `later` that will not end soon by itself; what it has not finished is lost.

    Raises
    ------
    KeyboardInterrupt
        If a signal has waited for longer than `PATIENCE`.
    """
    if time.monotonic() - _first > PATIENCE:
        raise KeyboardInterrupt


def forget() -> None:
    """Begin anew: no signal has come."""
    global _count, _first, _last
    _count, _first, _last = 0, math.inf, -math.inf


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """
    Let signals of a command wait until a library is imported, however many: half imported it would abort the process.

    Raises
    ------
    KeyboardInterrupt
        At the end, if one has come.
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
    Let Ctrl-C wait, but not when pressed again: the block asks `requested` and ends when it can.

    Where Python's own handler is in place, as in a script, ours takes its place within the block. Elsewhere than in the
    main thread nothing changes.
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
