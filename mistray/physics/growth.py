"""Function (exp(x) - 1)/x without loss of digits near 0, for the totals of lobes."""

from __future__ import annotations

from typing import Any

from mistray.physics._arrays import arithmetic

# Below this |x| the series is summed; 9 terms are exact to 1e-16.
_SERIES = 0.05
_TERMS = 9


def growth(x: Any) -> Any:
    """
    Return (exp(x) - 1)/x, which is 1 at x = 0.

    Parameters
    ----------
    x : float or array
        Any real number.

    Returns
    -------
    float or array
        Value in the shape of `x`; differentiable in Dr.Jit, also at 0. It is computed in float64.
    """
    xp = arithmetic(x)
    wide = xp.real(x)
    term = series = 1 + 0 * wide
    for k in range(2, _TERMS + 1):
        term = term * wide / k
        series = series + term
    small = (wide > -_SERIES) & (wide < _SERIES)
    return xp.result(xp.select(small, series, (xp.exp(wide) - 1) / xp.select(small, 1.0, wide)))
