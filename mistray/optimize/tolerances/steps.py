"""How many steps of a known number are done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, float], None]


class Steps:
    """
    Counts steps; a call is one of them.

    Parameters
    ----------
    progress : callable or None
        Called after each step with what is done and what there is to do.
    total : int
    """

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        """Count one step."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)
