"""The Harvey-Shack model, by b0 and by roughness: lobes, totals at all angles, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from oracles import scatter_integrals

from mistray.errors import MistrayError
from mistray.scatter.harvey_shack import HarveyShack, index_step
from mistray.scatter.total import lobe_total

pytestmark = pytest.mark.quick

DATA = Path(__file__).parents[1] / "data"
QUADRATURE = 1e-4  # relative, as required
NORMAL = np.array([1.0])


def test_lobes_of_b0() -> None:
    r = np.array([0.0, 0.01, 1.0])
    for from_front in (True, False):
        lobes = HarveyShack(0.11, 0.01, -1.5).lobes(550.0, 1.0, 1.5, from_front)
        assert [lobe.event for lobe in lobes] == ["reflection", "transmission"]
        for lobe in lobes:
            np.testing.assert_allclose(lobe.profile(r), 0.11 * (1 + (r / 0.01) ** 2) ** -0.75, rtol=1e-12)
    assert HarveyShack(0.0).lobes(550.0, 1.0, 1.5, True) == ()
    assert len(HarveyShack(0.11, event="reflection").lobes(550.0, 1.0, 1.5, True)) == 1


def test_totals_of_a_polish() -> None:
    """40 Å at 550 nm: transmission the same both ways, reflection with its own Δn from air and from inside."""
    table = pd.read_csv(DATA / "harvey_table13.csv", comment="#", skipinitialspace=True)
    model = HarveyShack(rms_nm=4.0)
    for row in table.itertuples(index=False):
        expected = {
            (1.0, "transmission"): row.TIS_pct_calc,
            (1.0, "reflection"): row[-2],
            (row.n, "reflection"): row[-1],
        }
        expected[row.n, "transmission"] = row.TIS_pct_calc
        for n_in, n_out in ((1.0, row.n), (row.n, 1.0)):
            for lobe in model.lobes(550.0, n_in, n_out, n_in == 1):
                total = 100 * lobe_total(lobe, NORMAL, n_in, n_out)[0]
                assert total == pytest.approx(expected[n_in, lobe.event], rel=QUADRATURE)
        b0, length = model.parameters(550.0, "transmission", 1.0, row.n)
        assert (b0, length) == (pytest.approx(row.b0_calc, rel=1e-6), 0.01)


def test_total_at_random_angles() -> None:
    rng = np.random.default_rng(1)
    for _ in range(25):
        length, slope, n = 10 ** rng.uniform(-5, -0.3), rng.uniform(-4, -0.1), rng.uniform(0.6, 2)
        cos_i = rng.uniform(0.01, 1, 3)
        profile = scatter_integrals.harvey_shack(1.0, length, slope)
        for lobe in HarveyShack(1.0, length, slope).lobes(550.0, 1.0, n, True):
            sine = np.sqrt(1 - cos_i**2) / (1 if lobe.event == "reflection" else n)
            expected = [0.0 if s >= 1 else scatter_integrals.total_scatter(profile, s) for s in sine]
            np.testing.assert_allclose(lobe_total(lobe, cos_i, 1.0, n), expected, rtol=QUADRATURE)


def test_wavelength() -> None:
    """With a reference the spectrum of the surface stays; with the roughness alone, l stays."""
    r = np.array([0.0, 1e-3, 0.3])
    (at_550, _), (at_660, _) = (HarveyShack(0.11, 0.01, -1.5, 550.0).lobes(x, 1.0, 1.5, True) for x in (550.0, 660.0))
    np.testing.assert_allclose(at_660.profile(r), at_550.profile(r / 1.2) / 1.2**4, rtol=1e-12)
    (at_550, _), (at_660, _) = (HarveyShack(0.11, 0.01, -1.5).lobes(x, 1.0, 1.5, True) for x in (550.0, 660.0))
    np.testing.assert_array_equal(at_660.profile(r), at_550.profile(r))
    (at_550, _), (at_660, _) = (HarveyShack(rms_nm=2.0).lobes(x, 1.0, 1.5, True) for x in (550.0, 660.0))
    np.testing.assert_allclose(at_660.profile(r), at_550.profile(r) / 1.2**2, rtol=1e-12)
    scaled = HarveyShack(rms_nm=2.0, reference_nm=550.0).lobes(660.0, 1.0, 1.5, True)[0]
    np.testing.assert_allclose(scaled.profile(r), at_550.profile(r / 1.2) / 1.2**4, rtol=1e-12)


def test_no_step_no_transmitted_scatter() -> None:
    (lobe,) = HarveyShack(rms_nm=2.0).lobes(550.0, 1.5, 1.5, True)
    assert lobe.event == "reflection"
    assert index_step("transmission", 1.0, 1.5) == index_step("transmission", 1.5, 1.0) == 0.5
    assert index_step("reflection", 1.5, 1.0) == 3.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"b0": 1.0, "l": 0.0}, "l is 0; it must lie"),
        ({"b0": 1.0, "s": 0.0}, "s is 0; it must lie"),
        ({"b0": 1.0, "s": 1.5}, "s is 1.5; it must lie"),
        ({"b0": 1.0, "s": math.nan}, "s is nan"),
        ({"b0": -1.0}, "b0 is -1; it must lie"),
        ({"rms_nm": -4.0}, "rms_nm is -4; it must"),
        ({}, "neither of b0 and rms_nm given"),
        ({"b0": 1.0, "rms_nm": 4.0}, "both of b0 and rms_nm given"),
        ({"b0": 1.0, "reference_nm": -550.0}, "reference_nm is -550; it must"),
    ],
)
def test_refuses(options: dict[str, float], message: str) -> None:
    with pytest.raises(MistrayError, match=message) as caught:
        HarveyShack(**options, name="lens")
    assert str(caught.value).startswith("HarveyShack 'lens': ")


def test_refuses_what_is_not_smooth() -> None:
    """15 nm at 550 nm: smooth in transmission, not in reflection, less so from inside."""
    model = HarveyShack(rms_nm=15.0)
    with pytest.raises(
        MistrayError, match=r"rms roughness 15 nm is not smooth in reflection at 550 nm .*0\.343, limit 0\.251"
    ):
        model.lobes(550.0, 1.0, 1.5, True)
    assert len(HarveyShack(rms_nm=15.0, event="transmission").lobes(550.0, 1.0, 1.5, True)) == 1
    assert len(model.lobes(1064.0, 1.0, 1.5, True)) == 2
    with pytest.raises(MistrayError, match="not smooth in reflection at 1064 nm"):
        model.lobes(1064.0, 1.5, 1.0, True)


def test_advice() -> None:
    assert HarveyShack(1.0).advice() is None
    assert HarveyShack(1.0, l=float(np.float32(0.01))).advice() is None
    assert "TIS is" in str(HarveyShack(100.0).advice())
    assert "l 0.5 and s -1.5" in str(HarveyShack(1.0, l=0.5).advice())
    assert "s -5" in str(HarveyShack(1.0, s=-5.0).advice())
