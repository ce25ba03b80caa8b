"""The Harvey-Shack model against float64 test vectors (closed forms and quadrature) and quadrature here."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles import scatter_integrals
from oracles.derivatives import central_differences

import mistray  # noqa: F401  (settles libLLVM and the variant)
from mistray.physics import harvey_shack as hs
from mistray.physics.disc import disc_total

VECTORS, QUADRATURE = 1e-6, 1e-4  # relative, as required
POLISH = {"rms_um": 0.004, "wavelength_um": 0.55}  # 40 Å, of the phone camera


def test_values() -> None:
    table = vectors.frame("harvey_values.csv")
    found = hs.bsdf(table["abs_dbeta"].to_numpy(), *(table[key].to_numpy() for key in ("b0", "l", "s")))
    np.testing.assert_allclose(found, table["BSDF"], rtol=VECTORS)


def test_tis_vectors() -> None:
    table = vectors.frame("harvey_tis.csv")
    for row in table.itertuples():
        sine = math.sin(math.radians(row.theta_i_deg))
        total = disc_total(lambda r, row=row: hs.bsdf(r, row.b0, row.l, row.s), sine)
        assert total == pytest.approx(row.TIS_numeric, rel=VECTORS), row
        if sine == 0:
            assert hs.tis(row.b0, row.l, row.s) == pytest.approx(row.TIS_closed_normal, rel=VECTORS), row
            assert hs.b0_from_tis(row.TIS_closed_normal, row.l, row.s) == pytest.approx(row.b0, rel=VECTORS), row
    assert len(table) > 30


def test_tis_by_quadrature() -> None:
    rng = np.random.default_rng(1)
    for _ in range(60):
        length, slope, sine = 10 ** rng.uniform(-5, 0.5), rng.uniform(-4, -0.1), rng.uniform(0, 1)
        profile = scatter_integrals.harvey_shack(1.0, length, slope)
        assert hs.tis(1.0, length, slope) == pytest.approx(
            scatter_integrals.total_scatter(profile, 0.0), rel=QUADRATURE
        )
        expected = scatter_integrals.total_scatter(profile, sine)
        found = disc_total(lambda r, length=length, slope=slope: hs.bsdf(r, 1.0, length, slope), sine)
        assert found == pytest.approx(expected, rel=QUADRATURE)


@pytest.mark.parametrize("slope", [-2 - 1e-1, -2 - 1e-3, -2 - 1e-9, -2.0, -2 + 1e-12, -2 + 1e-6, -2 + 1e-2])
def test_tis_next_to_a_slope_of_two(slope: float) -> None:
    """The closed form is 0/0 at s = -2, where it is a logarithm."""
    for length in (1e-4, 0.01, 1.0, 30.0):
        expected = scatter_integrals.total_scatter(scatter_integrals.harvey_shack(1.0, length, slope), 0.0)
        assert hs.tis(1.0, length, slope) == pytest.approx(expected, rel=1e-9)
    assert hs.tis(1.0, 0.01, -2.0) == pytest.approx(math.pi * 1e-4 * math.log1p(1e4), rel=1e-14)


def test_table_13() -> None:
    """
    Roughness 40 Å at 550 nm, l = 0.01, s = -1.5: b0 and TIS of four glasses.

    Δn of reflection is 2 from air and 2n from inside, which scatters 7 to 34 times as much as transmission.
    """
    table = vectors.frame("harvey_table13.csv")
    for row in table.itertuples():
        share = hs.tis_from_rms(**POLISH, index_step=row.n - 1)
        assert 100 * share == pytest.approx(row.TIS_pct_calc, rel=VECTORS)
        assert hs.b0_from_tis(share, 0.01, -1.5) == pytest.approx(row.b0_calc, rel=VECTORS)
        assert hs.phase_rms(**POLISH, index_step=row.n - 1) * 550 == pytest.approx(row.SSC_nm_calc, rel=VECTORS)
        outside, inside = (100 * hs.tis_from_rms(**POLISH, index_step=step) for step in (2, 2 * row.n))
        assert outside == pytest.approx(row[-2], rel=VECTORS)
        assert inside == pytest.approx(row[-1], rel=VECTORS)
        # as published, to their digits: TIS 0.1243 %, b0 0.1099
        assert 100 * share == pytest.approx(row.TIS_pct_seed, abs=5.1e-5)
        assert hs.b0_from_tis(share, 0.01, -1.5) == pytest.approx(row.b0_seed, rel=1e-3)
    assert hs.tis_from_rms(**POLISH, index_step=2, cos_i=0.5) == pytest.approx(share * (2 / (row.n - 1)) ** 2 / 4)


def test_limit_of_smooth_surfaces() -> None:
    """At the limit the mirror has σ = 0.02 λ; the smooth formula is then 3 % above that of Bennett and Porteus."""
    assert hs.phase_rms(0.02 * 0.55, 0.55, 2) == pytest.approx(hs.MAX_PHASE, rel=1e-12)
    exact = -math.expm1(-(hs.MAX_PHASE**2))
    share = hs.MAX_PHASE**2
    assert share == pytest.approx(0.063, abs=5e-4)
    assert 0.03 < share / exact - 1 < 0.035


def test_wavelength_scaling() -> None:
    """BSDF₂(r) = BSDF₁(r/k)/k⁴, and the same as ABg's far beyond the knee."""
    b0, length, slope, k = 0.11, 0.01, -1.5, 1.3
    scaled = hs.at_wavelength(b0, length, k)
    r = np.geomspace(1e-5, 2, 30)
    np.testing.assert_allclose(hs.bsdf(r, *scaled, slope), hs.bsdf(r / k, b0, length, slope) / k**4, rtol=1e-12)


POINTS = {"polish": (0.11, 0.01, -1.5), "s = -2": (1.0, 0.01, -2.0), "next to s = -2": (1.0, 0.01, -2.0001)}


@pytest.mark.parametrize("point", POINTS.values(), ids=POINTS.keys())
def test_drjit(point: tuple[float, float, float]) -> None:
    """Values to the rounding of float32; gradients against central differences in float64."""
    r = np.array([0.0, 1e-6, 1e-3, 0.1, 1.0, 1.99])
    np.testing.assert_allclose(hs.bsdf(mi.Float(r), *map(mi.Float, point)), hs.bsdf(r, *point), rtol=3e-6)
    np.testing.assert_allclose(hs.tis(*map(mi.Float, point)), hs.tis(*point), rtol=3e-6)
    steps = (1e-4 * point[0], 1e-4 * point[1], 1e-4)
    functions = (
        lambda b0, length, slope: hs.bsdf(dr.llvm.ad.Float64(r) if dr.is_array_v(b0) else r, b0, length, slope),
        hs.tis,
        hs.b0_from_tis,
    )
    for function in functions:
        expected = central_differences(function, point, steps)
        for k in range(3):
            parameters = [dr.llvm.ad.Float64(value) for value in point]
            dr.enable_grad(parameters[k])
            value = function(*parameters)
            dr.forward(parameters[k])
            np.testing.assert_allclose(
                np.squeeze(dr.grad(value)), np.squeeze(expected[k]), rtol=1e-7, atol=1e-9 * np.abs(expected[k]).max()
            )
