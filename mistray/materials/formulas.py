"""Dispersion formulas n(λ): those of refractiveindex.info's pages, those of Zemax AGF files, and nd with Vd.

Wavelengths λ are in µm and coefficients in the powers of µm that match; `cauchy_index` takes λ in nm. Formulas 1 to 9
of refractiveindex.info are those of its note "Dispersion formulas". Formulas 1 to 13 of AGF files are those of the
OpticStudio manual, "The Glass Dispersion Formulas". Where a formula has no value (a pole, or n² < 0) it raises
ArithmeticError or ValueError.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

LINE_D_NM = 587.5618
LINE_F_NM = 486.1327
LINE_C_NM = 656.2725

CAUCHY_RANGE_NM = (400.0, 1000.0)
"""Range of wavelengths, nm, in which nd and Vd are considered sufficient; see `cauchy_index` for the error."""

Formula = Callable[[Sequence[float], float], float]


def cauchy_index(nd: float, vd: float, wavelength_nm: float) -> float:
    """
    Return the index n of a glass of which only nd and Vd are known, at a wavelength λ in nm: n = A + B/λ².

    A and B follow from n(d) = nd and n(F) - n(C) = (nd - 1)/Vd. nd and Vd say nothing about partial dispersion, so a
    third term would be a guess. Greatest error against the Sellmeier formulas of eleven glasses, from N-BK7 to N-SF11,
    fused silica and sapphire:

    ============  ==================  =======================
    range, nm     crowns (Vd > 50)    dense flints (Vd = 25)
    ============  ==================  =======================
    480 … 660     1e-4                7e-4
    430 … 700     2.5e-4              3.5e-3
    400 … 1000    2e-3                7.5e-3
    ============  ==================  =======================

    Examples
    --------
    >>> print(f"{mistray.materials.cauchy_index(1.5168, 64.17, 486.1):.4f}")
    1.5224
    >>> print(f"{mistray.materials.refractive_index('N-BK7', 486.1):.4f}")
    1.5224
    """
    b = (nd - 1) / vd / (LINE_F_NM**-2 - LINE_C_NM**-2)
    return nd + b * (wavelength_nm**-2 - LINE_D_NM**-2)


def _pairs(c: Sequence[float]) -> Iterable[tuple[float, float]]:
    """Return the pairs (c0, c1), (c2, c3), … without those whose first value is 0; catalogues pad rows with them."""
    return ((a, b) for a, b in zip(c[::2], c[1::2], strict=True) if a != 0)


def _powers(c: Sequence[float], exponents: Sequence[float], x: float) -> float:
    """Return the sum Σ c x^e over coefficients c and exponents e; x is the wavelength λ in µm."""
    return sum(a * x**e for a, e in zip(c, exponents, strict=True) if a != 0)


def _poles(c: Sequence[float], x: float) -> float:
    """Return the sum Σ B x²/(x² - C) over pairs (B, C); x is the wavelength in µm, C is in µm²."""
    return sum(b * x * x / (x * x - pole) for b, pole in _pairs(c))


def _power_pairs(c: Sequence[float], x: float) -> float:
    """Return the sum Σ a x^e over pairs (a, e); x is the wavelength in µm."""
    return sum(a * x**e for a, e in _pairs(c))


def _herzberger(c: Sequence[float], x: float) -> float:
    """Return Herzberger's n (1959) = A + B L + C L² + D λ² + E λ⁴ + …, with L = 1/(λ² - 0.028) and λ in µm."""
    pole = 1 / (x * x - 0.028)
    return c[0] + c[1] * pole + c[2] * pole**2 + sum(a * x ** (2 * i) for i, a in enumerate(c[3:], 1))


def _ri_resonances(c: Sequence[float], x: float) -> float:
    """Return n from n² = C1 + C2 λ^C3/(λ² - C4^C5) + C6 λ^C7/(λ² - C8^C9) + Σ C10 λ^C11 …, λ in µm."""
    square = c[0]
    for a, e, pole, power in (c[i : i + 4] for i in (1, 5) if len(c) > i):
        square += a * x**e / (x * x - pole**power) if a != 0 else 0
    return math.sqrt(square + _power_pairs(c[9:], x))


def _ri_retro(c: Sequence[float], x: float) -> float:
    """Return n from (n² - 1)/(n² + 2) = C1 + C2 λ²/(λ² - C3) + C4 λ², λ in µm."""
    ratio = c[0] + c[1] * x * x / (x * x - c[2]) + c[3] * x * x
    return math.sqrt((1 + 2 * ratio) / (1 - ratio))


def _ri_exotic(c: Sequence[float], x: float) -> float:
    """Return n from n² = C1 + C2/(λ² - C3) + C4 (λ - C5)/((λ - C5)² + C6), λ in µm."""
    return math.sqrt(c[0] + c[1] / (x * x - c[2]) + c[3] * (x - c[4]) / ((x - c[4]) ** 2 + c[5]))


PAGE_FORMULAS: dict[int, Formula] = {
    1: lambda c, x: math.sqrt(1 + c[0] + sum(b * x * x / (x * x - pole**2) for b, pole in _pairs(c[1:]))),
    2: lambda c, x: math.sqrt(1 + c[0] + _poles(c[1:], x)),
    3: lambda c, x: math.sqrt(c[0] + _power_pairs(c[1:], x)),
    4: _ri_resonances,
    5: lambda c, x: c[0] + _power_pairs(c[1:], x),
    6: lambda c, x: 1 + c[0] + sum(b / (pole - x**-2) for b, pole in _pairs(c[1:])),
    7: _herzberger,
    8: _ri_retro,
    9: _ri_exotic,
}
"""Functions n(coefficients, wavelength in µm), by the number of a page's formula."""

_SCHOTT = (0, 2, -2, -4, -6, -8)

AGF_FORMULAS: dict[int, tuple[str, int, Formula]] = {
    1: ("Schott", 6, lambda c, x: math.sqrt(_powers(c, _SCHOTT, x))),
    2: ("Sellmeier 1", 6, lambda c, x: math.sqrt(1 + _poles(c, x))),
    3: ("Herzberger", 6, _herzberger),
    4: (
        "Sellmeier 2",
        5,
        lambda c, x: math.sqrt(1 + c[0] + _poles((c[1], c[2] ** 2), x) + (c[3] / (x * x - c[4] ** 2) if c[3] else 0)),
    ),
    5: ("Conrady", 3, lambda c, x: _powers(c, (0, -1, -3.5), x)),
    6: ("Sellmeier 3", 8, lambda c, x: math.sqrt(1 + _poles(c, x))),
    7: (
        "Handbook of Optics 1",
        4,
        lambda c, x: math.sqrt(c[0] + (c[1] / (x * x - c[2]) if c[1] else 0) - c[3] * x * x),
    ),
    8: ("Handbook of Optics 2", 4, lambda c, x: math.sqrt(c[0] + _poles(c[1:3], x) - c[3] * x * x)),
    9: ("Sellmeier 4", 5, lambda c, x: math.sqrt(c[0] + _poles(c[1:], x))),
    10: ("Extended", 8, lambda c, x: math.sqrt(_powers(c, (*_SCHOTT, -10, -12), x))),
    11: ("Sellmeier 5", 10, lambda c, x: math.sqrt(1 + _poles(c, x))),
    12: ("Extended 2", 8, lambda c, x: math.sqrt(_powers(c, (*_SCHOTT, 4, 6), x))),
    13: ("Extended 3", 9, lambda c, x: math.sqrt(_powers(c, (0, 2, 4, -2, -4, -6, -8, -10, -12), x))),
}
"""Name, number of coefficients and n(coefficients, wavelength in µm), by the number of an AGF formula."""
