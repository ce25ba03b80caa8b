"""The K-correlation roughness spectrum against float64 test vectors and quadrature here."""

from __future__ import annotations

import math

import numpy as np
import pytest
import vectors
from oracles import scatter_integrals

from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import harvey_shack
from mistray.physics import k_correlation as kc

VECTORS, QUADRATURE = 1e-6, 1e-4  # relative, as required


def test_band_limited_roughness() -> None:
    """A' and the BSDF of a smooth surface, S = 1.5, 2 (a logarithm) and 2.5."""
    table = vectors.frame("kcorr_bandlimited.csv")
    assert set(table["s"]) >= {1.5, 2.0, 2.5}
    for row in table.itertuples(index=False):
        amplitude = kc.band_amplitude_um4(row.sigma_prime_um, row.B_um, row.s, row.lambda_um)
        assert amplitude == pytest.approx(row.A_um4, rel=VECTORS)
        psd = kc.psd_um4(row.beta / row.lambda_um, amplitude, row.B_um, row.s)
        assert ghs.smooth(row.dn, psd, row.lambda_um) == pytest.approx(row[7], rel=VECTORS)
        cosine = math.sqrt(1 - row.beta**2)
        assert ghs.smooth(row.dn, psd, row.lambda_um) * cosine == pytest.approx(row[8], rel=VECTORS, abs=1e-15)
        assert kc.relevant_rms_um(amplitude, row.B_um, row.s, row.lambda_um) == pytest.approx(
            row.sigma_prime_um, rel=VECTORS
        )


def test_relevant_roughness() -> None:
    for row in vectors.frame("kcorr_sigma_rel.csv").itertuples(index=False):
        amplitude = kc.amplitude_um4(row.sigma_um, row.B_um, row.C + 1)
        sine = math.sin(math.radians(row.theta_i_deg))
        rms = kc.relevant_rms_um(amplitude, row.B_um, row.C + 1, row.lambda_um, sine)
        assert rms == pytest.approx(row.sigma_rel_um_numeric, rel=VECTORS)
        variance = ghs.phase_variance(2 * math.cos(math.radians(row.theta_i_deg)), rms, row.lambda_um)
        assert -math.expm1(-variance) == pytest.approx(row.TIS_GHS_R1, rel=VECTORS)


def test_total_roughness_by_quadrature() -> None:
    """The integral of the PSD over all frequencies is σ², and over a band what is asked for."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        rms, length, slope = 1e-3, 10 ** rng.uniform(-1, 3), rng.uniform(2.2, 5)
        amplitude = kc.amplitude_um4(rms, length, slope)
        x, weight = scatter_integrals.gauss_legendre(np.linspace(-20, 20 / (slope - 2), 401), 16)
        f = np.exp(x) / length
        integral = np.sum(weight * 2 * np.pi * f**2 * kc.psd_um4(f, amplitude, length, slope))
        assert math.sqrt(integral) == pytest.approx(rms, rel=QUADRATURE), (length, slope)
        wavelength = rng.uniform(0.2, 2)
        band = kc.band_amplitude_um4(rms, length, slope - 2, wavelength)
        profile = scatter_integrals.harvey_shack(band, wavelength / length, 2 - slope)
        variance = scatter_integrals.total_scatter(profile, 0.0) / wavelength**2
        assert math.sqrt(variance) == pytest.approx(rms, rel=QUADRATURE)


def test_tends_to_the_power_law() -> None:
    """Far above the knee the PSD falls as f^-S, and it is a Harvey-Shack lobe with l = λ/B and s = -S."""
    amplitude, length, slope = 2.0, 100.0, 2.5
    f = np.array([10.0, 20.0])
    psd = kc.psd_um4(f, amplitude, length, slope)
    assert math.log2(psd[0] / psd[1]) == pytest.approx(slope, rel=1e-6)
    np.testing.assert_allclose(psd, harvey_shack.bsdf(f * 0.5, amplitude, 0.5 / length, -slope), rtol=1e-12)
