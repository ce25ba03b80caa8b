"""NETD against textbook forms, with Planck's law and its integrals by scipy, and against counted electrons."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import constants
from scipy.integrate import quad

from mistray.physics import planck
from mistray.physics.netd import netd_by_detectivity, netd_by_photons

BAND = (8.0, 12.0)


def photon_radiance(wavelength_um: float, temperature: float) -> float:
    """Planck's law in photons/(s m² sr µm): 2c/λ⁴/(exp(x) - 1)."""
    x = constants.h * constants.c / (1e-6 * wavelength_um * constants.k * temperature)
    return 1e-6 * 2 * constants.c / (1e-6 * wavelength_um) ** 4 / math.expm1(x)


def test_photons_and_derivatives_of_a_band() -> None:
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


def test_by_detectivity_is_the_form_by_the_f_number() -> None:
    """J. M. Lloyd's form, (4F² + 1) √Δf/(π τ D* √A dL/dT), in cm, for optics that fill their cone."""
    f_number, passed, d_star, bandwidth, side_cm = 2.0, 0.9, 8e10, 2e4, 50e-4
    slope_cm2 = 1e2 * planck.band_derivative(300.0, *BAND)  # W/(cm² sr K)
    textbook = (4 * f_number**2 + 1) * math.sqrt(bandwidth) / (math.pi * passed * d_star * side_cm * slope_cm2)
    per_kelvin = passed * planck.cone_projected_solid_angle(f_number) * planck.band_derivative(300.0, *BAND)
    found = netd_by_detectivity(per_kelvin, d_star, (10 * side_cm) ** 2, bandwidth)
    assert found == pytest.approx(textbook, rel=1e-12)
    assert 0.01 < found < 1.0


def test_by_photons_is_that_of_counted_electrons() -> None:
    """
    A frame counts Poisson's numbers of electrons at 300 K and at 300 K + 1 K; the noise over the step is the NETD.

    40 000 frames: the standard deviation is known to 0.35 %, the step to 0.1 % of it; 2 % are 5 standard errors.
    """
    area, time, efficiency, cone = 15e-3**2, 1e-3, 0.6, 0.95 * math.pi / 17
    per_kelvin, flux = (
        cone * 1e-6 * value
        for value in (
            quad(photon_radiance, *BAND, args=(300.5,))[0] - quad(photon_radiance, *BAND, args=(299.5,))[0],
            quad(photon_radiance, *BAND, args=(300.0,))[0],
        )
    )
    rng = np.random.default_rng(3)
    cold, warm = (
        rng.poisson(efficiency * area * time * (flux + step * per_kelvin), 40_000).astype(float) for step in (0.0, 1.0)
    )
    counted = cold.std() / (warm.mean() - cold.mean())
    found = netd_by_photons(flux, per_kelvin, efficiency, area, 1 / (2 * time))
    assert found == pytest.approx(counted, rel=0.02)
    np.testing.assert_allclose(
        netd_by_photons([0.0, flux, 4 * flux], per_kelvin, efficiency, area, 500.0) / found, [0, 1, 2]
    )
