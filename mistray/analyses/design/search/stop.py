"""When a search ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def stop_reason(merits: Sequence[float], tolerance: float, patience: int, noisy: bool) -> str | None:
    """
    Whether a search is over: its last steps have lowered the merit by too little.

    Parameters
    ----------
    merits : sequence of float
        After each step, the start being the first.
    tolerance : float
        What `patience` steps must lower it by at least, 1; with 0 no search is ever over.
    patience : int
        Number of steps, at least 1.
    noisy : bool
        False: the least merit so far counts. True: the mean over `patience` steps against the mean over those before,
        because every merit has its own noise.

    Returns
    -------
    str or None
        Why it is over.
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
