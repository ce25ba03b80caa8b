"""Roughness and cleanliness that meet limits at the least cost: costs, the convex problem and its solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, dataclass

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp, minimize

from mistray.errors import MistrayError
from mistray.physics.contamination import CLEANED_SLOPE, coverage_percent
from mistray.ranges import FINITE, POSITIVE, Each
from mistray.toolkit.fields import Request, field

# Values whose scatter goes with a power of them; a cleanliness level has a law of its own
POWERS = {"rms_nm": 2.0, "A": 1.0, "b0": 1.0, "reflectance": 1.0, "coverage_percent": 1.0}
SCATTER = (*POWERS, "level")
GRID = 400  # values of a continuous variable where another one has steps
SLACK = 1e-9  # of a limit, for the rounding of a solution
STEP = 1e-4  # of ln(level), for the slope of its law


def relative_scatter(name: str, value: np.ndarray, slope: float = CLEANED_SLOPE) -> np.ndarray:
    """
    Return the scatter of a surface, up to a constant factor, from its roughness, cleanliness or amplitude.

    Smooth surfaces scatter in proportion to σ² (Rayleigh-Rice, Harvey-Shack), other models in proportion to their
    factors A, b0 and reflectance. Particles scatter about in proportion to the area that they cover, which follows from
    a level by `mistray.physics.contamination.coverage_percent`.

    Parameters
    ----------
    name : {"rms_nm", "level", "coverage_percent", "A", "b0", "reflectance"}
        Parameter of the scatter model.
    value : array
        Value in the unit of the parameter (nm for "rms_nm"), greater than 0; a level at least 1.
    slope : float
        Slope of the size distribution of particles.

    Returns
    -------
    array
        Shape of `value`.
    """
    if name == "level":
        return np.array([coverage_percent(float(v), slope) for v in np.ravel(value)]).reshape(np.shape(value))
    return np.asarray(value, dtype=np.float64) ** POWERS[name]


def elasticity(name: str, value: float, slope: float = CLEANED_SLOPE) -> float:
    """Return the logarithmic slope d ln(scatter) / d ln(value) of `relative_scatter` at a value."""
    if name != "level":
        return POWERS[name]
    low, high = relative_scatter(name, value * np.exp(np.array([-STEP, STEP])), slope)
    return float(np.log(high / low) / (2 * STEP))


@dataclass(frozen=True)
class PowerCost(Request):
    """
    Cost (reference / value)^exponent · weight: a value half as large costs 2^exponent times as much.

    The fields are the keys ``cost`` of a section ``[[choose]]`` in a budget file.
    """

    weight: float = field(POSITIVE, 1.0, "cost at the reference, in any unit")
    reference: float = field(POSITIVE, 1.0, "value of that cost, in its unit; in a file the default is `worst`")
    exponent: float = field(POSITIVE, 1.0, "power; by the rule of thumb the time of polishing goes with 1/σ")

    def __call__(self, value: np.ndarray) -> np.ndarray:
        """Return the cost of each value, an array of the same shape, in the unit of `weight`."""
        return np.asarray(self.weight * (self.reference / np.asarray(value, dtype=np.float64)) ** self.exponent)


@dataclass(frozen=True)
class StepCost(Request):
    """
    Cost of a few grades of a parameter that a supplier offers; values between them are not available.

    `values` ascend, in the unit of the parameter, and `costs` fall; they may be in any unit.
    """

    values: tuple[float, ...] = field(
        Each(FINITE), MISSING, "instead of best, worst and cost: grades that can be ordered, ascending"
    )
    costs: tuple[float, ...] = field(Each(FINITE), MISSING, "cost of each grade, falling")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.values) != len(self.costs):
            raise MistrayError(f"costs has {len(self.costs)} entries for {len(self.values)} values; give one for each")
        if np.any(np.diff(self.values) <= 0) or not self.values[0] > 0:
            raise MistrayError(f"values is {list(self.values)}; give ascending numbers above 0")
        if np.any(np.diff(self.costs) > 0) or min(self.costs) < 0 or self.costs[0] == 0:
            raise MistrayError(
                f"costs is {list(self.costs)}; what is worse must not cost more, and no cost is negative"
            )

    def __call__(self, value: np.ndarray) -> np.ndarray:
        """
        Return the cost of the coarsest grade at least as good as each value, or of the best grade if none is.

        The cost has the shape of the values and the unit of `costs`.
        """
        place = np.searchsorted(self.values, np.asarray(value) * (1 + 1e-9), side="right") - 1
        return np.asarray(np.array(self.costs)[np.maximum(place, 0)])


@dataclass(frozen=True)
class ToleranceChoice:
    """
    Parameter of a surface's scatter to be chosen: a roughness, cleanliness level or amplitude.

    Attributes
    ----------
    name : str
        Name of the parameter, see `relative_scatter`.
    value : float
        Value at which the metrics and their derivatives were computed, in the parameter's unit.
    best, worst : float
        Smallest and largest value to choose from, in that unit.
    cost : PowerCost or StepCost
        Cost of a value.
    slope : float
        Slope of the size distribution of particles.
    """

    name: str
    value: float
    best: float
    worst: float
    cost: PowerCost | StepCost
    slope: float = CLEANED_SLOPE

    def ratio(self, value: np.ndarray) -> np.ndarray:
        """Return, for each value of the parameter, the surface's scatter over that at its present value."""
        return relative_scatter(self.name, value, self.slope) / relative_scatter(
            self.name, np.array(self.value), self.slope
        )

    def ratio_slope(self, value: float) -> float:
        """Return the derivative of `ratio` with respect to the logarithm of the parameter, at a value."""
        return float(self.ratio(np.array(value))) * elasticity(self.name, value, self.slope)

    def grades(self) -> np.ndarray:
        """Return values of the parameter to choose from: the grades within its range, or 400 on a logarithmic scale."""
        if isinstance(self.cost, StepCost):
            return np.array([v for v in self.cost.values if self.best <= v <= self.worst])
        return np.geomspace(self.best, self.worst, GRID)


@dataclass(frozen=True)
class Model:
    """
    Metrics as sums over surfaces of their scatter, M_j = fixed_j + Σ_i parts_ji T_i(p_i)/T_i(p_i now).

    T_i(p) is the scatter of surface i at the value p of its parameter, up to a constant factor (`relative_scatter`).

    Attributes
    ----------
    fixed : (metrics,) float64
        Contribution of all other light, in the unit of each metric.
    parts : (metrics, variables) float64
        Contribution of each surface at its present value, ≥ 0, in the unit of each metric.
    """

    fixed: np.ndarray
    parts: np.ndarray

    @classmethod
    def of(cls, variables: Sequence[ToleranceChoice], values: np.ndarray, derivatives: np.ndarray) -> Model:
        """
        Return the model made from metrics and their derivatives.

        With T ~ p^ε the contribution of a surface is ∂M/∂p · p/ε. Contributions below 0, which noise can make, are set
        to 0.

        Parameters
        ----------
        variables : sequence of ToleranceChoice
            Parameters to choose, one for each column of `derivatives`.
        values : (metrics,) float64
            Metrics at the present values, each in its unit.
        derivatives : (metrics, variables) float64
            Derivatives with respect to the values themselves, not to their logarithms.
        """
        lever = np.array([v.value / elasticity(v.name, v.value, v.slope) for v in variables])
        parts = np.maximum(derivatives * lever, 0.0)
        return cls(values - parts.sum(axis=1), parts)

    def metrics(self, variables: Sequence[ToleranceChoice], numbers: np.ndarray) -> np.ndarray:
        """Return the metrics, (metrics,), that the model predicts for values of the parameters, (variables,)."""
        ratios = np.array([float(v.ratio(np.array(p))) for v, p in zip(variables, numbers, strict=True)])
        return np.asarray(self.fixed + self.parts @ ratios)


def allocate(variables: Sequence[ToleranceChoice], model: Model, limits: np.ndarray) -> np.ndarray:
    """
    Return the parameter values that meet all limits on the metrics at the least total cost.

    Over ln(p) costs and metrics are convex, so that the minimum that SLSQP finds is the only one. With grades, one
    grade of each list is chosen exactly (mixed-integer program, HiGHS). Continuous variables beside grades first take
    part in this choice on a fine list, and are then solved for with the grades held.

    Parameters
    ----------
    variables : sequence of ToleranceChoice
        Parameters to choose, with their ranges and costs.
    model : Model
        Metrics as functions of the parameters.
    limits : (metrics,) float64
        Largest value of each metric, in its unit.

    Returns
    -------
    (variables,) float64
        Values in the units of the parameters.

    Raises
    ------
    MistrayError
        If no values within the ranges meet the limits, see `excess`, or the search does not converge.
    """
    best = np.array([v.grades().min() for v in variables])
    if excess(variables, model, limits) > 1 + SLACK:
        raise MistrayError("no numbers within the ranges meet the limits")
    numbers = best
    held = [isinstance(v.cost, StepCost) for v in variables]
    if any(held):
        numbers = _choose(variables, model, limits)
    free = [k for k, is_held in enumerate(held) if not is_held]
    return _descend(variables, model, limits, numbers, free) if free else numbers


def excess(variables: Sequence[ToleranceChoice], model: Model, limits: np.ndarray) -> float:
    """
    Return the largest ratio of a metric to its limit, with all parameters at their best (least scatter).

    Above 1 no choice meets the limits.
    """
    best = np.array([v.grades().min() for v in variables])
    return float(np.max(model.metrics(variables, best) / limits))


def _choose(variables: Sequence[ToleranceChoice], model: Model, limits: np.ndarray) -> np.ndarray:
    """
    Return the grades of the parameters, (variables,), that meet the limits on the metrics at the least cost.

    Raises
    ------
    MistrayError
        If no grades meet the limits.
    """
    lists = [v.grades() for v in variables]
    costs = np.concatenate([v.cost(grades) for v, grades in zip(variables, lists, strict=True)])
    ratios = [v.ratio(grades) for v, grades in zip(variables, lists, strict=True)]
    loads = np.concatenate([model.parts[:, [k]] * ratio for k, ratio in enumerate(ratios)], axis=1)
    sizes = [len(grades) for grades in lists]
    one = np.repeat(np.eye(len(sizes)), sizes, axis=1)
    room = limits * (1 + SLACK) - model.fixed
    found = milp(
        costs / costs.max(),
        integrality=np.ones(len(costs)),
        bounds=Bounds(0, 1),
        constraints=[
            LinearConstraint(one, 1, 1),
            LinearConstraint(loads / limits[:, None], -np.inf, room / limits),
        ],
        options={"mip_rel_gap": 1e-6},
    )
    if found.x is None:
        raise MistrayError(f"no choice of grades meets the limits ({found.message}); widen the ranges")
    chosen = np.split(found.x, np.cumsum(sizes)[:-1])
    return np.array([grades[int(np.argmax(picks))] for grades, picks in zip(lists, chosen, strict=True)])


def _descend(
    variables: Sequence[ToleranceChoice], model: Model, limits: np.ndarray, start: np.ndarray, free: Sequence[int]
) -> np.ndarray:
    """
    Return values of all parameters, (variables,), of least cost within the limits.

    Those of the indices `free` minimise the cost, the others stay at `start`.

    Raises
    ------
    MistrayError
        If the search does not converge.
    """
    chosen = [variables[k] for k in free]
    held = [k for k in range(len(variables)) if k not in free]
    fixed = model.fixed + sum(model.parts[:, k] * float(variables[k].ratio(np.array(start[k]))) for k in held)
    parts = model.parts[:, list(free)] / limits[:, None]
    room = 1 - fixed / limits
    exponents = np.array([v.cost.exponent for v in chosen])  # type: ignore[union-attr]

    def costs(y: np.ndarray) -> np.ndarray:
        return np.array([float(v.cost(np.exp(t))) for v, t in zip(chosen, y, strict=True)])

    def log_cost(y: np.ndarray) -> float:  # which is convex, too, and alike however far the range reaches
        return float(np.log(np.sum(costs(y))))

    def log_cost_slope(y: np.ndarray) -> np.ndarray:
        return -exponents * costs(y) / np.sum(costs(y))

    def left(y: np.ndarray) -> np.ndarray:
        return np.asarray(room - parts @ np.array([float(v.ratio(np.exp(t))) for v, t in zip(chosen, y, strict=True)]))

    def left_slope(y: np.ndarray) -> np.ndarray:
        return np.asarray(-parts * np.array([v.ratio_slope(float(np.exp(t))) for v, t in zip(chosen, y, strict=True)]))

    low, high = np.log([v.best for v in chosen]), np.log([v.worst for v in chosen])
    found = minimize(
        log_cost,
        np.clip(np.log(start[list(free)]), low, high),
        jac=log_cost_slope,
        method="SLSQP",
        bounds=list(zip(low, high, strict=True)),
        constraints={"type": "ineq", "fun": left, "jac": left_slope},
        options={"ftol": 1e-8, "maxiter": 500},
    )
    y = np.clip(found.x, low, high)
    if not found.success or float(np.min(left(y))) < -1e-6:
        raise MistrayError(f"the least cost was not found ({found.message}); narrow the ranges")
    numbers = start.copy()
    numbers[list(free)] = np.exp(y)
    return numbers
