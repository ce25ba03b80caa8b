"""How many steps of a known number are done, and whether there is time for more."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from mistray.ranges import SECONDS

Progress = Callable[[float, float], None]


class Steps:
    """
    Counts steps; a call is one of them.

    Parameters
    ----------
    progress : callable or None
        Called after each step with what is done and what there is to do.
    total : int
    seconds : float or None
        Time for all of them from now on.
    """

    def __init__(self, progress: Progress | None, total: int, seconds: float | None = None) -> None:
        self._progress, self._total, self._done = progress, total, 0
        self._end = math.inf if seconds is None else time.perf_counter() + SECONDS.check("seconds", seconds)

    @property
    def limited(self) -> bool:
        """Whether the time is."""
        return math.isfinite(self._end)

    @property
    def left(self) -> float:
        """Time that is left, s; infinite where it is not limited."""
        return self._end - time.perf_counter()

    def __call__(self) -> None:
        """Count one step."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)
