"""Checks of the numbers of scatter models."""

from __future__ import annotations

import math

from mistray.errors import MistrayError


def need_positive(title: str, key: str, value: float, unit: str = "") -> None:
    """
    Refuse a number that is not finite and above 0.

    Raises
    ------
    MistrayError
    """
    if not (math.isfinite(value) and value > 0):
        raise MistrayError(f"{title}: {key} is {value:g}{unit}; give a number > 0")


def need_not_negative(title: str, key: str, value: float, unit: str = "") -> None:
    """
    Refuse a number that is not finite and at least 0.

    Raises
    ------
    MistrayError
    """
    if not (math.isfinite(value) and value >= 0):
        raise MistrayError(f"{title}: {key} is {value:g}{unit}; give a number ≥ 0")
