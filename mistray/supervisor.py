"""
Parent process of a command, which ends the command at Ctrl-C or SIGTERM, whatever the command is doing.

Python handles a signal only between two bytecode steps, in any thread. While Mitsuba parses a scene and holds the
interpreter's lock, no signal is handled. So the command runs in a child, which is forked before anything large is
imported. The parent only waits: it passes signals on, and kills a child that does not end by itself. It costs a few
milliseconds and the memory of a bare interpreter. Without fork or `sigtimedwait` the command runs in the process that
was started, and Python handles the signals.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import time

SIGNALS = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 1.75  # s that a command has to end by itself, with what it has found so far
DAY = 86400.0  # s, the longest wait
INTERRUPTED = 130  # exit status of a command that a signal has ended; from outside it is 128 + the number of the signal


def heard() -> list[signal.Signals]:
    """
    Return the signals that end a command: SIGINT and SIGTERM.

    A signal that is ignored from the start, as Ctrl-C in a background job, is left out and stays ignored.
    """
    return [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]


def hold() -> None:
    """Block the signals of `heard` until `listen`; called when the package begins to load."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, heard())


def supervise() -> None:
    """
    Continue in a child process; the calling process waits for it and ends with its exit status.

    The child blocks the signals until `listen`, so that none arrives before its handler is installed. Where there is no
    fork or `sigtimedwait`, nothing is done.
    """
    if not hasattr(os, "fork") or not hasattr(signal, "sigtimedwait"):
        return
    numbers = heard()
    signal.pthread_sigmask(signal.SIG_BLOCK, [*numbers, signal.SIGCHLD])
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # ignored by whoever has started this, the exit status would be lost
    here = os.getpid()
    child = os.fork()
    if child:
        _wait(child, numbers)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])
    _end_with(here)


def listen() -> None:
    """Unblock SIGINT and SIGTERM in this process; called once their handlers are installed."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def _wait(child: int, numbers: list[signal.Signals]) -> None:
    """
    Wait for the child process, pass signals (`numbers`) on to it, and end this process with its exit status.

    A child still alive `PATIENCE` seconds after the first signal is killed.
    """
    first, until = None, math.inf
    while True:
        left = min(until - time.monotonic(), DAY)
        found = signal.sigtimedwait([*numbers, signal.SIGCHLD], max(left, 0.0))
        if found is None and first is None:
            continue
        if found is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            _interrupted(first)
        elif found.si_signo == signal.SIGCHLD:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                _end_as(os.waitstatus_to_exitcode(status), first)
        else:
            if first is None:
                first, until = found.si_signo, time.monotonic() + PATIENCE
            if found.si_code <= 0:  # from a process; a terminal, which is the kernel, has told the child as well
                os.kill(child, found.si_signo)


def _end_as(code: int, first: int | None) -> None:
    """
    End this process with the exit code of the child, or by the child's signal if the code is negative.

    If a signal `first` came before and interrupted or killed the child, the code is 128 plus the number of `first`.
    """
    if first is not None and code == INTERRUPTED:
        os._exit(128 + first)
    if code >= 0:
        os._exit(code)
    if first is not None:
        _interrupted(first)
    if -code != signal.SIGKILL:
        signal.signal(-code, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [-code])
    os.kill(os.getpid(), -code)
    os._exit(128 - code)


def _interrupted(first: int | None) -> None:
    """Print that the command was interrupted and exit with 128 plus the number of the signal `first`."""
    try:
        os.write(2, b"mistray: interrupted\n")
    finally:
        os._exit(128 + (first or 0))


def _end_with(parent: int) -> None:
    """
    Ask Linux to kill this process when its parent ends, even by SIGKILL; do nothing on other systems.

    If the parent has already ended, this process does too.
    """
    if sys.platform != "linux":
        return
    import ctypes

    ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))  # PR_SET_PDEATHSIG
    if os.getppid() != parent:  # it has ended before
        os._exit(INTERRUPTED)
