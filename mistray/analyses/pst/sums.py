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
from mistray.errors import MistrayError
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

    Raises
    ------
    MistrayError
        If a cell that counts was not traced.
    """
    require_traced(pst, coefficients)
    return _summed(times(coefficients[..., None], pst.samples(classes)), pst.weight)


def quotient(pst: Pst, above: tuple[np.ndarray, Light], below: tuple[np.ndarray, Light]) -> Estimate:
    """
    Return the quotient q of two sums of coefficients times PST over the cells, with its standard error.

    Its error is that of the residual `above` - q `below`, to first order, and so includes their covariance.

    Parameters
    ----------
    pst : Pst
        Point source transmittance (PST).
    above, below : tuple of (n, m) float and str
        Coefficients and light of the two sums. The quotient is `UNKNOWN` if the lower one is 0, and NaN if a cell that
        counts in the upper one was not traced.

    Raises
    ------
    MistrayError
        If a cell that counts in the lower sum was not traced.
    """
    require_traced(pst, below[0])
    upper, lower = (times(k[..., None], pst.samples(light)) for k, light in (above, below))
    base = _summed(lower, pst.weight).value
    if not base > 0:
        return UNKNOWN
    value = _summed(upper, pst.weight).value / base
    return Estimate(value, _summed(upper - value * lower, pst.weight).se / base)


def times(coefficients: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return coefficients times values; 0 where the coefficient is 0, also for NaN, the value of untraced cells."""
    return np.where(coefficients != 0, coefficients * values, 0.0)


def require_traced(pst: Pst, coefficients: np.ndarray) -> None:
    """Raise `MistrayError` if a cell with a coefficient other than 0, (n, m), was not traced, as its time was up."""
    counts = coefficients != 0
    missing = np.argwhere(counts & np.isnan(pst.by_batch).any(axis=(0, 3)))
    if len(missing):
        i, j = missing[0]
        raise MistrayError(
            f"PST: {len(missing)} of {np.count_nonzero(counts)} cells that count were not traced, for the time was up, "
            f"the first at {pst.field_deg[i]:g}°, azimuth {pst.grid.azimuths_deg[j]:g}°; give the run more seconds"
        )


def _summed(parts: np.ndarray, weight: np.ndarray) -> Estimate:
    """Return the sum over cells of weighted samples, (n, m, b), averaged over batches, with its standard error."""
    # Cells that share their start rays are correlated: they are summed before the spread is computed
    if weight.ndim == 1:
        parts = parts.sum(axis=(0, 1))
    value, se = Pst.estimate(parts, weight)
    return Estimate(float(np.sum(value)), float(np.linalg.norm(se)))
