"""Harvey-Shack scatter model: BSDF = b0 (1 + (r/l)²)^(s/2), r = |β - β0|, s < 0.

r is the distance of the direction cosines of the scattered ray from those of the specular ray, tangential to the
surface, 0 ≤ r < 2; l is the r of the knee; b0 and the BSDF are in 1/sr. Sources: J. E. Harvey, *Light-Scattering
Characteristics of Optical Surfaces*, PhD thesis, University of Arizona 1976; E. Fest, *Stray Light Analysis and
Control*, SPIE Press 2013, chapter 4, for b0 from the roughness. Some authors write the exponent as -s/2 with s > 0.
"""

from __future__ import annotations

import math
from typing import Any

from mistray.physics._arrays import arithmetic
from mistray.physics.growth import growth

MAX_PHASE = 4 * math.pi * 0.02
"""Largest 2π Δn σ/λ of a surface that counts as smooth: a mirror with σ = 0.02 λ. It scatters 6.3 % of its light, and
the error of the smooth-surface formula is 3 % of that."""


def bsdf(r: Any, b0: Any, l: Any, s: Any) -> Any:  # noqa: E741
    """
    Return the BSDF of the Harvey-Shack model, b0 (1 + (r/l)²)^(s/2).

    Parameters
    ----------
    r : float or array
        Distance |β - β0| of the direction cosines, ≥ 0.
    b0 : float or array
        BSDF in the specular direction, 1/sr.
    l : float or array
        Distance r of the knee, > 0.
    s : float or array
        Slope beyond the knee, < 0.

    Returns
    -------
    float or array
        BSDF, 1/sr. Differentiable in all arguments in Dr.Jit.
    """
    return b0 * (1 + (r / l) * (r / l)) ** (0.5 * s)


def tis(b0: Any, l: Any, s: Any) -> Any:  # noqa: E741
    """
    Return the fraction of light scattered at normal incidence, the integral of BSDF cos θ over the half space.

    ``2π b0 l^(-s)/(s + 2) · [(1 + l²)^((s+2)/2) - l^(s+2)]``; at s = -2 it is ``π b0 l² ln(1 + 1/l²)``. It is less at
    oblique incidence, where the lobe is cut by the horizon.

    Parameters
    ----------
    b0, l, s : float or array
        Parameters of `bsdf`.

    Returns
    -------
    float or array
        Scattered fraction of the incident flux. Differentiable in all arguments in Dr.Jit, also at s = -2.
    """
    return b0 * _unit_tis(l, s)


def b0_from_tis(share: Any, l: Any, s: Any) -> Any:  # noqa: E741
    """
    Return the BSDF in the specular direction, 1/sr, for a scattered fraction at normal incidence: inverse of `tis`.

    Parameters
    ----------
    share : float or array
        Total integrated scatter, a fraction of the incident flux, ≥ 0.
    l, s : float or array
        Parameters of `bsdf`.

    Returns
    -------
    float or array
        BSDF in the specular direction b0, 1/sr. Differentiable in all arguments in Dr.Jit.
    """
    return share / _unit_tis(l, s)


def _unit_tis(l: Any, s: Any) -> Any:  # noqa: E741
    """Return the total integrated scatter for b0 = 1/sr: π l² (exp(p L) - 1)/p, p = 1 + s/2, L = ln(1 + 1/l²)."""
    xp = arithmetic(l, s)
    length2 = xp.real(l) * xp.real(l)
    logarithm = xp.log(1 + 1 / length2)
    return xp.result(math.pi * length2 * logarithm * growth((1 + 0.5 * xp.real(s)) * logarithm))


def tis_from_rms(rms_um: Any, wavelength_um: Any, index_step: Any, cos_i: Any = 1.0) -> Any:
    """
    Return the fraction of light that a smooth surface scatters, (2π Δn σ cos θi/λ)².

    In transmission it holds at normal incidence.

    Parameters
    ----------
    rms_um : float or array
        Rms roughness σ in the band of spatial frequencies up to 1/λ, µm.
    wavelength_um : float or array
        Vacuum wavelength λ, µm.
    index_step : float or array
        Index step Δn: n_in - n_out in transmission, of any sign; 2 n_in in reflection.
    cos_i : float or array
        Cosine of the angle of incidence.

    Returns
    -------
    float or array
        Scattered fraction of the specular light before scatter.
    """
    phase = phase_rms(rms_um, wavelength_um, index_step) * cos_i
    return phase * phase


def phase_rms(rms_um: Any, wavelength_um: Any, index_step: Any) -> Any:
    """
    Return the rms phase of the wavefront behind a rough surface at normal incidence, 2π Δn σ/λ, rad.

    The surface is smooth if this is small, 2π Δn σ ≪ λ; `MAX_PHASE` is the limit in mistray. Parameters as in
    `tis_from_rms`.
    """
    return 2 * math.pi * index_step * rms_um / wavelength_um


def at_wavelength(b0: Any, l: Any, ratio: Any) -> tuple[Any, Any]:  # noqa: E741
    """
    Return b0, 1/sr, and l at another wavelength, for a smooth surface that keeps its roughness; s does not change.

    Parameters
    ----------
    b0, l : float or array
        Parameters at the wavelength λ₁.
    ratio : float or array
        Ratio of the wavelengths k = λ₂/λ₁, > 0.

    Returns
    -------
    b0, l : float or array
        Parameters ``b0/k⁴``, 1/sr, and ``l k`` at λ₂.
    """
    squared = ratio * ratio
    return b0 / (squared * squared), l * ratio
