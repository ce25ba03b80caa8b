"""Scatter of rough surfaces against float64 vectors, SCATMECH 7 (NIST), stored and live, and Fresnel."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles import scatter_integrals

from mistray.errors import MistrayError
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import harvey_shack
from mistray.physics import k_correlation as kc
from mistray.physics import rayleigh_rice as rr
from mistray.physics.fresnel import reflectance

VECTORS, QUADRATURE = 1e-6, 1e-4  # relative, as required
LENGTH_UM = 2 * math.pi  # of the roughness spectrum of the stored values: σ = 1 nm, lc = 1 µm
AMPLITUDE_UM4 = 2 * math.pi * 1e-6


def test_stored_values_of_rayleigh_rice() -> None:
    for row in vectors.frame("rr_scatmech.csv").itertuples(index=False):
        ci, cs, cphi = (math.cos(math.radians(angle)) for angle in (row.theta_i, row.theta_s, row.phi_s))
        q = rr.polarization_factor(ci, cs, cphi, complex(row.n, row.k))
        assert q == pytest.approx(row.Q_scatmech, rel=VECTORS)
        psd = kc.psd_um4(row.f_1_um, AMPLITUDE_UM4, LENGTH_UM, 3.0)
        assert psd == pytest.approx(row.PSD_um4, rel=VECTORS)
        assert rr.brdf(ci, cs, q, psd, 0.6328) == pytest.approx(row.BRDF_SCATMECH_unpol, rel=VECTORS)


@pytest.mark.validation
@pytest.mark.parametrize("kind", ["reflection", "transmission"])
def test_live(kind: str) -> None:
    """Random substrates and directions; the roughness spectrum of SCATMECH is the same formula."""
    model = pytest.importorskip("pySCATMECH.brdf").BRDF_Model
    rng = np.random.default_rng(4)
    psd = {None: "ABC_PSD_Function", "A": AMPLITUDE_UM4, "B": LENGTH_UM, "C": 3}
    for _ in range(6):
        metal = kind == "reflection" and rng.random() < 0.5
        index = complex(rng.uniform(0.2, 4), rng.uniform(0, 8)) if metal else rng.uniform(0.5, 4)
        text = f"({index.real!r},{index.imag!r})" if metal else repr(index)
        values = {"lambda": 0.6328, "substrate": text, "type": int(kind == "transmission"), "psd": psd}
        theirs = model("Microroughness_BRDF_Model", values)
        for theta_i, theta_s, phi in rng.uniform(0, [1.55, 1.55, math.pi], (20, 3)):
            ci, cs, cphi = math.cos(theta_i), math.cos(theta_s), math.cos(phi)
            n = 1.0 if kind == "reflection" else index
            sine = math.sin(theta_i) / n
            if sine >= 1:
                continue
            r = math.sqrt(sine**2 + math.sin(theta_s) ** 2 - 2 * sine * math.sin(theta_s) * cphi)
            spectrum = kc.psd_um4(n * r / 0.6328, AMPLITUDE_UM4, LENGTH_UM, 3.0)
            if kind == "reflection":
                ours = rr.brdf(ci, cs, rr.polarization_factor(ci, cs, cphi, index), spectrum, 0.6328)
            else:
                path = ghs.path_in_transmission(ci, math.sqrt(1 - sine**2), 1.0, n)
                ours = ghs.smooth(path, spectrum, 0.6328, n) * rr.transmitted_factor(ci, cs, cphi, n)
            assert ours == pytest.approx(theirs.BRDF(thetai=theta_i, thetas=theta_s, phis=phi), rel=VECTORS)


@pytest.mark.parametrize("n", [0.66, 1.33, 1.5168, 4.0])
def test_specular_direction(n: float) -> None:
    """There Q is R and T of the bare surface, also beyond the critical angle."""
    ci = np.linspace(0.02, 1, 50)
    c2 = 1 - (1 - ci * ci) / n**2
    ct = np.sqrt(np.maximum(c2, 0.0))
    expected = np.where(c2 > 0, reflectance(ci, ct, 1.0, n), 1.0)
    np.testing.assert_allclose(rr.polarization_factor(ci, ci, np.ones_like(ci), n), expected, rtol=1e-12)
    np.testing.assert_allclose(rr.transmitted_factor(ci, ct, np.ones_like(ci), n), 1 - expected, atol=1e-12)


def test_reciprocity() -> None:
    """Q(i → s) is Q(s → i); in transmission, n² of the BTDF goes with the direction."""
    rng = np.random.default_rng(5)
    a, b, cphi = rng.uniform(0.01, 1, 200), rng.uniform(0.01, 1, 200), rng.uniform(-1, 1, 200)
    for index in (1.5168, 0.66, 1.37 + 7.62j):
        forth, back = rr.polarization_factor(a, b, cphi, index), rr.polarization_factor(b, a, cphi, index)
        np.testing.assert_allclose(forth, back, rtol=1e-12)
    n = 1.5168
    b = np.sqrt(1 - rng.uniform(0, 0.999, 200) / n**2)  # directions inside that come from outside

    def btdf(cos_i, cos_s, index):
        ct = np.sqrt(1 - (1 - cos_i**2) / index**2)
        # λ is that in the medium of incidence: 1/n of the other's
        in_medium = 1.0 if index > 1 else 1 / n
        return ghs.smooth(cos_i - index * ct, 1.0, in_medium, index) * rr.transmitted_factor(cos_i, cos_s, cphi, index)

    np.testing.assert_allclose(btdf(a, b, n) / n**2, btdf(b, a, 1 / n), rtol=1e-9)


def test_scalar_theory_is_right_near_the_refracted_beam_only() -> None:
    """What the docstring of the scalar theory says of it, for light from air into glass at normal incidence."""
    n = 1.5168
    whole = rr.transmitted_factor(1.0, 1.0, 1.0, n)
    for angle, share, error in ((2, 0.996, 1e-3), (10, 0.91, 0.02), (30, 0.35, 0.02)):
        cs = math.cos(math.radians(angle))
        scalar = (ghs.path_in_transmission(1.0, cs, 1.0, n) / (1 - n)) ** 2
        vector = np.mean([rr.transmitted_factor(1.0, cs, math.cos(phi), n) / whole for phi in (0, math.pi / 2)])
        assert scalar / vector == pytest.approx(share, abs=error)


def test_drjit() -> None:
    rng = np.random.default_rng(6)
    a, b, cphi = rng.uniform(0.05, 1, 50), rng.uniform(0.05, 1, 50), rng.uniform(-1, 1, 50)
    cosines = [mi.Float(x) for x in (a, b, cphi)]
    for index, array in ((1.37 + 7.62j, mi.Complex2f(1.37, 7.62)), (1.5168, mi.Float(1.5168)), (0.66, mi.Float(0.66))):
        expected = rr.polarization_factor(a, b, cphi, index)
        np.testing.assert_allclose(rr.polarization_factor(*cosines, array), expected, rtol=2e-4)
        if not isinstance(index, complex):
            expected = rr.transmitted_factor(a, b, cphi, index)
            np.testing.assert_allclose(rr.transmitted_factor(*cosines, array), expected, rtol=2e-3, atol=1e-6)
    normal = mi.Float(1.0)
    dr.enable_grad(normal)
    q = rr.polarization_factor(normal, mi.Float(0.7), mi.Float(0.2), mi.Complex2f(1.37, 7.62))
    dr.forward(normal)
    assert np.all(np.isfinite(dr.grad(q)))


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
        relevant = kc.relevant_rms_um(amplitude, row.B_um, row.s, row.lambda_um)
        assert relevant == pytest.approx(row.sigma_prime_um, rel=VECTORS)


def test_relevant_roughness() -> None:
    for row in vectors.frame("kcorr_sigma_rel.csv").itertuples(index=False):
        amplitude = kc.amplitude_um4(row.sigma_um, row.B_um, row.C + 1)
        sine = math.sin(math.radians(row.theta_i_deg))
        rms = kc.relevant_rms_um(amplitude, row.B_um, row.C + 1, row.lambda_um, sine)
        assert rms == pytest.approx(row.sigma_rel_um_numeric, rel=VECTORS)
        variance = ghs.phase_variance(2 * math.cos(math.radians(row.theta_i_deg)), rms, row.lambda_um)
        assert -math.expm1(-variance) == pytest.approx(row.TIS_GHS_R1, rel=VECTORS)


def test_total_roughness_by_quadrature_and_the_power_law() -> None:
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
    amplitude, length, slope = 2.0, 100.0, 2.5
    f = np.array([10.0, 20.0])
    psd = kc.psd_um4(f, amplitude, length, slope)
    assert math.log2(psd[0] / psd[1]) == pytest.approx(slope, rel=1e-6)
    np.testing.assert_allclose(psd, harvey_shack.bsdf(f * 0.5, amplitude, 0.5 / length, -slope), rtol=1e-12)


def test_reflection_by_generalized_harvey_shack() -> None:
    """The smooth form, the full series with the total and with the relevant roughness, and Rayleigh-Rice with Q = 1."""
    table = vectors.frame("ghs_rr_vectors.csv")
    assert table["phase_variance_a"].max() > 3
    for row in table.itertuples(index=False):
        ci, cs = np.cos(np.radians([row.theta_i, row.theta_s]))
        f, length = row.abs_dbeta / row.lambda_um, 2 * math.pi * row.lc_um
        psd = kc.psd_um4(f, kc.amplitude_um4(row.sigma_um, length, 3.0), length, 3.0)
        path = ghs.path_in_reflection(ci, cs)
        assert ghs.smooth(path, psd, row.lambda_um) == pytest.approx(row.BRDF_GHS_smooth_R1, rel=VECTORS)
        assert rr.brdf(ci, cs, 1.0, psd, row.lambda_um) == pytest.approx(row.BRDF_RR_Q1, rel=VECTORS)
        for rms, brdf in ((row.sigma_um, row.BRDF_GHS_full_sigma), (row.sigma_rel_um, row.BRDF_GHS_full_sigma_rel)):
            assert ghs.exponential(path, f, rms, row.lc_um, row.lambda_um) == pytest.approx(brdf, rel=VECTORS)
        assert ghs.phase_variance(path, row.sigma_um, row.lambda_um) == pytest.approx(row.phase_variance_a, rel=VECTORS)


def test_transmission_by_generalized_harvey_shack() -> None:
    """Smooth, σ = 4 nm, lc = 10 µm, λ = 0.55 µm, from both sides."""
    length = 2 * math.pi * 10
    amplitude = kc.amplitude_um4(0.004, length, 3.0)
    for row in vectors.frame("ghs_transmissive.csv").itertuples(index=False):
        ci, cs = (math.cos(math.radians(angle)) for angle in (row.theta_i_deg_in_n1, row.theta_s_deg_in_n2))
        psd = kc.psd_um4(row.f_1_per_um, amplitude, length, 3.0)
        path = ghs.path_in_transmission(ci, cs, row.n1, row.n2)
        assert ghs.smooth(path, psd, 0.55, row.n2) == pytest.approx(row.BTDF_over_T, rel=VECTORS)


def test_share_of_a_rough_surface() -> None:
    """Normal incidence, σ = 0.1 µm, lc = 50 µm, λ = 0.6328 µm: 0.968565 scattered, as some waves are evanescent."""
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
