"""Bare interfaces between lossless media: Snell's law and the unpolarised Fresnel reflectance.

Indices are real and positive, angles enter as cosines in [0, 1]. Only ``+ - * /`` are used on the arguments, so floats,
NumPy arrays and Dr.Jit arrays all work. Source: M. Born and E. Wolf, *Principles of Optics*, 7th ed., sections
1.5.2-1.5.4.
"""

from __future__ import annotations

from typing import Any

# Added to the denominators, because at grazing incidence between equal indices both amplitudes are 0/0. It is a normal
# number in float32 and too small to change any other value.
_TINY = 1e-30


def cos2_refracted(cos_i: Any, n_i: Any, n_t: Any) -> Any:
    """Square of the cosine of the refraction angle; negative means total internal reflection.

    Parameters
    ----------
    cos_i : float or array
        Cosine of the angle of incidence, in [0, 1].
    n_i, n_t : float or array
        Indices of the medium the ray is in and of the other one.

    Returns
    -------
    float or array
        ``1 - (n_i/n_t)² (1 - cos_i²)``, dimensionless, ≤ 1.
    """
    eta = n_i / n_t
    return 1 - eta * eta * (1 - cos_i * cos_i)


def reflectance(cos_i: Any, cos_t: Any, n_i: Any, n_t: Any) -> Any:
    """Fresnel reflectance for unpolarised light.

    Parameters
    ----------
    cos_i, cos_t : float or array
        Cosines of the angles of incidence and refraction, in [0, 1]; pass ``cos_t = 0`` for total internal reflection,
        the result is then 1.
    n_i, n_t : float or array
        Indices on the two sides.

    Returns
    -------
    float or array
        R = (r_s² + r_p²)/2 in [0, 1]; never NaN for arguments in range. The transmittance is 1 - R.
    """
    r_s = (n_i * cos_i - n_t * cos_t) / (n_i * cos_i + n_t * cos_t + _TINY)
    r_p = (n_t * cos_i - n_i * cos_t) / (n_t * cos_i + n_i * cos_t + _TINY)
    return 0.5 * (r_s * r_s + r_p * r_p)
