"""What a command does on Ctrl-C and SIGTERM, also where it is deep in a kernel or its compilation."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
from collections import namedtuple
from collections.abc import Iterator

from mistray.cli.arguments import INTERRUPTED
from mistray.interrupts import SIGNALS, forget, note, requested
from mistray.replace_file import remove_drafts

PATIENCE = 0.4  # s in which Python mostly comes to a signal by itself


def ignore() -> None:
    """Ignore what else comes: the command has ended, and only its last line and its exit code are left."""
    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            if signal.getsignal(number) is note:  # not the handler of somebody else, who calls commands from Python
                signal.signal(number, signal.SIG_IGN)
    # Python ends by SIGINT, whatever the exit code, if the last code that it compiled from text let an interrupt out,
    # as a dataclass or a named tuple does that is being made: so one is made that lets none out
    namedtuple("Nothing", ())


def leave_at_once(code: int) -> None:
    """
    End the process without what Python does at its end.

    A library that an interrupt has left half imported aborts there ("the GIL is released"), which takes the place of
    the exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or there is none
            stream.flush()
    os._exit(code)


@contextlib.contextmanager
def watched(process_ends: bool) -> Iterator[None]:
    """
    Treat SIGTERM as SIGINT, and remember both, see `mistray.interrupts`.

    While C++ code is at work Python's handlers wait. A thread of its own says so then, and at a second signal it ends
    the process.

    Parameters
    ----------
    process_ends : bool
        Whether the process ends with the command. After an interrupt its signals are ignored then, since one that
        comes while Python shuts down would take the exit code's place.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    forget()
    before = {number: signal.signal(number, note) for number in SIGNALS}
    here, there = socket.socketpair()
    there.setblocking(False)
    old = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False)
    ended = threading.Event()
    watch = threading.Thread(target=_watch, args=(here, ended), daemon=True)
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


def _watch(signals: socket.socket, ended: threading.Event) -> None:
    """Read the numbers of signals as they come, whatever the main thread does."""
    count = 0
    while numbers := signals.recv(16):
        for number in numbers:
            count += number in SIGNALS
        if not count or ended.wait(PATIENCE):
            continue
        if count == 1:
            _say("interrupted; what is under way ends first, or press Ctrl-C again to end at once")
        else:
            _say("interrupted")
            remove_drafts()
            os._exit(INTERRUPTED)


def _say(what: str) -> None:
    with contextlib.suppress(OSError):
        print(f"mistray: {what}", file=sys.stderr, flush=True)
