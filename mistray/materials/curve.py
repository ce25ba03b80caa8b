"""Curve of n or k over wavelength: a formula or a table, with the range in which it holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mistray.errors import MistrayError


@dataclass(frozen=True, eq=False)
class Curve:
    """
    Refractive index n or extinction coefficient k as a function of wavelength.

    Attributes
    ----------
    evaluate : callable
        Function of the wavelength in nm that returns the value. Where there is none, it returns nan or raises
        ArithmeticError or ValueError.
    range_nm : tuple of two float or None
        Range of wavelengths in which the data hold, nm; None if everywhere.
    nodes_nm : tuple of float
        Wavelengths of a table, ascending, nm; empty for a formula.
    """

    evaluate: Callable[[float], float]
    range_nm: tuple[float, float] | None = None
    nodes_nm: tuple[float, ...] = ()

    def covers(self, wavelength_nm: float) -> bool:
        """True if the data hold at a wavelength, nm."""
        return self.range_nm is None or self.range_nm[0] <= wavelength_nm <= self.range_nm[1]

    def at(self, wavelength_nm: float, what: str, extrapolate: bool, remedy: str) -> float:
        """
        Return the value, n or k, at a wavelength.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm, > 0.
        what : str
            Start of an error message, such as "material 'N-BK7'".
        extrapolate : bool
            Whether wavelengths outside the range are allowed: formulas are evaluated there, tables keep the value of
            the nearest end.
        remedy : str
            End of the error message about a wavelength outside the range.

        Raises
        ------
        MistrayError
            If the wavelength is outside the range and `extrapolate` is False, or if there is no value.
        """
        if self.range_nm is not None and not (extrapolate or self.covers(wavelength_nm)):
            low, high = self.range_nm
            raise MistrayError(f"{what}: {wavelength_nm:g} nm is outside its {low:g} … {high:g} nm; {remedy}")
        try:
            value = self.evaluate(wavelength_nm)
        except (ArithmeticError, ValueError):
            value = math.nan
        if not math.isfinite(value):
            raise MistrayError(f"{what}: its data have no value at {wavelength_nm:g} nm; use another wavelength")
        return value


def constant(value: float) -> Curve:
    """Return a curve that has the same value of n or k at all wavelengths."""
    return Curve(lambda wavelength_nm: value)


def table(wavelength_nm: Sequence[float] | np.ndarray, values: Sequence[float] | np.ndarray) -> Curve:
    """
    Return a curve of n or k that interpolates linearly between values at wavelengths.

    Parameters
    ----------
    wavelength_nm : (n,) float
        Wavelengths, nm, distinct, in any order, n ≥ 1.
    values : (n,) float
        Values at the wavelengths; nan means that there is no value up to the neighbouring wavelengths.
    """
    x, order = np.unique(np.asarray(wavelength_nm, dtype=np.float64), return_index=True)
    y = np.asarray(values, dtype=np.float64)[order]
    return Curve(lambda at: float(np.interp(at, x, y)), (float(x[0]), float(x[-1])), tuple(x.tolist()))
