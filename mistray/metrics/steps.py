"""Counter of the steps of a task that reports progress and tells the time left."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from mistray.ranges import SECONDS

Progress = Callable[[float, float], None]


class Steps:
    """
    Counter of the steps of a task; each call counts one step.

    Parameters
    ----------
    progress : callable or None
        Called after each step with the number of steps done and the number of all; None: no reports.
    total : int
        Number of all steps.
    seconds : float or None
        Time for all steps from now on, s; None: it is not limited.

    Raises
    ------
    MistrayError
        If `seconds` is out of range.
    """

    def __init__(self, progress: Progress | None, total: int, seconds: float | None = None) -> None:
        self._progress, self._total, self._done = progress, total, 0
        self._end = math.inf if seconds is None else time.perf_counter() + SECONDS.check("seconds", seconds)

    @property
    def limited(self) -> bool:
        """True if the time is limited."""
        return math.isfinite(self._end)

    @property
    def left(self) -> float:
        """Time left, s; negative after its end, infinite if it is not limited."""
        return self._end - time.perf_counter()

    def __call__(self) -> None:
        """Count one step as done, and report the progress."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)
