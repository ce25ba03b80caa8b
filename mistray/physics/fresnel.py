"""Bare interfaces between lossless media: Snell's law and the unpolarised Fresnel reflectance.

Indices are real and positive, angles enter as cosines in [0, 1]. Only ``+ - * /`` are used on the arguments, so floats,
NumPy arrays and Dr.Jit arrays all work. Source: M. Born and E. Wolf, *Principles of Optics*, 7th ed., sections
1.5.2-1.5.4.
"""

from __future__ import annotations

from typing import Any

# Added to denominators, because at grazing incidence between equal indices both amplitudes are 0/0. It is a normal
# number in float32 and too small to change any other value.
_TINY = 1e-30


def cos2_refracted(cos_i: Any, n_i: Any, n_t: Any) -> Any:
    """
    Return the square of the cosine of the refraction angle; negative in total internal reflection.

    Parameters
    ----------
    cos_i : float or array
        Cosine of the angle of incidence, in [0, 1].
    n_i, n_t : float or array
        Refractive indices of the medium of incidence and of the other medium.

    Returns
    -------
    float or array
        ``1 - (n_i/n_t)² (1 - cos_i²)``, dimensionless, ≤ 1.
    """
    eta = n_i / n_t
    return 1 - eta * eta * (1 - cos_i * cos_i)


def reflectance(cos_i: Any, cos_t: Any, n_i: Any, n_t: Any) -> Any:
    """
    Return the Fresnel reflectance for unpolarised light.

    Parameters
    ----------
    cos_i, cos_t : float or array
        Cosines of the angles of incidence and refraction, in [0, 1]; pass ``cos_t = 0`` for total internal reflection,
        the result is then 1.
    n_i, n_t : float or array
        Refractive indices on the side of incidence and on the other side.

    Returns
    -------
    float or array
        R = (r_s² + r_p²)/2 in [0, 1]; never NaN for arguments in range. The transmittance is 1 - R.
    """
    r_s, r_p = amplitudes(cos_i, cos_t, n_i, n_t)
    return 0.5 * (r_s * r_s + r_p * r_p)


def amplitudes(cos_i: Any, cos_t: Any, n_i: Any, n_t: Any) -> tuple[Any, Any]:
    """
    Return the Fresnel amplitudes r_s and r_p of the reflected electric field.

    At normal incidence r_s = -r_p = (n_i - n_t)/(n_i + n_t).
    Parameters are those of `reflectance`.
    """
    r_s = (n_i * cos_i - n_t * cos_t) / (n_i * cos_i + n_t * cos_t + _TINY)
    r_p = (n_t * cos_i - n_i * cos_t) / (n_t * cos_i + n_i * cos_t + _TINY)
    return r_s, r_p


def transmitted_product(cos_i: Any, cos_t: Any, n_i: Any, n_t: Any) -> Any:
    """
    Return the product t_s t_p of the transmitted amplitudes, normalised so that their squares are flux fractions.

    Parameters are those of `reflectance`.
    """
    both = 4 * n_i * n_t * cos_i * cos_t
    return both / ((n_i * cos_i + n_t * cos_t + _TINY) * (n_t * cos_i + n_i * cos_t + _TINY))


def total_product(cos_i: Any, beyond: Any, n_i: Any, n_t: Any) -> tuple[Any, Any]:
    """
    Return the real and the imaginary part of r_s r_p* in total internal reflection.

    Its phase is that of r_s less that of r_p, the retardance.

    Parameters
    ----------
    cos_i, n_i, n_t : float or array
        Parameters of `reflectance`.
    beyond : float or array
        Square root √((n_i/n_t)² sin² θ_i - 1) ≥ 0; i times it is the cosine of refraction for fields of exp(-iωt).
    """
    s_r, s_i = n_i * cos_i, n_t * beyond  # r_s = (s_r - i s_i) / (s_r + i s_i)
    p_r, p_i = n_t * cos_i, n_i * beyond
    size = (s_r * s_r + s_i * s_i) * (p_r * p_r + p_i * p_i) + _TINY
    a, b = s_r * p_r + s_i * p_i, s_r * p_i - s_i * p_r  # (s_r - i s_i) (p_r + i p_i) = a + i b
    return (a * a - b * b) / size, 2 * a * b / size
