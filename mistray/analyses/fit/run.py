"""Fit of model parameters to measured data, with confidence regions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import brentq, lsq_linear
from scipy.stats import chi2

from mistray.analyses.pst.metrics.pst_bands import Modelled
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.ranges import FINITE, POSITIVE, ByName, Words, shown
from mistray.result import KeyNumber, Result

Model = Callable[[np.ndarray], Modelled]
VALUES = ByName(FINITE, "{'slope': 1.0}")
HIGHEST_POWER = 100
STEPS = 30
SETTLED = 1.0
LONGEST = 9.0  # change of a parameter in its scale in one step, over its distance from its lower bound
LONGEST_LOG = np.log(3.0)
OFF_BOUND = 0.5  # standard deviations; what is 0 has no light to take derivatives from
DAMPING = 1e-3  # of Levenberg and Marquardt, at the start
MOST_DAMPING = 1e6
LIKELY = 0.95
PRECISE = 1e-6  # of an interval, relative
FARTHEST = 1e6  # times its distance from its lower bound that a parameter without an upper one can grow to
LEAST_EFFECT = 0.01  # standard errors by which data change as a parameter takes all its values, to depend on it
ALIKE = 1e-12  # least eigenvalue of the curvature, of unit diagonal, of parameters that are told apart
PART = 1e-3  # of a direction that the data do not tell, for a parameter to belong to it


class Evaluations:
    """
    Model of data, a function of parameters, that stores its evaluations for fits to many data sets.

    The model does not depend on the data, and its derivatives at a point count as valid within `settled` standard
    deviations. A fit that comes this near to a point of an earlier fit uses its evaluation instead of another one. So
    hundreds of noise realisations need only some tens of evaluations.

    Parameters
    ----------
    model : callable
        See `fit`.
    settled : float
        Distance within which the derivatives at a point hold, in standard deviations, greater than 0. A larger one
        saves evaluations of a model that is linear in the scales of its parameters, as a PST of single scatter is.

    Attributes
    ----------
    points : list of (k,) float64
        Values of the parameters at which the model was evaluated, in their units.
    found : list of Modelled
        Result of the model at each point.

    Examples
    --------
    >>> x = np.arange(1.0, 5.0)
    >>> def line(parameters):
    ...     return mistray.optimize.Modelled(parameters[0] * x, np.zeros((4, 4)), x[:, None])
    >>> model = mistray.optimize.Evaluations(line)
    >>> for noise in 0.0, 0.05, -0.05:
    ...     found = mistray.optimize.fit(model, 2.0 * x + noise, 0.1 * np.ones(4), {"slope": 1.0})
    >>> len(model.points)
    2
    """

    def __init__(self, model: Model, settled: float = SETTLED) -> None:
        self._model, self.settled = model, POSITIVE.check("settled", settled, "Evaluations")
        self.points: list[np.ndarray] = []
        self.found: list[Modelled] = []

    def at(self, values: np.ndarray, near: Callable[[np.ndarray], float], but: Collection[int] = ()) -> int:
        """
        Return the index of the evaluation to use for given values of the parameters.

        Parameters
        ----------
        values : (k,) float
            Values of the parameters.
        near : callable
            Squared distance of a point (k,) from the values, in standard deviations.
        but : collection of int
            Indices of evaluations not to use.

        Returns
        -------
        int
            Index of the nearest evaluation, or of a new one at the values if all are too far away.
        """
        far = {number: near(point) for number, point in enumerate(self.points) if number not in but}
        if far and min(far.values()) < self.settled**2:
            return min(far, key=lambda number: far[number])
        found = self._model(values)
        self.points.append(np.array(values, dtype=np.float64))
        self.found.append(found)
        return len(self.found) - 1


@dataclass(frozen=True, repr=False)
class Fit(Result, table=".page:parameter_table", figure=".figures:residual_figure"):
    """
    Result of `fit`: estimates of parameters with their errors and likelihood.

    In their scales the parameters x change the model by `slope`. So the likelihood is known around the estimate x̂,
    within the bounds. With the residual r and the covariance N of noise, χ²(x) = dᵀ N⁻¹ d, d = r - slope (x - x̂).

    Attributes
    ----------
    names : tuple of str
        Names of the parameters, (k,).
    power : (k,) float64
        Powers that define the scales of the parameters, dimensionless, see `fit`.
    low, high : (k,) float64
        Bounds of the parameters, in their units.
    value : (k,) float64
        Estimate, in the units of the parameters: the values of least χ² within the bounds.
    slope : (n, k) float64
        Derivatives of the model with respect to the parameters in their scales, in the unit of the data over these.
    residual : (n,) float64
        Observed minus modelled data, in the unit of the data.
    noise : (n, n) float64
        Covariance of the residual, in the square of that unit: noise of the data and of the model.
    history : tuple of (k,) float64
        The values that were accepted, in the units of the parameters, the start first, the estimate last.
    evaluations : int
        Number of evaluations of the model, without those that `Evaluations` had stored.

    Examples
    --------
    >>> x = np.arange(1.0, 5.0)
    >>> def line(parameters):
    ...     return mistray.optimize.Modelled(parameters[0] * x, np.zeros((4, 4)), x[:, None])
    >>> found = mistray.optimize.fit(line, 2.0 * x, 0.1 * np.ones(4), {"slope": 1.0})
    >>> low, high = found.interval("slope")
    >>> print(f"{low:.2f} … {high:.2f}, {found.degrees} degrees of freedom")
    1.96 … 2.04, 3 degrees of freedom
    """

    names: tuple[str, ...]
    power: np.ndarray
    low: np.ndarray
    high: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    residual: np.ndarray
    noise: np.ndarray
    history: tuple[np.ndarray, ...]
    evaluations: int

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return estimates with standard errors, in the parameters' units, χ² and degrees of freedom, by label."""
        values = {
            name: Estimate(*pair)
            for name, *pair in zip(self.names, self.value.tolist(), self.standard_error.tolist(), strict=True)
        }
        return {**values, "χ²": self.chi_square, "degrees of freedom": self.degrees}

    @property
    def estimate(self) -> dict[str, float]:
        """Estimated value of each parameter by name, in its unit."""
        return dict(zip(self.names, self.value.tolist(), strict=True))

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters in their scales, (k, k), without regard to bounds; ∞ or NaN if undetermined."""
        size, weights, directions = self._directions()
        told = weights > ALIKE
        scaled = directions[:, told] / size[:, None]
        found = np.asarray((scaled / weights[told]) @ scaled.T)
        blind = np.diag(self._blind()) > PART**2
        found[blind] = found[:, blind] = np.nan
        found[blind, blind] = np.inf
        return found

    @property
    def standard_error(self) -> np.ndarray:
        """
        Standard errors, (k,), in the parameters' units, bounds ignored.

        At the value 0 they are infinite for a `power` above 1, 0 below 1; infinite or NaN for undetermined parameters.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(np.sqrt(np.diag(self.covariance)) / _stretch(self.value, self.power))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the parameters, (k, k), -1 … 1; NaN for those that the data do not determine."""
        spread = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.covariance / np.outer(spread, spread))

    @property
    def untold(self) -> dict[str, tuple[str, ...]]:
        """Parameters that the data do not determine, each with those that can make up for its change, also jointly."""
        blind = np.abs(self._blind())
        return {
            name: tuple(other for other, part in zip(self.names, row, strict=True) if part > PART**2 and other != name)
            for name, row, own in zip(self.names, blind, np.diag(blind), strict=True)
            if own > PART**2
        }

    @property
    def chi_square(self) -> float:
        """χ² of the residual at the estimate, dimensionless."""
        return self._chi_square(np.zeros(len(self.names)))

    @property
    def told(self) -> int:
        """Number of parameters, or independent combinations of them, that the data determine."""
        return int(np.sum(self._directions()[1] > ALIKE))

    @property
    def degrees(self) -> int:
        """Degrees of freedom of `chi_square`: number of data minus `told`."""
        return len(self.residual) - self.told

    @property
    def probability(self) -> float:
        """Probability, 0 … 1, of a `chi_square` this large by noise alone; if tiny, the model does not fit the data."""
        return float(chi2.sf(self.chi_square, self.degrees))

    def distance(self, values: Mapping[str, float]) -> float:
        """
        Return minus twice the logarithm of the likelihood of other values over that of the estimate.

        If the other values are the truth, it is χ² with `told` degrees of freedom; smaller where bounds hold the
        estimate.

        Raises
        ------
        MistrayError
            If a value is missing, not finite or out of its bounds.
        """
        VALUES.check("values", values)
        missing = [name for name in self.names if name not in values]
        if missing:
            raise MistrayError(f"values lack {', '.join(missing)}; give one for each of {', '.join(self.names)}")
        given = np.array([values[name] for name in self.names], dtype=np.float64)
        for name, value, low, high in zip(self.names, given, self.low, self.high, strict=True):
            if not low <= value <= high:
                raise MistrayError(f"{name} is {value:g}; it lies between {low:g} and {high:g}")
        return self._chi_square(_scaled(given, self.power) - _scaled(self.value, self.power)) - self.chi_square

    def covers(self, values: Mapping[str, float], probability: float = LIKELY) -> bool:
        """True if values of the parameters lie in the confidence region of a probability."""
        return self.distance(values) <= float(chi2.ppf(probability, max(self.told, 1)))

    def interval(self, name: str, probability: float = LIKELY) -> tuple[float, float]:
        """
        Return the confidence interval of one parameter, by the profile likelihood.

        At each value of this parameter the others minimise χ². The interval ends where this minimum exceeds that of all
        by the quantile of χ² with one degree of freedom (S. S. Wilks, Ann. Math. Statist. 9, 60, 1938), or at a bound.
        An interval that begins or ends at a bound is a one-sided limit. The quantile is the same there, so that its
        coverage is at least the stated probability.

        Parameters
        ----------
        name : str
            Name of the parameter.
        probability : float
            Probability that the interval holds the truth, 0 … 1.

        Returns
        -------
        (float, float)
            Ends in the unit of the parameter; its bounds, perhaps infinite, if it is undetermined, see `untold`.
        """
        k = self.names.index(Words(self.names).check("name", name))
        rows, aims = _whitened(self.slope, self.residual, self.noise)
        if not np.any(rows[:, k]):
            return float(self.low[k]), float(self.high[k])
        others = np.arange(len(self.names)) != k
        room = self._room()
        allowed = self.chi_square + float(chi2.ppf(probability, 1))

        def excess(step: float) -> float:
            left = aims - rows[:, k] * step
            rest = _least_squares(rows[:, others], left, room[:, others])
            return float(np.sum(np.square(left - rows[:, others] @ rest))) - allowed

        here = _scaled(self.value, self.power)
        ends = []
        for end, bound in zip(room[:, k], (self.low[k], self.high[k]), strict=True):
            # What is longer than this is told no better than directions that are not told at all
            longest = np.sign(end) / np.linalg.norm(rows[:, k]) / np.sqrt(ALIKE)
            if excess(end if np.isfinite(end) else longest) <= 0:
                ends.append(float(bound))
                continue
            far = longest * np.sqrt(ALIKE)
            while excess(far) < 0:
                far *= 2
            far = far if abs(far) < abs(end) else end
            ends.append(float(_unscaled(here + brentq(excess, 0.0, far, xtol=PRECISE * abs(far)), self.power)[k]))
        return ends[0], ends[1]

    def __str__(self) -> str:
        lines, untold = [], self.untold
        for name, value, low, high in zip(self.names, self.value, self.low, self.high, strict=True):
            first, last = self.interval(name)
            others = untold.get(name)
            if others == ():
                lines.append(f"{name}: no datum depends on it, it stays {value:.4g}")
            elif first > low and last < high:
                lines.append(f"{name} = {value:.4g}, from {first:.4g} to {last:.4g} with {LIKELY:.0%}")
            elif first > low:
                lines.append(f"{name} > {first:.4g} with {LIKELY:.0%}, best {value:.4g}")
            elif last < high:
                lines.append(f"{name} < {last:.4g} with {LIKELY:.0%}, best {value:.4g}")
            else:
                along = f" with some {' and '.join(others)}" if others else ""
                lines.append(f"{name}: all from {low:.4g} to {high:.4g} agree with the data{along}, best {value:.4g}")
        lines.append(f"χ² = {self.chi_square:.1f} with {self.degrees} degrees of freedom, P = {self.probability:.2g}")
        return "\n".join(lines)

    def _chi_square(self, step: np.ndarray) -> float:
        """Return χ² at a step, (k,), away from the estimate, in the scales of the parameters."""
        rows, aims = _whitened(self.slope, self.residual, self.noise)
        return float(np.sum(np.square(aims - rows @ step)))

    def _directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return how well the data determine directions in the parameters.

        Returns
        -------
        size : (k,) float64
            Inverse standard error of each scale, were the others known; 1 where no datum depends on it.
        weights : (k,) float64
            Eigenvalues of the curvature in these units: 0 … k.
        directions : (k, k) float64
            Their directions, as columns.
        """
        rows, _ = _whitened(self.slope, self.residual, self.noise)
        size = np.linalg.norm(rows, axis=0)
        size = np.where(size > 0, size, 1.0)
        return size, *np.linalg.eigh((rows / size).T @ (rows / size))

    def _blind(self) -> np.ndarray:
        """Return the projection, (k, k), onto combinations of scaled parameters that the data do not determine."""
        _, weights, directions = self._directions()
        return np.asarray(directions[:, weights <= ALIKE] @ directions[:, weights <= ALIKE].T)

    def _room(self) -> np.ndarray:
        """Return the steps from the estimate to the lower (≤ 0) and upper (≥ 0) bounds, (2, k), in their scales."""
        return np.stack([_scaled(end, self.power) for end in (self.low, self.high)]) - _scaled(self.value, self.power)


def fit(
    model: Model | Evaluations,
    observed: Sequence[float] | np.ndarray,
    noise: float | Sequence[float] | np.ndarray,
    start: Mapping[str, float],
    *,
    low: Sequence[float] | np.ndarray | float = -np.inf,
    high: Sequence[float] | np.ndarray | float = np.inf,
    power: Sequence[float] | np.ndarray | float = 1.0,
    steps: int = STEPS,
) -> Fit:
    """
    Fit the parameters of a model to data by weighted least squares within bounds.

    Levenberg and Marquardt's method (D. W. Marquardt, J. SIAM 11, 1963) in scales in which the model is nearly linear.
    The weights are the inverse of the covariance of the data plus that of the model's own Monte Carlo noise, renewed at
    every step. It ends with the first step shorter than `Evaluations.settled`, by default one standard deviation,
    without another evaluation. The noise of the model is then that of one evaluation, which counts in the likelihood.

    A parameter stays where it is if the data change by less than `LEAST_EFFECT` standard errors as it takes all values
    from its lower to its upper bound. Without an upper one it is taken to grow a million times. For parameters of
    equal effect, the smallest joint change is made. `Fit.untold` names both kinds.

    Parameters
    ----------
    model : callable
        Takes values of the parameters, (k,), and returns a `Modelled`, such as a `PstBands`. `Evaluations` of a model
        serve many fits.
    observed : (n,) float
        Data, in the units of the model.
    noise : float, (n,) or (n, n) float
        Standard errors of the data, one for all or one for each, or their covariance.
    start : mapping of str to float
        Name → first guess, in the order in which the model takes them.
    low, high : float or (k,) float
        Bounds of the parameters, in their units. Give a position or another parameter of either sign finite ones, as
        `PstBands` does.
    power : float or (k,) float
        Scales: the power of each parameter with which the model grows linearly, 1 for a share of light or a position, 2
        for a roughness. 0 stands for its logarithm (G. E. P. Box, D. R. Cox, J. R. Stat. Soc. B 26, 211, 1964). With
        another power than 1 a parameter is not negative, and starts above 0. `PstBands.power` has the usual ones.
    steps : int
        Largest number of evaluations of the model.

    Returns
    -------
    Fit

    Raises
    ------
    MistrayError
        If shapes or values do not agree, data are too few, the model is not finite, or the fit does not settle.

    Examples
    --------
    >>> x = np.arange(1.0, 5.0)
    >>> def line(parameters):
    ...     return mistray.optimize.Modelled(parameters[0] * x, np.zeros((4, 4)), x[:, None])
    >>> observed = 2.0 * x + [0.1, -0.1, 0.1, -0.1]
    >>> found = mistray.optimize.fit(line, observed, 0.1 * np.ones(4), {"slope": 1.0})
    >>> print(f"{found.value[0]:.2f} ± {found.standard_error[0]:.2f}, χ² = {found.chi_square:.1f}")
    1.99 ± 0.02, χ² = 3.9
    """
    first_guess = VALUES.check("start", start)
    names, guess = tuple(first_guess), np.array(list(first_guess.values()), dtype=np.float64)
    data, spread = _checked_data(names, observed, noise)
    powers, floor, ceiling = (
        _of_each(name, given, len(names)) for name, given in (("power", power), ("low", low), ("high", high))
    )
    if not np.all((powers >= 0) & (powers <= HIGHEST_POWER)):
        raise MistrayError(f"power is {powers.tolist()}; give 0 for a logarithm, or powers up to {HIGHEST_POWER}")
    floor = np.where(powers == 1, floor, np.maximum(floor, 0.0))
    for name, value, first, last, power_of in zip(names, guess, floor, ceiling, powers, strict=True):
        if not first < last:
            raise MistrayError(f"{name}: low … high is {first:g} … {last:g}; give low below high")
        if not first <= value <= last or (value == 0 and power_of != 1):
            above = " above" if power_of != 1 and first == 0 else ""
            raise MistrayError(f"{name} starts with {value:g}; start between{above} {first:g} and {last:g}")
    bounds = np.stack([_scaled(floor, powers), _scaled(ceiling, powers)])
    memory = model if isinstance(model, Evaluations) else Evaluations(model)
    before, used = len(memory.points), set[int]()

    def evaluated(values: np.ndarray, near: Callable[[np.ndarray], float]) -> tuple[np.ndarray, Modelled]:
        number = memory.at(values, near, used)
        used.add(number)  # else two points whose noise differs could send the search back and forth
        found = memory.found[number]
        if found.value.shape != data.shape:
            raise MistrayError(f"the model gives {found.value.size} numbers for {data.size} that were observed")
        if not all(np.all(np.isfinite(part)) for part in (found.value, found.covariance, found.jacobian)):
            raise MistrayError(f"the model is not finite at {_words(names, memory.points[number])}; narrow low … high")
        return _scaled(memory.points[number], powers), found

    x, here = evaluated(guess, lambda point: 0.0 if np.array_equal(point, guess) else np.inf)
    damping, history = DAMPING, [_unscaled(x, powers)]
    while True:
        total = spread + here.covariance
        slope = here.jacobian / _stretch(_unscaled(x, powers), powers)
        rows, aims = _whitened(slope, data - here.value, total)
        depends = np.linalg.norm(rows, axis=0) > LEAST_EFFECT / _range(bounds - x, powers)
        slope, rows = slope * depends, rows * depends
        curvature = rows.T @ rows
        scale = np.diag(curvature)
        chi_square = float(aims @ aims)
        ahead = _least_squares(rows, aims, bounds - x)
        if ahead @ curvature @ ahead < memory.settled**2:
            left = data - here.value - slope @ ahead
            value = np.clip(_unscaled(x + ahead, powers), floor, ceiling)
            spent = len(memory.points) - before
            return Fit(names, powers, floor, ceiling, value, slope, left, total, (*history, value), spent)
        room = _reach(bounds - x, scale, powers)
        while True:
            spent = len(memory.points) - before
            if spent >= steps or damping > MOST_DAMPING:
                at = _words(names, _unscaled(x, powers))
                raise MistrayError(
                    f"no fit after {spent} evaluations, at {at}, χ² = {chi_square:.4g}; start closer or trace more rays"
                )
            damped = np.vstack([rows, np.diag(np.sqrt(damping * scale))])
            move = _least_squares(damped, np.concatenate([aims, np.zeros(len(x))]), room)
            aim = x + move
            tried, there = evaluated(_unscaled(aim, powers), partial(_squared, aim=aim, power=powers, metric=curvature))
            apart, _ = _whitened(data - there.value, aims, total)
            # At other values a model may have drawn other rays: χ² has noise of its own
            if float(apart @ apart) < chi_square + len(data):
                x, here, damping = tried, there, damping / 10
                history.append(_unscaled(x, powers))
                break
            damping *= 10


def _checked_data(
    names: Sequence[str], observed: Sequence[float] | np.ndarray, noise: float | Sequence[float] | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the data, (n,), and the covariance of their noise, (n, n), after checks of shape and value."""
    data = np.array(FINITE.check_each("observed", observed))
    if len(data) <= len(names):
        raise MistrayError(
            f"observed has {data.size} numbers for {len(names)} parameters; give more numbers than parameters"
        )
    spread = _numbers("noise", noise)
    spread = np.full(data.shape, spread) if spread.size == 1 else spread
    if spread.shape not in (data.shape, 2 * data.shape):
        raise MistrayError(f"noise has the shape {spread.shape}; give {len(data)} standard errors or their covariance")
    if spread.ndim == 1:
        with np.errstate(over="ignore"):  # an infinite square is refused below
            spread = np.diag(np.square(spread))
    if not np.all(np.isfinite(spread)):
        raise MistrayError(f"noise is {shown(noise)}; give finite numbers, whose squares are finite, too")
    if not np.all(np.diag(spread) > 0):
        raise MistrayError("noise has a standard error of 0; every number needs one greater than 0")
    if not np.allclose(spread, spread.T) or not np.linalg.eigvalsh(spread)[0] > 0:
        raise MistrayError("noise is not a covariance; give a symmetric matrix that is positive definite")
    return data, spread


def _of_each(name: str, given: Any, count: int) -> np.ndarray:
    """Return a number for each of `count` parameters, (k,), given for all or for each."""
    numbers = _numbers(name, given)
    if numbers.shape not in ((), (1,), (count,)) or np.any(np.isnan(numbers)):
        raise MistrayError(f"{name} is {shown(given)}; give one number for all parameters, or {count}")
    return np.broadcast_to(numbers, (count,)).astype(np.float64)


def _numbers(name: str, given: Any) -> np.ndarray:
    """Return an argument as an array of float64; raise `MistrayError` if it does not consist of numbers."""
    try:
        return np.asarray(list(given) if isinstance(given, Iterator | Set) else given, dtype=np.float64)
    except (TypeError, ValueError):
        raise MistrayError(f"{name} is {shown(given)}; give numbers") from None


def _reach(room: np.ndarray, scale: np.ndarray, power: np.ndarray) -> np.ndarray:
    """
    Return the largest allowed steps down (≤ 0) and up (≥ 0), (2, k), in scales with the curvature `scale`, (k,).

    They end half a standard error before a bound, `room`, (2, k), away. A logarithm changes by at most ln 3. A distance
    from a lower bound becomes at most ten times as long, or ten standard errors if it is 0.
    """
    error = 1 / np.sqrt(np.where(scale > 0, scale, np.inf))  # what no datum depends on does not move
    low, high = np.minimum(room[0] + OFF_BOUND * error, 0.0), np.maximum(room[1] - OFF_BOUND * error, 0.0)
    most = np.where(power == 0, LONGEST_LOG, np.where(np.isfinite(room[0]), LONGEST * -room[0], np.inf))
    # A start at its lower bound has no distance from it; it goes ten standard deviations
    most = np.where(most > 0, most, 10 * error)
    return np.stack([np.where(power == 0, np.maximum(low, -LONGEST_LOG), low), np.minimum(high, most)])


def _range(room: np.ndarray, power: np.ndarray) -> np.ndarray:
    """
    Return the width of each parameter's range in its scale, (k,), from the distances to its bounds, (2, k).

    Of a logarithm it is the growth of the parameter up to its upper bound, with which data may grow, and the distance
    to its lower bound. A parameter without an upper bound is taken to grow a million times, and a logarithm to fall no
    farther. For other scales without a lower bound the width is infinite.
    """
    above = np.where(np.isfinite(room[0]) & (room[0] < 0), FARTHEST * -room[0], np.inf)
    finite = np.all(np.isfinite(room), axis=0)
    down, up = np.minimum([-room[0], room[1]], np.log(FARTHEST))
    return np.where(power == 0, np.expm1(up) + down, np.where(finite, room[1] - room[0], above))


def _whitened(rows: np.ndarray, aims: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives, (n, k), and residuals, (n,), in units in which noise is uncorrelated with variance 1."""
    root = cholesky(noise, lower=True)
    return solve_triangular(root, rows, lower=True), solve_triangular(root, aims, lower=True)


def _least_squares(rows: np.ndarray, aims: np.ndarray, room: np.ndarray) -> np.ndarray:
    """Return the step, (k,), within bounds, (2, k), that minimises |rows step - aims|; the shortest of several."""
    size = np.linalg.norm(rows, axis=0)
    free = (room[1] > room[0]) & (size > 0)
    step = np.zeros(rows.shape[1])
    if np.any(free):
        shortest = np.sqrt(ALIKE) * np.eye(int(np.sum(free)))
        scaled, sought = np.vstack([rows[:, free] / size[free], shortest]), np.append(aims, np.zeros(len(shortest)))
        with np.errstate(over="ignore"):  # an infinite bound is none
            within = room[:, free] * size[free]
        found = lsq_linear(scaled, sought, within, method="bvls")
        step[free] = found.x / size[free]
    return np.clip(step, *room)


def _squared(point: np.ndarray, aim: np.ndarray, power: np.ndarray, metric: np.ndarray) -> float:
    """Return the squared distance from a point in parameter units to a scaled one, by the weights `metric`, (k, k)."""
    apart = _scaled(point, power) - aim
    return float(apart @ metric @ apart)


def _scaled(value: np.ndarray, power: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(power == 0, np.log(value), np.power(value, np.where(power == 0, 1.0, power)))


def _unscaled(x: np.ndarray, power: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.where(power == 0, np.exp(x), np.power(x, 1 / np.where(power == 0, 1.0, power)))


def _stretch(value: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Return the derivative, (k,), of each scaled parameter (a power or logarithm) with respect to the parameter."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(power == 0, 1 / value, power * np.power(value, power - 1))


def _words(names: Sequence[str], values: np.ndarray) -> str:
    return ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, values, strict=True))
