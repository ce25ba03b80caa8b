"""Sums over the cells of a PST and their quotients, with standard errors from the batches.

The cells of a backward trace share their start rays: a sum over cells is formed in every batch, and only then is the
spread of the batches taken. Where every cell has start rays of its own (forward), the errors of the cells are
independent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mistray.analysis.estimate import UNKNOWN, Estimate
from mistray.analysis.pst.result import Pst, members
from mistray.recorders.direction_recorder import CLASSES

Light = str | Sequence[str]


def weighted_sum(pst: Pst, coefficients: np.ndarray, classes: Light = "total") -> Estimate:
    """
    Sum of coefficients times PST over the cells.

    Parameters
    ----------
    pst : Pst
        In its own convention.
    coefficients : (n, m) float
    classes : str or sequence of str
        See `Pst.samples`.
    """
    hidden = np.sum(coefficients**2 * pst.hidden(classes))
    return _summed(coefficients[..., None] * pst.samples(classes), pst.weight, float(hidden))


def quotient(
    pst: Pst, above: tuple[np.ndarray, Light], below: tuple[np.ndarray, Light], floor: float = 0.0
) -> Estimate:
    """
    Quotient of two sums over the cells of one PST.

    Its error is that of the residual `above` - q `below`, to first order, and so knows how far both vary together.

    Parameters
    ----------
    pst : Pst
    above, below : tuple of (n, m) float and str
        Coefficients and light of the two sums.
    floor : float
        The quotient is unknown unless the lower sum is greater than this.
    """
    upper, lower = (k[..., None] * pst.samples(light) for k, light in (above, below))
    base = _summed(lower, pst.weight).value
    if not base > floor:
        return UNKNOWN
    value = _summed(upper, pst.weight).value / base
    # What is hidden is independent from class to class: in both sums it counts with the difference of its coefficients
    hidden = 0.0
    for name in CLASSES:
        k = sum(sign * part[0] for sign, part in ((1.0, above), (-value, below)) if name in members(part[1]))
        hidden += float(np.sum(np.square(k) * pst.hidden(name)))
    return Estimate(value, _summed(upper - value * lower, pst.weight, hidden).se / base)


def _summed(parts: np.ndarray, weight: np.ndarray, hidden: float = 0.0) -> Estimate:
    """Sum of the cells' parts, (n, m, b), over cells and batches, and the variance that they do not show."""
    if weight.ndim == 1:
        parts = parts.sum(axis=(0, 1))
    value = np.sum(weight * parts, axis=-1)
    used = np.maximum(np.count_nonzero(weight, axis=-1), 2)
    spread = np.sum(np.square(weight * (parts - value[..., None])), axis=-1) * used / (used - 1)
    return Estimate(float(np.sum(value)), float(np.sqrt(np.sum(spread) + hidden)))
