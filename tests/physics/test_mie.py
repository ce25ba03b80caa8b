"""Single spheres and particles of a cleanliness level against float64 vectors, Bessel functions and closed forms."""

import math
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles import mie as oracle
from oracles import scatter_integrals
from refusals import each_refused
from scipy.integrate import quad

from mistray.physics import contamination, harvey_shack, mie
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import k_correlation as kc
from mistray.physics import rayleigh_rice as rr
from mistray.physics.fresnel import reflectance


def test_vectors() -> None:
    """From x = 0.01 to the largest of level 500; efficiencies by miepython, to the digits of its fewer orders."""
    for row in vectors.frame("mie_spheres.csv").itertuples():
        answer = mie.spheres([row.x], complex(row.n, abs(row.k)), np.radians([0, 10, 90, 180]))
        found = [answer.extinction[0], answer.scattering[0], *answer.intensity[0]]
        expected = [row.Qext, row.Qsca, row.i_0deg, row.i_10deg, row.i_90deg, row.i_180deg]
        np.testing.assert_allclose(found, expected, rtol=1e-8, err_msg=f"x = {row.x}, m = {row.n} + {row.k}i")
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


def test_small_spheres_scatter_as_rayleigh_says_and_bad_input() -> None:
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
    each_refused(
        ([1.0], 1.5 - 0.1j, "k between 0 and 100"),
        ([1.0], 0j, "n must lie between 0.01 and 100"),
        ([1.0], complex("nan"), "relative index nan"),
        ([1.0, 1e-3], 1.5, "size parameter πD/λ = 0.001; it must be 0.01 … 20000"),
        ([1e5], 1.5, "size parameter πD/λ = 1e\\+05"),
        ([np.nan], 1.5, "size parameter πD/λ = nan"),
        by=mie.spheres,
    )


PARTICLES = 1e-3  # relative, as required
WAVELENGTH_UM = 0.55
DUST = contamination.dust_index(WAVELENGTH_UM)
COLUMNS = {f"F_CL{level:g}": (level, 0.926) for level in (300.0, 400.0, 500.0)}
COLUMNS["F_CL500_slope0.383"] = (500.0, 0.383)


def test_one_particle_is_as_large_as_the_level() -> None:
    """Equation 11 of the study: one on 0.1 m² is larger than the level; its logarithm is a parabola in log D."""
    for level in (300.0, 400.0, 500.0):
        assert contamination.count(level, level) == pytest.approx(1)
        for slope in (0.926, 0.383):
            expected = 10 ** (slope * (np.log10(level) ** 2 - 1))
            assert contamination.count(10.0, level, slope) == pytest.approx(expected)
    d, h = np.array([1.5, 10.0, 120.0]), 1e-4
    density = (contamination.count(d - h, 300) - contamination.count(d + h, 300)) / (2 * h)
    np.testing.assert_allclose(contamination.density(d, 300), density, rtol=1e-6)


def test_coverage_of_the_standard_and_index_of_dust() -> None:
    """Equation 12 gives percent: 0.1 % is level 395."""
    levels = np.array([300, 396, 400, 500])
    expected = [0.02736, 0.10085, 0.10585, 0.31651]
    found = contamination.standard_coverage_percent(levels)
    np.testing.assert_allclose(found, expected, atol=5e-6)
    assert contamination.standard_coverage_percent(395.3) == pytest.approx(0.1, abs=2e-5)
    assert (contamination.dust_index(0.4), contamination.dust_index(10.6)) == (1.53 + 0.005j, 1.7 + 0.2j)
    expected = 0.005 + (0.55 - 0.4) / (0.6328 - 0.4) * (0.0005 - 0.005)
    assert complex(1.53, expected) == pytest.approx(DUST, rel=1e-12)


@pytest.mark.parametrize(
    ("level", "slope", "percent"),
    [(300, 0.926, 0.02531), (396, 0.926, 0.0935), (400, 0.926, 0.09819), (500, 0.926, 0.29390), (500, 0.383, 7.43e-4)],
)
def test_area_of_the_spheres(level: float, slope: float, percent: float) -> None:
    found = contamination.coverage_percent(level, slope)
    assert found == pytest.approx(percent, rel=1e-3)

    def area(log_d: float) -> float:
        d = np.exp(log_d)
        return float(contamination.density(d, level, slope) * np.pi * d**3 / 4e11)

    assert found == pytest.approx(100 * quad(area, 0, np.log(level), epsrel=1e-10)[0], rel=1e-8)
    assert contamination.level_of_coverage(found, slope) == pytest.approx(level, rel=1e-9)
    truncated = contamination.level_of_coverage(0.05, slope, 2.0, 200.0)
    assert contamination.coverage_percent(truncated, slope, 2.0, 200.0) == pytest.approx(0.05, rel=1e-9)


@pytest.mark.parametrize("column", COLUMNS)
def test_scattered_light(column: str) -> None:
    table = vectors.frame("contam_F_055um.csv")
    cloud = contamination.cloud(WAVELENGTH_UM, DUST, *COLUMNS[column])
    np.testing.assert_allclose(cloud.f(np.radians(table["theta_deg"].to_numpy())), table[column], rtol=PARTICLES)


def test_totals_and_truncation_and_immersion_matter() -> None:
    """Extinction 2.106 times the covered area, scatter 1.548 times: the particles absorb the rest."""
    cloud = contamination.cloud(WAVELENGTH_UM, DUST, 300.0)
    area = contamination.coverage_percent(300.0) / 100
    assert cloud.extinction / area == pytest.approx(2.106, rel=PARTICLES)
    assert cloud.scattering / area == pytest.approx(1.5494, rel=PARTICLES)
    assert cloud.between(0, np.pi) == pytest.approx(cloud.scattering, rel=1e-5)
    assert cloud.between(0, 1) + cloud.between(1, np.pi) == pytest.approx(cloud.scattering, rel=1e-5)
    # Small angles belong to large particles, and in a medium of their own index they are not seen
    whole = contamination.cloud(WAVELENGTH_UM, DUST, 300.0)
    cut = contamination.cloud(WAVELENGTH_UM, DUST, 300.0, max_um=50.0)
    assert cut.f(1e-4) < 0.25 * whole.f(1e-4)
    assert cut.f(np.radians(60)) == pytest.approx(float(whole.f(np.radians(60))), rel=0.1)
    matched = contamination.cloud(WAVELENGTH_UM, 1.53 + 1e-9j, 300.0, max_um=50.0, immersion=1.53)
    assert matched.extinction < 1e-4 * cut.extinction


def test_particles_that_cannot_be() -> None:
    each_refused(
        (0.5, "cleanliness level 0.5; it must be 1 or more"),
        (float("nan"), "cleanliness level nan"),
        (300, 0.0, "slope 0; it must be greater than 0"),
        (300, 0.926, 0.5, "diameters 0.5 … 300 µm at level 300"),
        (300, 0.926, 1.0, 400.0, "diameters 1 … 400 µm at level 300"),
        (300, 0.926, 50.0, 50.0, "min_um < max_um"),
        by=partial(contamination.cloud, WAVELENGTH_UM, DUST),
    )
    each_refused((0.15, "no index of dust at 0.15 µm"), by=contamination.dust_index)
    each_refused((1e-9, 0.926, 1.0, 10.0, "no cleanliness level"), by=contamination.level_of_coverage)


NEAR, QUADRATURE = 1e-6, 1e-4  # relative, as required
LENGTH_UM = 2 * math.pi  # of the roughness spectrum of the stored values: σ = 1 nm, lc = 1 µm
AMPLITUDE_UM4 = 2 * math.pi * 1e-6


def test_stored_values_of_rayleigh_rice() -> None:
    for row in vectors.frame("rr_scatmech.csv").itertuples(index=False):
        ci, cs, cphi = (math.cos(math.radians(angle)) for angle in (row.theta_i, row.theta_s, row.phi_s))
        q = rr.polarization_factor(ci, cs, cphi, complex(row.n, row.k))
        assert q == pytest.approx(row.Q_scatmech, rel=NEAR)
        psd = kc.psd_um4(row.f_1_um, AMPLITUDE_UM4, LENGTH_UM, 3.0)
        assert psd == pytest.approx(row.PSD_um4, rel=NEAR)
        assert rr.brdf(ci, cs, q, psd, 0.6328) == pytest.approx(row.BRDF_SCATMECH_unpol, rel=NEAR)


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
            assert ours == pytest.approx(theirs.BRDF(thetai=theta_i, thetas=theta_s, phis=phi), rel=NEAR)


@pytest.mark.parametrize("n", [0.66, 1.33, 1.5168, 4.0])
def test_specular_direction(n: float) -> None:
    """There Q is R and T of the bare surface, also beyond the critical angle."""
    ci = np.linspace(0.02, 1, 50)
    c2 = 1 - (1 - ci * ci) / n**2
    ct = np.sqrt(np.maximum(c2, 0.0))
    expected = np.where(c2 > 0, reflectance(ci, ct, 1.0, n), 1.0)
    np.testing.assert_allclose(rr.polarization_factor(ci, ci, np.ones_like(ci), n), expected, rtol=1e-12)
    np.testing.assert_allclose(rr.transmitted_factor(ci, ct, np.ones_like(ci), n), 1 - expected, atol=1e-12)


def test_reciprocity_scalar_theory_and_drjit() -> None:
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
    # What the docstring of the scalar theory says of it, for light from air into glass at normal incidence
    n = 1.5168
    whole = rr.transmitted_factor(1.0, 1.0, 1.0, n)
    for angle, share, error in ((2, 0.996, 1e-3), (10, 0.91, 0.02), (30, 0.35, 0.02)):
        cs = math.cos(math.radians(angle))
        scalar = (ghs.path_in_transmission(1.0, cs, 1.0, n) / (1 - n)) ** 2
        vector = np.mean([rr.transmitted_factor(1.0, cs, math.cos(phi), n) / whole for phi in (0, math.pi / 2)])
        assert scalar / vector == pytest.approx(share, abs=error)
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


def test_relevant_roughness_and_generalized_harvey_shack() -> None:
    """A' and the BSDF of a smooth surface, S = 1.5, 2 (a logarithm) and 2.5."""
    table = vectors.frame("kcorr_bandlimited.csv")
    assert set(table["s"]) >= {1.5, 2.0, 2.5}
    for row in table.itertuples(index=False):
        amplitude = kc.band_amplitude_um4(row.sigma_prime_um, row.B_um, row.s, row.lambda_um)
        assert amplitude == pytest.approx(row.A_um4, rel=NEAR)
        psd = kc.psd_um4(row.beta / row.lambda_um, amplitude, row.B_um, row.s)
        assert ghs.smooth(row.dn, psd, row.lambda_um) == pytest.approx(row[7], rel=NEAR)
        cosine = math.sqrt(1 - row.beta**2)
        assert ghs.smooth(row.dn, psd, row.lambda_um) * cosine == pytest.approx(row[8], rel=NEAR, abs=1e-15)
        relevant = kc.relevant_rms_um(amplitude, row.B_um, row.s, row.lambda_um)
        assert relevant == pytest.approx(row.sigma_prime_um, rel=NEAR)
    for row in vectors.frame("kcorr_sigma_rel.csv").itertuples(index=False):
        amplitude = kc.amplitude_um4(row.sigma_um, row.B_um, row.C + 1)
        sine = math.sin(math.radians(row.theta_i_deg))
        rms = kc.relevant_rms_um(amplitude, row.B_um, row.C + 1, row.lambda_um, sine)
        assert rms == pytest.approx(row.sigma_rel_um_numeric, rel=NEAR)
        variance = ghs.phase_variance(2 * math.cos(math.radians(row.theta_i_deg)), rms, row.lambda_um)
        assert -math.expm1(-variance) == pytest.approx(row.TIS_GHS_R1, rel=NEAR)
    # The integral of the PSD over all frequencies is σ², and over a band what is asked for
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
    # The smooth form, the full series with the total and with the relevant roughness, and Rayleigh-Rice with Q = 1
    table = vectors.frame("ghs_rr_vectors.csv")
    assert table["phase_variance_a"].max() > 3
    for row in table.itertuples(index=False):
        ci, cs = np.cos(np.radians([row.theta_i, row.theta_s]))
        f, length = row.abs_dbeta / row.lambda_um, 2 * math.pi * row.lc_um
        psd = kc.psd_um4(f, kc.amplitude_um4(row.sigma_um, length, 3.0), length, 3.0)
        path = ghs.path_in_reflection(ci, cs)
        assert ghs.smooth(path, psd, row.lambda_um) == pytest.approx(row.BRDF_GHS_smooth_R1, rel=NEAR)
        assert rr.brdf(ci, cs, 1.0, psd, row.lambda_um) == pytest.approx(row.BRDF_RR_Q1, rel=NEAR)
        for rms, brdf in ((row.sigma_um, row.BRDF_GHS_full_sigma), (row.sigma_rel_um, row.BRDF_GHS_full_sigma_rel)):
            assert ghs.exponential(path, f, rms, row.lc_um, row.lambda_um) == pytest.approx(brdf, rel=NEAR)
        assert ghs.phase_variance(path, row.sigma_um, row.lambda_um) == pytest.approx(row.phase_variance_a, rel=NEAR)


def test_generalized_harvey_shack_in_transmission_and_its_share() -> None:
    """Smooth, σ = 4 nm, lc = 10 µm, λ = 0.55 µm, from both sides."""
    length = 2 * math.pi * 10
    amplitude = kc.amplitude_um4(0.004, length, 3.0)
    for row in vectors.frame("ghs_transmissive.csv").itertuples(index=False):
        ci, cs = (math.cos(math.radians(angle)) for angle in (row.theta_i_deg_in_n1, row.theta_s_deg_in_n2))
        psd = kc.psd_um4(row.f_1_per_um, amplitude, length, 3.0)
        path = ghs.path_in_transmission(ci, cs, row.n1, row.n2)
        assert ghs.smooth(path, psd, 0.55, row.n2) == pytest.approx(row.BTDF_over_T, rel=NEAR)
    # Normal incidence, σ = 0.1 µm, lc = 50 µm, λ = 0.6328 µm: 0.968565 scattered, as some waves are evanescent
    edges = np.concatenate([[0.0], np.logspace(-7, -0.2, 80), 1 - np.logspace(-0.5, -9, 40), [1.0]])
    r, weight = scatter_integrals.gauss_legendre(edges, 12)
    path = ghs.path_in_reflection(1.0, np.sqrt(1 - r * r))
    bsdf = ghs.exponential(path, r / 0.6328, 0.1, 50.0, 0.6328)
    assert np.sum(weight * 2 * np.pi * r * bsdf) == pytest.approx(0.968565, abs=1e-6)
    assert -math.expm1(-ghs.phase_variance(2.0, 0.1, 0.6328)) == pytest.approx(0.980621, abs=1e-6)
    # With a bound instead of the largest variance, and beyond what the series is for
    arguments = (np.array([0.1, 2.0]), 0.3, 0.1, 2.0, 0.6328)
    np.testing.assert_allclose(ghs.exponential(*arguments, max_variance=30.0), ghs.exponential(*arguments), rtol=1e-12)
    single = ghs.exponential(mi.Float(arguments[0]), mi.Float(0.3), mi.Float(0.1), *arguments[3:], max_variance=4.0)
    np.testing.assert_allclose(single, ghs.exponential(*arguments), rtol=1e-5)
    each_refused((2.0, 0.3, 1.0, 2.0, 0.6328, "variance of the phase is 394"), by=ghs.exponential)
