"""
Weighted sums over the cells of a PST, and quotients of such sums, with standard errors from the batches.

The cells of a backward trace share their start rays: a sum over cells is formed in every batch, and only then is the
spread of the batches computed. Where every cell has start rays of its own (forward), the errors of the cells are
independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mistray.analyses.pst.result import Pst
from mistray.estimate import UNKNOWN, Estimate

Light = str | Sequence[str]


def weighted_sum(pst: Pst, coefficients: np.ndarray, classes: Light = "total") -> Estimate:
    """
    Return the sum over the cells of coefficients times PST, in the unit of the coefficients, with its standard error.

    Parameters
    ----------
    pst : Pst
        PST in its own convention.
    coefficients : (n, m) float
        Factor of the PST of each cell.
    classes : str or sequence of str
        See `Pst.samples`.
    """
    return _summed(coefficients[..., None] * pst.samples(classes), pst.weight)


def quotient(
    pst: Pst, above: tuple[np.ndarray, Light], below: tuple[np.ndarray, Light], floor: float = 0.0
) -> Estimate:
    """
    Return the quotient q of two sums of coefficients times PST over the cells, with its standard error.

    Its error is that of the residual `above` - q `below`, to first order, and so includes their covariance.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    above, below : tuple of (n, m) float and str
        Coefficients and light of the two sums.
    floor : float
        Limit of the lower sum, at or below which the quotient is `UNKNOWN` (NaN); so it is if a cell is NaN.
    """
    upper, lower = (k[..., None] * pst.samples(light) for k, light in (above, below))
    base = _summed(lower, pst.weight).value
    if not base > floor:
        return UNKNOWN
    value = _summed(upper, pst.weight).value / base
    return Estimate(value, _summed(upper - value * lower, pst.weight).se / base)


def _summed(parts: np.ndarray, weight: np.ndarray) -> Estimate:
    """Return the sum over cells of weighted samples, (n, m, b), averaged over batches, with its standard error."""
    # Cells that share their start rays are correlated: they are summed before the spread is computed
    if weight.ndim == 1:
        parts = parts.sum(axis=(0, 1))
    value, se = Pst.estimate(parts, weight)
    return Estimate(float(np.sum(value)), float(np.linalg.norm(se)))
