"""The Harvey-Shack model against float64 test vectors and quadrature."""

from __future__ import annotations

import math

import pytest
import vectors
from oracles import scatter_integrals

from mistray.physics import harvey_shack as hs

VECTORS = 1e-6  # relative, as required
POLISH = {"rms_um": 0.004, "wavelength_um": 0.55}  # 40 Å, of the phone camera


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
