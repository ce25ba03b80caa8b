"""Minimum and maximum of two numbers by one comparison.

`dr.minimum` and `dr.maximum` order signed zeros and pass on every NaN, which takes five more instructions. In the
innermost loops that is a tenth of the time. The functions here return `b` if either number is NaN.
"""

from __future__ import annotations

from typing import Any

import drjit as dr


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers: a where a < b, else b."""
    return dr.select(a < b, a, b)


def larger(a: Any, b: Any) -> Any:
    """Return the larger of two numbers: a where a > b, else b."""
    return dr.select(a > b, a, b)
