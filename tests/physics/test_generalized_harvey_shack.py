"""The generalised Harvey-Shack theory against float64 test vectors (series and Hankel transforms)."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles import scatter_integrals

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.errors import MistrayError
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import k_correlation as kc
from mistray.physics import rayleigh_rice

VECTORS = 1e-6  # relative, as required


def test_reflection() -> None:
    """The smooth form, the full series with the total and with the relevant roughness, and Rayleigh-Rice with Q = 1."""
    table = vectors.frame("ghs_rr_vectors.csv")
    assert table["phase_variance_a"].max() > 3
    for row in table.itertuples(index=False):
        ci, cs = (math.cos(math.radians(angle)) for angle in (row.theta_i, row.theta_s))
        f, length = row.abs_dbeta / row.lambda_um, 2 * math.pi * row.lc_um
        psd = kc.psd_um4(f, kc.amplitude_um4(row.sigma_um, length, 3.0), length, 3.0)
        path = ghs.path_in_reflection(ci, cs)
        assert ghs.smooth(path, psd, row.lambda_um) == pytest.approx(row.BRDF_GHS_smooth_R1, rel=VECTORS)
        assert rayleigh_rice.brdf(ci, cs, 1.0, psd, row.lambda_um) == pytest.approx(row.BRDF_RR_Q1, rel=VECTORS)
        full = ghs.exponential(path, f, row.sigma_um, row.lc_um, row.lambda_um)
        assert full == pytest.approx(row.BRDF_GHS_full_sigma, rel=VECTORS)
        relevant = ghs.exponential(path, f, row.sigma_rel_um, row.lc_um, row.lambda_um)
        assert relevant == pytest.approx(row.BRDF_GHS_full_sigma_rel, rel=VECTORS)
        assert ghs.phase_variance(path, row.sigma_um, row.lambda_um) == pytest.approx(row.phase_variance_a, rel=VECTORS)


def test_transmission() -> None:
    """Smooth, σ = 4 nm, lc = 10 µm, λ = 0.55 µm, from both sides."""
    length = 2 * math.pi * 10
    amplitude = kc.amplitude_um4(0.004, length, 3.0)
    for row in vectors.frame("ghs_transmissive.csv").itertuples(index=False):
        ci, cs = (math.cos(math.radians(angle)) for angle in (row.theta_i_deg_in_n1, row.theta_s_deg_in_n2))
        psd = kc.psd_um4(row.f_1_per_um, amplitude, length, 3.0)
        path = ghs.path_in_transmission(ci, cs, row.n1, row.n2)
        assert ghs.smooth(path, psd, 0.55, row.n2) == pytest.approx(row.BTDF_over_T, rel=VECTORS)


def test_share_of_a_rough_surface() -> None:
    """
    Normal incidence, σ = 0.1 µm, lc = 50 µm, λ = 0.6328 µm: 0.968565 scattered, of 1 - exp(-a) = 0.980621.

    The path difference at the scattered angles is less than at the specular one, and some waves are evanescent.
    """
    r, weight = scatter_integrals.gauss_legendre(
        np.concatenate([[0.0], np.logspace(-7, -0.2, 80), 1 - np.logspace(-0.5, -9, 40), [1.0]]), 12
    )
    path = ghs.path_in_reflection(1.0, np.sqrt(1 - r * r))
    bsdf = ghs.exponential(path, r / 0.6328, 0.1, 50.0, 0.6328)
    assert np.sum(weight * 2 * np.pi * r * bsdf) == pytest.approx(0.968565, abs=1e-6)
    assert -math.expm1(-ghs.phase_variance(2.0, 0.1, 0.6328)) == pytest.approx(0.980621, abs=1e-6)


def test_number_of_terms() -> None:
    """With a bound instead of the largest variance, and beyond what the series is for."""
    arguments = (np.array([0.1, 2.0]), 0.3, 0.1, 2.0, 0.6328)
    np.testing.assert_allclose(ghs.exponential(*arguments, max_variance=30.0), ghs.exponential(*arguments), rtol=1e-12)
    single = ghs.exponential(mi.Float(arguments[0]), mi.Float(0.3), mi.Float(0.1), *arguments[3:], max_variance=4.0)
    np.testing.assert_allclose(single, ghs.exponential(*arguments), rtol=1e-5)
    with pytest.raises(MistrayError, match="variance of the phase is 394"):
        ghs.exponential(2.0, 0.3, 1.0, 2.0, 0.6328)
