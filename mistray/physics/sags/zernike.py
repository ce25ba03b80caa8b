"""Zernike polynomials over a disc: standard ones of unit variance in the order of Noll, and Fringe ones.

Standard: R. J. Noll, "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66, 207 (1976). Fringe: J.
Wyant and K. Creath, "Basic wavefront aberration theory for optical metrology", Applied Optics and Optical Engineering
XI (1992), table 4, with unit value at the rim. The azimuth of the point (x, y) is counted from the x axis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

LAST_STANDARD, LAST_FRINGE = 231, 37


def noll_orders(j: int) -> tuple[int, int]:
    """Return the radial order n and azimuthal order m of the polynomial of Noll index j ≥ 1; m < 0 for a sine."""
    n = (math.isqrt(8 * j - 7) - 1) // 2
    first = n * (n + 1) // 2  # polynomials of lower order
    place = j - first  # 1 … n + 1
    m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place - 1) // 2) + 1
    return n, m if j % 2 == 0 else -m


def fringe_orders(j: int) -> tuple[int, int]:
    """Return the radial order n and azimuthal order m of the polynomial of Fringe index j, 1 … 37; m < 0 for a sine."""
    if j == LAST_FRINGE:
        return 12, 0
    half = math.isqrt(j - 1)  # (n + |m|)/2
    place = j - 1 - half * half  # 0 … 2 half
    m = half - place // 2
    return 2 * half - m, m if place % 2 == 0 else -m


def polynomial(n: int, m: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """
    Return the Zernike polynomial R_n^|m|(ρ) cos mφ, or with sin |m|φ for m < 0; it is 1 at ρ = 1 on the x axis.

    Parameters
    ----------
    n, m : int
        Radial and azimuthal order; |m| ≤ n, n - |m| even.
    x, y : ndarray
        Coordinates in units of the radius of the disc; the result has their shape.
    """
    order, r2 = abs(m), x * x + y * y
    radial = np.zeros_like(r2)
    for k in range((n - order) // 2 + 1):
        factor = (-1) ** k * math.comb(n - k, k) * math.comb(n - 2 * k, (n - order) // 2 - k)
        radial = radial + factor * r2 ** ((n - order) // 2 - k)
    turned = (x + 1j * y) ** order  # ρ^|m| exp(i |m| φ)
    return np.asarray(radial * (turned.imag if m < 0 else turned.real))


def standard(x: np.ndarray, y: np.ndarray, terms: Mapping[int, float]) -> np.ndarray:
    """
    Return a sum of standard Zernike polynomials, in the unit of their coefficients, which are keyed by Noll index.

    Coordinates x, y are in units of the radius of the disc.
    """
    total = np.zeros(np.broadcast(x, y).shape)
    for j, amount in terms.items():
        n, m = noll_orders(j)
        total = total + amount * math.sqrt((n + 1) * (2 if m else 1)) * polynomial(n, m, x, y)
    return total


def fringe(x: np.ndarray, y: np.ndarray, terms: Mapping[int, float]) -> np.ndarray:
    """
    Return a sum of Fringe Zernike polynomials, in the unit of their coefficients, which are keyed by Fringe index.

    Coordinates x, y are in units of the radius of the disc.
    """
    total = np.zeros(np.broadcast(x, y).shape)
    for j, amount in terms.items():
        total = total + amount * polynomial(*fringe_orders(j), x, y)
    return total
