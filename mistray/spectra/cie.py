"""Standards of the CIE: the observer, the luminous efficiency of the eye, daylight. From the package colour-science."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
OBSERVER = "CIE 1931 2 Degree Standard Observer"
LUMENS_PER_WATT = 683.0  # of light with V = 1: the definition of the candela


def colour_science() -> Any:
    """
    The package ``colour``, imported when it is needed because that takes a second.

    It changes on import how NumPy prints numbers, and with that the digits that pandas writes to CSV; that is undone.
    """
    with np.printoptions():
        import colour
    return colour


def observer() -> tuple[Array, Array]:
    """Wavelengths (n,), nm, and x̄, ȳ, z̄ (n, 3) of the CIE 1931 2° observer (ISO/CIE 11664-1), 360 … 830 nm."""
    table = colour_science().MSDS_CMFS[OBSERVER]
    return np.asarray(table.wavelengths, dtype=np.float64), np.asarray(table.values, dtype=np.float64)


def luminous_efficiency(wavelength_nm: npt.ArrayLike) -> Array:
    """V(λ) of the eye in daylight (ISO 23539), which is ȳ of the observer; 0 outside of its table."""
    wavelengths, values = observer()
    return np.interp(np.asarray(wavelength_nm, dtype=np.float64), wavelengths, values[:, 1], left=0.0, right=0.0)


def daylight() -> tuple[Array, Array]:
    """Wavelengths, nm, and relative power of the standard illuminant D65 (ISO/CIE 11664-2), 300 … 780 nm."""
    table = colour_science().SDS_ILLUMINANTS["D65"]
    return np.asarray(table.wavelengths, dtype=np.float64), np.asarray(table.values, dtype=np.float64)
