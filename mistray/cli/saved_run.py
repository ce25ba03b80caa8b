"""Messages of a command that fails or is interrupted, which say where its run is saved."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mistray.cli.signals import ignore
from mistray.errors import MistrayError
from mistray.supervisor import INTERRUPTED


class SavedRun:
    """
    File in which a run is saved, so that a later command can continue it with --resume.

    Parameters
    ----------
    path : Path or None
        File; None if nothing is saved.
    what : callable
        Function that returns the contents of the file with a verb for the message, e.g. "what is finished is".
    resumed : bool
        Whether the command has continued a saved run, so that the file exists from the start.

    Attributes
    ----------
    code : int
        Exit status of the command: 130 after an interrupt.
    """

    def __init__(self, path: Path | None, what: Callable[[], str], resumed: bool) -> None:
        self.path, self.what, self.resumed, self.code = path, what, resumed, 0
        self._before = self._changed()

    @property
    def how(self) -> dict[str, Any]:
        """Arguments ``state`` and ``resume`` for the function that computes the run, by name."""
        return {"state": self.path, "resume": self.resumed}

    @contextlib.contextmanager
    def reported(self) -> Iterator[None]:
        """
        Report errors and interrupts in a block.

        If the file has changed, errors say how to continue; so does a line on stderr after an interrupt, which sets
        `code` and is not raised again. An interrupt of a resumed run counts as if the file had changed.

        Raises
        ------
        MistrayError, KeyboardInterrupt
            Errors of the block; an interrupt if nothing is saved.
        """
        try:
            yield
        except (KeyboardInterrupt, MistrayError) as error:
            new = self._changed() != self._before
            if not new and (isinstance(error, MistrayError) or not self.resumed):
                raise
            if isinstance(error, MistrayError):  # perhaps that the last part of it cannot be saved
                error.args = (f"{error}; what was saved is in {self.path}, go on with --resume", *error.args[1:])
                raise
            ignore()
            print(f"mistray: interrupted; {self.what()} in {self.path}, go on with --resume", file=sys.stderr)
            self.code = INTERRUPTED

    def _changed(self) -> int | None:
        """Return the time at which the file was last written, ns; None if there is no file."""
        return self.path.stat().st_mtime_ns if self.path is not None and self.path.exists() else None
