"""Budget of roughness and cleanliness: how smooth and clean surfaces must be to meet limits at the least cost."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.budget.allocation import Model, ToleranceChoice, allocate, excess
from mistray.analyses.budget.read_budget import BudgetStudy, Grades, read_budget
from mistray.analyses.budget.result import Budget, Chosen, Met
from mistray.errors import MistrayError, errors_of
from mistray.estimate import Estimate
from mistray.ids import fits
from mistray.metrics.gradient import gradient
from mistray.metrics.metric import Metric
from mistray.metrics.parameters import Parameter, parameters
from mistray.metrics.scene_values import assign
from mistray.metrics.steps import Progress, Steps
from mistray.notes import warns
from mistray.percent import percent_text
from mistray.physics.contamination import CLEANED_SLOPE
from mistray.scene.load import find, load_text
from mistray.scene.titles import scene_name
from mistray.scene.unshared import SceneText

SETTLED = 0.02  # relative change of all numbers below which they count as found


@warns
def budget(
    scene: str | Path, study: str | Path | Mapping[str, Any] | BudgetStudy, *, progress: Progress | None = None
) -> Budget:
    """
    Allocate cleanliness and roughness to the surfaces of a scene so that metrics meet their limits at the least cost.

    To first order in scatter a metric is a sum of what single surfaces scatter. The gradient gives each part, the
    convex problem of `mistray.analyses.budget.allocation` the values, and fresh gradients there correct what is
    not of first order. The result is measured on other seeds.

    Parameters
    ----------
    scene : str or Path
        Scene XML file or name of a shipped scene.
    study : str, Path, mapping or BudgetStudy
        Study of a budget, or its TOML file or content, see docs/sensitivity.md.
    progress : callable, optional
        Called with the work done so far and the total work.

    Returns
    -------
    Budget

    Raises
    ------
    MistrayError
        If the study or the scene cannot be used, or a metric exceeds its limit with all values at their best; the
        message says by how much. If the iterations end before this is measured, `Budget.holds` is False instead.

    Examples
    --------
    >>> study = {
    ...     "require": [{"metric": "pst_bin", "field_deg": 30, "limit": 2.6e-3}],
    ...     "choose": [{"surfaces": "plate_*", "parameter": "A", "best": 1e-5, "worst": 1e-2, "cost": {"weight": 1}}],
    ...     "traced": {"rays": 10_000},
    ... }
    >>> found = mistray.optimize.budget("plate_and_wall", study)
    >>> found.holds
    True
    >>> [surface for chosen in found.chosen for surface in chosen.surfaces]
    ['plate_front', 'plate_rear']
    """
    began = time.perf_counter()
    read = read_budget(study)
    source = find(scene)
    text = SceneText(source, own=not read.shared).text(source.parent)
    search = _Search(load_text(source, text), read, progress)
    chosen, gradients = search.run()
    left_out, requirements = tuple(search.left_out), search.verify()
    found = Budget(read, source, chosen, requirements, gradients, left_out, time.perf_counter() - began)
    return found.of_scene(scene_name(source))


class _Search:
    """Search for a budget: gradients of the metrics, choice of values, and check with other random seeds."""

    def __init__(self, scene: Any, study: BudgetStudy, progress: Progress | None) -> None:
        self.study = study
        self.params = mi.traverse(scene)
        known = parameters(scene, self.params)
        pairs = _pairs(study, known)
        self.keys = [parameter.key for parameter, _ in pairs]
        self.known = [parameter for parameter, _ in pairs]
        self.grades = [grades for _, grades in pairs]
        self.start = np.array([float(np.ravel(parameter.value)[0]) for parameter in self.known])
        self.metrics: list[Metric] = [requirement.made(scene) for requirement in study.requirements]
        self.limits = np.array([requirement.limit for requirement in study.requirements])
        self.left_out: list[str] = []
        self.advance = Steps(progress, len(self.metrics) * (study.iterations + 2 * study.seeds))
        self.numbers = self.start

    def choices(self, numbers: np.ndarray) -> list[ToleranceChoice]:
        """Return the parameters to choose, with their ranges and costs, at present values `numbers` in their units."""
        result = []
        for parameter, grades, number in zip(self.known, self.grades, numbers, strict=True):
            slope_key = f"{parameter.key.rpartition('.')[0]}.slope"
            slope = float(self.params[slope_key][0]) if grades.parameter == "level" else CLEANED_SLOPE
            result.append(
                ToleranceChoice(grades.parameter, float(number), grades.best, grades.worst, grades.cost, slope)
            )
        return result

    def derive(self, numbers: np.ndarray) -> tuple[Model, np.ndarray, np.ndarray]:
        """
        Return the model of the metrics at parameter values `numbers`, (variables,), in their units.

        Also return the metrics and their standard errors, (metrics,) each, in the units of the metrics.
        """
        assign(self.params, {key: np.array([p]) for key, p in zip(self.keys, numbers, strict=True)})
        values, errors, rows = [], [], []
        for metric in self.metrics:
            with errors_of(f"budget '{self.study.name}'"):  # of a model that a number does not suit
                found = gradient(metric, self.params, self.keys, edges=False)
            self.left_out += [text for text in found.left_out if text not in self.left_out]
            values.append(found.value)
            errors.append(found.value_se)
            rows.append([float(found.gradient[key][0]) for key in self.keys])
            self.advance()
        return Model.of(self.choices(numbers), np.array(values), np.array(rows)), np.array(values), np.array(errors)

    def run(self) -> tuple[tuple[Chosen, ...], int]:
        """
        Choose values of the parameters until they change by less than 2 % or iterations run out.

        Return the choices and the number of gradients of each metric.

        Raises
        ------
        MistrayError
            If a metric is 0 at the start, or exceeds its limit with all values at their best.
        """
        numbers, first, gradients = self.start, np.zeros(0), 0
        while True:
            model, values, errors = self.derive(numbers)
            gradients += 1
            if gradients == 1:
                _require_light(self.metrics, values)
                first = model.parts / values[:, None]
            choices = self.choices(numbers)
            # What aims at a limit itself misses it every other time
            aim = self.limits / (1 + self.study.sigmas * errors / values)
            if excess(choices, model, aim) > 1:  # no room for noise
                aim = self.limits
            if excess(choices, model, aim) > 1:
                new = np.array([choice.grades().min() for choice in choices])
                if np.allclose(new, numbers, rtol=1e-6) and np.any(values > self.limits):
                    raise self._infeasible(model, values, errors)
            else:
                new = allocate(choices, model, aim)
            settled = np.all(np.abs(new / numbers - 1) < SETTLED)
            numbers = new
            if settled or gradients == self.study.iterations:
                break
        self.numbers = numbers
        ratios = np.array([float(c.ratio(np.array(p))) for c, p in zip(choices, numbers, strict=True)])
        return self._chosen(first, model.parts * ratios / model.metrics(choices, numbers)[:, None]), gradients

    def verify(self) -> tuple[Met, ...]:
        """Return each requirement with its metric before and after the choice, traced with fresh random seeds."""
        before, after = self._levels(self.start), self._levels(self.numbers)
        return tuple(
            Met(metric.name, metric.unit, float(limit), b, a)
            for metric, limit, b, a in zip(self.metrics, self.limits, before, after, strict=True)
        )

    def _levels(self, numbers: np.ndarray) -> list[Estimate]:
        assign(self.params, {key: np.array([p]) for key, p in zip(self.keys, numbers, strict=True)})
        found = []
        for metric in self.metrics:
            first = metric.independent_seed
            values = []
            for seed in range(first, first + self.study.seeds):
                values.append(metric.value(seed=seed))
                self.advance()
            found.append(Estimate(float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))))
        return found

    def _chosen(self, first: np.ndarray, last: np.ndarray) -> tuple[Chosen, ...]:
        return tuple(
            Chosen(
                key=parameter.key,
                parameter=grades.parameter,
                unit=parameter.unit,
                surfaces=parameter.shapes,
                before=float(self.start[k]),
                after=float(self.numbers[k]),
                best=grades.best,
                worst=grades.worst,
                cost_before=float(grades.cost(np.array(self.start[k]))),
                cost_after=float(grades.cost(np.array(self.numbers[k]))),
                shares_before=tuple(map(float, first[:, k])),
                shares_after=tuple(map(float, last[:, k])),
            )
            for k, (parameter, grades) in enumerate(zip(self.known, self.grades, strict=True))
        )

    def _infeasible(self, model: Model, values: np.ndarray, errors: np.ndarray) -> MistrayError:
        worst = int(np.argmax(values / self.limits))
        other = max(1 - float(model.parts[worst].sum() / values[worst]), 0.0)
        return MistrayError(
            f"budget '{self.study.name}': at best the {self.metrics[worst].name} is "
            f"{values[worst]:.4g} ± {errors[worst]:.1g}, {values[worst] / self.limits[worst]:.3g} times the limit "
            f"{self.limits[worst]:g}; {percent_text(other)} of it do not come from these surfaces; raise it, or allow "
            "better or more surfaces"
        )


def _require_light(metrics: Sequence[Metric], values: np.ndarray) -> None:
    for metric, value in zip(metrics, values, strict=True):
        if not value > 0:
            raise MistrayError(f"the {metric.name} is {value:g}: no light is found; trace more rays or other paths")


def _pairs(study: BudgetStudy, known: Mapping[str, Parameter]) -> list[tuple[Parameter, Grades]]:
    """Return the scatter parameters to choose, each with its section ``[[choose]]``, in the order of the scene."""
    found: dict[str, Grades] = {}
    for number, grades in enumerate(study.choices, start=1):
        where = f"budget '{study.name}': choose[{number}]"
        having = {key: parameter for key, parameter in known.items() if key.rpartition(".")[2] == grades.parameter}
        for pattern in grades.surfaces:
            keys = [key for key, parameter in having.items() if any(fits(s, pattern) for s in parameter.shapes)]
            if not keys:
                surfaces = ", ".join(dict.fromkeys(s for parameter in having.values() for s in parameter.shapes))
                raise MistrayError(
                    f"{where}: no surface '{pattern}' has a {grades.parameter} with a derivative; "
                    f"{f'those that have one are {surfaces}' if surfaces else 'none has'}"
                )
            for key in keys:
                if found.get(key, grades) is not grades:
                    raise MistrayError(f"{where}: '{key}' is chosen by another section too; name each surface once")
                found[key] = grades
    return [(known[key], found[key]) for key in known if key in found]
