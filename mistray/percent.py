"""Shares as texts in percent."""

from __future__ import annotations

import math


def percent_text(share: float, digits: int = 2) -> str:
    """
    A share in percent, such as "0.31 %", "12 %" or "240 %", never with an exponent for what is large.

    Parameters
    ----------
    share : float
        1 is all.
    digits : int
        That are kept, and more where there are more before the point.
    """
    value = 100 * share
    if not math.isfinite(value):
        return "– %"
    text = f"{value:.{digits}g}"
    return f"{value:.0f} %" if "e+" in text else f"{text} %"
