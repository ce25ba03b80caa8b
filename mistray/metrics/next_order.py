"""Comparison of a result with one measured with one more scatter event, or one more reflection, on each path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mistray.percent import percent_text
from mistray.settings import NO_LIMIT, Settings
from mistray.surfaces.surfaces import SurfaceTable

LIMITS = {"max_scatters": "scatter event", "max_reflections": "reflection"}
ERRORS = 2.0  # standard errors beyond which the change of a number is significant
MATTERS = 0.05  # relative change that matters


@dataclass(frozen=True, eq=False)
class NextOrder:
    """
    Results measured twice: with a limit on the number of events per path, and with the limit raised by one.

    Attributes
    ----------
    limit : {"max_scatters", "max_reflections"}
        Name of the limit.
    allowed : int
        Limit in the second measurement.
    names : tuple of str
        Names of the compared results.
    before, after : (n,) float64
        Values in the first and in the second measurement, each in its own unit.
    before_se, after_se : (n,) float64
        Standard errors of these values.
    difference_se : (n,) float64
        Standard error of `after` - `before`.
    taken : bool
        Whether the second measurement is the result.
    """

    limit: str
    allowed: int
    names: tuple[str, ...]
    before: np.ndarray
    before_se: np.ndarray
    after: np.ndarray
    after_se: np.ndarray
    difference_se: np.ndarray
    taken: bool = field(default=False)

    @property
    def change(self) -> np.ndarray:
        """Change of each result over the size of its first value, (n,); 0 if both are 0, inf if only the first is."""
        apart = self.after - self.before
        known = (self.before != 0) | (apart == 0)
        return np.where(known, apart / np.where(self.before == 0, 1.0, np.abs(self.before)), np.inf)

    @property
    def matters(self) -> bool:
        """
        True if any result changes by more than 5 % of its first value and by more than two standard errors.

        With many results the required number of errors is larger, so that a false alarm is as rare as for one.
        """
        return bool(np.any(self._significant))

    @property
    def worst(self) -> int:
        """Index of the result with the largest `change` of either sign, among the significant ones if there are any."""
        change = np.nan_to_num(np.abs(self.change), nan=-1.0, posinf=np.finfo(float).max)
        sure = self._significant
        return int(np.argmax(np.where(sure, change, -1.0) if sure.any() else change))

    @property
    def _significant(self) -> np.ndarray:
        from scipy.special import ndtr, ndtri  # scipy.stats takes 0.3 s to import

        count = max(int(np.count_nonzero(np.isfinite(self.after - self.before))), 1)
        errors = ERRORS if count == 1 else float(-ndtri(ndtr(-ERRORS) / count))
        apart = np.abs(self.after - self.before)
        return (apart > errors * self.difference_se) & (apart > MATTERS * np.abs(self.before))

    @property
    def sentence(self) -> str:
        """Finding in one sentence: the result that changes most, its two values, and the difference with its error."""
        k = self.worst
        second, first = (
            f"{value:.3g} ± {percent_text(se / abs(value), 1) if value else f'{se:.1g}'}"
            for value, se in ((self.after[k], self.after_se[k]), (self.before[k], self.before_se[k]))
        )
        apart = f"{self.after[k] - self.before[k]:+.2g} ± {self.difference_se[k]:.1g}"
        event = f"One more {LIMITS[self.limit]} ({self.limit} {self.allowed})"
        text = f"{event}: {self.names[k]} is {second} instead of {first}, difference {apart}"
        if self.taken:
            return f"{text}; the numbers shown are those with {self.limit} {self.allowed}."
        if self.matters:
            return f"{text}; the numbers shown are those of the other limit, which changes more."
        return f"{text}; no number changes by more than {100 * MATTERS:g} % for certain."

    def record(self) -> dict[str, Any]:
        """Return the comparison's fields as JSON-serialisable values, one row per result."""
        numbers = ("before", "before_se", "after", "after_se", "difference_se")
        rows = [
            {"name": name, **{key: float(getattr(self, key)[k]) for key in numbers}}
            for k, name in enumerate(self.names)
        ]
        return {"limit": self.limit, "allowed": self.allowed, "taken": self.taken, "numbers": rows}


def decided(orders: Sequence[NextOrder]) -> tuple[NextOrder, ...]:
    """
    Return the comparisons, at most one of them marked as `taken`.

    It is the one with the largest relative change among those with a significant change.
    """
    mattering = [order for order in orders if order.matters]
    most = max(mattering, key=lambda order: abs(float(order.change[order.worst])), default=None)
    return tuple(replace(order, taken=order is most) for order in orders)


def next_limits(settings: Settings, table: SurfaceTable) -> dict[str, int]:
    """
    Return the limits that can be raised, by name, with their raised values.

    A limit of 0 excludes light on purpose and is not raised; nor is `NO_LIMIT`. Scatter events need scatter in the
    scene.

    Parameters
    ----------
    settings : Settings
        Settings of the first measurement.
    table : SurfaceTable
        Surfaces of the scene.
    """
    scatters = table.optics.scatters or any(interface.scatter for interface in table.interfaces)
    usable = {"max_scatters": scatters, "max_reflections": True}
    now = {limit: int(getattr(settings, limit)) for limit, useful in usable.items() if useful}
    return {limit: value + 1 for limit, value in now.items() if 0 < value < NO_LIMIT}
