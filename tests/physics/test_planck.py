"""Thermal radiation against float64 test vectors, quadrature by scipy, and Stefan and Boltzmann's law."""

from __future__ import annotations

import math

import numpy as np
import pytest
import vectors
from scipy import constants
from scipy.integrate import quad

from mistray.errors import MistrayError
from mistray.physics import planck

PER_M2 = 1e-6  # W/m² in W/mm²
BANDS = {"0.4-0.7": (0.4, 0.7), "3-5": (3.0, 5.0), "8-12": (8.0, 12.0), "8-14": (8.0, 14.0)}


def radiance(wavelength_um: float, temperature: float) -> float:
    """Planck's law in W/(m² sr µm), from the constants of scipy."""
    x = constants.h * constants.c / (1e-6 * wavelength_um * constants.k * temperature)
    return 1e-6 * 2 * constants.h * constants.c**2 / (1e-6 * wavelength_um) ** 5 / math.expm1(x)


def test_bands() -> None:
    table = vectors.frame("planck_bands.csv")
    temperatures = table["T_K"].to_numpy()
    for name, (low, high) in BANDS.items():
        rtol = 1e-11 if name != "0.4-0.7" else 1e-8  # exp(-270) with rounded constants
        np.testing.assert_allclose(
            planck.band_radiance(temperatures, low, high), PER_M2 * table[f"L_{name}"], rtol=rtol
        )
        derivative = table["dL_0.4-0.7" if name == "0.4-0.7" else f"dLdT_{name}"]
        np.testing.assert_allclose(planck.band_derivative(temperatures, low, high), PER_M2 * derivative, rtol=1e-6)
    np.testing.assert_allclose(planck.peak_wavelength_um(temperatures), table["lambda_peak_um"], rtol=1e-6)
    total = planck.band_radiance(temperatures, 0.0, math.inf)
    np.testing.assert_allclose(total, PER_M2 * table["L_total_W_m2_sr"], rtol=1e-10)
    sigma = 2 * math.pi**5 * constants.k**4 / (15 * constants.h**3 * constants.c**2)
    np.testing.assert_allclose(total, PER_M2 * sigma * temperatures**4 / math.pi, rtol=1e-12)


@pytest.mark.parametrize("temperature", [3.0, 77.0, 293.0, 6000.0])
@pytest.mark.parametrize("band", [(0.5, 0.50001), (3.0, 5.0), (8.0, 1000.0), (2e4, math.inf)])
def test_any_band_by_quadrature(temperature: float, band: tuple[float, float]) -> None:
    """Narrow, wide and open bands; in x = hc/(λkT) the integrand is smooth for scipy, too."""
    c2 = 1e6 * constants.h * constants.c / constants.k
    first = c2 / (band[1] * temperature)
    last = min(c2 / (band[0] * temperature), first + 80)
    found = planck.band_radiance(temperature, *band)
    scale = 2 * constants.k**4 * temperature**4 / (constants.h**3 * constants.c**2)
    rising = math.exp(-first)  # taken out: the integrand itself underflows at 3 K

    def integrand(power: int) -> float:
        return quad(lambda x: x**power * math.exp(first - x) / -math.expm1(-x), first, last, epsrel=1e-13)[0]

    assert found == pytest.approx(PER_M2 * scale * integrand(3) * rising, rel=1e-11, abs=0)
    step = 1e-3 * temperature
    pair = [planck.band_radiance(temperature + sign * step, *band) for sign in (1, -1)]
    if min(pair) > 1e-200:
        estimate = (pair[0] - pair[1]) / (2 * step)
        assert planck.band_derivative(temperature, *band) == pytest.approx(estimate, rel=1e-3 + (1e-3 * first) ** 2)


def test_spectrum() -> None:
    wavelengths = np.geomspace(0.3, 300, 20)
    expected = [PER_M2 * radiance(w, 293.0) for w in wavelengths]
    np.testing.assert_allclose(planck.spectral_radiance(wavelengths, 293.0), expected, rtol=1e-11)
    peak = planck.peak_wavelength_um(293.0)
    near = planck.spectral_radiance(np.array([0.999, 1.0, 1.001]) * peak, 293.0)
    assert np.argmax(near) == 1
    nodes, radiances = planck.band_nodes(293.0, 3.0, 5.0)
    expected = quad(lambda w: radiance(w, 293.0) * math.sin(w), 3.0, 5.0, epsrel=1e-13)[0]
    assert np.sum(radiances * np.sin(nodes)) == pytest.approx(PER_M2 * expected, rel=1e-12)


def test_self_emission() -> None:
    """E of the scene, of optics in the cone, and of the housing about it."""
    for row in vectors.frame("self_emission.csv").itertuples():
        solid_angle = planck.cone_projected_solid_angle(row.F)
        assert solid_angle == pytest.approx(row.proj_solid_angle, rel=1e-12)
        sine = math.sin(math.atan(0.5 / row.F))
        assert solid_angle == pytest.approx(math.pi * sine**2, rel=1e-12)
        scene, optics, housing = (PER_M2 * value for value in row[5:8])
        assert planck.self_emission(1.0, row.T, 8.0, 12.0, row.F) == pytest.approx(scene, rel=1e-11)
        assert planck.self_emission(row.emissivity, row.T, 8.0, 12.0, row.F) == pytest.approx(optics, rel=1e-11)
        outside = row.emissivity * planck.band_radiance(row.T, 8.0, 12.0) * (math.pi - solid_angle)
        assert outside == pytest.approx(housing, rel=1e-11)


def test_narcissus() -> None:
    for row in vectors.frame("narcissus.csv").itertuples():
        found = planck.narcissus_nitd(row.R * row.fraction_of_cone_returning_cold, row.T_housing, row.T_cold, 8.0, 12.0)
        assert found == pytest.approx(row.NITD_K, rel=1e-8)
    small = planck.narcissus_nitd(1.0, 293.0, 292.99, 8.0, 12.0)
    assert small == pytest.approx(0.01, rel=1e-4)


def test_cold_and_bad_input() -> None:
    assert planck.band_radiance(0.0, 8.0, 12.0) == planck.band_derivative(0.0, 8.0, 12.0) == 0
    for arguments, words in (
        ((-1.0, 8.0, 12.0), "temperature of -1 K"),
        ((math.nan, 8.0, 12.0), "temperature of nan K"),
        ((300.0, 12.0, 8.0), "band of 12 to 8 µm"),
        ((300.0, -1.0, 8.0), "band of -1 to 8 µm"),
    ):
        with pytest.raises(MistrayError, match=words):
            planck.band_radiance(*arguments)
