"""Command line of mistray: it parses arguments, calls the functions of the package and prints their results."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from mistray.cli.signals import ignore, leave_at_once, watched
from mistray.interrupts import requested
from mistray.supervisor import INTERRUPTED, listen

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command with Ctrl-C and SIGTERM handled; return its exit code, see `mistray.cli.program.main`."""
    if argv is None:
        _open_closed()
    code = _run(argv)
    if argv is None and code == INTERRUPTED:
        leave_at_once(code)
    return code


def _open_closed() -> None:
    """
    Connect standard streams that are closed to the null device.

    Otherwise a file opened later would get the number of a closed stream, and libraries would print into it. Python
    prints on stdout what is meant for stderr if that is None.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - for as long as the process


def _run(argv: Sequence[str] | None) -> int:
    with watched(process_ends=argv is None):
        try:
            listen()
            from mistray.cli import program

            return program.main(argv)
        except (KeyboardInterrupt, Exception):  # C code makes a SystemError of an interrupt while a library is imported
            if not requested():
                raise
            ignore()
            print("mistray: interrupted, nothing was written", file=sys.stderr)
            return INTERRUPTED


def __dir__() -> list[str]:
    return sorted(__all__)
