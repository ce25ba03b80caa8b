"""Sequential quadratic programming within a trust region, for merits with steep penalties at limits.

Each step minimises a model of the merit in a box about the point. The model has the smooth part to second order and
the penalties as squares of linearised residuals, so that a valley between steep walls is known from the first step.
Where the walls bend, a second trial corrects the first. The curvature of the Lagrangian is estimated by damped BFGS
updates (Nocedal & Wright, Numerical Optimization, 2nd ed., procedure 18.2). The box grows or shrinks with the quality
of the model (algorithm 4.1).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import lsq_linear

from mistray.analyses.optimize.search.point import Pieces, Point

if TYPE_CHECKING:
    from mistray.analyses.optimize.search.point import AfterStep, Merit
    from mistray.analyses.optimize.study.model import Optimizer

GOOD, BAD = 0.75, 0.25  # lowered by so much of what the model says: the box grows, shrinks
LARGEST, SMALLEST = 0.5, 1e-8  # half side of the box; the least is where single precision ends
LEAST = 0.01  # of the curvature along a step is left by an update
FAINT = 1e-10  # of the curvature, so that the model has one minimum
ROUNDS = 30  # of finding out which one-sided penalties count


def sqp(function: Merit, y0: np.ndarray, optimizer: Optimizer, after: AfterStep) -> str:
    """
    Minimise a merit given by its pieces; for the arguments and the result see `Search`.

    `step_size` limits the move of each coordinate in the first trial.
    """
    y, here = y0, function(y0)
    size = optimizer.step_size
    pieces = _pieces(here)
    # Along the valley the first trial is the gradient: it moves no coordinate by more than `step_size`
    along = pieces.slope - np.linalg.pinv(pieces.rows) @ (pieces.rows @ pieces.slope)
    curvature = np.eye(len(y)) * max(np.max(np.abs(along)) / size, FAINT * np.sum(pieces.rows**2), FAINT)
    while size > SMALLEST:
        low, high = np.maximum(-size, -y), np.minimum(size, 1 - y)
        step = _lowest(pieces, curvature, low, high)
        expected = -_change(pieces, curvature, step)
        if expected <= 0:
            return "no lower merit along the gradients"
        trial = np.clip(y + step, 0.0, 1.0)
        there = function(trial)
        if here.merit - there.merit < BAD * expected and len(pieces.rows):
            # Walls that bend: once more, with the residuals as they were found (a second-order correction)
            found = replace(pieces, residuals=_pieces(there).residuals - pieces.rows @ step)
            corrected = np.clip(y + _lowest(found, curvature, low, high), 0.0, 1.0)
            again = function(corrected)
            if again.merit < there.merit:
                trial, there, step = corrected, again, corrected - y
        share = (here.merit - there.merit) / expected
        curvature = _learnt(curvature, step, pieces, _pieces(there))
        length = float(np.max(np.abs(step)))
        if share > GOOD and length > 0.9 * size:
            size = min(2 * size, LARGEST)
        elif share < BAD:
            size = BAD * length
        if there.merit < here.merit:
            y, here, pieces = trial, there, _pieces(there)
            after(y)
    return "no lower merit within the precision of the parameters"


def _pieces(point: Point) -> Pieces:
    assert point.pieces is not None  # the evaluation knows the method
    return point.pieces


def _change(pieces: Pieces, curvature: np.ndarray, step: np.ndarray) -> float:
    """Return the change of the merit, dimensionless, that the quadratic model predicts for a step, (n,)."""
    smooth = pieces.slope @ step + 0.5 * step @ curvature @ step
    return float(smooth + pieces.penalty(pieces.residuals + pieces.rows @ step) - pieces.penalty(pieces.residuals))


def _lowest(pieces: Pieces, curvature: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the step, (n,), from `low` to `high`, (n,), that minimises the quadratic model; 0 if none lowers it."""
    free = high > low
    values, axes = np.linalg.eigh(curvature)
    roots = np.sqrt(np.maximum(values, FAINT * values[-1]))
    # Smooth part: |root s + root⁻ᵀ slope|²/2 but for a constant
    rows = [roots[:, None] * axes.T / np.sqrt(2.0)]
    ends = [-(axes.T @ pieces.slope) / roots / np.sqrt(2.0)]
    scale = np.sqrt(pieces.weights)
    counts = ~pieces.one_sided | (pieces.residuals > 0)
    best, least = np.zeros(len(low)), 0.0
    for _ in range(ROUNDS):
        a = np.concatenate([*rows, (scale[:, None] * pieces.rows)[counts]])
        b = np.concatenate([*ends, (-scale * pieces.residuals)[counts]])
        step = np.zeros(len(low))
        if np.any(free):
            found = lsq_linear(a[:, free], b, (low[free], high[free]), method="bvls")
            step[free] = np.clip(found.x, low[free], high[free])
        change = _change(pieces, curvature, step)
        if change < least:
            best, least = step, change
        now = ~pieces.one_sided | (pieces.residuals + pieces.rows @ step > 0)
        if np.array_equal(now, counts):
            break
        counts = now
    return best


def _learnt(curvature: np.ndarray, step: np.ndarray, before: Pieces, behind: Pieces) -> np.ndarray:
    """
    Return the curvature of the Lagrangian, (n, n), after a step, by a damped BFGS update.

    Its multipliers are those that best balance the gradient of the smooth part with those of the residuals. The
    multipliers of the squares, 2 w r, would be too large where a single trial lies off the walls.
    """
    counts = ~before.one_sided | (before.residuals > 0) | (behind.residuals > 0)
    multipliers = np.zeros(len(counts))
    multipliers[counts] = -np.linalg.pinv(behind.rows[counts].T) @ behind.slope
    multipliers[before.one_sided] = np.maximum(multipliers[before.one_sided], 0.0)
    change = behind.slope - before.slope + (behind.rows - before.rows).T @ multipliers
    known = curvature @ step
    expected = step @ known
    if expected <= 0:
        return curvature
    seen = step @ change
    if seen < LEAST * expected:
        share = (1 - LEAST) * expected / (expected - seen)
        change = share * change + (1 - share) * known
        seen = step @ change
    return np.asarray(curvature - np.outer(known, known) / expected + np.outer(change, change) / seen)
