"""Gaussian lobe over direction cosines: BSDF = f0 exp(-(r/w)²), r = |β - β0|.

It is the Gaussian scatter of OpticStudio and FRED. r is the distance of the direction cosines of the scattered ray from
those of the specular ray, tangential to the surface. w is the r at which the lobe has fallen to 1/e.
"""

from __future__ import annotations

import math
from typing import Any

from mistray.physics._arrays import arithmetic
from mistray.physics.growth import growth


def bsdf(r: Any, total: Any, width: Any) -> Any:
    """
    Return the BSDF f0 exp(-(r/w)²) that scatters the fraction `total` at normal incidence.

    ``f0 = total/(π w² (1 - exp(-1/w²)))``; at oblique incidence the horizon cuts a part of the lobe.

    Parameters
    ----------
    r : float or array
        Distance |β - β0| of the direction cosines, ≥ 0.
    total : float or array
        Fraction of light scattered at normal incidence, ≥ 0.
    width : float or array
        Width w of the lobe, > 0.

    Returns
    -------
    float or array
        BSDF, 1/sr. Differentiable in all arguments in Dr.Jit.
    """
    inverse = 1 / (width * width)
    return total / (math.pi * growth(-inverse)) * arithmetic(r, width).exp(-r * r * inverse)
