"""Particles of a cleanliness level: distribution, covered area and Mie scatter, against float64 test vectors."""

from __future__ import annotations

import numpy as np
import pytest
import vectors
from scipy.integrate import quad

from mistray.errors import MistrayError
from mistray.physics import contamination

VECTORS = 1e-3  # relative, as required
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
    np.testing.assert_allclose(cloud.f(np.radians(table["theta_deg"].to_numpy())), table[column], rtol=VECTORS)


def test_totals() -> None:
    """Extinction 2.106 times the covered area, scatter 1.548 times: the particles absorb the rest."""
    cloud = contamination.cloud(WAVELENGTH_UM, DUST, 300.0)
    area = contamination.coverage_percent(300.0) / 100
    assert cloud.extinction / area == pytest.approx(2.106, rel=VECTORS)
    assert cloud.scattering / area == pytest.approx(1.5494, rel=VECTORS)
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


def test_bad_input() -> None:
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
