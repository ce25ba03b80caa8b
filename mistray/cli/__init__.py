"""The command line: parses, calls the functions of the package, prints."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from mistray.cli.signals import ignore, leave_at_once, watched
from mistray.interrupts import requested
from mistray.supervisor import INTERRUPTED, listen

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command, see `mistray.cli.program.main`, from the first moment on with a handler of Ctrl-C."""
    code = _run(argv)
    if argv is None and code == INTERRUPTED:
        leave_at_once(code)
    return code


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
