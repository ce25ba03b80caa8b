"""The polynomial terms of a sag with an adjoint of their own, which is shorter than the automatic one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.physics.geometry.sag import polynomial, polynomial_derivative, polynomial_second_derivative


class AsphericTerms(dr.CustomOp):
    """
    P = Σ a_i r^(2i), i = 2, 3, …, or P' = dP/d(r²).

    With the adjoints p of P, or q of P':  of a_i  p r^(2i) or q i r^(2i-2),  of r²  p P' or q P''.
    """

    def eval(self, r2: Any, coefficients: Sequence[Any], still: Sequence[Any], derivative: bool) -> Any:
        """
        Value of P (mm) or P' (1/mm).

        Parameters
        ----------
        r2 : mi.Float64
            mm².
        coefficients : sequence of mi.Float64
            What derivatives go to.
        still : sequence of mi.Float64
            The same numbers, perhaps without the last ones where these are 0.
        derivative : bool
            P' instead of P.
        """
        self.r2, self.still, self.orders = dr.detach(r2), [dr.detach(a) for a in still], len(coefficients)
        self.derivative = derivative
        # As wide as r² in any case: a single 0 would get the sum of the adjoints of all lanes
        return (polynomial_derivative if derivative else polynomial)(self.r2, self.still) + mi.Float64(0) * self.r2

    def backward(self) -> None:
        """Pass the adjoint on."""
        adjoint = self.grad_out()
        further = polynomial_second_derivative if self.derivative else polynomial_derivative
        self.set_grad_in("r2", adjoint * further(self.r2, self.still))
        power, found = adjoint * (self.r2 if self.derivative else self.r2 * self.r2), []
        for order in range(2, 2 + self.orders):
            found.append(order * power if self.derivative else power)
            power = power * self.r2
        self.set_grad_in("coefficients", found)

    def name(self) -> str:
        """For messages of Dr.Jit."""
        return "aspheric terms"
