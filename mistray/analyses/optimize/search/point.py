"""Interface of search methods, and the merit with its gradient at one point, which they use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from mistray.analyses.optimize.study.model import Optimizer


@dataclass(frozen=True)
class Pieces:
    """
    Merit split into a smooth part and penalties, which are weighted squares of residuals of the limits.

    All numbers are dimensionless. Gradients are with respect to the n scaled variables, see `Point`.

    Attributes
    ----------
    slope : (n,) float64
        Gradient of the smooth part.
    weights : (m,) float64
        Weights of the penalties: one adds weight · r², or weight · max(r, 0)² if it is one-sided.
    residuals : (m,) float64
        Residuals r of the penalties.
    rows : (m, n) float64
        Gradients of r.
    one_sided : (m,) bool
        Whether a penalty counts positive residuals only.
    """

    slope: np.ndarray
    weights: np.ndarray
    residuals: np.ndarray
    rows: np.ndarray
    one_sided: np.ndarray

    def penalty(self, residuals: np.ndarray) -> float:
        """Return the sum of the penalties, dimensionless, for given residuals, (m,)."""
        counted = np.where(self.one_sided, np.maximum(residuals, 0.0), residuals)
        return float(np.sum(self.weights * counted**2))

    @property
    def multipliers(self) -> np.ndarray:
        """Derivatives of the penalties with respect to the residuals of the limits, (m,), dimensionless."""
        counted = np.where(self.one_sided, np.maximum(self.residuals, 0.0), self.residuals)
        return np.asarray(2 * self.weights * counted)


@dataclass(frozen=True)
class Point:
    """
    Merit and its gradient at one point of the unit cube: variables as fractions of the way between their bounds.

    Attributes
    ----------
    merit : float
        Merit, dimensionless.
    slope : (n,) float64
        Gradient of the merit with respect to the point.
    pieces : Pieces or None
        Smooth part and penalties of the merit; None unless the terms were differentiated one by one.
    """

    merit: float
    slope: np.ndarray
    pieces: Pieces | None = None


Merit = Callable[[np.ndarray], Point]  # a point of the unit cube, (n,) → what is known there
AfterStep = Callable[[np.ndarray], None]  # called with the point after each step; an exception of it ends the search


class Search(Protocol):
    """Interface of a search method, which minimises a merit within bounds along its gradient."""

    def __call__(self, function: Merit, y0: np.ndarray, optimizer: Optimizer, after: AfterStep, /) -> str:
        """
        Minimise a merit from a start point; return the reason why the search ended.

        Parameters
        ----------
        function : callable
            Function of a point in the unit cube, (n,), that returns a `Point`. It must be the same at every call,
            unless the method says otherwise.
        y0 : (n,) float64
            Start, a point of the unit cube.
        optimizer : Optimizer
            Settings of the search; each method documents its `step_size`.
        after : callable
            Called with the point after each step; ends the search by an exception.

        Returns
        -------
        str
            Reason why the search ended by itself.
        """
