"""A number with its standard error."""

from __future__ import annotations

import math
from typing import NamedTuple


class Estimate(NamedTuple):
    """A Monte Carlo number: ``value`` and its standard error ``se``, in the same unit."""

    value: float
    se: float

    def over(self, other: Estimate) -> Estimate:
        """
        Quotient with the relative errors added in quadrature (independent runs); NaN when ``other`` is 0 or not finite.

        For numbers of one run, which share start rays, this is an approximation.
        """
        if other.value == 0 or not math.isfinite(other.value):
            return UNKNOWN
        quotient = self.value / other.value
        return Estimate(quotient, math.hypot(self.se, quotient * other.se) / abs(other.value))


UNKNOWN = Estimate(math.nan, math.nan)
