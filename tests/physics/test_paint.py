"""The growth of a paint's lobe against Fresnel's equations with complex numbers, and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from drjit_derivatives import forward_derivatives
from oracles.derivatives import central_differences

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics.paint import gain


def fresnel(cosine: np.ndarray, n: float) -> np.ndarray:
    """|(a - b)/(a + b)|² of admittances, independent of the package."""
    inner = np.sqrt(n**2 - 1 + cosine**2 + 0j)
    s = (cosine - inner) / (cosine + inner)
    p = (n**2 * cosine - inner) / (n**2 * cosine + inner)
    return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)


@pytest.mark.parametrize("n", [1.3, 1.5, 1.8])
def test_is_the_root_of_two_reflectances(n: float) -> None:
    cos_i, cos_s = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    expected = np.sqrt(fresnel(cos_i, n) * fresnel(cos_s, n)) / ((n - 1) / (n + 1)) ** 2
    np.testing.assert_allclose(gain(cos_i, cos_s, n), expected, rtol=1e-12)


def test_exchange_and_end() -> None:
    a, b = np.random.default_rng(4).random((2, 100))
    np.testing.assert_array_equal(gain(a, b, 1.5), gain(b, a, 1.5))
    assert gain(0.0, 0.0, 1.5) == pytest.approx(25, rel=1e-12)  # 1/F(0)


def test_derivative() -> None:
    point = (0.3, 0.4, 1.5)
    found = forward_derivatives(gain, point)
    np.testing.assert_allclose(found, central_differences(gain, point, (1e-4,) * 3), rtol=1e-7)
