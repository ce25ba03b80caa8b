"""Reads the requirements of a budget from TOML; every message is one line with the file, the key and the remedy."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mistray.optimize.metrics.by_name import FACTORIES
from mistray.optimize.metrics.metric import Metric
from mistray.optimize.tolerances.allocation import SCATTER, PowerCost, StepCost
from mistray.optimize.toml.section import Section
from mistray.renamed import old_names


@dataclass(frozen=True)
class Requirement:
    """
    One of the sections ``[[require]]``: a metric and what it may be at most.

    Attributes
    ----------
    metric : str
        A name in `mistray.optimize.metrics.by_name.FACTORIES`.
    limit : float
        In the unit of the metric, greater than 0.
    arguments : mapping
        Of the metric's function.
    """

    metric: str
    limit: float
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def of(self, scene: Any) -> Metric:
        """The metric of a scene."""
        return FACTORIES[self.metric](scene, **self.arguments)


@dataclass(frozen=True)
class Grades:
    """
    One of the sections ``[[choose]]``: what is to be chosen, and what it costs.

    Attributes
    ----------
    surfaces : tuple of str
        Ids of shapes or patterns such as ``L*_front``.
    parameter : str
        One of `mistray.optimize.tolerances.allocation.SCATTER`.
    best, worst : float
        Range; the best is the smallest.
    cost : PowerCost or StepCost
        Of each surface.
    """

    surfaces: tuple[str, ...]
    parameter: str
    best: float
    worst: float
    cost: PowerCost | StepCost


@dataclass(frozen=True)
class BudgetStudy:
    """
    What a budget shall meet, and by which means.

    Attributes
    ----------
    name : str
        File or other name, for messages.
    requirements : tuple of Requirement
    choices : tuple of Grades
    iterations : int
        Most gradients of each metric, 1 … 20.
    sigmas : float
        Standard errors of the metric that are left to its limit, 0 … 10.
    seeds : int
        Of the verification, 2 … 100.
    shared : bool
        Surfaces that share a model keep doing so and get one number.
    """

    name: str
    requirements: tuple[Requirement, ...]
    choices: tuple[Grades, ...]
    iterations: int = 4
    sigmas: float = 2.0
    seeds: int = 4
    shared: bool = False


def read_budget(source: str | Path | Mapping[str, Any] | BudgetStudy) -> BudgetStudy:
    """
    Read what a budget shall meet.

    Parameters
    ----------
    source : str, Path, mapping or BudgetStudy
        A TOML file or its content as a dictionary, see docs/sensitivity.md for the keys; a `BudgetStudy` is returned.

    Raises
    ------
    MistrayError
        If the file is missing or no TOML, a key is unknown or missing, or a value is impossible.
    """
    if isinstance(source, BudgetStudy):
        return source
    if isinstance(source, Mapping):
        return _study(Section("budget", "", source, Path()))
    return _study(Section.of_file(source, "budget"))


def _study(section: Section) -> BudgetStudy:
    section.known(("require", "choose", "traced", "solver"))
    traced = section.table("traced")
    requirements = tuple(_requirement(item, traced) for item in section.tables("require"))
    choices = tuple(_choice(item) for item in section.tables("choose"))
    for key, found in (("require", requirements), ("choose", choices)):
        if not found:
            raise section.fail(key, f"is missing; add at least one section [[{key}]]")
    solver = section.table("solver")
    solver.known(("iterations", "sigmas", "seeds", "shared"))
    return BudgetStudy(
        section.title.removeprefix("budget ").strip("'"),
        requirements,
        choices,
        solver.whole("iterations", BudgetStudy.iterations, 1, 20),
        solver.number("sigmas", BudgetStudy.sigmas, 0.0, 10.0),
        solver.whole("seeds", BudgetStudy.seeds, 2, 100),
        solver.flag("shared", BudgetStudy.shared),
    )


def _requirement(section: Section, traced: Section) -> Requirement:
    kind = section.choice("metric", None, tuple(FACTORIES))
    if "limit" not in section.content:
        raise section.fail("limit", "is missing; give the greatest value that the metric may have")
    limit = section.positive("limit", 1.0)
    names = old_names(FACTORIES[kind])
    own = {key: value for key, value in section.renamed(names).content.items() if key not in ("metric", "limit")}
    arguments = {**traced.renamed(names).content, **own}
    needed = [
        name
        for name, parameter in inspect.signature(FACTORIES[kind]).parameters.items()
        if parameter.default is inspect.Parameter.empty and parameter.kind is not inspect.Parameter.VAR_KEYWORD
    ]
    for name in needed[1:]:  # the first is the scene
        if name not in arguments:
            raise section.fail(name, f"is missing; the metric '{kind}' needs {', '.join(needed[1:])}")
    return Requirement(kind, limit, {key: tuple(v) if isinstance(v, list) else v for key, v in arguments.items()})


def _choice(section: Section) -> Grades:
    section.known(("surfaces", "parameter", "best", "worst", "cost", "values", "costs"))
    surfaces = section.content.get("surfaces")
    names = [surfaces] if isinstance(surfaces, str) else surfaces
    if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
        raise section.fail("surfaces", f'is {surfaces!r}; give ids of shapes or patterns, such as ["L*_front"]')
    parameter = section.choice("parameter", None, SCATTER)
    if "values" in section.content or "costs" in section.content:
        for key in ("best", "worst", "cost"):
            if key in section.content:
                raise section.fail(key, "stands beside a list of values, which has its own; remove it or the list")
        cost = _steps(section)
        return Grades(tuple(names), parameter, cost.values[0], cost.values[-1], cost)
    least = 1.0 if parameter == "level" else 0.0
    best, worst = (section.number(key, None, least, 1e9) for key in ("best", "worst"))
    if not 0 < best < worst:
        raise section.fail(
            "best", f"is {best:g} and worst {worst:g}; the best is greater than 0 and less than the worst"
        )
    own = section.table("cost")
    own.known(("weight", "reference", "exponent"))
    power = PowerCost(own.positive("weight", 1.0), own.positive("reference", worst), own.positive("exponent", 1.0))
    return Grades(tuple(names), parameter, best, worst, power)


def _steps(section: Section) -> StepCost:
    missing = [key for key in ("values", "costs") if key not in section.content]
    if missing:
        raise section.fail(missing[0], "is missing; values and their costs go together")
    values, costs = section.numbers("values"), section.numbers("costs")
    if len(values) != len(costs):
        raise section.fail("costs", f"has {len(costs)} entries for {len(values)} values; give one for each")
    least = 1.0 if section.content.get("parameter") == "level" else 0.0
    if any(a >= b for a, b in itertools.pairwise(values)) or not values[0] > 0 or values[0] < least:
        raise section.fail(
            "values", f"is {list(values)}; give ascending numbers{' from 1 on' if least else ' above 0'}"
        )
    if any(a < b for a, b in itertools.pairwise(costs)) or min(costs) < 0 or costs[0] == 0:
        raise section.fail("costs", f"is {list(costs)}; what is worse must not cost more, and no cost is negative")
    return StepCost(values, costs)
