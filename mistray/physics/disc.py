"""Integral of a lobe over the directions above the horizon, a unit disc of direction cosines.

In these coordinates BSDF cos θ dΩ is BSDF d²β, and a lobe that depends on r = |β - β0| is a disc about β0 that the
horizon cuts. Within ρ = 1 - |β0| the circles of radius r are whole; beyond, the arc is ``2π - 2 acos[(1 - |β0|² -
r²)/(2 |β0| r)]``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_OCTAVES = 60  # octaves of radii below the edge; the profile within them is taken as constant
_EDGE_STEPS = 12  # panels beyond the first whole circle from either end, geometric towards the ends of the arc


def disc_total(profile: Callable[[np.ndarray], np.ndarray], sin_0: float) -> float:
    """
    Return the integral of a profile over the unit disc.

    Parameters
    ----------
    profile : callable
        Function of the distances r from the centre of the lobe, (m,) in (0, 2), that returns values, 1/sr; smooth in
        log r.
    sin_0 : float
        Distance |β0| of the lobe's centre from that of the disc, 0 … 1.

    Returns
    -------
    float
        Scattered fraction of the light; relative error about 1e-10 for power laws with a few knees.
    """
    whole = (1 - sin_0) if sin_0 < 1 else 0.0
    total = 0.0
    if whole > 0:
        r, weight = _panels(np.log(whole) - np.log(2) * np.arange(_OCTAVES, -1, -1.0))
        smallest = whole * 2.0**-_OCTAVES
        total += float(np.sum(weight * r * r * 2 * np.pi * profile(r)))
        total += float(np.pi * smallest**2 * profile(np.array([smallest]))[0])
    if sin_0 == 0:
        return total
    # The arc has square roots at both ends, so the panels shrink towards them
    start = np.log(max(whole, 2.0**-_OCTAVES))
    span = np.log(1 + sin_0) - start
    inner = np.linspace(0, 1, max(8, int(np.ceil(span / np.log(2))) + 1))
    steps = inner[1] * 4.0 ** -np.arange(_EDGE_STEPS, 0, -1.0)
    r, weight = _panels(start + span * np.concatenate([[0.0], steps, inner[1:-1], 1 - steps[::-1], [1.0]]))
    # (1 - |β0|² - r²) without cancellation next to the first whole circle
    cosine = (whole * (1 + sin_0) - r * r) / (2 * sin_0 * r)
    arc = 2 * np.pi - 2 * np.arccos(np.clip(cosine, -1, 1))
    return total + float(np.sum(weight * r * r * arc * profile(r)))


def _panels(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return radii r and weights, (m,), for ∫ d(ln r) by Gauss's rule on each interval between `edges` in ln r."""
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    nodes = middle[:, None] + half[:, None] * _NODES
    return np.exp(nodes).ravel(), (half[:, None] * _WEIGHTS).ravel()
