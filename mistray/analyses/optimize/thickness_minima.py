"""Layer thicknesses of least cost: minima found from points of a Latin hypercube."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

Cost = Callable[[np.ndarray], np.ndarray]  # (n, L) thicknesses in nm → (n,)
DIFFERENCE_NM = 0.01
FLOOR = 1e-30  # of a cost, for its logarithm


def thickness_minima(
    cost: Cost,
    bounds_nm: Sequence[tuple[float, float]],
    given: Sequence[np.ndarray],
    *,
    points: int,
    followed: int,
    seed: int = 0,
) -> list[np.ndarray]:
    """
    Return local minima of the logarithm of a cost within bounds, the deepest first; some may coincide.

    Parameters
    ----------
    cost : callable
        Function of thicknesses, nm, (n, L), that returns costs, (n,), greater than 0; less counts as `FLOOR`.
    bounds_nm : sequence of (low, high)
        Bounds of the thickness of each layer, nm.
    given : sequence of (L,) float64
        Further starting designs, nm.
    points, followed : int
        Size of the Latin hypercube, and number of its best points that are followed to a minimum.
    seed : int
        Seed of the Latin hypercube.

    Returns
    -------
    list of (L,) float64
        Thicknesses, nm.
    """
    low, high = np.array(bounds_nm).T
    layers = len(low)
    scattered = qmc.scale(qmc.LatinHypercube(layers, seed=np.random.default_rng(seed)).random(points), low, high)
    steps = DIFFERENCE_NM * np.concatenate([np.zeros((1, layers)), np.eye(layers), -np.eye(layers)])

    def slope(d: np.ndarray) -> tuple[float, np.ndarray]:
        places = np.maximum(d + steps, 0.0)  # a layer of no thickness has a slope on one side
        values = np.log(np.maximum(cost(places), FLOOR))
        up, down = np.split(values[1:], 2)
        return float(values[0]), (up - down) / (DIFFERENCE_NM + np.minimum(d, DIFFERENCE_NM))

    starts = [*given, *scattered[np.argsort(cost(scattered))[:followed]]]
    ends = [minimize(slope, start, jac=True, method="L-BFGS-B", bounds=bounds_nm) for start in starts]
    return [np.asarray(end.x) for end in sorted(ends, key=lambda end: float(end.fun))]
