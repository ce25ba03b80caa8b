"""Polynomial terms of an aspheric sag with a hand-written adjoint, which is shorter than the automatic one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.physics.geometry.sag import polynomial, polynomial_derivative, polynomial_second_derivative


class AsphericTerms(dr.CustomOp):
    """
    Polynomial terms of an aspheric sag, P = Σ a_i r^(2i), i = 2, 3, …, mm, or P' = dP/d(r²), 1/mm.

    With the adjoint p of P, or q of P', the adjoint of a_i is p r^(2i), or q i r^(2i-2); that of r² is p P', or q P''.
    """

    def eval(self, r2: Any, coefficients: Sequence[Any], still: Sequence[Any], derivative: bool) -> Any:
        """
        Return the polynomial terms P of the sag, mm, or their derivative P' with respect to r², 1/mm.

        Parameters
        ----------
        r2 : mi.Float64
            Squared radius, mm².
        coefficients : sequence of mi.Float64
            Coefficients a_i, which receive the derivatives.
        still : sequence of mi.Float64
            Coefficients without derivatives; trailing zeros may be missing.
        derivative : bool
            Whether to return P' instead of P.
        """
        self.r2, self.still, self.orders = dr.detach(r2), [dr.detach(a) for a in still], len(coefficients)
        self.derivative = derivative
        # The zero term makes the result as wide as r²: a literal 0 would receive the sum of the adjoints of all lanes
        return (polynomial_derivative if derivative else polynomial)(self.r2, self.still) + mi.Float64(0) * self.r2

    def backward(self) -> None:
        """Propagate the adjoint of the result to r² and to the coefficients a_i."""
        adjoint = self.grad_out()
        further = polynomial_second_derivative if self.derivative else polynomial_derivative
        self.set_grad_in("r2", adjoint * further(self.r2, self.still))
        # Adjoints of a_i, by ascending powers of r²
        power, found = adjoint * (self.r2 if self.derivative else self.r2 * self.r2), []
        for order in range(2, 2 + self.orders):
            found.append(order * power if self.derivative else power)
            power = power * self.r2
        self.set_grad_in("coefficients", found)

    def name(self) -> str:
        """Return the name of this operation in Dr.Jit's messages."""
        return "aspheric terms"
