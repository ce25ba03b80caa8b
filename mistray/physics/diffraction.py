"""Diffraction at edges far from the direct beam: half plane, circular aperture, and rays that pass an edge.

Lengths (wavelength λ, radii, distances) are in mm. Directions are given by direction cosines β tangential to the
aperture, or by the angle θ to the direct beam.

- Half plane: J. B. Keller, "Geometrical theory of diffraction", J. Opt. Soc. Am. 52, 116 (1962). The diffracted rays of
  a point of the edge keep their direction cosine along the edge. Written in direction cosines, the mean of his
  coefficients for both polarisations is λ/(4π²) (1 - β_i·β_s)/(cos θi cos θs)/(β_s - β_i)² for the tangential parts of
  both directions. It is the same for light in the opposite direction.
- Circular aperture: the half plane averaged over all directions of the edge, which agrees with the mean of the Airy
  pattern over its rings.
- Rays: an edge deflects a ray that passes it at the distance x at random. The density is a Gaussian of standard
  deviation λ/(4π x) after Heisenberg's relation: E. R. Freniere, G. G. Gregory, R. A. Hassler, "Edge diffraction in
  Monte Carlo ray tracing", Proc. SPIE 3780 (1999). Far from the beam that is sqrt(π/2) = 1.25 times too much;
  λ/((2π)^1.5 x) gives the half plane's λ/(4π²θ²).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.physics._arrays import arithmetic
from mistray.physics.growth import growth

SPREADS = {"half_plane": (2 * math.pi) ** -1.5, "heisenberg": 1 / (4 * math.pi)}
"""Standard deviation of the deflection times x/λ, by law: exact far from the beam, or after Heisenberg."""
GRAZING = 0.05
"""Least cosine, that of 87°, up to which diffraction grows towards the plane of the aperture."""


def half_plane(theta: npt.ArrayLike, wavelength_mm: float) -> np.ndarray:
    """
    Return the flux diffracted to one side by an edge at small angles, λ/(4π²θ²).

    Parameters
    ----------
    theta : array_like
        Angle to the direct beam, rad, ≠ 0.
    wavelength_mm : float
        Wavelength λ, mm.

    Returns
    -------
    array
        Flux per length of the edge, per angle and per irradiance, mm/rad, in the shape of `theta`.
    """
    return wavelength_mm / (4 * np.pi**2 * np.asarray(theta, dtype=np.float64) ** 2)


def keller(theta: npt.ArrayLike, wavelength_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the flux diffracted by a perfectly conducting half plane at normal incidence, at any angle.

    Parameters
    ----------
    theta : array_like
        Angle to the direct beam, rad, positive into the shadow, -π/2 … π/2, ≠ 0.
    wavelength_mm : float
        Wavelength λ, mm.

    Returns
    -------
    soft, hard : array
        Flux for the electric field along the edge, and for the magnetic field along it, as that of `half_plane`.
        Their mean is λ/(4π² sin² θ).
    """
    theta = np.asarray(theta, dtype=np.float64)
    # φ - φ' and φ + φ' of Keller: light comes from φ' = π/2, the shadow of the screen φ = 0 begins at φ = 3π/2
    minus, plus = np.cos(0.5 * (np.pi + theta)), np.cos(0.5 * theta)
    scale = wavelength_mm / (16 * np.pi**2)
    return scale * (1 / minus + 1 / plus) ** 2, scale * (1 / minus - 1 / plus) ** 2


def obliquity(cos_i: Any, cos_s: Any, r2: Any) -> Any:
    """
    Return the factor of unpolarised diffraction off the normal, (1 - β_i·β_s)/(cos θi cos θs); 1 along the beam.

    It is computed as ``1 + |d_s - d_i|²/(2 cos θi cos θs)``, which loses no digits near the beam. Near the plane of the
    aperture it would be infinite; cosines below `GRAZING` count as `GRAZING`.

    Parameters
    ----------
    cos_i, cos_s : float or array
        Cosines of the beam and of the diffracted direction with the normal of the aperture.
    r2 : float or array
        Squared distance |β_s - β_i|² of the direction cosines.
    """
    maximum = arithmetic(cos_i, cos_s, r2).maximum
    along = cos_s - cos_i
    return 1 + (r2 + along * along) / (2 * maximum(cos_i, GRAZING) * maximum(cos_s, GRAZING))


def circular_aperture(theta: npt.ArrayLike, wavelength_mm: float, radius_mm: float) -> np.ndarray:
    """
    Return the intensity of a circular aperture at normal incidence, averaged over the rings, λ/(2π³ a sin³ θ).

    Parameters
    ----------
    theta : array_like
        Angle to the direct beam, rad; several λ/a at least.
    wavelength_mm, radius_mm : float
        Wavelength λ and radius a, mm.

    Returns
    -------
    array
        Intensity per flux through the aperture, 1/sr, in the shape of `theta`. Divided by cos θ it is a BSDF (BDDF).
    """
    return wavelength_mm / (2 * np.pi**3 * radius_mm * np.sin(np.asarray(theta, dtype=np.float64)) ** 3)


def spread(law: str = "half_plane") -> float:
    """
    Return σ x/λ, the standard deviation of an edge ray's deflection times its distance from the edge, in wavelengths.

    Parameters
    ----------
    law : {"half_plane", "heisenberg"}
        Law that is exact far from the beam, or Heisenberg's relation.

    Raises
    ------
    MistrayError
        If no law has this name.
    """
    if law not in SPREADS:
        raise MistrayError(f"law of edge diffraction is '{law}'; use {' or '.join(map(repr, SPREADS))}")
    return SPREADS[law]


def deflection_sigma(distance_mm: npt.ArrayLike, wavelength_mm: float, law: str = "half_plane") -> np.ndarray:
    """
    Return the standard deviation of the tangent by which a ray that passes an edge is deflected.

    Parameters
    ----------
    distance_mm : array_like
        Distance x from the edge, mm, > 0; the result has its shape.
    wavelength_mm : float
        Wavelength λ, mm.
    law : {"half_plane", "heisenberg"}
        Law of the standard deviation: λ/((2π)^1.5 x) or λ/(4π x).

    Raises
    ------
    MistrayError
        If no law has this name.
    """
    return spread(law) * wavelength_mm / np.asarray(distance_mm, dtype=np.float64)


def deflection_density(delta: Any, width_mm: Any, wavelength_mm: float, law: str = "half_plane") -> Any:
    """
    Return the density of the deflection of rays that pass an edge at random distances up to a width.

    It is ``c/(sqrt(2π) w δ²) (1 - exp(-δ² w²/(2 c²)))`` with c = σ x, the mean of the Gaussians over 0 < x < w. Its
    integral over δ is 1. Beyond δ = c/w, about λ/(16 w), it is the flux diffracted by the edge over the flux of the
    strip.

    Parameters
    ----------
    delta : float or array
        Change δ of the direction cosine across the edge; the density is symmetric, per unit of δ.
    width_mm : float or array
        Width w of the strip along the edge, mm, > 0.
    wavelength_mm : float
        Wavelength λ, mm.
    law : {"half_plane", "heisenberg"}
        Law of the standard deviation, see `deflection_sigma`.
    """
    inverse = width_mm / (spread(law) * wavelength_mm)  # w/c
    # (1 - exp(-u))/u with u = δ² w²/(2 c²), finite at 0
    return inverse / (2 * math.sqrt(2 * math.pi)) * growth(-0.5 * (delta * inverse) ** 2)


def sampled_deflection(
    u: npt.ArrayLike, normal: npt.ArrayLike, width_mm: float, wavelength_mm: float, law: str = "half_plane"
) -> np.ndarray:
    """
    Return random changes of the direction cosine across an edge, which have the density `deflection_density`.

    Parameters
    ----------
    u : array_like
        Uniform random numbers in 0 … 1, not 0: the distance from the edge in units of the width.
    normal : array_like
        Random numbers of the standard normal distribution.
    width_mm, wavelength_mm, law
        Parameters of `deflection_density`.
    """
    return deflection_sigma(width_mm * np.asarray(u), wavelength_mm, law) * np.asarray(normal)


def ring_bsdf(r: Any, width_mm: Any, wavelength_mm: float, law: str = "half_plane") -> Any:
    """
    Return the BSDF of a thin ring inside the edge of an opening, without `obliquity`: `deflection_density` over π r.

    Each point of the ring deflects across its own piece of the edge; all pieces together scatter evenly about the
    direct beam. Far from the beam this is λ/(4π³ w r³). The ring's flux is 2 w/a of that of an aperture of radius a,
    which gives `circular_aperture`.

    Parameters
    ----------
    r : float or array
        Distance |β_s - β_i| of the direction cosines, > 0.
    width_mm : float or array
        Width w of the ring, mm: its area over the length of the edge.
    wavelength_mm : float
        Wavelength λ, mm.
    law : {"half_plane", "heisenberg"}
        Law of the standard deviation, see `deflection_sigma`.

    Returns
    -------
    float or array
        BSDF, 1/sr. Its integral over the unit disc is 1, less the part of the density beyond. Differentiable in the
        width in Dr.Jit.
    """
    ops = arithmetic(r, width_mm)
    wide, width = ops.real(r), ops.real(width_mm)
    return ops.result(deflection_density(wide, width, wavelength_mm, law) / (math.pi * wide))
