"""Sag of a conic of revolution with even polynomial terms.

Lengths in mm; r² in mm²; curvature in 1/mm; coefficients in mm^(1-2i) for r^(2i), i = 2, 3, ….
Single precision ends at 1e-38 and 3e38, which such coefficients exceed at apertures of 300 mm and 1 µm. `in_proportion`
scales them to the surface's own size instead, so that all have the unit 1/mm like the curvature.

Every function takes floats, NumPy arrays or Dr.Jit arrays and uses operators only, so the tracing kernel, the shape
plugins and the float64 checks share one formula.

The conic term is ``c r² / (1 + sqrt(1 - (1 + k) c² r²))`` (the standard "even asphere" of lens design, for example
D. Malacara and Z. Malacara, *Handbook of Optical Design*, 2nd ed., appendix 2). It ends at r = 1/(c sqrt(1 + k)) when
k > -1; beyond this radius the functions return NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from mistray.physics._arrays import sqrt
from mistray.ranges import several


def trimmed(terms: float | Iterable[float]) -> tuple[float, ...]:
    """Return polynomial coefficients without the zeros at their end."""
    found = tuple(several(terms))
    return found[: max((place for place, term in enumerate(found, start=1) if term), default=0)]


def sag(r2: Any, curvature: Any, conic: Any, coefficients: float | Sequence[Any] = (), per_area: Any = 1) -> Any:
    """
    Return the sag z(r) along +z, mm, zero at the vertex.

    Parameters
    ----------
    r2 : float or array
        Squared distance from the axis, mm², ≥ 0.
    curvature : float or array
        Curvature 1/radius, 1/mm; 0 is a plane. It is positive if the centre of curvature is on the +z side.
    conic : float or array
        Conic constant k; 0 for a sphere, -1 for a paraboloid.
    coefficients : float, or sequence of float or array
        Coefficients ``(a4, a6, …)``: mm⁻³, mm⁻⁵, …; may be empty. With another ``per_area``, those of `in_proportion`,
        1/mm.
    per_area : float or array
        Factor w in the polynomial Σ b_i r² (w r²)^(i-1), 1/mm²; with 1 the coefficients are the usual ones.

    Returns
    -------
    float or array
        Sag in mm, in the shape of ``r2``; NaN beyond the end of the conic.
    """
    conic_term = curvature * r2 / (1 + sqrt(1 - (1 + conic) * curvature * curvature * r2))
    return conic_term + polynomial(r2, coefficients, per_area)


def sag_derivative(
    r2: Any, curvature: Any, conic: Any, coefficients: float | Sequence[Any] = (), per_area: Any = 1
) -> Any:
    """
    Return the derivative of the sag with respect to r², dz/d(r²), 1/mm.

    The slope is dz/dr = 2 r dz/d(r²), and a normal at (x, y) is (-2x d, -2y d, 1) with d = dz/d(r²). There is no
    division by r, so the vertex is exact. Parameters as in `sag`.
    """
    conic_term = 0.5 * curvature / sqrt(1 - (1 + conic) * curvature * curvature * r2)
    return conic_term + polynomial_derivative(r2, coefficients, per_area)


def polynomial(r2: Any, coefficients: float | Sequence[Any], per_area: Any = 1) -> Any:
    """Return the sum of the polynomial terms of the sag, mm; parameters as in `sag`."""
    value: Any = 0
    u2 = r2 * per_area
    for a in reversed(several(coefficients)):
        value = (value + a) * u2
    return value * r2


def polynomial_derivative(r2: Any, coefficients: float | Sequence[Any], per_area: Any = 1) -> Any:
    """Return the derivative of the polynomial terms with respect to r², 1/mm; parameters as in `sag`."""
    value: Any = 0
    u2 = r2 * per_area
    terms = several(coefficients)
    power = len(terms) + 1
    for a in reversed(terms):
        value = (value + power * a) * u2
        power -= 1
    return value


def polynomial_second_derivative(r2: Any, coefficients: float | Sequence[Any], per_area: Any = 1) -> Any:
    """Return the second derivative of the polynomial terms with respect to r², mm⁻³; parameters as in `sag`."""
    value: Any = 0
    u2 = r2 * per_area
    terms = several(coefficients)
    power = len(terms) + 1
    for a in reversed(terms):
        value = value * u2 + power * (power - 1) * a
        power -= 1
    return value * per_area


def in_proportion(coefficients: float | Sequence[float], radius: float) -> tuple[tuple[float, ...], float]:
    """
    Return aspheric coefficients scaled to a surface's own size, for single precision.

    Parameters
    ----------
    coefficients : float or sequence of float
        Coefficients ``(a4, a6, …)``, mm⁻³, mm⁻⁵, ….
    radius : float
        Size of the surface, 1e-15 … 1e15 mm.

    Returns
    -------
    coefficients : tuple of float
        Scaled coefficients b_i = a_2i R^(2i-2), 1/mm; infinite if beyond double precision.
    per_area : float
        Scale 1/R², 1/mm². R is the power of two nearest to `radius`, so that nothing is rounded.
    """
    exponent = round(math.log2(radius))
    scaled = tuple(a * 2.0 ** (2 * i * exponent) for i, a in enumerate(several(coefficients), start=1))
    return scaled, math.ldexp(1.0, -2 * exponent)


def conic_end(curvature: float, conic: float) -> float:
    """Return the radius, mm, at which the conic term of `sag` ends with an infinite slope; ``inf`` if it never does."""
    q = (1 + conic) * curvature * curvature
    return 1 / math.sqrt(q) if q > 0 else math.inf
