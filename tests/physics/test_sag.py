import math

import mitsuba as mi
import numpy as np
import pytest

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics.geometry import sag as sags
from mistray.physics.geometry.sag import conic_end, sag, sag_derivative
from mistray.physics.sags.terms import vertex_curvatures

# L2 rear of the phone camera: the steepest surface at hand, slope 2.07 at its rim
STEEP = (1 / 3.482, 8.701, (0.00521579, 0.0715829, -0.0460926, 0.012431, 0.0332216))


def test_conics_their_ends_and_rims_of_the_phone_camera():
    r = np.linspace(0, 7, 50)
    for radius in (-20.0, 7.5):
        sphere = radius - math.copysign(1, radius) * np.sqrt(radius**2 - r**2)
        np.testing.assert_allclose(sag(r**2, 1 / radius, 0.0), sphere, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sag(r**2, 1 / 50, -1.0), r**2 / 100, rtol=1e-15)
    assert np.all(sag(r**2, 0.0, 3.0) == 0)
    other = 1 / 1.679, 0.22669364, (0.00980281, -0.0381227, 0.0239681, -0.00629128, -0.00275496, -0.000269638)
    for printed_rim, radius, shape in ((0.379217, 1.06523826, STEEP), (0.58172, 1.43762465, other)):
        assert float(sag(radius**2, *shape)) == pytest.approx(printed_rim, abs=5.1e-7)
    c, k, _ = STEEP
    end = conic_end(c, k)
    assert end == pytest.approx(1.118, abs=5e-4)
    assert np.isfinite(sag(np.float64((end * (1 - 1e-9)) ** 2), c, k))
    assert np.isnan(sag(np.array([(end * 1.001) ** 2]), c, k)).all()
    assert math.isnan(sag((end * 1.001) ** 2, c, k))
    assert conic_end(c, -1.0) == math.inf
    assert conic_end(0.0, 2.0) == math.inf


@pytest.mark.parametrize("shape", [STEEP, (-1 / 9.162, 0.0, (0.0373187, -0.0089176)), (0.05, -1.3, ())])
def test_derivative_against_central_differences(shape):
    r2, h = np.linspace(1e-3, 1.06**2, 40), 1e-6
    slope = sag_derivative(r2, *shape)
    np.testing.assert_allclose(slope, (sag(r2 + h, *shape) - sag(r2 - h, *shape)) / (2 * h), rtol=1e-8)
    for function, expected in ((sag, sag(r2, *shape)), (sag_derivative, slope)):
        np.testing.assert_allclose(np.array(function(mi.Float64(r2), *shape)), expected, rtol=1e-14)


def test_polynomial_derivatives_are_those_of_the_terms():
    """Against NumPy's polynomials: a term a_i r^(2i) is that of degree i in r²; the sag of a plane has no other."""
    coefficients = (0.3, -0.2, 0.15, 0.07, -0.04, 0.02, 0.05, -0.01, 0.03)
    whole = np.polynomial.Polynomial([0.0, 0.0, *coefficients])
    r2 = np.linspace(0, 1.2, 9)
    functions = (sags.polynomial, sags.polynomial_derivative, sags.polynomial_second_derivative)
    for order, function in enumerate(functions):
        np.testing.assert_allclose(function(r2, coefficients), whole.deriv(order)(r2), rtol=1e-13, atol=1e-15)
        assert np.all(np.asarray(function(r2, ())) == 0)
    np.testing.assert_allclose(sag(r2, 0.0, 0.0, coefficients), whole(r2), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(sag_derivative(r2, 0.0, 0.0, coefficients), whole.deriv()(r2), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize(
    ("terms", "x", "y"),
    [
        ({"r2": 1e-3}, 2e-3, 2e-3),
        ({"curvature": 0.01, "conic": -0.5, "r1": 2e-3, "r2": 1e-3, "r3": 1e-2, "r4": 1e-2}, 0.012, 0.012),
        (
            {"curvature_x": 0.02, "curvature": 0.01, "a2": 1e-3, "r2": 2e-3, "xy_2_0": 3e-3, "slope_y": 0.1},
            0.032,
            0.016,
        ),
    ],
)
def test_vertex_curvatures_are_the_second_derivatives_at_the_vertex(terms, x, y):
    """Of a r² they are 2 a; r1 has a kink there, and higher powers have none."""
    np.testing.assert_allclose(vertex_curvatures(terms, 1e-3), (x, y), rtol=1e-6)
