"""Thermal radiation of a blackbody in a band of wavelengths, and irradiance of warm optics on a detector.

Radiances are in W/(mm² sr): 1 W/(mm² sr) = 10⁶ W/(m² sr). Wavelengths are vacuum ones, in µm. The radiances hold in
vacuum; in a medium of index n they are n² times as large. Sources: M. Planck, Verhandl. Dtsch. Phys. Ges. 2, 237
(1900); the constants h, c and k are exact in the SI of 2019. Narcissus: J. W. Howard, I. R. Abel, "Narcissus:
reflections on retroreflections in thermal imaging systems", Appl. Opt. 21, 3393 (1982).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError

PLANCK, LIGHT, BOLTZMANN = 6.62607015e-34, 299792458.0, 1.380649e-23  # J s, m/s, J/K
C2_UM_K = 1e6 * PLANCK * LIGHT / BOLTZMANN  # second radiation constant: x = C2/(λ T)
_PEAK_X = 4.965114231744276  # root of x = 5 (1 - exp(-x))
# 2 h c² T⁴ (k/(h c))⁴ x³/(exp(x) - 1) dx is the radiance in dx; in W/(mm² sr K⁴)
_SCALE = 1e-6 * 2 * BOLTZMANN**4 / (PLANCK**3 * LIGHT**2)
# Panels of at most 1.1 in x, whose next singularities are 2π away: 16 nodes are exact to the rounding
_DARK = 745.0  # x from which exp(-x) is 0
_PANELS, _LONGEST, _ABOVE = 64, 64.0, 3.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def spectral_radiance(wavelength_um: npt.ArrayLike, temperature_K: npt.ArrayLike) -> Any:
    """
    Return the spectral radiance of a blackbody, W/(mm² sr µm).

    Parameters
    ----------
    wavelength_um : array_like
        Wavelength λ, µm, > 0.
    temperature_K : array_like
        Temperature T, K, > 0; broadcasts with λ.
    """
    wavelength, temperature = (np.asarray(v, dtype=np.float64) for v in (wavelength_um, temperature_K))
    with np.errstate(over="ignore"):
        occupied = np.expm1(C2_UM_K / (wavelength * temperature))
    return 1e18 * 2 * PLANCK * LIGHT**2 / wavelength**5 / occupied


def band_nodes(temperature_K: float, low_um: float, high_um: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the nodes of a quadrature for the radiance of a blackbody over a band.

    Parameters
    ----------
    temperature_K : float
        Temperature T, K, ≥ 0.
    low_um, high_um : float
        Limits of the band, µm, 0 ≤ low < high ≤ ∞.

    Returns
    -------
    wavelengths_um, radiances : (m,) float64
        Nodes: ∫ L(λ) f(λ) dλ is the sum of radiances · f(wavelengths), W/(mm² sr); relative error 1e-13 for f = 1. At 0
        K, or if no light is in the band, there is one node with the radiance 0.

    Raises
    ------
    MistrayError
        If the temperature or a limit of the band is out of range.
    """
    if not (math.isfinite(temperature_K) and temperature_K >= 0):
        raise MistrayError(f"temperature of {temperature_K:g} K; give one of 0 K or more")
    if not 0 <= low_um < high_um:
        raise MistrayError(f"band of {low_um:g} to {high_um:g} µm; give 0 ≤ low < high")
    if temperature_K == 0 or high_um * temperature_K < C2_UM_K / _DARK:
        return np.array([high_um if math.isfinite(high_um) else low_um + 1]), np.zeros(1)
    first = C2_UM_K / (high_um * temperature_K)
    # What is left out is less than exp(-61) of the peak of the band
    furthest = max(first, _ABOVE) + _LONGEST
    last = min(C2_UM_K / (low_um * temperature_K), furthest) if low_um > 0 else furthest
    edges = np.linspace(first, last, _PANELS + 1)
    half = 0.5 * np.diff(edges)[:, None]
    x = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * _NODES).ravel()
    with np.errstate(over="ignore"):
        radiances = _SCALE * temperature_K**4 * (half * _WEIGHTS).ravel() * x**3 / np.expm1(x)
    return C2_UM_K / (x * temperature_K), radiances


def band_radiance(temperature_K: npt.ArrayLike, low_um: float, high_um: float) -> Any:
    """
    Return the radiance of a blackbody in a band, W/(mm² sr).

    Parameters
    ----------
    temperature_K : array_like
        Temperature T, K, ≥ 0.
    low_um, high_um : float
        Limits of the band, µm, as in `band_nodes`.

    Returns
    -------
    float or array of the shape of `temperature_K`
        Radiance, W/(mm² sr); relative error 1e-13. Over all wavelengths it is σ T⁴/π.
    """
    return _by_temperature(lambda t: float(band_nodes(t, low_um, high_um)[1].sum()), temperature_K)


def band_derivative(temperature_K: npt.ArrayLike, low_um: float, high_um: float) -> Any:
    """Return the derivative dL/dT of `band_radiance`, W/(mm² sr K); parameters as there."""
    return _by_temperature(lambda t: float(derivative_nodes(t, low_um, high_um)[1].sum()), temperature_K)


def derivative_nodes(temperature_K: float, low_um: float, high_um: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return wavelengths, µm, and terms, W/(mm² sr K), whose sum is dL/dT of a blackbody's radiance L in a band.

    Parameters are those of `band_nodes`; at 0 K all derivatives are 0.

    Each wavelength has dL/dT = L x exp(x)/((exp(x) - 1) T) with x = hc/(λ k T).
    """
    wavelengths, radiances = band_nodes(temperature_K, low_um, high_um)
    if temperature_K == 0:
        return wavelengths, radiances
    x = C2_UM_K / (wavelengths * temperature_K)
    return wavelengths, radiances * x / -np.expm1(-x) / temperature_K


def photons_per_joule(wavelength_um: npt.ArrayLike) -> Any:
    """Return the number of photons in a joule of light of a wavelength, µm: λ/(hc), 1/J."""
    return 1e-6 * np.asarray(wavelength_um, dtype=np.float64) / (PLANCK * LIGHT)


def peak_wavelength_um(temperature_K: npt.ArrayLike) -> Any:
    """Return the wavelength of the largest `spectral_radiance`, µm: W. Wien's displacement law, 2897.77 µm K/T."""
    return C2_UM_K / _PEAK_X / np.asarray(temperature_K, dtype=np.float64)


def cone_projected_solid_angle(f_number: npt.ArrayLike) -> Any:
    """
    Return the projected solid angle of a cone of light, π sin² u = π/(4 F² + 1), sr.

    Parameters
    ----------
    f_number : array_like
        F-number F = 1/(2 tan u), with the half angle u of the cone: distance over diameter of the exit pupil.
    """
    return np.pi / (4 * np.asarray(f_number, dtype=np.float64) ** 2 + 1)


def self_emission(
    emissivity: npt.ArrayLike, temperature_K: npt.ArrayLike, low_um: float, high_um: float, f_number: npt.ArrayLike
) -> Any:
    """
    Return the irradiance on a detector in air by optics that fill its cone, ε L π/(4 F² + 1), W/mm².

    L is the radiance of a blackbody at the temperature of the optics.

    Parameters
    ----------
    emissivity : array_like
        Emissivity ε = 1 - R - T of the optics (G. Kirchhoff), 0 … 1.
    temperature_K, low_um, high_um
        Temperature, K, and limits of the band, µm, as in `band_radiance`.
    f_number : array_like
        F-number, as in `cone_projected_solid_angle`.
    """
    radiance = band_radiance(temperature_K, low_um, high_um)
    return np.asarray(emissivity, dtype=np.float64) * radiance * cone_projected_solid_angle(f_number)


def narcissus_nitd(
    returned: npt.ArrayLike,
    housing_K: float,
    cold_K: float,
    low_um: float,
    high_um: float,
    scene_K: float | None = None,
) -> np.ndarray:
    """
    Return the narcissus-induced temperature difference (NITD), K: fraction · [L(T_h) - L(T_c)]/(dL/dT)(T_s).

    A detector sees the cold space about itself instead of the housing in a fraction of its cone. The NITD is the change
    of the scene's temperature with the same signal. Losses of the optics act on the scene and on the image alike and
    cancel to first order.

    Parameters
    ----------
    returned : array_like
        Fraction of the cone of light that returns to the cold space: reflectance times fraction of the cone.
    housing_K, cold_K : float
        Temperatures T_h of the housing, and T_c of the cold space, K, ≥ 0.
    low_um, high_um : float
        Limits of the band, µm, as in `band_radiance`.
    scene_K : float, optional
        Temperature T_s of the scene, K, > 0; by default that of the housing.
    """
    missing = band_radiance(housing_K, low_um, high_um) - band_radiance(cold_K, low_um, high_um)
    return (
        np.asarray(returned, dtype=np.float64)
        * missing
        / band_derivative(housing_K if scene_K is None else scene_K, low_um, high_um)
    )


def _by_temperature(function: Any, temperature_K: npt.ArrayLike) -> Any:
    """Return the values of a function of one temperature, K, in the shape of `temperature_K`; a float for a float."""
    temperatures = np.asarray(temperature_K, dtype=np.float64)
    values = np.array([function(float(t)) for t in temperatures.ravel()]).reshape(temperatures.shape)
    return values if values.ndim else float(values)
