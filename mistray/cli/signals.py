"""Response of a command to Ctrl-C and SIGTERM, even while a kernel runs or is compiled."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import socket
import sys
import threading
import time
from collections import namedtuple
from collections.abc import Iterator

from mistray.interrupts import AGAIN, forget, note, requested
from mistray.replace_file import remove_drafts
from mistray.supervisor import INTERRUPTED, SIGNALS, heard

PATIENCE = 0.4  # s in which Python mostly comes to a second signal by itself
MOST_PATIENCE = 1.5  # s that a command has to end after the first one; less than `mistray.supervisor.PATIENCE`

_telling = threading.Event()  # the command itself says that it is interrupted


def ignore() -> None:
    """Ignore further signals, as only the last line and the exit code of the command are left to give."""
    _telling.set()
    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            if signal.getsignal(number) is note:  # not the handler of somebody else, who calls commands from Python
                signal.signal(number, signal.SIG_IGN)
    # Python ends by SIGINT, whatever the exit code, if the last code that it compiled from text let an interrupt out,
    # as a dataclass or a named tuple does that is being made: so one is made that lets none out
    namedtuple("Nothing", ())


def leave_at_once(code: int) -> None:
    """
    End the process with an exit code, without Python's clean-up.

    A library that an interrupt has left half imported would abort during the clean-up ("the GIL is released"), so that
    the exit code would be lost.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or there is none
            stream.flush()
    os._exit(code)


@contextlib.contextmanager
def watched(process_ends: bool) -> Iterator[None]:
    """
    Handle SIGINT and SIGTERM alike within a block and record them; signals ignored before stay ignored.

    They may still be blocked, see `mistray.supervisor.listen`. Outside the main thread nothing is done.

    While C++ code runs, Python's handlers wait; a separate thread then ends the process.

    Parameters
    ----------
    process_ends : bool
        Whether the process ends with the command. Then one signal is enough to end it, otherwise two. After an
        interrupt further signals are ignored, since one during Python's shutdown would change the exit code.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    forget()
    _telling.clear()
    before = {number: signal.signal(number, note) for number in heard()}
    here, there = socket.socketpair()
    there.setblocking(False)
    old = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False)
    ended = threading.Event()
    watch = threading.Thread(target=_watch, args=(here, ended, MOST_PATIENCE if process_ends else None), daemon=True)
    watch.start()
    try:
        yield
    finally:
        ended.set()
        signal.set_wakeup_fd(old)
        if process_ends and requested():
            ignore()
        else:
            for number, handler in before.items():
                signal.signal(number, handler)
        there.close()
        watch.join()
        here.close()


def _watch(signals: socket.socket, ended: threading.Event, patience: float | None) -> None:
    """
    End the process after signals that the main thread does not handle in time; runs in a thread of its own.

    Parameters
    ----------
    signals : socket
        Socket to which Python writes the number of each signal.
    ended : Event
        Event that is set when the command ends.
    patience : float or None
        Time after the first signal at which the process is ended, s; None: one signal alone does not end it.
    """
    first = math.inf
    while True:
        now = time.monotonic()
        signals.settimeout(None if patience is None or first == math.inf else max(first + patience - now, 1e-3))
        try:
            numbers = signals.recv(16)
        except TimeoutError:
            break
        if not numbers:
            return
        if not any(number in SIGNALS for number in numbers):
            continue
        if first == math.inf:
            first = time.monotonic()
        elif time.monotonic() - first > AGAIN and not ended.wait(PATIENCE):
            break
    if not ended.is_set() and not _telling.is_set():
        remove_drafts()
        with contextlib.suppress(OSError):
            print("mistray: interrupted", file=sys.stderr, flush=True)
        os._exit(INTERRUPTED)
