"""Real and complex arithmetic for floats, NumPy and Dr.Jit arrays, so that a formula is written once."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np


def sqrt(x: Any) -> Any:
    """
    Return the square root of ``x``; NaN below zero, in the array library of ``x``.

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


def arctan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y) from the x axis, rad, -π … π, in the array library of the arguments."""
    if all(isinstance(v, int | float | np.ndarray | np.generic) for v in (x, y)):
        return np.arctan2(y, x)
    import drjit as dr

    return dr.atan2(y, x)


@dataclass(frozen=True)
class Arithmetic:
    """
    Functions of an array library that formulas with complex numbers need, computed in float64.

    Attributes
    ----------
    real : callable
        Makes a float64 array from a real number or array.
    complex : callable
        Makes a complex array of double precision from arrays of real and imaginary parts.
    re, im : callable
        Real and imaginary part of a number or array, real or complex.
    is_real : callable
        Whether a number or array is real: by its type in Dr.Jit, by its values in NumPy.
    sqrt, exp, log, sincos, maximum, select, detach : callable
        Functions of the same names in Dr.Jit.
    result : callable
        Brings a result to the precision of the arguments in Dr.Jit; in NumPy it stays as it is.
    """

    real: Any
    complex: Any
    re: Any
    im: Any
    is_real: Any
    sqrt: Any
    exp: Any
    log: Any
    sincos: Any
    maximum: Any
    select: Any
    detach: Any
    result: Any


def arithmetic(*values: Any) -> Arithmetic:
    """
    Return the arithmetic for the numbers and arrays of one formula.

    Parameters
    ----------
    *values : number, numpy.ndarray or Dr.Jit array
        All arguments of the formula.

    Returns
    -------
    Arithmetic
        Functions of Dr.Jit if one of the values is a Dr.Jit array, else functions of NumPy.
    """
    kinds = [type(value) for value in values if type(value).__module__.startswith("drjit.")]
    if not kinds:
        return _NUMPY
    import drjit as dr

    widest = dr.expr_t(*kinds)
    module = sys.modules[widest.__module__]
    given = dr.value_t(widest) if dr.is_complex_v(widest) else widest
    given_complex = module.Complex2f64 if given is module.Float64 else module.Complex2f

    def part(of_array: Any, of_number: Any) -> Any:
        return lambda x: of_array(x) if dr.is_array_v(x) else of_number(x)

    return Arithmetic(
        real=module.Float64,
        complex=module.Complex2f64,
        re=part(dr.real, np.real),
        im=part(dr.imag, np.imag),
        is_real=lambda x: not (dr.is_complex_v(x) if dr.is_array_v(x) else np.any(np.imag(x))),
        sqrt=dr.sqrt,
        exp=dr.exp,
        log=dr.log,
        sincos=dr.sincos,
        maximum=dr.maximum,
        select=dr.select,
        detach=dr.detach,
        result=lambda x: (given_complex if dr.is_complex_v(x) else given)(x),
    )


def _float64(x: Any) -> np.ndarray:
    return np.asarray(x, dtype=np.float64)


def _complex128(re: Any, im: Any) -> np.ndarray:
    result = np.empty(np.broadcast(re, im).shape, dtype=np.complex128)
    result.real, result.imag = re, im
    return result


_NUMPY = Arithmetic(
    real=_float64,
    complex=_complex128,
    re=np.real,
    im=np.imag,
    is_real=lambda x: not np.any(np.imag(x)),
    sqrt=np.sqrt,
    exp=np.exp,
    log=np.log,
    sincos=lambda x: (np.sin(x), np.cos(x)),
    maximum=np.maximum,
    select=np.where,
    detach=lambda x: x,
    result=lambda x: x,
)
