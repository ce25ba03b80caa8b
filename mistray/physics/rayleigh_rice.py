"""Rayleigh-Rice vector perturbation theory of light scattered by a smooth surface.

BRDF = (16π²/λ⁴) cos θi cos θs Q PSD(f), f = |β - β0|/λ. Q is the polarisation factor for unpolarised light and has the
role of a reflectance: in the specular direction it is R. Sources: E. L. Church, H. A. Jenkinson, J. M. Zavada, Opt.
Eng. 18, 125 (1979); J. C. Stover, *Optical Scattering*, 3rd ed., SPIE Press 2012, chapter 5. Conventions: exp(-iωt), n
+ ik.

In transmission BTDF = n² (4π²/λ⁴) (cos θi - n cos θt)² Q PSD(f), f = n |β - β0|/λ, for the index n of the other side.
θt is the angle of the refracted beam; β and θs are in the other medium. Q has the role of a transmittance: in the
specular direction it is T. It follows from the same currents at the surface, which radiate to both sides. Their
tangential electric field is the same on both sides, and so is the tangential magnetic field of the normal currents.
"""

from __future__ import annotations

import math
from typing import Any

from mistray.physics._arrays import Arithmetic, arithmetic


def brdf(cos_i: Any, cos_s: Any, q: Any, psd_um4: Any, wavelength_um: Any) -> Any:
    """
    Return the BRDF of a smooth surface, (16π²/λ⁴) cos θi cos θs Q PSD(f).

    Parameters
    ----------
    cos_i, cos_s : float or array
        Cosines of the angles of incidence and of scatter, 0 … 1.
    q : float or array
        Factor Q of `polarization_factor`; or R, for a coarser result that is wrong far from the specular direction.
    psd_um4 : float or array
        Two-dimensional roughness spectrum at f = |β - β0|/λ, µm⁴.
    wavelength_um : float or array
        Wavelength λ in the medium of the light, µm.

    Returns
    -------
    float or array
        Absolute BRDF, 1/sr.
    """
    squared = wavelength_um * wavelength_um
    return 16 * math.pi**2 * cos_i * cos_s * q * psd_um4 / (squared * squared)


def polarization_factor(cos_i: Any, cos_s: Any, cos_phi: Any, index: Any) -> Any:
    """
    Return the polarisation factor Q in reflection for unpolarised light, summed over both scattered polarisations.

    With ε = N², q = sqrt(ε - sin²θ) and the azimuth φ of the scattered direction from the specular plane,

    - q_ss = (ε - 1) cos φ/[(ci + qi)(cs + qs)]
    - q_sp = -(ε - 1) sin φ qs/[(ci + qi)(ε cs + qs)]
    - q_ps = -(ε - 1) sin φ qi/[(ε ci + qi)(cs + qs)]
    - q_pp = (ε - 1)(ε sin θi sin θs - qi qs cos φ)/[(ε ci + qi)(ε cs + qs)]

    and Q is half the sum of the squares of their moduli.

    Parameters
    ----------
    cos_i, cos_s : float or array
        Cosines of the angles of incidence and of scatter, 0 … 1.
    cos_phi : float or array
        Cosine of the azimuth: 1 in the specular half plane, -1 on the side of the incident ray.
    index : number or array
        Index N = n + ik of the substrate relative to the medium of the light; k ≥ 0, not 1.

    Returns
    -------
    float or array
        Factor Q ≥ 0. It is R of the bare substrate for θs = θi, φ = 0, and may exceed 1 elsewhere.
    """
    ci, cs, cphi, eps = _float64(cos_i, cos_s, cos_phi, index)
    xp = arithmetic(cos_i, cos_s, cos_phi, index)
    si2, ss2 = 1 - ci * ci, 1 - cs * cs
    qi, qs = xp.sqrt(eps - si2), xp.sqrt(eps - ss2)
    sines = xp.sqrt(xp.maximum(si2 * ss2, _TINY))
    s_in, s_out, p_in, p_out = ci + qi, cs + qs, eps * ci + qi, eps * cs + qs
    ss = _square(xp, cphi / (s_in * s_out))
    sp = _square(xp, qs / (s_in * p_out)) * (1 - cphi * cphi)
    ps = _square(xp, qi / (p_in * s_out)) * (1 - cphi * cphi)
    pp = _square(xp, (eps * sines - qi * qs * cphi) / (p_in * p_out))
    return xp.result(0.5 * _square(xp, eps - 1) * (ss + sp + ps + pp))


def transmitted_factor(cos_i: Any, cos_s: Any, cos_phi: Any, index: Any) -> Any:
    """
    Return the polarisation factor Q in transmission for unpolarised incident light.

    With ε = n², qi = sqrt(ε - sin²θi), qs = n cos θs, κ = n sin θs, cs = sqrt(1 - κ²), imaginary beyond the critical
    angle, and the azimuth φ of the scattered direction from the specular plane,

    - q_ss = cos φ/[(ci + qi)(cs + qs)]
    - q_sp = -n cs sin φ/[(ci + qi)(ε cs + qs)]
    - q_ps = -qi sin φ/[(ε ci + qi)(cs + qs)]
    - q_pp = n (κ sin θi + qi cs cos φ)/[(ε ci + qi)(ε cs + qs)]

    and Q is 2 cos θi qs (ci + qi)² times the sum of the squares of their moduli.

    Parameters
    ----------
    cos_i, cos_s : float or array
        Cosines of the angles of incidence and of scatter, 0 … 1, each in its own medium.
    cos_phi : float or array
        Cosine of the azimuth: 1 in the specular half plane.
    index : float or array
        Real index n of the medium of the scattered light relative to that of the incident light.

    Returns
    -------
    float or array
        Factor Q ≥ 0. It is T of the bare surface in the specular direction, and may exceed 1 elsewhere. It is 0 if the
        incident light is totally reflected.
    """
    ci, cs, cphi, eps = _float64(cos_i, cos_s, cos_phi, index)
    xp = arithmetic(cos_i, cos_s, cos_phi, index)
    n, si2 = xp.real(index), 1 - ci * ci
    kappa2 = n * n * (1 - cs * cs)
    refracted = xp.re(eps) - si2
    # The outer normal wave number of the scattered light, complex; qi and qs are real
    outer = xp.sqrt(xp.complex(1 - kappa2, 0 * kappa2))
    qi, qs = xp.sqrt(xp.maximum(refracted, _TINY)), n * cs
    sines = xp.sqrt(xp.maximum(si2 * kappa2, _TINY))
    s_in, s_out, p_in, p_out = ci + qi, outer + qs, eps * ci + qi, eps * outer + qs
    ss = _square(xp, cphi / (s_in * s_out))
    sp = _square(xp, n * outer / (s_in * p_out)) * (1 - cphi * cphi)
    ps = _square(xp, qi / (p_in * s_out)) * (1 - cphi * cphi)
    pp = _square(xp, n * (sines + qi * outer * cphi) / (p_in * p_out))
    q = 2 * ci * qs * s_in * s_in * (ss + sp + ps + pp)
    return xp.result(xp.select(refracted > 0, q, 0.0))


# Under a root, so that its derivative is finite at normal incidence.
_TINY = 1e-30


def _float64(cos_i: Any, cos_s: Any, cos_phi: Any, index: Any) -> tuple[Any, Any, Any, Any]:
    """Return the three cosines in float64, and the complex relative permittivity, which is `index` squared."""
    xp = arithmetic(cos_i, cos_s, cos_phi, index)
    n, k = xp.real(xp.re(index)), xp.real(xp.im(index))
    return xp.real(cos_i), xp.real(cos_s), xp.real(cos_phi), xp.complex(n * n - k * k, 2 * n * k)


def _square(xp: Arithmetic, z: Any) -> Any:
    """Return the squared modulus |z|² of a complex array."""
    return xp.re(z) * xp.re(z) + xp.im(z) * xp.im(z)
