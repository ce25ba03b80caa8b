"""Formatting of fractions in percent."""

from __future__ import annotations

import math


def percent_text(share: float, digits: int = 2) -> str:
    """
    Return a fraction in percent, such as "0.31 %", "12 %" or "240 %", without an exponent for large values.

    Parameters
    ----------
    share : float
        Fraction; 1 is the whole. A value that is not finite gives "– %".
    digits : int
        Number of significant digits; digits before the point are always kept.
    """
    value = 100 * share
    if not math.isfinite(value):
        return "– %"
    text = f"{value:.{digits}g}"
    return f"{value:.0f} %" if "e+" in text else f"{text} %"
