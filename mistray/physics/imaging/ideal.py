"""Airy disc: the image of a point without aberration (M. Born, E. Wolf, *Principles of Optics*, 7th ed., 8.5.2)."""

from __future__ import annotations

FIRST_DARK_RING = 1.2196698912665045  # first zero of J1 over π, in units of λN


def airy_diameter(wavelength_mm: float, f_number: float) -> float:
    """Return the diameter 2.44 λN of the first dark ring of the Airy pattern, mm, for wavelength λ and F-number N."""
    return 2 * FIRST_DARK_RING * wavelength_mm * f_number
