"""What a command does on Ctrl-C and SIGTERM, also where it is deep in a kernel or its compilation."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator

from mistray.cli.arguments import INTERRUPTED
from mistray.interrupts import SIGNALS, forget, note
from mistray.replace_file import remove_drafts

PATIENCE = 0.4  # s in which Python mostly comes to a signal by itself


@contextlib.contextmanager
def watched() -> Iterator[None]:
    """
    Treat SIGTERM as SIGINT, and remember both, see `mistray.interrupts`.

    While C++ code is at work Python's handlers wait. A thread of its own says so then, and at a second signal it ends
    the process.
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
