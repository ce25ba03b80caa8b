"""Thermal radiation against float64 test vectors and scipy's quadrature; NETD against a textbook and counts."""

import math

import numpy as np
import pytest
import vectors
from refusals import each_refused
from scipy import constants
from scipy.integrate import quad

from mistray.physics import planck
from mistray.physics.netd import netd_by_detectivity, netd_by_photons

PER_M2 = 1e-6  # W/m² in W/mm²
BAND = (8.0, 12.0)


def radiance(wavelength_um: float, temperature: float) -> float:
    """Planck's law in W/(m² sr µm), from the constants of scipy."""
    x = constants.h * constants.c / (1e-6 * wavelength_um * constants.k * temperature)
    return 1e-6 * 2 * constants.h * constants.c**2 / (1e-6 * wavelength_um) ** 5 / math.expm1(x)


def test_bands() -> None:
    table = vectors.frame("planck_bands.csv")
    temperatures = table["T_K"].to_numpy()
    for name in ("0.4-0.7", "3-5", "8-12", "8-14"):
        low, high = map(float, name.split("-"))
        rtol = 1e-11 if name != "0.4-0.7" else 1e-8  # exp(-270) with rounded constants
        found = planck.band_radiance(temperatures, low, high)
        np.testing.assert_allclose(found, PER_M2 * table[f"L_{name}"], rtol=rtol)
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


def test_spectrum_emission_and_bad_input() -> None:
    wavelengths = np.geomspace(0.3, 300, 20)
    expected = [PER_M2 * radiance(w, 293.0) for w in wavelengths]
    np.testing.assert_allclose(planck.spectral_radiance(wavelengths, 293.0), expected, rtol=1e-11)
    peak = planck.peak_wavelength_um(293.0)
    assert np.argmax(planck.spectral_radiance(np.array([0.999, 1.0, 1.001]) * peak, 293.0)) == 1
    nodes, radiances = planck.band_nodes(293.0, 3.0, 5.0)
    expected = quad(lambda w: radiance(w, 293.0) * math.sin(w), 3.0, 5.0, epsrel=1e-13)[0]
    assert np.sum(radiances * np.sin(nodes)) == pytest.approx(PER_M2 * expected, rel=1e-12)
    for row in vectors.frame("self_emission.csv").itertuples():
        solid_angle = planck.cone_projected_solid_angle(row.F)
        assert solid_angle == pytest.approx(row.proj_solid_angle, rel=1e-12)
        assert solid_angle == pytest.approx(math.pi * math.sin(math.atan(0.5 / row.F)) ** 2, rel=1e-12)
        scene, optics, housing = (PER_M2 * value for value in row[5:8])
        assert planck.self_emission(1.0, row.T, *BAND, row.F) == pytest.approx(scene, rel=1e-11)
        assert planck.self_emission(row.emissivity, row.T, *BAND, row.F) == pytest.approx(optics, rel=1e-11)
        outside = row.emissivity * planck.band_radiance(row.T, *BAND) * (math.pi - solid_angle)
        assert outside == pytest.approx(housing, rel=1e-11)
    for row in vectors.frame("narcissus.csv").itertuples():
        found = planck.narcissus_nitd(row.R * row.fraction_of_cone_returning_cold, row.T_housing, row.T_cold, *BAND)
        assert found == pytest.approx(row.NITD_K, rel=1e-8)
    assert planck.narcissus_nitd(1.0, 293.0, 292.99, *BAND) == pytest.approx(0.01, rel=1e-4)
    assert planck.band_radiance(0.0, *BAND) == planck.band_derivative(0.0, *BAND) == 0
    each_refused(
        (-1.0, 8.0, 12.0, "temperature of -1 K"),
        (math.nan, 8.0, 12.0, "temperature of nan K"),
        (300.0, 12.0, 8.0, "band of 12 to 8 µm"),
        (300.0, -1.0, 8.0, "band of -1 to 8 µm"),
        by=planck.band_radiance,
    )


def photon_radiance(wavelength_um: float, temperature: float) -> float:
    """Planck's law in photons/(s m² sr µm)."""
    return radiance(wavelength_um, temperature) * 1e-6 * wavelength_um / (constants.h * constants.c)


def test_photons_detectivity_and_counted_electrons() -> None:
    """The quadratures of `planck` times photons per joule, beside scipy's; the derivative by differences of 1e-3 K."""
    for temperature in (77.0, 300.0):
        waves, radiances = planck.band_nodes(temperature, *BAND)
        found = 1e6 * float(radiances @ planck.photons_per_joule(waves))
        assert found == pytest.approx(quad(photon_radiance, *BAND, args=(temperature,))[0], rel=1e-9)
        waves, slopes = planck.derivative_nodes(temperature, *BAND)
        above, below = (quad(photon_radiance, *BAND, args=(temperature + step,))[0] for step in (5e-4, -5e-4))
        assert 1e6 * float(slopes @ planck.photons_per_joule(waves)) == pytest.approx((above - below) / 1e-3, rel=1e-6)
        assert slopes.sum() == pytest.approx(planck.band_derivative(temperature, *BAND), rel=1e-13)
    assert planck.derivative_nodes(0.0, *BAND)[1].sum() == 0
    # J. M. Lloyd's form, (4F² + 1) √Δf/(π τ D* √A dL/dT), in cm, for optics that fill their cone
    f_number, passed, d_star, bandwidth, side_cm = 2.0, 0.9, 8e10, 2e4, 50e-4
    slope_cm2 = 1e2 * planck.band_derivative(300.0, *BAND)  # W/(cm² sr K)
    textbook = (4 * f_number**2 + 1) * math.sqrt(bandwidth) / (math.pi * passed * d_star * side_cm * slope_cm2)
    per_kelvin = passed * planck.cone_projected_solid_angle(f_number) * planck.band_derivative(300.0, *BAND)
    found = netd_by_detectivity(per_kelvin, d_star, (10 * side_cm) ** 2, bandwidth)
    assert found == pytest.approx(textbook, rel=1e-12)
    assert 0.01 < found < 1.0
    # Poisson's numbers of electrons at 300 K and 301 K in 40 000 frames: 2 % are 5 standard errors of the NETD
    area, time, efficiency, cone = 15e-3**2, 1e-3, 0.6, 0.95 * math.pi / 17
    below, flux, above = (cone * 1e-6 * quad(photon_radiance, *BAND, args=(t,))[0] for t in (299.5, 300.0, 300.5))
    per_kelvin = above - below
    rng = np.random.default_rng(3)
    electrons = efficiency * area * time * np.array([flux, flux + per_kelvin])
    cold, warm = (rng.poisson(count, 40_000).astype(float) for count in electrons)
    counted = cold.std() / (warm.mean() - cold.mean())
    none, found, double = netd_by_photons([0.0, flux, 4 * flux], per_kelvin, efficiency, area, 1 / (2 * time))
    assert (none, found, double) == pytest.approx((0, counted, 2 * found), rel=0.02)
    assert double == pytest.approx(2 * found, rel=1e-7)
