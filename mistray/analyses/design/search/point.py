"""Merit and gradient at one point of a search, with the penalties by themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Pieces:
    """
    The merit split into a smooth part and penalties that are weighted squares of residuals.

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
        """Return the sum of the penalties for given residuals, (m,)."""
        counted = np.where(self.one_sided, np.maximum(residuals, 0.0), residuals)
        return float(np.sum(self.weights * counted**2))

    @property
    def multipliers(self) -> np.ndarray:
        """Return the derivatives of the penalties with respect to their residuals, (m,)."""
        counted = np.where(self.one_sided, np.maximum(self.residuals, 0.0), self.residuals)
        return np.asarray(2 * self.weights * counted)


@dataclass(frozen=True)
class Point:
    """
    The merit at one point of the unit cube.

    Attributes
    ----------
    merit : float
    slope : (n,) float64
        Gradient of the merit with respect to the point.
    pieces : Pieces or None
        Smooth part and penalties; None unless the terms were differentiated one by one.
    """

    merit: float
    slope: np.ndarray
    pieces: Pieces | None = None


Merit = Callable[[np.ndarray], Point]  # a point of the unit cube, (n,) → what is known there
AfterStep = Callable[[np.ndarray], None]  # called with the point after each step; an exception of it ends the search
