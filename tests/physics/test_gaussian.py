"""The Gaussian lobe and the function its total rests on, against quadrature and exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles import scatter_integrals
from oracles.derivatives import central_differences

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics import gaussian
from mistray.physics.growth import growth

QUADRATURE = 1e-4  # relative, as required


def test_shape() -> None:
    r = np.array([0.0, 0.05, 0.1, 0.5])
    np.testing.assert_allclose(
        gaussian.bsdf(r, 0.3, 0.1) / gaussian.bsdf(0.0, 0.3, 0.1), np.exp(-((r / 0.1) ** 2)), rtol=1e-12
    )


@pytest.mark.parametrize("width", [1e-4, 0.01, 0.3, 1.0, 1e3, 1e7])
def test_total(width: float) -> None:
    total = scatter_integrals.total_scatter(lambda r: gaussian.bsdf(r, 0.3, width), 0.0)
    assert total == pytest.approx(0.3, rel=QUADRATURE)


@pytest.mark.parametrize("x", [-700.0, -3.0, -0.06, -0.05, -0.049, -1e-9, 0.0, 1e-9, 0.049, 0.05, 0.06, 3.0])
def test_growth(x: float) -> None:
    """The series in exact fractions, and the quotient where nothing cancels."""
    exact, term = Fraction(1), Fraction(1)
    for k in range(2, 60):
        term *= Fraction(x) / k
        exact += term
    expected = float(exact) if abs(x) < 4 else math.expm1(x) / x
    assert growth(x) == pytest.approx(expected, rel=1e-14)
    assert growth(np.array([x, 0.0]))[0] == pytest.approx(expected, rel=1e-14)


def test_drjit() -> None:
    r, point = np.array([0.0, 0.05, 0.4, 1.9]), (0.3, 0.2)
    np.testing.assert_allclose(
        gaussian.bsdf(mi.Float(r), *map(mi.Float, point)), gaussian.bsdf(r, *point), rtol=1e-4, atol=1e-30
    )

    def bsdf(total, width):
        return gaussian.bsdf(dr.llvm.ad.Float64(r) if dr.is_array_v(total) else r, total, width)

    expected = central_differences(bsdf, point, (1e-4, 1e-4))
    for k in range(2):
        parameters = [dr.llvm.ad.Float64(value) for value in point]
        dr.enable_grad(parameters[k])
        values = bsdf(*parameters)
        dr.forward(parameters[k])
        np.testing.assert_allclose(dr.grad(values), expected[k], rtol=1e-7, atol=1e-9)
