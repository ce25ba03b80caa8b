"""Closed forms of images without aberration: Airy pattern, transfer functions of circular and annular pupils.

Lengths are in mm. Sources: M. Born, E. Wolf, *Principles of Optics*, 7th ed., sections 8.5.2, 8.8.2 and 9.5; E. L.
O'Neill, "Transfer function for an annular aperture", J. Opt. Soc. Am. 46, 285 (1956).
"""

import math

import numpy as np
import numpy.typing as npt
from scipy.special import j0, j1

from .geometry import Array


def airy_irradiance(radius: npt.ArrayLike, wavelength_mm: float, f_number: float) -> Array:
    """Irradiance of the Airy pattern for a flux of 1, 1/mm², at a distance from the middle, mm; working F-number."""
    x = math.pi * np.asarray(radius, dtype=np.float64) / (wavelength_mm * f_number)
    peak = math.pi / (4 * (wavelength_mm * f_number) ** 2)
    small = np.abs(x) < 1e-8
    return np.asarray(peak * np.where(small, 1.0, 2 * j1(x) / np.where(small, 1.0, x)) ** 2)


def airy_encircled(radius: npt.ArrayLike, wavelength_mm: float, f_number: float) -> Array:
    """Return the fraction of the Airy pattern's flux within a radius, mm; 0.838 at the first dark ring."""
    x = math.pi * np.asarray(radius, dtype=np.float64) / (wavelength_mm * f_number)
    return np.asarray(1 - j0(x) ** 2 - j1(x) ** 2)


def cut_off(wavelength_mm: float, f_number: float) -> float:
    """Return the frequency 1/(λN) beyond which an image has no contrast, 1/mm."""
    return 1 / (wavelength_mm * f_number)


def circular_mtf(share: npt.ArrayLike) -> Array:
    """Return the MTF of a circular pupil without aberration, at a fraction of the cut-off frequency, ≥ 0."""
    v = np.clip(np.abs(np.asarray(share, dtype=np.float64)), 0.0, 1.0)
    return np.asarray(2 / math.pi * (np.arccos(v) - v * np.sqrt(1 - v * v)))


def annular_mtf(share: npt.ArrayLike, obstruction: float) -> Array:
    """MTF without aberration by share of the cut-off; an obstruction takes less than 1 of the pupil's radius."""
    v, e = np.abs(np.asarray(share, dtype=np.float64)), obstruction
    if e == 0:
        return circular_mtf(v)
    inner = e * e * circular_mtf(v / e)
    # Overlap of the two circles of radii 1 and e at the distance 2v, in units of the area of the outer one
    d = 2 * v
    part = (d > 1 - e) & (d < 1 + e)
    s = np.where(part, d, 1.0)
    a = np.arccos(np.clip((s * s + 1 - e * e) / (2 * s), -1, 1))
    b = np.arccos(np.clip((s * s + e * e - 1) / (2 * s * e), -1, 1))
    root = np.sqrt(np.maximum((1 + e - s) * (s + e - 1) * (s - e + 1) * (s + e + 1), 0))
    lens = (a + e * e * b - 0.5 * root) / math.pi
    cross = np.where(d <= 1 - e, e * e, np.where(part, lens, 0.0))
    return np.asarray((circular_mtf(v) + inner - 2 * cross) / (1 - e * e))


def defocused_strehl(w20_waves: npt.ArrayLike) -> Array:
    """Return the Strehl ratio sinc²(W20) of a circular pupil with a defocus of W20 ρ² waves."""
    return np.asarray(np.sinc(np.asarray(w20_waves, dtype=np.float64)) ** 2)
