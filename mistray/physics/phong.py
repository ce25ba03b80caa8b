"""Phong model: BSDF = b0 cos^n α, with the angle α between the scattered and the specular direction.

It is the Phong scatter of FRED, a function of the cosine of that angle; first B. T. Phong, Commun. ACM 18, 311 (1975).
The form without a division by cos θs, which in reflection is reciprocal: R. R. Lewis, Comput. Graph. Forum 13, 109
(1994). A lobe of exponent n has fallen to 1/e at α ≈ sqrt(2/n).
"""

from __future__ import annotations

import math
from typing import Any

from mistray.physics._arrays import arithmetic

_TINY = 1e-30


def bsdf(chord: Any, b0: Any, exponent: Any) -> Any:
    """
    Return the BSDF b0 cos^n α, which is 0 for α ≥ 90°.

    Parameters
    ----------
    chord : float or array
        Distance of the two unit vectors, 2 sin(α/2), 0 … 2.
    b0 : float or array
        BSDF in the specular direction, 1/sr.
    exponent : float or array
        Exponent n, ≥ 1.

    Returns
    -------
    float or array
        BSDF, 1/sr. Differentiable in all arguments in Dr.Jit.
    """
    xp = arithmetic(chord, b0, exponent)
    cosine = 1 - 0.5 * chord * chord
    power = xp.exp(exponent * xp.log(xp.maximum(cosine, _TINY)))
    return b0 * xp.select(cosine > 0, power, 0.0)


def tis(b0: Any, exponent: Any) -> Any:
    """
    Return the total integrated scatter at normal incidence, 2π b0/(n + 2).

    Parameters
    ----------
    b0, exponent : float or array
        Parameters of `bsdf`.
    """
    return 2 * math.pi * b0 / (exponent + 2)
