"""Differentiable properties of surfaces as path replay reads them: geometry, refractive indices, R and T.

Aspheric coefficients are scaled to the size of their surface, so that all values are within single precision. Tables of
R and T have slopes beside their values: differences of neighbours, which need the host's float64.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from mistray.physics.geometry.sag import (
    in_proportion,
    polynomial,
    polynomial_derivative,
    polynomial_second_derivative,
)
from mistray.surfaces.gradient_columns import COEFFICIENTS, GEOMETRY
from mistray.surfaces.optics import Optics
from mistray.surfaces.surfaces import SurfaceTable

TABLE_CHANNELS = 3  # R from the front, R from the back, T


@dataclass
class SurfaceNumbers:
    """
    Differentiable properties of all surfaces: geometry, refractive indices, R and T of coatings.

    Attributes
    ----------
    geometry : (surfaces, len(GEOMETRY)) float64
        Columns of `mistray.surfaces.gradient_columns.GEOMETRY`, in their units.
    indices : (surfaces, 2) float64
        Real refractive indices in front and behind.
    rows : (rows, TABLE_CHANNELS) float64
        Rows of the tables of R and T: R from the front, R from the back, T.
    ideal : (surfaces, 2) float64
        R and T of ideal coatings; not used for other coatings.
    """

    geometry: np.ndarray
    indices: np.ndarray
    rows: np.ndarray
    ideal: np.ndarray


def numbers_of(table: SurfaceTable) -> SurfaceNumbers:
    """Return the present geometry, indices, R and T of the surfaces of a table as `SurfaceNumbers`, in float64."""
    geometry = np.zeros((table.count, len(GEOMETRY)))
    for piece in table.pieces:
        for name, value in piece.columns.items():
            geometry[piece.index, GEOMETRY.index(name)] = value
    optics = table.optics
    rows = np.array(optics.table, dtype=np.float64).reshape(-1, 4)[:, :TABLE_CHANNELS]
    # The kernel's rows are float32; slopes are differences of neighbours, and need the host's float64
    for known, (first, _, total, _) in zip(optics.tables, optics.host_places, strict=True):
        if known is not None:
            for place, part in ((first, known.refraction), (total, known.total)):
                rows[place : place + len(part)] = part[:, :, 0]
    return SurfaceNumbers(geometry, optics.host_indices[:, :2].copy(), rows, optics.host_indices[:, 2:].copy())


def of_four(rows: np.ndarray) -> np.ndarray:
    """Return rows of three values padded with a zero, so that the device reads each as one vector of four."""
    return np.pad(rows, ((0, 0), (0, 4 - rows.shape[1])))


def row_slopes(optics: Optics, rows: np.ndarray) -> np.ndarray:
    """Return the change per row of tabulated R and T, (rows, channels): central differences, one-sided at the ends."""
    slopes = np.zeros_like(rows)
    for first, last, total, total_last in optics.host_places.tolist():
        for start, intervals in ((first, last), (total, total_last)):
            slopes[start : start + intervals + 1] = np.gradient(rows[start : start + intervals + 1], axis=0)
    return slopes


def proportions(table: SurfaceTable) -> tuple[np.ndarray, np.ndarray]:
    """
    Return factors that scale the parameters of surfaces to their own size, so that all are within single precision.

    Returns
    -------
    scales : (surfaces, len(GEOMETRY)) float64
        Factors of the columns: those of `mistray.physics.geometry.sag.in_proportion` for coefficients, 1 for others.
    per_area : (surfaces,) float64
        Scale of r², 1/mm².
    """
    scales, per_area = np.ones((table.count, len(GEOMETRY))), np.ones(table.count)
    places = [GEOMETRY.index(name) for name in COEFFICIENTS]
    for piece in table.pieces:
        scales[piece.index, places], per_area[piece.index] = in_proportion([1.0] * len(places), piece.size)
    return scales, per_area


class AsphericTerms(dr.CustomOp):
    """
    Polynomial terms of an aspheric sag with a hand-written adjoint, which is shorter than the automatic one.

    The terms are P = Σ a_i r^(2i), i = 2, 3, …, mm, or P' = dP/d(r²), 1/mm.

    With the adjoint p of P, or q of P', the adjoint of a_i is p r^(2i), or q i r^(2i-2); that of r² is p P', or q P''.
    a_i, mm^(1-2i), is the aspheric coefficient of r^(2i). In the code u² = w r² with a factor w, 1/mm², and the
    coefficients are those of `in_proportion`.
    """

    def eval(self, r2: Any, coefficients: Sequence[Any], still: Sequence[Any], per_area: Any, derivative: bool) -> Any:
        """
        Return the polynomial terms P of the sag, mm, or their derivative P' with respect to r², 1/mm.

        Parameters
        ----------
        r2 : mi.Float64
            Squared radius, mm².
        coefficients : sequence of mi.Float64
            Scaled coefficients a_i, which receive the derivatives.
        still : sequence of mi.Float64
            Scaled coefficients without derivatives, which the value is computed from; trailing zeros may be missing.
        per_area : mi.Float64
            Scale w of r², 1/mm², see `mistray.physics.geometry.sag.in_proportion`.
        derivative : bool
            Whether to return P' instead of P.
        """
        self.r2, self.still, self.orders = dr.detach(r2), [dr.detach(a) for a in still], len(coefficients)
        self.derivative, self.per_area = derivative, dr.detach(per_area)
        # The zero term makes the result as wide as r²: a literal 0 would receive the sum of the adjoints of all lanes
        return (polynomial_derivative if derivative else polynomial)(self.r2, self.still, self.per_area) + 0 * self.r2

    def backward(self) -> None:
        """Propagate the adjoint of the sag's polynomial to r² and to its coefficients a_i."""
        adjoint = self.grad_out()
        further = polynomial_second_derivative if self.derivative else polynomial_derivative
        self.set_grad_in("r2", adjoint * further(self.r2, self.still, self.per_area))
        # Adjoints of a_i, by ascending powers of u²
        u2 = self.per_area * self.r2
        power, found = adjoint * (u2 if self.derivative else u2 * self.r2), []
        for order in range(2, 2 + self.orders):
            found.append(order * power if self.derivative else power)
            power = power * u2
        self.set_grad_in("coefficients", found)

    def name(self) -> str:
        """Return the name of this operation for Dr.Jit's messages."""
        return "aspheric terms"
