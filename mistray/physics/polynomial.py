"""Polynomial and binomial BSDFs, for fits to measured data of isotropic surfaces.

With the direction cosines β of the scattered and β0 of the specular direction, tangential to the surface, scatter of an
isotropic surface depends on four invariants,

    U = |β|²,   W = |β0|²,   V = β·β0,   T = |β - β0|² = U - 2V + W,

and the BSDF is

    log10 BSDF = Σ c_ijk (U + W)^i (U W)^j V^k + Σ l_jk V^k log10(1 + d^j T).

The first sum is the diffuse part, the second the Lorentzian one, a peak about the specular direction whose knee lies at
|β - β0| = d^(-j/2). Exchange of the two directions exchanges U and W and changes nothing: every such BSDF is
reciprocal. Without j in the first sum it is the binomial form. A. W. Greynolds introduced the invariants and both sums;
FRED and ASAP have them as Binomial and Polynomial. Their sums are ordered differently, so that their coefficients
cannot be copied one by one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mistray.physics._arrays import arithmetic

LN10 = math.log(10)


def bsdf(
    sums: tuple[Any, Any, Any],
    t: Any,
    diffuse: Mapping[tuple[int, int, int], Any],
    lorentzian: Mapping[tuple[int, int], Any],
    d: Any,
) -> Any:
    """
    Return the polynomial BSDF, 1/sr, 10 to the power Σ c_ijk (U + W)^i (U W)^j V^k + Σ l_jk V^k log10(1 + d^j T).

    The invariants of the direction cosines, β scattered and β0 specular, are U = |β|², W = |β0|², V = β·β0 and
    T = |β - β0|².

    Parameters
    ----------
    sums : tuple of float or array
        Sums U + W and U W, and V.
    t : float or array
        Invariant T, ≥ 0.
    diffuse : mapping
        Coefficients c_ijk by (i, j, k).
    lorentzian : mapping
        Coefficients l_jk by (j, k).
    d : float or array
        Base d of the Lorentzian terms, > 0.

    Returns
    -------
    float or array
        BSDF, 1/sr. Differentiable in the invariants, the coefficients and d in Dr.Jit.
    """
    xp = arithmetic(*sums, t, d, *diffuse.values(), *lorentzian.values())
    total = 0.0 * t
    for (i, j, k), c in diffuse.items():
        total = total + LN10 * c * _power(sums[0], i) * _power(sums[1], j) * _power(sums[2], k)
    for (j, k), c in lorentzian.items():
        total = total + c * xp.log(1 + _power(d, j) * t) * _power(sums[2], k)
    return xp.exp(total)


def _power(x: Any, n: int) -> Any:
    """Return x^n for integers n ≥ 0 as a product, so that 0^0 is 1 and the derivative at 0 is finite."""
    found: Any = 1.0
    for _ in range(n):
        found = found * x
    return found
