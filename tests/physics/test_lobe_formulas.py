"""Formulas of lobes against float64 vectors, TracePro's sheet, closed forms and quadrature, and their derivatives."""

import math
from collections.abc import Callable
from fractions import Fraction
from types import ModuleType

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from drjit_derivatives import forward_derivatives
from oracles import scatter_integrals
from oracles.derivatives import central_differences
from refusals import each_refused
from scipy.integrate import quad

from mistray.physics import abg, gaussian, harvey_shack
from mistray.physics import k_correlation as kc
from mistray.physics.disc import disc_total
from mistray.physics.growth import growth
from mistray.physics.henyey_greenstein import phase_function, sampled_cosine
from mistray.physics.paint import gain

pytestmark = pytest.mark.quick

VECTORS, QUADRATURE = 1e-6, 1e-4  # relative, as required
R = np.array([0.0, 1e-6, 1e-3, 0.1, 1.0, 1.99])


def test_values() -> None:
    for model, table, distance, names, value in (
        (abg, "abg_values.csv", "abs_beta_minus_beta0", "ABg", "BSDF_per_sr"),
        (harvey_shack, "harvey_values.csv", "abs_dbeta", ("b0", "l", "s"), "BSDF"),
    ):
        rows = vectors.frame(table)
        found = model.bsdf(rows[distance].to_numpy(), *(rows[name].to_numpy() for name in names))
        np.testing.assert_allclose(found, rows[value], rtol=VECTORS)


@pytest.mark.parametrize(
    ("model", "table", "names"), [(abg, "abg_tis.csv", "ABg"), (harvey_shack, "harvey_tis.csv", ("b0", "l", "s"))]
)
def test_tis_vectors(model: ModuleType, table: str, names: str) -> None:
    for row in vectors.frame(table).to_dict("records"):
        numbers, sine = [row[name] for name in names], math.sin(math.radians(row["theta_i_deg"]))
        total = disc_total(lambda r, numbers=numbers: model.bsdf(r, *numbers), sine)
        assert total == pytest.approx(row["TIS_numeric"], rel=VECTORS), row
        if sine == 0:
            closed = row["TIS_closed_normal"]
            assert model.tis(*numbers) == pytest.approx(closed, rel=VECTORS), row
            if model is harvey_shack:
                assert harvey_shack.b0_from_tis(closed, row["l"], row["s"]) == pytest.approx(row["b0"], rel=VECTORS)


@pytest.mark.parametrize("width", [1e-4, 0.01, 0.3, 1.0, 1e3, 1e7])
def test_total_of_a_gaussian(width: float) -> None:
    total = scatter_integrals.total_scatter(lambda r: gaussian.bsdf(r, 0.3, width), 0.0)
    assert total == pytest.approx(0.3, rel=1e-4)


@pytest.mark.parametrize("x", [-700.0, -3.0, -0.06, -0.05, -0.049, -1e-9, 0.0, 1e-9, 0.049, 0.05, 0.06, 3.0])
def test_growth(x: float) -> None:
    exact, term = Fraction(1), Fraction(1)
    for k in range(2, 60):
        term *= Fraction(x) / k
        exact += term
    expected = float(exact) if abs(x) < 4 else math.expm1(x) / x
    assert growth(x) == pytest.approx(expected, rel=1e-14)
    assert growth(np.array([x, 0.0]))[0] == pytest.approx(expected, rel=1e-14)


def k_correlation(f: np.ndarray, rms: float, length: float, slope: float) -> np.ndarray:
    return kc.psd_um4(f, kc.band_amplitude_um4(rms, length, slope, 0.55), length, slope)


def alone(function: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """A function of the numbers alone, as one of a distance, too."""
    return lambda _, *numbers: function(*numbers)


ABG_STEPS, HARVEY_STEPS = (2.5e-7, 1e-7, 1e-4), (1e-5, 1e-6, 1e-4)


@pytest.mark.parametrize(
    ("function", "r", "point", "steps"),
    [
        *((abg.bsdf, R[1:], (0.0025, 1e-3, g), ABG_STEPS) for g in (0.0, 0.5, 1.8, 3.0)),
        *(
            (function, R, point, HARVEY_STEPS)
            for function in (harvey_shack.bsdf, alone(harvey_shack.tis), alone(harvey_shack.b0_from_tis))
            for point in ((0.11, 0.01, -1.5), (1.0, 0.01, -2.0), (1.0, 0.01, -2.0001))
        ),
        (gaussian.bsdf, np.array([0.0, 0.05, 0.4, 1.9]), (0.3, 0.2), (1e-4, 1e-4)),
        (k_correlation, np.array([0.0, 1e-3, 0.1, 2.0]), (1.5e-3, 200.0, 2.0), (1e-7, 1e-2, 1e-4)),
    ],
)
def test_drjit(function: Callable, r: np.ndarray, point: tuple[float, ...], steps: tuple[float, ...]) -> None:
    """Values to the rounding of float32; derivatives against central differences in float64."""
    single, double = function(mi.Float(r), *map(mi.Float, point)), function(r, *point)
    rounding = 1e-4 if function is gaussian.bsdf else 3e-6
    np.testing.assert_allclose(np.squeeze(single), double, rtol=rounding, atol=1e-30)
    expected = central_differences(lambda *numbers: function(r, *numbers), point, steps)
    found = forward_derivatives(lambda *numbers: function(dr.llvm.ad.Float64(r), *numbers), point)
    scale = np.abs(expected).max(axis=tuple(range(1, expected.ndim)), keepdims=True)
    np.testing.assert_array_less(np.abs(found - expected), 1e-7 * np.abs(expected) + 1e-9 * scale + 1e-300)


def test_derivatives_and_directions() -> None:
    for g in (0.0, 0.5, 1.8, 3.0):
        found = forward_derivatives(lambda *numbers: abg.bsdf(dr.llvm.ad.Float64([0.0]), *numbers), (0.0025, 1e-3, g))
        assert np.all(np.isfinite(found))
    table = vectors.frame("abg_directions.csv")
    theta_i, theta_s, phi = (np.radians(table[key]) for key in ("theta_i", "theta_s", "phi_s_from_specular"))
    r = np.hypot(np.sin(theta_s) * np.cos(phi) - np.sin(theta_i), np.sin(theta_s) * np.sin(phi))
    np.testing.assert_allclose(r, table["abs_dbeta"], rtol=VECTORS, atol=1e-12)
    np.testing.assert_allclose(abg.bsdf(r.to_numpy(), 0.0025, 0.001, 1.8), table["BSDF"], rtol=VECTORS)


@pytest.mark.parametrize("b", [2e-12, 1e-6, 1e-2, 3.0])
@pytest.mark.parametrize("g", [2 / 3, 1.0, 2.0])
@pytest.mark.parametrize("step", [0.0, 1e-12, -1e-10, 1e-8, 1e-6, -1e-4])
def test_tis_where_the_hypergeometric_function_degenerates(b: float, g: float, step: float) -> None:
    g = g * (1 + step)
    expected = scatter_integrals.total_scatter(scatter_integrals.abg(1.0, b, g), 0.0)
    assert abg.tis(1.0, b, g) == pytest.approx(expected, rel=VECTORS)


@pytest.mark.parametrize("b", [1e-12, 1e-3, 0.5, 3.0, 1e300])
@pytest.mark.parametrize("g", [1e-308, 1e-6, 1e-2, 0.3, 0.999])
def test_tis_of_slight_slopes(b: float, g: float) -> None:
    """2π A ∫ r dr/(B + r^g) over r = exp(-t); the function of 1/B was lost below g 0.03."""
    integral, _ = quad(lambda t: math.exp(-2 * t) / (b + math.exp(-g * t)), 0, 300, epsabs=0, epsrel=1e-12, limit=500)
    assert abg.tis(1.0, b, g) == pytest.approx(2 * math.pi * integral, rel=1e-11)


def test_tis_limits() -> None:
    assert abg.tis(0.3, 0.5, 0.0) == pytest.approx(math.pi * 0.3 / 1.5, rel=1e-15)  # Lambertian
    assert abg.tis(0.3, 0.0, 1.5) == pytest.approx(2 * math.pi * 0.3 / 0.5, rel=1e-15)
    assert abg.tis(0.3, 1e-14, 0.5) == pytest.approx(abg.tis(0.3, 0.0, 0.5), rel=VECTORS)
    for sine in (0.0, 0.6, 1.0):
        assert disc_total(lambda r: abg.bsdf(r, 0.05 / math.pi, 0.0, 0.0), sine) == pytest.approx(0.05, rel=1e-12)
    each_refused((1.0, 0.0, 2.0, "give B > 0"), by=abg.tis)
    a, b = abg.at_wavelength(1.0, 1e-6, 2.0, 1.0, step_ratio=3.0, specular_ratio=0.5)
    assert (a, b) == (pytest.approx(4.5), pytest.approx(1e-6))


# σ 50 Å, correlation length 100 µm, λ 0.5 µm, Δn 2, R 0.95: the sheet "ABg from RMS"
SHEET = {"rms_um": 0.005, "correlation_length_um": 100.0, "wavelength_um": 0.5, "index_step": 2.0, "reflectance": 0.95}


def test_abg_from_rms() -> None:
    """Every cell of TracePro's sheet, with the sheet's own integral; without it the lobe scatters what it says."""
    expected = dict(vectors.frame("tracepro_sheet.csv").set_index("quantity")["computed"])
    found = abg.abg_from_rms(**SHEET, raw_integral=0.015552516)
    cells = {
        "As_um4": found.psd_amplitude_um4,
        "Bs_um": found.psd_length_um,
        "C": found.psd_slope,
        "D_um-4": found.bsdf_per_psd,
        "BSDF0=D*As": found.bsdf_0,
        "BP_TIS=R(1-exp(-(2 pi dn sigma/lam)^2))": found.tis,
        "B=(lam/Bs)^g": found.b,
        "g": found.g,
        "correction=BP/raw": found.correction,
        "min wave = sigma/0.02": found.shortest_wavelength_um,
    }
    assert cells == {name: pytest.approx(expected[name], rel=VECTORS) for name in cells}
    assert f"{found.a:.5E}" == "1.81832E-06"  # as the sheet prints it
    printed = expected["TIS of the sheet's own final ABg (A,B,g)"]
    assert abg.tis(found.a, found.b, found.g) == pytest.approx(printed, rel=1e-5)  # A has 6 digits there
    assert printed > 1.16 * found.tis
    assert abg.abg_from_rms(**SHEET).a == pytest.approx(expected["A for exact ABg TIS = BP"], rel=VECTORS)
    rng = np.random.default_rng(2)
    for _ in range(20):
        wavelength = rng.uniform(0.3, 2)
        rms, length, step = rng.uniform(1e-4, 0.02) * wavelength, 10 ** rng.uniform(0, 3), rng.uniform(0.3, 2)
        result = abg.abg_from_rms(rms, length, wavelength, step, 0.9)
        profile = scatter_integrals.abg(result.a, result.b, result.g)
        assert scatter_integrals.total_scatter(profile, 0.0) == pytest.approx(result.tis, rel=QUADRATURE)


def test_abg_from_rms_refuses() -> None:
    each_refused(
        ({"rms_um": 0.0}, "rms is 0; it must"),
        ({"rms_um": math.nan}, "rms is nan; it must"),
        ({"correlation_length_um": -1.0}, "correlation length is -1; it must"),
        ({"wavelength_um": 0.0}, "wavelength is 0; it must"),
        ({"wavelength_um": 0.2}, "is not smooth at 0.2 um; give at least 0.25 um"),
        ({"index_step": 0.0}, "index step is 0"),
        ({"reflectance": 1.2}, "reflectance is 1.2"),
        ({"raw_integral": 0.0}, "raw integral is 0"),
        by=lambda change: abg.abg_from_rms(**{**SHEET, **change}),
    )


POLISH = {"rms_um": 0.004, "wavelength_um": 0.55}  # 40 Å, of the phone camera


@pytest.mark.parametrize("slope", [-2 - 1e-1, -2 - 1e-3, -2 - 1e-9, -2.0, -2 + 1e-12, -2 + 1e-6, -2 + 1e-2])
def test_tis_next_to_a_slope_of_two(slope: float) -> None:
    """The closed form is 0/0 at s = -2, where it is a logarithm."""
    for length in (1e-4, 0.01, 1.0, 30.0):
        expected = scatter_integrals.total_scatter(scatter_integrals.harvey_shack(1.0, length, slope), 0.0)
        assert harvey_shack.tis(1.0, length, slope) == pytest.approx(expected, rel=1e-9)
    assert harvey_shack.tis(1.0, 0.01, -2.0) == pytest.approx(math.pi * 1e-4 * math.log1p(1e4), rel=1e-14)


def test_table_13_and_limit_of_smooth_surfaces() -> None:
    """b0 and TIS of four glasses, l = 0.01, s = -1.5; Δn of reflection is 2 from air and 2n from inside."""
    for row in vectors.frame("harvey_table13.csv").itertuples():
        share = harvey_shack.tis_from_rms(**POLISH, index_step=row.n - 1)
        assert 100 * share == pytest.approx(row.TIS_pct_calc, rel=VECTORS)
        assert harvey_shack.b0_from_tis(share, 0.01, -1.5) == pytest.approx(row.b0_calc, rel=VECTORS)
        phase = harvey_shack.phase_rms(**POLISH, index_step=row.n - 1)
        assert 550 * phase == pytest.approx(row.SSC_nm_calc, rel=VECTORS)
        both_sides = [100 * harvey_shack.tis_from_rms(**POLISH, index_step=step) for step in (2, 2 * row.n)]
        assert both_sides == pytest.approx(row[-2:], rel=VECTORS)
        # as published, to their digits: TIS 0.1243 %, b0 0.1099
        assert 100 * share == pytest.approx(row.TIS_pct_seed, abs=5.1e-5)
        assert harvey_shack.b0_from_tis(share, 0.01, -1.5) == pytest.approx(row.b0_seed, rel=1e-3)
    aslant = harvey_shack.tis_from_rms(**POLISH, index_step=2, cos_i=0.5)
    assert aslant == pytest.approx(share * (2 / (row.n - 1)) ** 2 / 4)
    # At the limit the mirror has σ = 0.02 λ; the smooth formula is then 3 % above that of Bennett and Porteus
    assert harvey_shack.phase_rms(0.02 * 0.55, 0.55, 2) == pytest.approx(harvey_shack.MAX_PHASE, rel=1e-12)
    share = harvey_shack.MAX_PHASE**2
    assert share == pytest.approx(0.063, abs=5e-4)
    assert 0.03 < share / -math.expm1(-share) - 1 < 0.035


def fresnel(cosine: np.ndarray, n: float) -> np.ndarray:
    """|(a - b)/(a + b)|² of admittances, independent of the package."""
    inner = np.sqrt(n**2 - 1 + cosine**2 + 0j)
    s = (cosine - inner) / (cosine + inner)
    p = (n**2 * cosine - inner) / (n**2 * cosine + inner)
    return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)


def test_paint_and_henyey_greenstein() -> None:
    """The root of two reflectances, by Fresnel's equations with complex numbers."""
    cos_i, cos_s = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    for n in (1.3, 1.5, 1.8):
        expected = np.sqrt(fresnel(cos_i, n) * fresnel(cos_s, n)) / ((n - 1) / (n + 1)) ** 2
        np.testing.assert_allclose(gain(cos_i, cos_s, n), expected, rtol=1e-12)
        np.testing.assert_array_equal(gain(cos_i, cos_s, n), gain(cos_s, cos_i, n))
    found = forward_derivatives(gain, (0.3, 0.4, 1.5))
    np.testing.assert_allclose(found, central_differences(gain, (0.3, 0.4, 1.5), (1e-4,) * 3), rtol=1e-7)
    # Vectors, norm and mean cosine; the samples invert the distribution, below |g| = 1e-3 a uniform one
    table = vectors.frame("hg_phase.csv")
    np.testing.assert_allclose(phase_function(table["cos"], table["g"]), table["p_per_sr"], rtol=1e-12)
    for g in (-0.7, 0.0, 1e-4, 0.3, 0.9):

        def moment(power: int, g: float = g) -> float:
            return 2 * np.pi * quad(lambda c: c**power * float(phase_function(c, g)), -1, 1, points=[np.sign(g)])[0]

        assert (moment(0), moment(1)) == (pytest.approx(1, rel=1e-7), pytest.approx(g, abs=1e-7))
        for u in (0.01, 0.2, 0.5, 0.9):
            share = quad(lambda c, g=g: 2 * np.pi * float(phase_function(c, g)), -1, float(sampled_cosine(u, g)))[0]
            assert share == pytest.approx(u, abs=1e-4)
