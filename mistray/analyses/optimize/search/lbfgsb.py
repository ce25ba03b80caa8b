"""L-BFGS-B search (Byrd, Lu, Nocedal & Zhu, SIAM J. Sci. Comput. 16, 1190, 1995), from SciPy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

if TYPE_CHECKING:
    from mistray.analyses.optimize.search.point import AfterStep, Merit
    from mistray.analyses.optimize.study.model import Optimizer

UNLIMITED = 10**9  # what ends a search is decided after each step


def lbfgsb(function: Merit, y0: np.ndarray, optimizer: Optimizer, after: AfterStep) -> str:
    """Minimise a merit by L-BFGS-B, see `Search`; `step_size` limits the move of each coordinate in the first trial."""
    first = function(y0)
    slope = first.slope
    largest = float(np.max(np.abs(np.where(((y0 <= 0) & (slope > 0)) | ((y0 >= 1) & (slope < 0)), 0.0, slope))))
    if largest == 0:
        return "the gradient is 0"
    # The first trial is the gradient itself: in units of `unit` it moves no coordinate by more than `step_size`
    unit = float(np.sqrt(optimizer.step_size / largest))

    def point(z: np.ndarray) -> np.ndarray:
        return np.clip(z * unit, 0.0, 1.0)

    known = {(y0 / unit).tobytes(): first}

    def scaled(z: np.ndarray) -> tuple[float, np.ndarray]:
        found = known.pop(z.tobytes()) if z.tobytes() in known else function(point(z))
        return found.merit, found.slope * unit

    outcome = minimize(
        scaled,
        y0 / unit,
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, 1.0 / unit)] * len(y0),
        callback=lambda z: after(point(z)),
        options={"maxiter": UNLIMITED, "maxfun": UNLIMITED, "ftol": 0.0, "gtol": 0.0},
    )
    if outcome.success:
        return "converged: the merit no longer changes"
    return f"no lower merit along the gradient ({outcome.message})"
