"""Departure of a surface from a quadric as a sum of products of Chebyshev polynomials, for single precision.

Zernike, Forbes's, XY and other polynomials have coefficients that cancel: a sum of powers in float32 loses digits with
every order. In Chebyshev polynomials over the surface's own box no coefficient is larger than the departure itself,
and what is no polynomial (a toroid, a biconic) comes close to one at an exponential rate. See L. N. Trefethen,
*Approximation Theory and Approximation Practice* (2013), chapters 3 and 8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

DEGREES = (2, 4, 6, 8, 10, 12, 14, 16, 20)
OVERLAP = 1.002  # of the box, so that rounding does not leave it
GRID = 61  # points each way at which the error is measured
NEGLIGIBLE = 1e-14  # of the largest coefficient: what symmetry makes 0

Sag = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Form:
    """
    Properties of a departure that the code which evaluates it depends on.

    Attributes
    ----------
    degree : int
        Greatest total order; -1: there is no departure.
    even_x, even_y : bool
        It is the same at -x, at -y (from the middle of its box).
    """

    degree: int = -1
    even_x: bool = False
    even_y: bool = False

    @property
    def terms(self) -> tuple[tuple[int, int], ...]:
        """Orders in x and y of the coefficients, in their order."""
        return tuple(
            (i, j)
            for j in range(0, self.degree + 1, 2 if self.even_y else 1)
            for i in range(0, self.degree + 1 - j, 2 if self.even_x else 1)
        )

    def evaluate(self, u: Any, v: Any, coefficients: Sequence[Any]) -> tuple[Any, Any, Any]:
        """
        Value and derivatives.

        Parameters
        ----------
        u, v : float or array
            Place in the box, -1 … 1; NumPy or Dr.Jit.
        coefficients : sequence of float or array
            In the order of `terms`, mm.

        Returns
        -------
        value, by_u, by_v
            mm.
        """
        across, slopes = _polynomials(u, self.degree)
        along, rises = _polynomials(v, self.degree)
        rows: dict[int, list[tuple[int, Any]]] = {}
        for (i, j), c in zip(self.terms, coefficients, strict=True):
            rows.setdefault(j, []).append((i, c))
        value: Any = 0
        by_u: Any = 0
        by_v: Any = 0
        for j, row in rows.items():
            part: Any = 0
            slope: Any = 0
            for i, c in row:
                part = part + c * across[i]
                slope = slope + c * slopes[i] if i else slope
            value, by_u = value + part * along[j], by_u + slope * along[j]
            by_v = by_v + part * rises[j] if j else by_v
        return value, by_u, by_v


@dataclass(frozen=True)
class BoxDeparture:
    """
    A departure over a box.

    Attributes
    ----------
    form : Form
    half : (2,) float
        Half sizes of the box, whose middle is the origin, mm.
    coefficients : (n,) float64
        mm.
    error, slope_error : float
        Largest difference from what it stands for within the outline, mm, and of its slope.
    """

    form: Form
    half: tuple[float, float]
    coefficients: np.ndarray
    error: float
    slope_error: float

    @classmethod
    def of(
        cls, sag: Sag, half: tuple[float, float], x: np.ndarray, y: np.ndarray, enough: float, form: Form | None = None
    ) -> BoxDeparture:
        """
        The departure that a function gives.

        Parameters
        ----------
        sag : callable
            mm, of arrays of x and y; NaN where there is none.
        half : (2,) float
            Half sizes of the box, mm.
        x, y : (n,) float64
            Points at which the error counts, mm.
        enough : float
            Error at which no higher degree is tried, mm.
        form : Form, optional
            What it has to be; by default the least that is good enough.
        """
        half = (OVERLAP * half[0], OVERLAP * half[1])
        exact = sag(x, y)
        if (form is None and not np.any(np.abs(exact) > 1e-3 * enough)) or (form is not None and form.degree < 0):
            return cls(Form(), half, np.zeros(0), float(np.max(np.abs(exact), initial=0.0)), 0.0)
        best: BoxDeparture | None = None
        for degree in DEGREES if form is None else (form.degree,):
            table = _table(sag, half, degree, x, y)
            found = _compact(table, half, form or _form(table))
            error = float(np.max(np.abs(found.at(x, y)[0] - exact)))
            best = found if best is None or error < best.error else best
            best = cls(best.form, half, best.coefficients, min(error, best.error), 0.0)
            if best.error <= enough:
                break
        assert best is not None
        return cls(best.form, half, best.coefficients, best.error, best._slope_error(sag, x, y))

    def _slope_error(self, sag: Sag, x: np.ndarray, y: np.ndarray) -> float:
        step = 1e-5 * min(self.half)
        _, by_x, by_y = self.at(x, y)
        with np.errstate(invalid="ignore"):
            exact = (
                (sag(x + step, y) - sag(x - step, y)) / (2 * step),
                (sag(x, y + step) - sag(x, y - step)) / (2 * step),
            )
        noise = 1e-15 * float(np.max(np.abs(self.coefficients), initial=0.0)) / step
        return max(float(np.nanmax(np.abs(e - own))) for e, own in zip(exact, (by_x, by_y), strict=True)) - noise

    def at(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Value (mm) and slopes at points in mm."""
        if self.form.degree < 0:
            zero = np.zeros(np.shape(x))
            return zero, zero, zero
        value, by_u, by_v = self.form.evaluate(x / self.half[0], y / self.half[1], self.coefficients.tolist())
        return value, by_u / self.half[0], by_v / self.half[1]


def _polynomials(u: Any, degree: int) -> tuple[list[Any], list[Any]]:
    """T_0 … T_degree and their derivatives."""
    values: list[Any] = [1.0, u]
    slopes: list[Any] = [0.0, 1.0]
    twice = 2 * u
    for _ in range(degree - 1):
        slopes.append(2 * values[-1] + twice * slopes[-1] - slopes[-2])
        values.append(twice * values[-1] - values[-2])
    return values, slopes


def _table(sag: Sag, half: tuple[float, float], degree: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(degree + 1, degree + 1) coefficients by orders in x and y, of a total order up to `degree`."""
    count = 2 * degree + 2
    nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = sag(half[0] * nodes[:, None], half[1] * nodes[None, :])
    if np.isfinite(values).all():
        basis = chebyshev.chebvander(nodes, degree)
        table = basis.T @ values @ basis * (4 / count**2)
        table[0] /= 2
        table[:, 0] /= 2
        return np.where(np.add.outer(np.arange(degree + 1), np.arange(degree + 1)) <= degree, table, 0.0)
    # The corners of the box have no sag: least squares over the outline
    exact = sag(x, y)
    some = np.flatnonzero(np.isfinite(exact))
    orders = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    across = chebyshev.chebvander(x[some] / half[0], degree)
    along = chebyshev.chebvander(y[some] / half[1], degree)
    matrix = np.stack([across[:, i] * along[:, j] for i, j in orders], axis=1)
    found = np.linalg.lstsq(matrix, exact[some], rcond=1e-13)[0]
    table = np.zeros((degree + 1, degree + 1))
    for (i, j), c in zip(orders, found, strict=True):
        table[i, j] = c
    return table


def _form(table: np.ndarray) -> Form:
    """Without the orders that symmetry makes 0."""
    there = np.argwhere(np.abs(table) > NEGLIGIBLE * np.abs(table).max())
    return Form(len(table) - 1, not np.any(there[:, 0] % 2), not np.any(there[:, 1] % 2))


def _compact(table: np.ndarray, half: tuple[float, float], form: Form) -> BoxDeparture:
    return BoxDeparture(form, half, np.array([table[place] for place in form.terms]), np.inf, np.inf)
