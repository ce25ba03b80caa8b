"""Square root for floats, NumPy and Dr.Jit arrays, so that a formula is written once."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def sqrt(x: Any) -> Any:
    """Square root of ``x``; NaN below zero, in the array library of ``x``.

    Parameters
    ----------
    x : float, numpy.ndarray or Dr.Jit array
        Any shape.

    Returns
    -------
    float, numpy.ndarray or Dr.Jit array
        Same type and shape as ``x``.
    """
    if isinstance(x, (int, float)):
        return math.sqrt(x) if x >= 0 else math.nan
    if isinstance(x, (np.ndarray, np.generic)):
        with np.errstate(invalid="ignore"):
            return np.sqrt(x)
    import drjit as dr

    return dr.sqrt(x)
