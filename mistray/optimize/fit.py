"""The inverse problem: parameters of a model from measured numbers, with the covariance of the estimate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from mistray.errors import MistrayError
from mistray.optimize.pst_bands import Modelled
from mistray.percent import percent_text

Model = Callable[[np.ndarray], Modelled]
STEPS = 30
SETTLED = 1.0  # standard deviations; a shorter step is taken with the derivatives as they are
LONGEST = np.log(3.0)  # change of the logarithm of a parameter in one step
DAMPING = 1e-3  # of Levenberg and Marquardt, at the start
MOST_DAMPING = 1e6


@dataclass(frozen=True)
class Fit:
    """
    Result of `fit`.

    Attributes
    ----------
    names : tuple of str
        Of the parameters, (k,).
    value : (k,) float64
        The estimate.
    covariance : (k, k) float64
        Of its natural logarithms: relative variances.
    residual : (n,) float64
        Observed less modelled.
    noise : (n, n) float64
        Covariance of the residual: noise of the data and of the model.
    chi_square : float
    history : tuple of (k,) float64
        The values that were accepted, the start first, the estimate last.
    evaluations : int
    """

    names: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    noise: np.ndarray
    chi_square: float
    history: tuple[np.ndarray, ...]
    evaluations: int

    @property
    def estimate(self) -> dict[str, float]:
        """Name → value."""
        return dict(zip(self.names, self.value.tolist(), strict=True))

    @property
    def relative_error(self) -> np.ndarray:
        """(k,) standard deviations of the logarithms."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> np.ndarray:
        """(k, k)."""
        return np.asarray(self.covariance / np.outer(self.relative_error, self.relative_error))

    @property
    def degrees(self) -> int:
        """Degrees of freedom of `chi_square`."""
        return len(self.residual) - len(self.names)

    @property
    def probability(self) -> float:
        """That noise alone makes `chi_square` as large or larger; if tiny, the model is not that of the data."""
        return float(chi2.sf(self.chi_square, self.degrees))

    def distance(self, values: Mapping[str, float]) -> float:
        """Squared distance of other values in units of the covariance, of the logarithms: χ² with k degrees."""
        apart = np.log([values[name] for name in self.names]) - np.log(self.value)
        return float(apart @ np.linalg.solve(self.covariance, apart))

    def covers(self, values: Mapping[str, float], probability: float = 0.95) -> bool:
        """Whether values lie in the region that holds the truth with this probability."""
        return self.distance(values) <= float(chi2.ppf(probability, len(self.names)))

    def __str__(self) -> str:
        lines = [
            f"{name} = {value:.4g} ± {percent_text(error)}"
            for name, value, error in zip(self.names, self.value, self.relative_error, strict=True)
        ]
        return "\n".join(
            [*lines, f"χ² = {self.chi_square:.1f} with {self.degrees} degrees of freedom, P = {self.probability:.2g}"]
        )


def fit(
    model: Model,
    observed: Sequence[float] | np.ndarray,
    noise: Sequence[float] | np.ndarray,
    start: Mapping[str, float],
    *,
    low: Sequence[float] | np.ndarray | float = 0.0,
    high: Sequence[float] | np.ndarray | float = np.inf,
    steps: int = STEPS,
) -> Fit:
    """
    Positive parameters that make a model agree with data, by weighted least squares in their logarithms.

    Levenberg and Marquardt's method (D. W. Marquardt, J. SIAM 11, 1963). The weights are the inverse of the covariance
    of the data plus that of the model's own Monte Carlo noise, renewed at every step; the covariance of the estimate is
    (Jᵀ W J)⁻¹. It ends with the first step that is shorter than a standard deviation, without another evaluation: the
    noise of the model is then that of one evaluation, which is in the covariance.

    Parameters
    ----------
    model : callable
        Takes values of the parameters, (k,), and returns a `Modelled`, such as a `PstBands`.
    observed : (n,) float
    noise : (n,) or (n, n) float
        Standard errors of the data, or their covariance.
    start : mapping of str to float
        Name → first guess, in the order in which the model takes them; greater than 0.
    low, high : float or (k,) float
        What the parameters can be.
    steps : int
        Most evaluations of the model.

    Returns
    -------
    Fit

    Raises
    ------
    MistrayError
        For shapes and values that do not fit, data that do not tell the parameters apart, and if it does not settle.
    """
    names, guess = tuple(start), np.array(list(start.values()), dtype=np.float64)
    data, spread = np.asarray(observed, dtype=np.float64), np.asarray(noise, dtype=np.float64)
    if data.ndim != 1 or len(data) <= len(names) or not np.all(np.isfinite(data)):
        raise MistrayError(
            f"{data.size} observed numbers for {len(names)} parameters; give more finite numbers than parameters"
        )
    if spread.shape not in (data.shape, 2 * data.shape):
        raise MistrayError(f"noise has the shape {spread.shape}; give {len(data)} standard errors or their covariance")
    if spread.ndim == 1:
        spread = np.diag(np.square(spread))
    if not np.all(np.diag(spread) > 0):
        raise MistrayError("noise has a standard error of 0; every number needs one greater than 0")
    if not np.all(guess > 0):
        raise MistrayError(f"start is {dict(start)}; parameters are fitted in their logarithms and must be above 0")
    floor = np.broadcast_to(np.asarray(low, dtype=np.float64), guess.shape)
    with np.errstate(divide="ignore"):
        bounds = np.log(floor), np.log(np.broadcast_to(np.asarray(high, dtype=np.float64), guess.shape))
    x, damping, evaluations = np.clip(np.log(guess), *bounds), DAMPING, 1
    here = _evaluate(model, x, data)
    history = [np.exp(x)]
    while True:
        weights = cho_factor(spread + here.covariance)
        residual = data - here.value
        by_log = here.jacobian * np.exp(x)
        curvature, slope = by_log.T @ cho_solve(weights, by_log), by_log.T @ cho_solve(weights, residual)
        scale = np.diag(curvature)
        if not np.all(scale > 0) or np.linalg.cond(curvature / np.sqrt(np.outer(scale, scale))) > 1e12:
            raise MistrayError(f"the data do not tell {', '.join(names)} apart; fix one of them or add other data")
        ahead = np.linalg.solve(curvature, slope)
        chi_square = float(residual @ cho_solve(weights, residual))
        ahead = np.clip(x + ahead, *bounds) - x
        if ahead @ curvature @ ahead < SETTLED**2:
            left = residual - by_log @ ahead
            return Fit(
                names,
                np.exp(x + ahead),
                np.linalg.inv(curvature),
                left,
                spread + here.covariance,
                float(left @ cho_solve(weights, left)),
                (*history, np.exp(x + ahead)),
                evaluations,
            )
        while True:
            if evaluations >= steps or damping > MOST_DAMPING:
                at = ", ".join(f"{name} = {v:.4g}" for name, v in zip(names, np.exp(x), strict=True))
                raise MistrayError(
                    f"no fit after {evaluations} evaluations, at {at}, χ² = {chi_square:.4g}; start closer, or trace "
                    "more rays"
                )
            move = np.linalg.solve(curvature + damping * np.diag(scale), slope)
            move *= min(1.0, LONGEST / float(np.max(np.abs(move))))
            tried = np.clip(x + move, *bounds)
            there = _evaluate(model, tried, data)
            evaluations += 1
            apart = data - there.value
            # At other values a model may have drawn other rays: χ² has noise of its own
            if float(apart @ cho_solve(weights, apart)) < chi_square + len(data):
                x, here, damping = tried, there, damping / 10
                history.append(np.exp(x))
                break
            damping *= 10


def _evaluate(model: Model, x: np.ndarray, data: np.ndarray) -> Modelled:
    found = model(np.exp(x))
    if found.value.shape != data.shape:
        raise MistrayError(f"the model gives {found.value.size} numbers for {data.size} that were observed")
    return found
