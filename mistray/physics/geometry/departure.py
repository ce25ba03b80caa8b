"""Departure of a surface from a quadric as a sum of products of Chebyshev polynomials, for single precision.

Zernike, Forbes's, XY and other polynomials have coefficients that cancel: a sum of powers in float32 loses digits with
every order. In Chebyshev polynomials over the surface's own box no coefficient exceeds the departure itself. Sags that
are not polynomials (a toroid, a biconic) are approximated at an exponential rate. See L. N. Trefethen, *Approximation
Theory and Approximation Practice* (2013), chapters 3 and 8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

DEGREES = (2, 4, 6, 8, 10, 12, 14, 16, 20)
OVERLAP = 1.002  # factor of the box, so that rounding does not lead out of it
GRID = 61  # points in each direction at which the error is measured
NEGLIGIBLE = 1e-14  # relative to the largest coefficient: smaller ones are 0 by symmetry

Sag = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Form:
    """
    Form of a departure: degree and symmetry of its polynomials, which determine the code that evaluates it.

    Attributes
    ----------
    degree : int
        Greatest total order of the polynomials; -1 for no departure.
    even_x, even_y : bool
        Whether the departure is symmetric in x and in y about the middle of its box.
    """

    degree: int = -1
    even_x: bool = False
    even_y: bool = False

    @property
    def terms(self) -> tuple[tuple[int, int], ...]:
        """
        Orders in x and in y of each polynomial, in the order of the coefficients; empty for no departure.

        A coordinate in which the departure is even has even orders only.
        """
        return tuple(
            (i, j)
            for j in range(0, self.degree + 1, 2 if self.even_y else 1)
            for i in range(0, self.degree + 1 - j, 2 if self.even_x else 1)
        )

    def evaluate(self, u: Any, v: Any, coefficients: Sequence[Any]) -> tuple[Any, Any, Any]:
        """
        Return the departure and its derivatives with respect to u and v, mm.

        Parameters
        ----------
        u, v : float or array
            Position in the box, -1 … 1; arrays of NumPy or Dr.Jit.
        coefficients : sequence of float or array
            Coefficients in the order of `terms`, mm.

        Returns
        -------
        value, by_u, by_v
            Departure and its derivatives, mm.
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
    Approximate departure of a surface from its quadric, in Chebyshev polynomials over a rectangle.

    Attributes
    ----------
    form : Form
        Form of the departure.
    half : (2,) float
        Half sizes of the box in x and y, mm; the origin is its middle.
    coefficients : (n,) float64
        Coefficients in the order of `form.terms`, mm.
    error, slope_error : float
        Largest difference from the exact departure within the outline, mm, and from its slope, dimensionless.
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
        Return the polynomial departure that approximates a given function.

        It has no terms if the function is negligible. Its box is `OVERLAP` times as large as `half`.

        Parameters
        ----------
        sag : callable
            Exact departure, mm, for arrays of x and y, mm; NaN outside its domain.
        half : (2,) float
            Half sizes of the box, mm.
        x, y : (n,) float64
            Points at which the error is measured, mm. Coefficients are fitted to them if the departure is NaN in the
            box.
        enough : float
            Error below which no higher degree is tried, mm.
        form : Form, optional
            Form of the result; by default the smallest one that is accurate enough, or the most accurate one if none
            is.
        """
        half = (OVERLAP * half[0], OVERLAP * half[1])
        exact = sag(x, y)
        if (form is None and not np.any(np.abs(exact) > 1e-3 * enough)) or (form is not None and form.degree < 0):
            return cls(Form(), half, np.zeros(0), float(np.max(np.abs(exact), initial=0.0)), 0.0)
        best: BoxDeparture | None = None
        for degree in DEGREES if form is None else (form.degree,):
            table = _table(sag, half, degree, x, y)
            terms = form or _form(table)
            found = cls(terms, half, np.array([table[place] for place in terms.terms]), np.inf, np.inf)
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
        """Return the departure, mm, and its slopes in x and y at points, mm, each in the shape of the points."""
        if self.form.degree < 0:
            zero = np.zeros(np.shape(x))
            return zero, zero, zero
        value, by_u, by_v = self.form.evaluate(x / self.half[0], y / self.half[1], self.coefficients.tolist())
        return value, by_u / self.half[0], by_v / self.half[1]


def _polynomials(u: Any, degree: int) -> tuple[list[Any], list[Any]]:
    """Return two lists: the Chebyshev polynomials T_0 … T_degree at u in -1 … 1, and their derivatives."""
    values: list[Any] = [1.0, u]
    slopes: list[Any] = [0.0, 1.0]
    twice = 2 * u
    for _ in range(degree - 1):
        slopes.append(2 * values[-1] + twice * slopes[-1] - slopes[-2])
        values.append(twice * values[-1] - values[-2])
    return values, slopes


def _table(sag: Sag, half: tuple[float, float], degree: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """
    Return Chebyshev coefficients of a sag by x and y order, (degree + 1, degree + 1), mm; 0 above total `degree`.

    They interpolate over the box of half sizes `half`, mm. If the sag is NaN in a part of it, they are fitted to the
    points `x`, `y`, (n,), mm.
    """
    count = 2 * degree + 2
    nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    values = sag(half[0] * nodes[:, None], half[1] * nodes[None, :])
    if np.isfinite(values).all():
        basis = chebyshev.chebvander(nodes, degree)
        table = basis.T @ values @ basis * (4 / count**2)
        table[0] /= 2
        table[:, 0] /= 2
        return np.where(np.add.outer(np.arange(degree + 1), np.arange(degree + 1)) <= degree, table, 0.0)
    # The corners of the box lie outside the sag's domain: least squares over the outline
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
    """Return the form of a table of Chebyshev coefficients, by order in x, then y: degree, and symmetry in x and y."""
    there = np.argwhere(np.abs(table) > NEGLIGIBLE * np.abs(table).max())
    return Form(len(table) - 1, not np.any(there[:, 0] % 2), not np.any(there[:, 1] % 2))
