"""Reader of the requirements of a budget in TOML; every error message is one line with file, key and remedy."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

from mistray.analyses.budget.allocation import SCATTER, PowerCost, StepCost
from mistray.analyses.pst.metrics.by_name import FACTORIES, SETTINGS, own_arguments
from mistray.errors import MistrayError
from mistray.metrics.metric import Metric
from mistray.ranges import FLAG, LEVEL, POSITIVE, TEXT, OfType, Range, Several, Words
from mistray.toolkit.fields import Request, field
from mistray.toolkit.toml_section import TomlSection, keys_of

FORM = 'ids of shapes or patterns, such as ["L*_front"]'


@dataclass(frozen=True)
class Requirement(Request):
    """Section ``[[require]]`` of a budget file: a metric and its upper limit, in the unit of the metric."""

    metric: str = field(Words(tuple(FACTORIES)), MISSING, "metric, one of those of `mistray sensitivity` or `pst_mask`")
    limit: float = field(POSITIVE, MISSING, "largest value that meets it, in the unit of the metric")
    arguments: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # of the metric's function

    def made(self, scene: Any) -> Metric:
        """Return the metric of this requirement for a scene."""
        return FACTORIES[self.metric](scene, **self.arguments)


@dataclass(frozen=True)
class Grades(Request):
    """
    Section ``[[choose]]`` of a budget file: surfaces, the parameter to be chosen on each, its range and its cost.

    `best` and `worst` are in the unit of the parameter; `best`, the smaller one, scatters least.
    """

    surfaces: tuple[str, ...] = field(
        Several(TEXT), MISSING, "ids of shapes, or patterns such as `L*_front`; each surface gets a number of its own"
    )
    cost: PowerCost | StepCost = field(
        OfType(object, "must be a table of weight, reference and exponent"),
        MISSING,
        "cost of each surface, weight · (reference/value)^exponent",
    )
    parameter: str = field(Words(SCATTER), MISSING, f"value of their scatter model: {', '.join(SCATTER)}")
    best: float = field(POSITIVE, MISSING, "best value that can be chosen, the smallest")
    worst: float = field(POSITIVE, MISSING, "worst value that can be chosen; the scatter model must allow it")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.best < self.worst and not isinstance(self.cost, StepCost):
            raise MistrayError(f"best is {self.best:g} and worst {self.worst:g}; the best is less than the worst")
        if self.parameter == "level":
            LEVEL.check("best", self.best)


@dataclass(frozen=True)
class BudgetStudy(Request):
    """
    Requirements that a budget shall meet, and the means to do so.

    `name` is that of the file, or "budget" without one, for messages; the other fields are its sections and keys.
    """

    name: str
    requirements: tuple[Requirement, ...]
    choices: tuple[Grades, ...]
    iterations: int = field(Range(1, 20, whole=True), 4, "most gradients of each metric")
    sigmas: float = field(
        Range(0.0, 10.0), 2.0, "standard errors of the metric that are left to the limit, where there is room for them"
    )
    seeds: int = field(Range(2, 100, whole=True), 4, "seeds of the measurement at the end, before and after")
    shared: bool = field(FLAG, False, "surfaces that share a scatter model keep sharing it, and get one number")


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
    solver.known(keys_of(BudgetStudy))
    name = section.title.removeprefix("budget ").strip("'")
    return solver.make(BudgetStudy, {"name": name, "requirements": requirements, "choices": choices})


def _requirement(section: TomlSection, traced: TomlSection) -> Requirement:
    factory = FACTORIES[section.value("metric", Words(tuple(FACTORIES)))]
    own = {key: value for key, value in section.content.items() if key not in keys_of(Requirement)}
    for table in (section, traced):
        for key in filter(SETTINGS.get, table.content):
            table.value(key, SETTINGS[key])  # refused here, by its place
    # Weights belong to the wavelengths beside them
    shared = {key: value for key, value in traced.content.items() if key != "weights" or "wavelength_nm" not in own}
    arguments = {**shared, **own}
    needed = [key for key, is_needed in own_arguments(factory).items() if is_needed]
    for name in needed:
        if name not in arguments:
            raise section.fail(name, f"is missing; the metric '{factory.__name__}' needs {', '.join(needed)}")
    known = {key: tuple(value) if isinstance(value, list) else value for key, value in arguments.items()}
    return section.make(Requirement, {"arguments": known})


def _choice(section: TomlSection) -> Grades:
    section.known((*keys_of(Grades), *keys_of(StepCost)))
    section.value("parameter", Words(SCATTER))  # before what depends on it
    surfaces = section.content.get("surfaces")
    names = (surfaces,) if isinstance(surfaces, str) and surfaces else section.texts("surfaces", FORM)
    if "values" not in section and "costs" not in section:
        cost = section.table("cost").make(PowerCost, reference=section.value("worst", POSITIVE))
        return section.make(Grades, {"surfaces": names, "cost": cost})
    for key in ("best", "worst", "cost"):
        if key in section:
            raise section.fail(key, "stands beside a list of values, which has its own; remove it or the list")
    missing = [key for key in keys_of(StepCost) if key not in section]
    if missing:
        raise section.fail(missing[0], "is missing; values and their costs go together")
    steps = section.make(StepCost, {key: section.numbers(key) for key in keys_of(StepCost)})
    ends = {"best": steps.values[0], "worst": steps.values[-1]}
    return section.make(Grades, {"surfaces": names, "cost": steps, **ends})
