"""The hand-written adjoint of the aspheric terms against NumPy's polynomials."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mistray.gradients.aspheric_terms import AsphericTerms

pytestmark = pytest.mark.quick

ORDERS = 9


@pytest.mark.parametrize("derivative", [False, True])
@pytest.mark.parametrize("known", [0, 2, ORDERS])  # coefficients that are not 0
def test_adjoint(derivative: bool, known: int) -> None:
    """Also that of the coefficients that are 0, and within a symbolic loop, where it is used."""
    rng = np.random.default_rng(3)
    values = np.concatenate([rng.uniform(-1, 1, known), np.zeros(ORDERS - known)])
    r2, weights = rng.uniform(0, 1.3, 50), rng.uniform(-1, 1, 50)
    x, w = mi.Float64(r2), mi.Float64(weights)
    coefficients = [dr.opaque(mi.Float64, float(v)) for v in values]
    dr.enable_grad(x, *coefficients)
    found = dr.custom(AsphericTerms, x, coefficients, coefficients[:known], derivative)
    dr.set_grad(found, w)
    dr.enqueue(dr.ADMode.Backward, found)
    dr.traverse(dr.ADMode.Backward)
    whole = np.polynomial.Polynomial([0.0, 0.0, *values])
    order = int(derivative)
    np.testing.assert_allclose(np.array(dr.detach(found)), whole.deriv(order)(r2), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(np.array(dr.grad(x)), weights * whole.deriv(order + 1)(r2), rtol=1e-12, atol=1e-14)
    for place, coefficient in enumerate(coefficients):
        power = np.polynomial.Polynomial([0.0] * (2 + place) + [1.0]).deriv(order)(r2)
        assert dr.grad(coefficient)[0] == pytest.approx(weights @ power, rel=1e-12), place
