"""Central differences of real functions."""

from collections.abc import Callable, Sequence

import numpy as np

from .geometry import Array


def central_differences(function: Callable[..., Array], point: Sequence[float], steps: Sequence[float]) -> Array:
    """Derivatives by each argument, (arguments, …), of fourth order: (8 [f(h) - f(-h)] - [f(2h) - f(-2h)])/12h."""
    rows = []
    for k, step in enumerate(steps):
        values = []
        for shift in (1, -1, 2, -2):
            moved = list(point)
            moved[k] += shift * step
            values.append(np.asarray(function(*moved), dtype=float))
        rows.append((8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * step))
    return np.array(rows)
