"""Messages of a command that fails, or is interrupted, on the run that it has saved."""

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
    A file of a run that a later command goes on with, and what the command says of it.

    Parameters
    ----------
    path : Path or None
        None: nothing is saved.
    what : callable
        What is in it after an interrupt, with its verb.
    resumed : bool
        Whether it is there from the start.

    Attributes
    ----------
    code : int
        Exit status of the command: 130 after an interrupt.
    how : dict
        Keywords ``state`` and ``resume`` of the function whose run it is.
    """

    def __init__(self, path: Path | None, what: Callable[[], str], resumed: bool) -> None:
        self.path, self.what, self.resumed, self.code = path, what, resumed, 0
        self.how: dict[str, Any] = {"state": path, "resume": resumed}
        self._before = self._changed()

    @contextlib.contextmanager
    def reported(self) -> Iterator[None]:
        """Say of errors and interrupts of a block, once there is something to go on with, where that is."""
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
        """When the file was written last; None if there is none."""
        return self.path.stat().st_mtime_ns if self.path is not None and self.path.exists() else None
