"""Forbes's Q polynomials: departures of mild (Qbfs) and strong (Qcon) aspheres from a conic.

G. W. Forbes, "Shape specification for axially symmetric optical surfaces", Opt. Express 15, 5218 (2007), and "Robust,
efficient computational methods for axially symmetric optical aspheres", Opt. Express 18, 19700 (2010). With u the
distance from the axis in units of `radius` and x = u²:

    Qcon:  u⁴ Σ a_m Qcon_m(x),             Qcon_m the Jacobi polynomials P_m^(0,4)(2x - 1)
    Qbfs:  u² (1 - u²)/cos γ Σ a_m Qbfs_m(x),  cos² γ = (1 - (1 + k) c² ρ²)/(1 - k c² ρ²)

γ is the slope of the conic of curvature c and constant k from which the asphere departs along its normals; Forbes has
a sphere, k = 0. The Qbfs have slopes, along these normals, that are orthogonal with the weight 1/√(x - x²).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np


def qcon(x: np.ndarray, terms: Mapping[int, float]) -> np.ndarray:
    """Σ a_m Qcon_m(x), times x²; terms by m = 0, 1, …."""
    from scipy.special import eval_jacobi  # takes longer to import than all else of a sag

    total = np.zeros(np.shape(x))
    for m, amount in terms.items():
        total = total + amount * eval_jacobi(m, 0, 4, 2 * np.asarray(x) - 1)
    return np.asarray(total * np.square(x))


def qbfs(x: np.ndarray, terms: Mapping[int, float]) -> np.ndarray:
    """Σ a_m Qbfs_m(x), times x (1 - x); terms by m = 0, 1, …."""
    x = np.asarray(x, dtype=np.float64)
    values = qbfs_values(x, max(terms, default=0))
    total = np.zeros(x.shape)
    for m, amount in terms.items():
        total = total + amount * values[m]
    return np.asarray(total * x * (1 - x))


def qbfs_values(x: np.ndarray, last: int) -> list[np.ndarray]:
    """Qbfs_0 … Qbfs_last, by the three-term recurrence of Forbes (2010), appendix A."""
    auxiliary = [np.full_like(x, 2.0), 6 - 8 * x]
    while len(auxiliary) <= last:
        auxiliary.append((2 - 4 * x) * auxiliary[-1] - auxiliary[-2])
    f, g, h = [2.0, math.sqrt(19) / 2], [-0.5], [0.0]
    values = [np.ones_like(x), (13 - 16 * x) / math.sqrt(19)]
    for m in range(2, last + 1):
        h.append(-m * (m - 1) / (2 * f[m - 2]))
        g.append(-(1 + g[m - 2] * h[m - 1]) / f[m - 1])
        f.append(math.sqrt(m * (m + 1) + 3 - g[m - 1] ** 2 - h[m - 1] ** 2))
        values.append((auxiliary[m] - g[m - 1] * values[m - 1] - h[m - 1] * values[m - 2]) / f[m])
    return values[: last + 1]
