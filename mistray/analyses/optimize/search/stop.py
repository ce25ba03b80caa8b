"""Criterion by which a search ends: too small a decrease of the merit over several steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def stop_reason(merits: Sequence[float], tolerance: float, patience: int, noisy: bool) -> str | None:
    """
    Return why a search is over; None while its last steps still lower the merit by enough, or are too few to tell.

    Parameters
    ----------
    merits : sequence of float
        Merit at the start and after each step.
    tolerance : float
        Least decrease of the merit over `patience` steps, dimensionless; with 0 no search is ever over.
    patience : int
        Number of steps over which the decrease is judged, at least 1.
    noisy : bool
        False: the least merit so far counts. True: the mean over `patience` steps against the mean over those before,
        because every merit has its own noise.

    Returns
    -------
    str or None
        Reason for the end; None: the search goes on.
    """
    if tolerance == 0:
        return None
    if noisy:
        if len(merits) < 2 * patience:
            return None
        before, now = np.mean(merits[-2 * patience : -patience]), np.mean(merits[-patience:])
        what = f"the mean merit of {patience} steps is less than {tolerance:g} below that of the {patience} before"
    else:
        if len(merits) <= patience:
            return None
        before, now = np.min(merits[:-patience]), np.min(merits)
        what = f"the last {patience} steps have lowered the merit by less than {tolerance:g}"
    return f"converged: {what}" if before - now < tolerance else None
