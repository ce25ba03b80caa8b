"""Monte Carlo estimates: numbers with their standard errors."""

from __future__ import annotations

import math
from typing import NamedTuple


class Estimate(NamedTuple):
    """
    A Monte Carlo estimate and its standard error, in the same unit.

    Attributes
    ----------
    value : float
        Estimate; its unit is that of the attribute or table that holds it.
    se : float
        Standard error, ≥ 0; NaN if it is unknown.

    Examples
    --------
    >>> stray = mistray.analysis.Estimate(2.5e-4, 3e-6)
    >>> direct = mistray.analysis.Estimate(0.5, 0.001)
    >>> ratio = stray.over(direct)
    >>> print(f"{ratio.value:.2e} ± {ratio.se:.0e}")
    5.00e-04 ± 6e-06
    """

    value: float
    se: float

    def times(self, factor: float) -> Estimate:
        """Return the estimate multiplied by an exact number, and its standard error by the size of that number."""
        return Estimate(factor * self.value, abs(factor) * self.se)

    def over(self, other: Estimate) -> Estimate:
        """
        Return the quotient of two estimates; NaN if ``other`` is 0 or not finite.

        Relative errors add in quadrature. This holds for independent runs, and is an approximation for numbers of one
        run, which share start rays.
        """
        if other.value == 0 or not math.isfinite(other.value):
            return UNKNOWN
        quotient = self.value / other.value
        return Estimate(quotient, math.hypot(self.se, quotient * other.se) / abs(other.value))


UNKNOWN = Estimate(math.nan, math.nan)
