"""The ABg model: its lobes, its total at all angles, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles import scatter_integrals

from mistray.errors import MistrayError
from mistray.scatter.abg import ABg
from mistray.scatter.radial import RadialTable
from mistray.scatter.total import lobe_total

pytestmark = pytest.mark.quick

DATA = Path(__file__).parents[1] / "data"
QUADRATURE = 1e-4  # relative, as required


def test_lobes_of_events_and_sides() -> None:
    r = np.array([0.0, 0.01, 1.0])
    model = ABg(0.0025, 1e-3, 1.8)
    for from_front in (True, False):
        lobes = model.lobes(550.0, 1.0, 1.5, from_front)
        assert [lobe.event for lobe in lobes] == ["reflection", "transmission"]
        for lobe in lobes:
            assert lobe.shares == (0, 1, 0)
            np.testing.assert_allclose(lobe.profile(r), 0.0025 / (1e-3 + r**1.8), rtol=1e-12)
    (only,) = ABg(0.0025, 1e-3, 1.8, event="transmission", relative_to="incident").lobes(550.0, 1.0, 1.5, True)
    assert (only.event, only.shares) == ("transmission", (1, 0, 0))
    back = ABg(0.0025, 1e-3, 1.8, side="back")
    assert back.lobes(550.0, 1.0, 1.5, True) == ()
    assert len(back.lobes(550.0, 1.0, 1.5, False)) == 2
    assert ABg(0.0, 1e-3, 1.8).lobes(550.0, 1.0, 1.5, True) == ()


def test_wavelength() -> None:
    """Scaled only where a reference is given; parameters of the stored vectors."""
    table = pd.read_csv(DATA / "abg_wavelength_scaling.csv", comment="#", skipinitialspace=True)
    r = np.array([0.0, 1e-3, 0.3])
    for row in table.itertuples():
        lobe, _ = ABg(row.A1, row.B1, row.g1, 1e3 * row.lam1_um).lobes(1e3 * row.lam2_um, 1.0, 1.5, True)
        np.testing.assert_allclose(lobe.profile(r), row.A2 / (row.B2 + r**row.g2), rtol=1e-6)
        lobe, _ = ABg(row.A1, row.B1, row.g1).lobes(1e3 * row.lam2_um, 1.0, 1.5, True)
        np.testing.assert_allclose(lobe.profile(r), row.A1 / (row.B1 + r**row.g1), rtol=1e-12)


def test_total_at_random_angles() -> None:
    """Reflected and transmitted, about the refracted direction."""
    rng = np.random.default_rng(1)
    for _ in range(25):
        b, g, n = 10 ** rng.uniform(-11.9, 0), rng.uniform(0, 4), rng.uniform(0.6, 2)
        cos_i = rng.uniform(0.01, 1, 3)
        for lobe in ABg(1.0, b, g).lobes(550.0, 1.0, n, True):
            sine = np.sqrt(1 - cos_i**2) / (1 if lobe.event == "reflection" else n)
            expected = [
                0.0 if s >= 1 else scatter_integrals.total_scatter(scatter_integrals.abg(1.0, b, g), s) for s in sine
            ]
            np.testing.assert_allclose(lobe_total(lobe, cos_i, 1.0, n), expected, rtol=QUADRATURE)


def test_radial_law_of_sampling() -> None:
    """The share of the flux within r, for g = 2 and B = 1e-6: r(u) = sqrt(B ((1 + 1/B)^u - 1))."""
    rows = pd.read_csv(DATA / "abg_sampling_g2.csv", comment="#", skipinitialspace=True)
    (lobe, _) = ABg(1.0, 1e-6, 2.0).lobes(550.0, 1.0, 1.5, True)
    table = RadialTable.of(lobe.profile)
    share = table.within(rows["r"].to_numpy()) / table.within(np.array([1.0]))
    np.testing.assert_allclose(share, rows["u"], atol=QUADRATURE)
    found = np.sqrt(1e-6 * (np.power(1 + 1e6, rows["u"]) - 1))
    np.testing.assert_allclose(found, rows["r"], rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0, 1e-3, 1.8), "A is -1; it must lie"),
        ((math.nan, 1e-3, 1.8), "A is nan"),
        ((1.0, 0.0, 1.8), "B is 0; give B > 1e-12, or B ≥ 0 with g = 0"),
        ((1.0, -1e-3, 0.0), "B is -0.001"),
        ((1.0, 1e-12, 2.0), "B is 1e-12"),
        ((1.0, math.inf, 2.0), "B is inf"),
        ((1.0, 1e-3, -2.0), "g is -2"),
        ((1.0, 1e-3, 2.0, 0.0), "reference_nm is 0; it must lie"),
    ],
)
def test_refuses(arguments: tuple[float, ...], message: str) -> None:
    with pytest.raises(MistrayError, match=message) as caught:
        ABg(*arguments, name="lens")
    assert str(caught.value).startswith("ABg 'lens': ")


def test_lambertian_needs_no_b() -> None:
    """It has no peak, so it is sampled about the normal."""
    (lobe, _) = ABg(0.05 / math.pi, 0.0, 0.0).lobes(550.0, 1.0, 1.5, True)
    assert lobe.centre == "normal"
    np.testing.assert_allclose(lobe_total(lobe, np.array([1.0, 0.5, 0.01]), 1.0, 1.5), 0.05, rtol=QUADRATURE)


def test_advice() -> None:
    for a, b, g in [(1e-4, 1e-8, 2.5), (1e-4, float(np.float32(1e-6)), 2), (0.1, 0.5, 4), (0.3, 7, 0), (0, 7, 9)]:
        assert ABg(a, b, g).advice() is None
    for a, b, g in [(1e-4, 1e-3, 1.8), (1e-9, 1e-8, 4), (1e-4, 1e-8, 1), (0.1, 0.5, 1.5)]:
        assert f"B {b:g} and g {g:g}" in str(ABg(a, b, g).advice())
    assert "TIS is 57.9" in str(ABg(1.0, 1e-8, 2.0).advice())  # π ln(1 + 1/B)
    assert str(ABg(1.0, 1e-3, 1.8, name="lens").advice()).startswith("ABg 'lens': B 0.001 and g 1.8")
