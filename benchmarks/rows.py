"""One line of the table of `make bench`, and the clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

REPEATS = 5


@dataclass
class Row:
    """What is compared, both rates, the ratio and the bar (None: no bar); `small`: the ratio must stay below it."""

    what: str
    ours: str
    other: str
    ratio: float
    bar: float | None
    small: bool = False

    def __str__(self) -> str:
        verdict = ""
        if self.bar is not None:
            reached = self.ratio <= self.bar if self.small else self.ratio >= self.bar
            verdict = f"{'≤' if self.small else '≥'} {self.bar:g} {'reached' if reached else 'NOT REACHED'}"
        ratio = "" if np.isnan(self.ratio) else f"{self.ratio:.2f}"
        return f"| {self.what} | {self.ours} | {self.other} | {ratio} | {verdict} |"


def alternate(first: Callable[[], None], second: Callable[[], None]) -> tuple[float, float]:
    """Best wall time of each of two actions, run in turn; both are run once before."""
    first()
    second()
    best = [np.inf, np.inf]
    for _ in range(REPEATS):
        for k, action in enumerate((first, second)):
            start = time.perf_counter()
            action()
            best[k] = min(best[k], time.perf_counter() - start)
    return best[0], best[1]
