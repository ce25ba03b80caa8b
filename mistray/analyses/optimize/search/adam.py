"""Adam (Kingma & Ba, ICLR 2015, algorithm 1) within bounds: a gradient search that tolerates noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mistray.analyses.optimize.search.point import AfterStep, Merit
    from mistray.analyses.optimize.study.model import Optimizer

# The authors' values
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


def adam(function: Merit, y0: np.ndarray, optimizer: Optimizer, after: AfterStep) -> str:
    """
    Lower a merit by steps whose length hardly depends on that of the gradient; see `Search`.

    The merit may have noise. `step_size` is α of the first step, and each further α is `decay` times the one before. A
    step beyond a bound ends at it.
    """
    y = y0
    first, second = np.zeros_like(y0), np.zeros_like(y0)
    slope = function(y).slope
    step = 0
    while np.any(slope) or np.any(first):
        step += 1
        first = BETA_1 * first + (1 - BETA_1) * slope
        second = BETA_2 * second + (1 - BETA_2) * slope**2
        mean, square = first / (1 - BETA_1**step), second / (1 - BETA_2**step)
        size = optimizer.step_size * optimizer.decay ** (step - 1)
        y = np.clip(y - size * mean / (np.sqrt(square) + EPSILON), 0.0, 1.0)
        slope = function(y).slope
        after(y)
    return "the gradient is 0"
