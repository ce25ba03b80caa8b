"""CIE standards, from the package colour-science: observer, luminous efficiency of the eye, daylight."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
OBSERVER = "CIE 1931 2 Degree Standard Observer"
# Of light with V = 1. The candela has 683 lm/W at 540 THz, where V is 0.999997 (ISO 23539:2023)
LUMENS_PER_WATT = 683.002
VISIBLE_NM = (360.0, 830.0)  # where V is known


def colour_science() -> Any:
    """
    Import and return the package ``colour``; it is imported only when needed, because this takes a second.

    The import changes how NumPy prints numbers, and so the digits that pandas writes to CSV; this change is undone.
    """
    with np.printoptions():
        import colour
    return colour


def observer() -> tuple[Array, Array]:
    """Return wavelengths (n,), nm, and x̄, ȳ, z̄ (n, 3) of the CIE 1931 2° observer (ISO/CIE 11664-1), 360 … 830 nm."""
    table = colour_science().MSDS_CMFS[OBSERVER]
    return np.asarray(table.wavelengths, dtype=np.float64), np.asarray(table.values, dtype=np.float64)


def luminous_efficiency(wavelength_nm: npt.ArrayLike) -> Array:
    """Return the luminous efficiency V(λ), 0 … 1, of the eye by day (ISO 23539), λ in nm; 0 outside 360 … 830 nm."""
    wavelengths, values = observer()
    return np.interp(np.asarray(wavelength_nm, dtype=np.float64), wavelengths, values[:, 1], left=0.0, right=0.0)


@functools.lru_cache(maxsize=1024)
def luminous_efficacy(wavelength_nm: float) -> float:
    """Return the luminous efficacy of light of one wavelength in nm: 683.002 lm/W times V(λ)."""
    return LUMENS_PER_WATT * float(luminous_efficiency(wavelength_nm))


def daylight() -> tuple[Array, Array]:
    """Return wavelengths (n,), nm, and relative power (n,) of the illuminant D65 (ISO/CIE 11664-2), 300 … 780 nm."""
    table = colour_science().SDS_ILLUMINANTS["D65"]
    return np.asarray(table.wavelengths, dtype=np.float64), np.asarray(table.values, dtype=np.float64)
