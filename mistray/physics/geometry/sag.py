"""Sag of a conic of revolution with even polynomial terms.

Lengths in mm; r² in mm²; curvature in 1/mm; coefficients in mm^(1-2i) for r^(2i), i = 2, 3, ….
Single precision ends at 1e-38 and 3e38, which such coefficients pass at apertures of 300 mm and 1 µm. `in_proportion`
gives them in units of the surface's own size instead: all are then lengths^-1, as the curvature is.

Every function takes floats, NumPy arrays or Dr.Jit arrays and uses operators only, so the tracing kernel, the shape
plugins and the float64 checks share one formula.

The conic term is ``c r² / (1 + sqrt(1 - (1 + k) c² r²))`` (the standard "even asphere" of lens design, for example
D. Malacara and Z. Malacara, *Handbook of Optical Design*, 2nd ed., appendix 2). It ends at r = 1/(c sqrt(1 + k)) when
k > -1; beyond this radius the functions return NaN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from mistray.physics._arrays import sqrt


def sag(r2: Any, curvature: Any, conic: Any, coefficients: Sequence[Any] = (), per_area: Any = 1) -> Any:
    """Sag z(r) along +z, zero at the vertex.

    Parameters
    ----------
    r2 : float or array
        Squared distance from the axis, mm², ≥ 0.
    curvature : float or array
        1/radius, 1/mm; 0 is a plane. Positive: centre of curvature on the +z side.
    conic : float or array
        Conic constant k; 0 sphere, -1 paraboloid.
    coefficients : sequence of float or array
        ``(a4, a6, …)``: mm⁻³, mm⁻⁵, …; may be empty. With another ``per_area``, those of `in_proportion`, in 1/mm.
    per_area : float or array
        w in the polynomial Σ b_i r² (w r²)^(i-1), 1/mm²; with 1 the coefficients are the usual ones.

    Returns
    -------
    float or array
        Sag in mm, in the shape of ``r2``; NaN where the conic has ended.
    """
    conic_term = curvature * r2 / (1 + sqrt(1 - (1 + conic) * curvature * curvature * r2))
    return conic_term + polynomial(r2, coefficients, per_area)


def sag_derivative(r2: Any, curvature: Any, conic: Any, coefficients: Sequence[Any] = (), per_area: Any = 1) -> Any:
    """Derivative of the sag with respect to r², dz/d(r²) in 1/mm.

    The slope is dz/dr = 2 r dz/d(r²) and a normal at (x, y) is (-2x d, -2y d, 1) with d = dz/d(r²): no division by r,
    hence exact at the vertex. Parameters as in `sag`.
    """
    conic_term = 0.5 * curvature / sqrt(1 - (1 + conic) * curvature * curvature * r2)
    return conic_term + polynomial_derivative(r2, coefficients, per_area)


def polynomial(r2: Any, coefficients: Sequence[Any], per_area: Any = 1) -> Any:
    """The polynomial terms of the sag, mm. Parameters as in `sag`."""
    value: Any = 0
    u2 = r2 * per_area
    for a in reversed(coefficients):
        value = (value + a) * u2
    return value * r2


def polynomial_derivative(r2: Any, coefficients: Sequence[Any], per_area: Any = 1) -> Any:
    """Derivative of the polynomial terms with respect to r², 1/mm. Parameters as in `sag`."""
    value: Any = 0
    u2 = r2 * per_area
    power = len(coefficients) + 1
    for a in reversed(coefficients):
        value = (value + power * a) * u2
        power -= 1
    return value


def polynomial_second_derivative(r2: Any, coefficients: Sequence[Any]) -> Any:
    """Second derivative of the polynomial terms with respect to r², mm⁻³. Parameters as in `sag`."""
    value: Any = 0
    power = len(coefficients) + 1
    for a in reversed(coefficients):
        value = value * r2 + power * (power - 1) * a
        power -= 1
    return value


def in_proportion(coefficients: Sequence[float], radius: float) -> tuple[tuple[float, ...], float]:
    """
    Coefficients in units of a surface's own size, for single precision.

    Parameters
    ----------
    coefficients : sequence of float
        ``(a4, a6, …)``, mm⁻³, mm⁻⁵, ….
    radius : float
        Size of the surface, 1e-15 … 1e15 mm.

    Returns
    -------
    coefficients : tuple of float
        b_i = a_2i R^(2i-2) in 1/mm; infinite where that is beyond double precision.
    per_area : float
        1/R² in 1/mm². R is the power of two next to `radius`: nothing is rounded.
    """
    exponent = round(math.log2(radius))
    scaled = tuple(a * 2.0 ** (2 * i * exponent) for i, a in enumerate(coefficients, start=1))
    return scaled, math.ldexp(1.0, -2 * exponent)


def conic_end(curvature: float, conic: float) -> float:
    """Radius in mm at which the conic term ends (its slope is infinite there); ``inf`` when it never does."""
    q = (1 + conic) * curvature * curvature
    return 1 / math.sqrt(q) if q > 0 else math.inf
