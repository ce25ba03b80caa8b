"""
Surface transfer function of Harvey and Shack: effect of a surface's roughness on the image of a point.

A surface whose heights are a stationary Gaussian process of variance σ² and autocovariance C(s) shifts the phase of the
wavefront by 2π path/λ times its height. Averaged over such surfaces, the optical transfer function is that of the
smooth system times

    H(s) = exp{-a [1 - C(s)/σ²]},   a = (2π σ path/λ)²,

where s is the lag on the surface that belongs to a frequency of the image. `phase_variance` of
`mistray.physics.generalized_harvey_shack` is a, with path = 2 n cos θ in reflection (a = (4π σ cos θ/λ)² in air) and
|n₁ cos θ₁ - n₂ cos θ₂| in transmission. H(0) is 1. At lags beyond the correlation length H is exp(-a), the unscattered
fraction of the light, 1 - TIS. Surfaces are independent of each other, so their functions are multiplied.

From frequency to lag. Light that a surface scatters by the spatial frequency f of its roughness changes its optical
direction cosine n β by λ f, λ in vacuum. With the element B of the ray matrix from the surface to the image (mm of
image for a unit of n β) it lands λ B f beside the direct image. A frequency ν of the image and a place in it are a
Fourier pair, as f and the lag s are, so that s = λ |B| ν. For a surface that images a point without error, rays from a
footprint of the diameter D converge with the numerical aperture D/(2 |B|) (A y + B n β = 0 at the image point, and
AD - BC = 1), so that |B| = N D with the working F-number N:

    s = λ N D ν = D ν/ν_c,   ν_c = 1/(λ N).

At the cut-off of diffraction the lag is the diameter of the footprint, for each surface of a system. Only the size of
the beam there counts, not the position of the surface. At an angle of incidence θ the footprint is D/cos θ long in the
plane of incidence, and so is the lag.

Sources: J. E. Harvey, *Light-Scattering Characteristics of Optical Surfaces*, PhD thesis, University of Arizona 1976;
J. E. Harvey, E. C. Moran, W. P. Zmek, *Transfer function characterization of grazing incidence optical systems*, Appl.
Opt. 27, 1527 (1988), for the factor cos θ. The lag is derived above.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import special

Array = npt.NDArray[np.float64]


def surface_transfer(correlation: npt.ArrayLike, phase_variance: float) -> Array:
    """
    Return the surface transfer function H = exp{-a [1 - C(s)/σ²]}.

    Parameters
    ----------
    correlation : array_like
        Correlation C(s)/σ², at most 1: 1 at the lag 0, and 0 for independent heights.
    phase_variance : float
        Variance a of the phase, rad², ≥ 0; see `mistray.physics.generalized_harvey_shack.phase_variance`.

    Returns
    -------
    float64 array
        Transfer function in the shape of `correlation`.
    """
    return np.exp(-phase_variance * (1 - np.asarray(correlation, dtype=np.float64)))


def lag_um(frequency_per_mm: npt.ArrayLike, wavelength_um: float, f_number: float, footprint_mm: float) -> Array:
    """
    Return the lag on a surface for a frequency of the image, ``λ N D ν``.

    Parameters
    ----------
    frequency_per_mm : array_like
        Spatial frequency ν on the detector, 1/mm, ≥ 0.
    wavelength_um : float
        Vacuum wavelength λ, µm.
    f_number : float
        Working F-number N at the image.
    footprint_mm : float
        Diameter D of the beam of one image point on the surface, along the direction of the frequency, mm. In the plane
        of incidence it is measured along the surface.

    Returns
    -------
    float64 array
        Lag, µm, in the shape of the frequencies. N D of a converging beam is its distance from the image.
    """
    return np.asarray(frequency_per_mm, dtype=np.float64) * wavelength_um * f_number * footprint_mm


def exponential_correlation(lag: npt.ArrayLike, length: float) -> Array:
    """
    Return the correlation C(s)/σ² = exp(-s/lc), whose spectrum is K-correlation of slope 3 with B = 2π lc.

    Parameters
    ----------
    lag, length : array_like, float
        Lag s ≥ 0 and correlation length lc > 0, in one unit.
    """
    return np.exp(-np.asarray(lag, dtype=np.float64) / length)


def gaussian_correlation(lag: npt.ArrayLike, length: float) -> Array:
    """
    Return the correlation C(s)/σ² = exp(-(s/lc)²), whose spectrum is π lc² σ² exp(-(π lc f)²).

    Parameters
    ----------
    lag, length : array_like, float
        Lag s ≥ 0 and correlation length lc > 0, at which it has fallen to 1/e, in one unit.
    """
    return np.exp(-np.square(np.asarray(lag, dtype=np.float64) / length))


def k_correlation(lag: npt.ArrayLike, length: float, slope: float) -> Array:
    """
    Return the correlation C(s)/σ² of the K-correlation spectrum A'/(1 + (B f)²)^(S/2), over all frequencies.

    ``2 (x/2)^m K_m(x)/Γ(m)`` with m = S/2 - 1, x = 2π s/B and the modified Bessel function K_m: the Hankel transform of
    the spectrum (I. S. Gradshteyn, I. M. Ryzhik, *Table of Integrals, Series, and Products*, 6.565.4), divided by
    σ² = 2π A'/(B² (S - 2)).

    Parameters
    ----------
    lag, length : array_like, float
        Lag s ≥ 0 and length B > 0, in one unit.
    slope : float
        Slope S > 2; the total roughness of a smaller slope is infinite.
    """
    m = slope / 2 - 1
    x = 2 * math.pi * np.asarray(lag, dtype=np.float64) / length
    # K_m by its scaled form: x^m and Γ(m) leave the range of floats before their product does. Where K_m itself leaves
    # it, at small x and large m, the correlation is 1 to all digits
    x = np.clip(x, 0, 1e6)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        bessel = special.kve(m, x)
        log = math.log(2) - math.lgamma(m) + m * np.log(x / 2) + np.log(bessel) - x
        return np.where(np.isfinite(bessel), np.exp(log), 1.0)


def ring_transform(inner: Array, outer: Array, flux: Array, frequency: npt.ArrayLike) -> Array:
    """
    Return the Hankel transform of light on evenly lit rings, Σ flux · <J0(2π r q)>.

    The mean of J0 over a ring is exact: ``[r₂ J1(k r₂) - r₁ J1(k r₁)]/(k (r₂² - r₁²)/2)``, k = 2π q. The error for a
    smooth profile comes from its change over a ring. With d ln r = h and f ∝ r^-g the relative error of a ring's mean
    radius is about g h²/12.

    Parameters
    ----------
    inner, outer : (n,) float64
        Inner and outer radii of the rings, 0 ≤ inner < outer.
    flux : (n,) float64
        Flux of each ring, in any unit.
    frequency : (m,) array_like
        Frequencies q, in the inverse of the unit of the radii.

    Returns
    -------
    (m,) float64
        Transform at the frequencies, in the unit of `flux`.
    """
    k = 2 * math.pi * np.asarray(frequency, dtype=np.float64)[:, None]
    return ring_means(inner, outer, k) @ flux


def ring_means(inner: Array, outer: Array, k: Array) -> Array:
    """
    Return means of the Bessel function J0(k r) over rings, (m, n).

    `inner` and `outer` are the radii of the rings, (n,); the wave number `k`, (m, 1), is in the inverse of their unit.
    """
    a, b = k * inner, k * outer
    # At small arguments the quotient of differences is a series: 1 - (a² + b²)/8
    small = b < 1e-3
    safe = np.where(small, 1.0, b * b - a * a)
    exact = 2 * (b * special.j1(b) - a * special.j1(a)) / safe
    return np.where(small, 1 - (a * a + b * b) / 8, exact)
