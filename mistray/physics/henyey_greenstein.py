"""Phase function of Henyey and Greenstein, for scatter in the bulk of a material.

Source: L. G. Henyey, J. L. Greenstein, "Diffuse radiation in the Galaxy", Astrophys. J. 93, 70 (1941).
"""

from __future__ import annotations

import math
from typing import Any

from mistray.physics._arrays import arithmetic

ISOTROPIC = 1e-3  # asymmetry below which the direction is uniform


def phase_function(cosine: Any, g: Any) -> Any:
    """
    Return the phase function, the fraction of the scattered light per solid angle, 1/sr.

    Parameters
    ----------
    cosine : float or array
        Cosine of the scattering angle.
    g : float or array
        Asymmetry parameter, the mean cosine, -1 < g < 1.
    """
    ops = arithmetic(cosine, g)
    denominator = 1 + g * g - 2 * g * cosine
    return (1 - g * g) / (4 * math.pi * denominator * ops.sqrt(denominator))


def phase_about(ahead: Any, behind: Any, g: Any) -> Any:
    """
    Return `phase_function` of two unit directions, 1/sr, in a form that keeps its digits for g close to 1 or -1.

    Parameters
    ----------
    ahead, behind : float or array
        Squared length of the difference and of the sum of the directions, 2 - 2 cos and 2 + 2 cos.
    g : float or array
        Asymmetry parameter, -1 < g < 1.
    """
    ops = arithmetic(ahead, behind, g)
    size = abs(g)
    denominator = (1 - size) * (1 - size) + size * ops.select(g > 0, ahead, behind)
    return (1 - size) * (1 + size) / (4 * math.pi * denominator * ops.sqrt(denominator))


def sampled_cosine(u: Any, g: Any) -> Any:
    """
    Return the cosine of a random scattering angle with the density of `phase_function`; isotropic for |g| < 0.001.

    Parameters
    ----------
    u : float or array
        Uniform random numbers in 0 … 1.
    g : float or array
        Asymmetry parameter, -1 < g < 1.
    """
    ops = arithmetic(u, g)
    uniform = abs(g) < ISOTROPIC
    safe = ops.select(uniform, 1 + 0 * g, g)
    ratio = (1 - safe * safe) / (1 - safe + 2 * safe * u)
    return ops.select(uniform, 2 * u - 1, (1 + safe * safe - ratio * ratio) / (2 * safe))
