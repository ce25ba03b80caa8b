"""Single spheres and particles of a cleanliness level against float64 vectors, Bessel functions and closed forms."""

import numpy as np
import pytest
import vectors
from oracles import mie as oracle
from scipy.integrate import quad

from mistray.errors import MistrayError
from mistray.physics import contamination, mie

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
    assert contamination.dust_index(0.4) == 1.53 + 0.005j
    assert contamination.dust_index(10.6) == 1.7 + 0.2j
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


def test_totals() -> None:
    """Extinction 2.106 times the covered area, scatter 1.548 times: the particles absorb the rest."""
    cloud = contamination.cloud(WAVELENGTH_UM, DUST, 300.0)
    area = contamination.coverage_percent(300.0) / 100
    assert cloud.extinction / area == pytest.approx(2.106, rel=PARTICLES)
    assert cloud.scattering / area == pytest.approx(1.5494, rel=PARTICLES)
    assert cloud.between(0, np.pi) == pytest.approx(cloud.scattering, rel=1e-5)
    assert cloud.between(0, 1) + cloud.between(1, np.pi) == pytest.approx(cloud.scattering, rel=1e-5)


def test_truncation_and_immersion_matter() -> None:
    """Small angles belong to large particles, and in a medium of their own index they are not seen."""
    whole = contamination.cloud(WAVELENGTH_UM, DUST, 300.0)
    cut = contamination.cloud(WAVELENGTH_UM, DUST, 300.0, max_um=50.0)
    assert cut.f(1e-4) < 0.25 * whole.f(1e-4)
    assert cut.f(np.radians(60)) == pytest.approx(float(whole.f(np.radians(60))), rel=0.1)
    matched = contamination.cloud(WAVELENGTH_UM, 1.53 + 1e-9j, 300.0, max_um=50.0, immersion=1.53)
    assert matched.extinction < 1e-4 * cut.extinction


def test_particles_that_cannot_be() -> None:
    for arguments, words in (
        ((0.5,), "cleanliness level 0.5; it must be 1 or more"),
        ((float("nan"),), "cleanliness level nan"),
        ((300, 0.0), "slope 0; it must be greater than 0"),
        ((300, 0.926, 0.5), "diameters 0.5 … 300 µm at level 300"),
        ((300, 0.926, 1.0, 400.0), "diameters 1 … 400 µm at level 300"),
        ((300, 0.926, 50.0, 50.0), "min_um < max_um"),
    ):
        with pytest.raises(MistrayError, match=words):
            contamination.cloud(WAVELENGTH_UM, DUST, *arguments)
    with pytest.raises(MistrayError, match=r"no index of dust at 0.15 µm"):
        contamination.dust_index(0.15)
    with pytest.raises(MistrayError, match="no cleanliness level"):
        contamination.level_of_coverage(1e-9, 0.926, 1.0, 10.0)
