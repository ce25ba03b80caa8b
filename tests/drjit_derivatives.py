"""Derivatives of functions of numbers by Dr.Jit's automatic differentiation, in float64."""

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np


def forward_derivatives(function: Callable[..., Any], point: Sequence[float]) -> np.ndarray:
    """Derivatives by each argument, (arguments, …); the function takes Dr.Jit's arrays of doubles."""
    found = []
    for k in range(len(point)):
        arguments = [dr.llvm.ad.Float64(value) for value in point]
        dr.enable_grad(arguments[k])
        value = function(*arguments)
        dr.forward(arguments[k])
        found.append(np.squeeze(np.array(dr.grad(value))))
    return np.array(found)
