"""Result of a budget: chosen values, and requirements before and after the choice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from mistray.analyses.budget.read_budget import BudgetStudy
from mistray.estimate import Estimate
from mistray.result import KeyNumber, Result
from mistray.scene.unshared import SceneText
from mistray.toolkit.rows import column, derived


@dataclass(frozen=True)
class Chosen:
    """
    Roughness, cleanliness level or amplitude of a surface, as the budget has chosen it.

    `before` and `after` are its values, `best` and `worst` the ends of its range, all in `unit`; the costs are those of
    both values. `shares_before` and `shares_after` are the fractions, 0 … 1, of each metric that its scatter makes, by
    the first gradient and by the model of the last one at the values chosen.
    """

    shares_before: tuple[float, ...]
    shares_after: tuple[float, ...]
    surfaces: tuple[str, ...] = column("surfaces that have it", head="surface", between=", ")
    key: str = column("its key in the scene")
    parameter: str = column("name of the parameter", head="number")
    unit: str = column("unit of its values")
    before: float = column("value before")
    after: float = column("value after")
    best: float = column("best that could be chosen")
    worst: float = column("worst that could be chosen")
    cost_before: float = column("cost of the value before", head="cost [before]", digits=".3g")
    cost_after: float = column("cost of the value after", head="cost [after]", digits=".3g")

    @property
    def at_bound(self) -> bool:
        """True if the chosen value lies at the best or worst end of its range, to within 1e-4."""
        return min(abs(self.after / bound - 1) for bound in (self.best, self.worst)) < 1e-4


@dataclass(frozen=True)
class Met:
    """Requirement with its metric before and after the budget, measured on seeds that the search has not used."""

    requirement: str = column("metric that is limited")
    unit: str = column("its unit")
    limit: float = column("largest value that meets it", digits=".5g")
    before: Estimate = column("value before")
    after: Estimate = column("value after")

    @derived.column("whether the number after is at most the limit")
    def met(self) -> bool:
        """True if the metric after the budget is at most the limit."""
        return self.after.value <= self.limit

    @property
    def distance(self) -> float:
        """
        Limit minus metric after the budget, in standard errors; negative if the limit is exceeded.

        It is ±∞ if the metric has no error.
        """
        room = self.limit - self.after.value
        return room / self.after.se if self.after.se > 0 else math.copysign(math.inf, room)


@dataclass(frozen=True, repr=False)
class Budget(Result, table=".page:numbers_table", figure=".figures:budget_figure"):
    """
    Result of `budget`: chosen values of parameters, and the requirements before and after.

    Attributes
    ----------
    study : BudgetStudy
        Requirements and choices of the budget.
    source : Path
        The scene file.
    chosen : tuple of Chosen
        Chosen values in the order of the scene.
    requirements : tuple of Met
        Requirements with their metrics before and after.
    gradients : int
        Number of gradients of each metric.
    left_out : tuple of str
        Effects that the gradients leave out.
    seconds : float
        Duration, s.

    Examples
    --------
    >>> study = {
    ...     "require": [{"metric": "pst_bin", "field_deg": 30, "limit": 2.6e-3}],
    ...     "choose": [{"surfaces": "plate_*", "parameter": "A", "best": 1e-5, "worst": 1e-2, "cost": {"weight": 1}}],
    ...     "traced": {"rays": 10_000},
    ... }
    >>> (met,) = mistray.optimize.budget("plate_and_wall", study).requirements
    >>> print(f"{met.requirement}: {met.before.value:.1e}, afterwards {met.after.value:.1e}; limit {met.limit:.1e}")
    PST at 30°: 2.9e-03, afterwards 2.5e-03; limit 2.6e-03
    """

    study: BudgetStudy
    source: Path
    chosen: tuple[Chosen, ...]
    requirements: tuple[Met, ...]
    gradients: int
    left_out: tuple[str, ...]
    seconds: float

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return whether all requirements are met, metrics after, and total costs before and after, by label."""
        before, after = self.cost
        metrics = {f"{item.requirement} [{item.unit}]": item.after for item in self.requirements}
        verdict = "met" if self.holds else "NOT met"
        return {"requirements": verdict, **metrics, "cost before": before, "cost after": after}

    @property
    def holds(self) -> bool:
        """True if all requirements are met."""
        return all(item.met for item in self.requirements)

    @property
    def cost(self) -> tuple[float, float]:
        """Total cost of all chosen values before and after, in the unit of the cost weights."""
        return sum(c.cost_before for c in self.chosen), sum(c.cost_after for c in self.chosen)

    def scene_text(self, folder: str | Path) -> str:
        """Return the text of a scene file for `folder` in which the chosen scatter values are set."""
        file = SceneText(self.source, own=not self.study.shared)
        for item in self.chosen:
            file.set(item.key, item.after)
        return file.text(folder)
