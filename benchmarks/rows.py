"""One line of the table of `make bench`, the clock, and the check that both sides did the same work."""

from __future__ import annotations

import importlib.metadata
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mistray.errors import MistrayError

REPEATS = 5
SHORTEST = 1e-9  # s; a clock that did not move


@dataclass(frozen=True)
class Row:
    """
    What is compared and what came out.

    Attributes
    ----------
    key : str
        Stable name within its part: the kept record is searched for it.
    what : str
        What both sides do.
    ours, other : str
        Time, rate or size of each.
    ratio : float
        NaN: there is none, and `other` says why.
    bar : float or None
        What the ratio must reach, or stay below if `small`.
    equal : str
        The number that shows that both sides did the same work.
    series : mapping of str to sequence of float
        Points of a curve, for the figure.
    failed : bool
        The row could not be measured, for another reason than a program that is not installed.
    """

    key: str
    what: str
    ours: str
    other: str
    ratio: float
    bar: float | None = None
    small: bool = False
    equal: str = ""
    series: Mapping[str, Sequence[float]] = field(default_factory=dict)
    failed: bool = False

    @property
    def verdict(self) -> str:
        """The bar and whether it is reached."""
        if self.bar is None or math.isnan(self.ratio):
            return ""
        reached = self.ratio <= self.bar if self.small else self.ratio >= self.bar
        return f"{'≤' if self.small else '≥'} {self.bar:g} {'reached' if reached else 'NOT REACHED'}"

    def __str__(self) -> str:
        ratio = "" if math.isnan(self.ratio) else f"{self.ratio:.3g}" if self.ratio < 10 else f"{self.ratio:.1f}"
        return f"| {self.what} | {self.ours} | {self.other} | {ratio} | {self.verdict} | {self.equal} |"


class NotTheSameWorkError(MistrayError):
    """Both sides differ by more than they may: their times must not be compared."""


def agree(what: str, ours: ArrayLike, other: ArrayLike, tolerance: float) -> str:
    """
    Check that numbers of both sides are the same, and say how well.

    Parameters
    ----------
    what : str
        Name of the number, such as "ghost flux".
    ours, other : float or array_like
        Of the same shape.
    tolerance : float
        Largest difference, over the largest size of `other`.

    Returns
    -------
    str
        Cell of the table.

    Raises
    ------
    NotTheSameWorkError
    """
    here, there = np.broadcast_arrays(np.asarray(ours, dtype=float), np.asarray(other, dtype=float))
    size = float(np.max(np.abs(there), initial=0.0))
    differences = np.abs(here - there)
    worst = np.unravel_index(np.argmax(differences), differences.shape)
    difference = float(differences[worst]) / size if size > 0 else math.inf
    if not difference <= tolerance:  # NaN is no agreement either
        raise NotTheSameWorkError(
            f"not the same work: {what} {here[worst]:.9g} here and {there[worst]:.9g} there, difference "
            f"{difference:.2g}, allowed {tolerance:.2g}; no ratio is given"
        )
    return f"{what} to {difference:.1g}"


def measured(key: str, what: str, make: Callable[[], Row]) -> Row:
    """A row, or one that says that both sides did not do the same work, so that the rows after it are measured."""
    try:
        return make()
    except NotTheSameWorkError as error:
        return Row(key, what, "", str(error), math.nan, failed=True)


@dataclass(frozen=True)
class Timing:
    """Shortest wall time of an action, s, and the processor time of all threads over it."""

    seconds: float
    cores: float


def alternate(*actions: Callable[[], Any], repeats: int = REPEATS) -> list[Timing]:
    """
    Shortest wall time of each of several actions, run in turn; all are run once before, which compiles.

    Parameters
    ----------
    *actions : callable
        Without arguments; what they return is dropped.
    repeats : int
        Turns.

    Returns
    -------
    list of Timing
        One for each action.
    """
    for action in actions:
        action()
    best = [Timing(math.inf, 0.0)] * len(actions)
    for _ in range(repeats):
        for k, action in enumerate(actions):
            wall, cpu = time.perf_counter(), time.process_time()
            action()
            seconds = max(time.perf_counter() - wall, SHORTEST)
            if seconds < best[k].seconds:
                best[k] = Timing(seconds, (time.process_time() - cpu) / seconds)
    return best


def duration(timing: Timing) -> str:
    """Cell of the table: seconds and the cores that worked."""
    return f"{timing.seconds:.3g} s, {timing.cores:.1f} cores"


def missing(key: str, what: str, *packages: str, how: str = "") -> Row | None:
    """
    A row that names the packages that are not installed; None if all of them are.

    Parameters
    ----------
    key, what : str
        As in `Row`.
    *packages : str
        Names to import.
    how : str
        Command that installs them; default: pip with their names.
    """
    absent = [name for name in packages if find_spec(name) is None]
    if not absent:
        return None
    command = how or f"pip install {' '.join(absent)}"
    return Row(key, what, "", f"not measured: {', '.join(absent)} not installed ({command})", math.nan)


def version(package: str) -> str:
    """Name and version of an installed program."""
    return f"{package} {importlib.metadata.version(package)}"


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent of the power law through points, by least squares of the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
