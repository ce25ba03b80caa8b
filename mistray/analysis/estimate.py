"""A number with its standard error."""

from __future__ import annotations

import math
from collections.abc import Iterable
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


def total(parts: Iterable[Estimate]) -> Estimate:
    """
    Sum of numbers of one run.

    Their errors are added linearly: the paths of one run share start rays, so that nothing smaller is safe. The
    standard error of a sum is therefore an upper bound.
    """
    parts = list(parts)
    return Estimate(math.fsum(part.value for part in parts), math.fsum(part.se for part in parts))
