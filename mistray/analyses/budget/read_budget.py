"""Read the requirements of a budget from TOML; every error message is one line with the file, the key and a remedy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mistray.analyses.budget.allocation import SCATTER, PowerCost, StepCost
from mistray.analyses.pst.metrics.by_name import FACTORIES, own_arguments
from mistray.errors import MistrayError
from mistray.metrics.metric import Metric
from mistray.ranges import FLAG, LEVEL, POSITIVE, Range, Words, check_fields
from mistray.toolkit.toml_section import TomlSection

FORM = 'ids of shapes or patterns, such as ["L*_front"]'


@dataclass(frozen=True)
class Requirement:
    """
    Section ``[[require]]``: a metric and the largest value that it may have.

    Attributes
    ----------
    metric : str
        A name in `mistray.analyses.pst.metrics.by_name.FACTORIES`.
    limit : float
        Largest value, in the unit of the metric, greater than 0.
    arguments : mapping
        Arguments of the function that makes the metric.
    """

    metric: str = Words(tuple(FACTORIES)).field()
    limit: float = POSITIVE.field()
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)

    def of(self, scene: Any) -> Metric:
        """Make the metric for a scene."""
        return FACTORIES[self.metric](scene, **self.arguments)


@dataclass(frozen=True)
class Grades:
    """
    Section ``[[choose]]``: a parameter of some surfaces that the budget may choose, with its range and cost.

    Attributes
    ----------
    surfaces : tuple of str
        Ids of shapes or patterns such as ``L*_front``.
    parameter : str
        One of `mistray.analyses.budget.allocation.SCATTER`.
    best, worst : float
        Smallest and largest value to choose from, in the unit of the parameter.
    cost : PowerCost or StepCost
        Cost of each surface.
    """

    surfaces: tuple[str, ...]
    cost: PowerCost | StepCost
    parameter: str = Words(SCATTER).field()
    best: float = POSITIVE.field()
    worst: float = POSITIVE.field()

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.best < self.worst and not isinstance(self.cost, StepCost):
            raise MistrayError(f"best is {self.best:g} and worst {self.worst:g}; the best is less than the worst")
        if self.parameter == "level":
            LEVEL.check("best", self.best)


@dataclass(frozen=True)
class BudgetStudy:
    """
    Requirements that a budget shall meet, parameters that it may choose, and settings of the search.

    Attributes
    ----------
    name : str
        File or other name, for messages.
    requirements : tuple of Requirement
    choices : tuple of Grades
    iterations : int
        Largest number of gradients of each metric, 1 … 20.
    sigmas : float
        Margin that is kept between a metric and its limit, in standard errors of the metric, 0 … 10.
    seeds : int
        Number of seeds of the verification, 2 … 100.
    shared : bool
        Surfaces that share a scatter model keep sharing it and get one value.
    """

    name: str
    requirements: tuple[Requirement, ...]
    choices: tuple[Grades, ...]
    iterations: int = Range(1, 20, whole=True).field(4)
    sigmas: float = Range(0.0, 10.0).field(2.0)
    seeds: int = Range(2, 100, whole=True).field(4)
    shared: bool = FLAG.field(False)

    def __post_init__(self) -> None:
        check_fields(self)


def read_budget(source: str | Path | Mapping[str, Any] | BudgetStudy) -> BudgetStudy:
    """
    Return a budget study read from a TOML file or from a mapping.

    Parameters
    ----------
    source : str, Path, mapping or BudgetStudy
        A TOML file or its content as a dictionary, see docs/sensitivity.md for the keys. A `BudgetStudy` is returned as
        it is.

    Raises
    ------
    MistrayError
        If the file is missing or not TOML, a key is unknown or missing, or a value is impossible.
    """
    if isinstance(source, BudgetStudy):
        return source
    section = TomlSection.of(source, "budget")
    section.known(("require", "choose", "traced", "solver"))
    traced = section.table("traced")
    requirements = tuple(_requirement(item, traced) for item in section.tables("require"))
    choices = tuple(_choice(item) for item in section.tables("choose"))
    for key, found in (("require", requirements), ("choose", choices)):
        if not found:
            raise section.fail(key, f"is missing; add at least one section [[{key}]]")
    solver = section.table("solver")
    solver.known(("iterations", "sigmas", "seeds", "shared"))
    return solver.make(
        BudgetStudy,
        name=section.title.removeprefix("budget ").strip("'"),
        requirements=requirements,
        choices=choices,
    )


def _requirement(section: TomlSection, traced: TomlSection) -> Requirement:
    factory = FACTORIES[section.value("metric", Words(tuple(FACTORIES)))]
    own = {key: value for key, value in section.content.items() if key not in ("metric", "limit")}
    arguments = {**traced.content, **own}
    needed = [key for key, is_needed in own_arguments(factory).items() if is_needed]
    for name in needed:
        if name not in arguments:
            raise section.fail(name, f"is missing; the metric '{factory.__name__}' needs {', '.join(needed)}")
    return section.make(
        Requirement, arguments={key: tuple(v) if isinstance(v, list) else v for key, v in arguments.items()}
    )


def _choice(section: TomlSection) -> Grades:
    section.known(("surfaces", "parameter", "best", "worst", "cost", "values", "costs"))
    section.value("parameter", Words(SCATTER))  # before what depends on it
    surfaces = section.content.get("surfaces")
    names = (surfaces,) if isinstance(surfaces, str) and surfaces else section.texts("surfaces", FORM)
    if "values" not in section and "costs" not in section:
        own = section.table("cost")
        own.known(PowerCost.__dataclass_fields__)
        return section.make(
            Grades, surfaces=names, cost=own.make(PowerCost, reference=section.value("worst", POSITIVE))
        )
    for key in ("best", "worst", "cost"):
        if key in section:
            raise section.fail(key, "stands beside a list of values, which has its own; remove it or the list")
    missing = [key for key in ("values", "costs") if key not in section]
    if missing:
        raise section.fail(missing[0], "is missing; values and their costs go together")
    cost = section.make(StepCost, values=section.numbers("values"), costs=section.numbers("costs"))
    return section.make(Grades, surfaces=names, cost=cost, best=cost.values[0], worst=cost.values[-1])
