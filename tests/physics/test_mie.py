"""Mie scattering against float64 test vectors, SciPy's Bessel functions and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import vectors
from oracles import mie as oracle

from mistray.errors import MistrayError
from mistray.physics import mie

VECTORS = 1e-8  # relative, as required
ANGLES_DEG = (0, 10, 90, 180)


def test_vectors() -> None:
    """From x = 0.01 to the largest of level 500; efficiencies by miepython, to the digits of its fewer orders."""
    for row in vectors.frame("mie_spheres.csv").itertuples():
        answer = mie.spheres([row.x], complex(row.n, abs(row.k)), np.radians(ANGLES_DEG))
        found = [answer.extinction[0], answer.scattering[0], *answer.intensity[0]]
        expected = [row.Qext, row.Qsca, row.i_0deg, row.i_10deg, row.i_90deg, row.i_180deg]
        np.testing.assert_allclose(found, expected, rtol=VECTORS, err_msg=f"x = {row.x}, m = {row.n} + {row.k}i")
        np.testing.assert_allclose(found[:2], [row.Qext_miepython, row.Qsca_miepython], rtol=1e-7)


@pytest.mark.parametrize("index", [1.33, 1.53 + 0.002j, 0.75, 0.3 + 3.5j, 1.9 + 1j])
def test_random_spheres_against_bessel_functions(index: complex) -> None:
    """Many sizes at once, in any order, each as if alone; forward and backward included."""
    rng = np.random.default_rng(4)
    x = np.exp(rng.uniform(np.log(0.05), np.log(60), 12))
    angle = np.concatenate([[0.0, np.pi], rng.uniform(0.01, np.pi - 0.01, 20)])
    answer = mie.spheres(x, index, angle)
    for k, size in enumerate(x):
        extinction, scattering, intensity = oracle.sphere(size, index, angle)
        assert answer.extinction[k] == pytest.approx(extinction, rel=1e-8)
        assert answer.scattering[k] == pytest.approx(scattering, rel=1e-8)
        # Where the orders cancel, the digits of the largest intensity count
        np.testing.assert_allclose(answer.intensity[k], intensity, rtol=1e-7, atol=1e-11 * intensity.max())


def test_scattering_is_the_integral_of_the_intensity() -> None:
    x = np.array([0.3, 2.0, 17.0, 150.0])
    nodes, weights = np.polynomial.legendre.leggauss(2000)
    answer = mie.spheres(x, 1.53 + 0.01j, np.arccos(nodes))
    total = 2 * np.pi * answer.intensity @ weights / (np.pi * x**2)
    np.testing.assert_allclose(total, answer.scattering, rtol=1e-6)


def test_small_spheres_scatter_as_rayleigh_says() -> None:
    """Qsca = 8/3 x⁴ |(m² - 1)/(m² + 2)|² up to x², and (1 + cos²θ)/2 over the angle."""
    index, x = 1.5 + 0.1j, 0.01
    angle = np.radians([0, 30, 60, 90, 120])
    answer = mie.spheres([x], index, angle)
    polarisability = (index**2 - 1) / (index**2 + 2)
    assert answer.scattering[0] == pytest.approx(8 / 3 * x**4 * abs(polarisability) ** 2, rel=10 * x**2)
    assert answer.extinction[0] == pytest.approx(4 * x * polarisability.imag, rel=10 * x**2)
    shape = answer.intensity[0] / answer.intensity[0, 0]
    np.testing.assert_allclose(shape, (1 + np.cos(angle) ** 2) / 2, atol=10 * x**2)
    # Without absorption all that is lost is scattered, at any size
    answer = mie.spheres(np.geomspace(0.02, 500, 40), 1.6)
    np.testing.assert_allclose(answer.scattering, answer.extinction, rtol=1e-8)


def test_bad_input() -> None:
    for x, index, words in (
        ([1.0], 1.5 - 0.1j, "k between 0 and 100"),
        ([1.0], 0j, "n must lie between 0.01 and 100"),
        ([1.0], complex("nan"), "relative index nan"),
        ([1.0, 1e-3], 1.5, "size parameter πD/λ = 0.001; it must be 0.01 … 20000"),
        ([1e5], 1.5, "size parameter πD/λ = 1e\\+05"),
        ([np.nan], 1.5, "size parameter πD/λ = nan"),
    ):
        with pytest.raises(MistrayError, match=words):
            mie.spheres(x, index)
