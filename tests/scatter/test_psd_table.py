"""Surfaces of measured spectrum: the K-correlation model as a table, units, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mistray.errors import MistrayError
from mistray.scatter.k_correlation import KCorrelation
from mistray.scatter.measured.psd_table import PsdTable
from mistray.scatter.total import lobe_total

POLISH = Path(__file__).parents[1] / "data" / "psd_polish.csv"
TABLE = 2e-3  # relative: power laws between 600 frequencies, and a constant below the first


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("theory", ["ghs", "rayleigh_rice", "rayleigh_rice_vector"])
def test_is_the_model_that_was_tabulated(theory: str) -> None:
    event = "reflection" if theory == "rayleigh_rice" else "both"
    known = KCorrelation(4.0, 20.0, 2.5, theory=theory, event=event)
    r = np.geomspace(1e-5, 2, 200)
    for wavelength, n_in, n_out in ((550.0, 1.0, 1.5), (550.0, 1.5, 1.0), (1064.0, 1.0, 1.7)):
        table = PsdTable.read(POLISH, theory=theory, event=event, beyond="slope")
        ours, theirs = (m.lobes(wavelength, n_in, n_out, True) for m in (table, known))
        for a, b in zip(ours, theirs, strict=True):
            assert (a.event, a.factor) == (b.event, b.factor)
            np.testing.assert_allclose(a.profile(r), b.profile(r), rtol=TABLE)
            cos_i = np.array([1.0, 0.9])
            np.testing.assert_allclose(lobe_total(a, cos_i, n_in, n_out), lobe_total(b, cos_i, n_in, n_out), rtol=TABLE)


def test_total_of_a_smooth_surface() -> None:
    """(4π σ/λ)² times the mean of ((1 + cos θs)/2)², with σ of the frequencies up to 1/λ; a flat spectrum."""
    flat = PsdTable((1e-3, 100.0), (1e-6, 1e-6), event="reflection")
    (lobe,) = flat.lobes(500.0, 1.0, 1.5, True)
    assert flat.relevant_rms_um(500.0, 1.0) ** 2 == pytest.approx(np.pi * 1e-6 * 2.0**2, rel=1e-3)
    sigma_2, mean = np.pi * 1e-6 * 4.0, 0.25 * (1 + 4 / 3 + 0.5)
    assert lobe_total(lobe, np.array([1.0]), 1.0, 1.5)[0] == pytest.approx(
        (4 * np.pi / 0.5) ** 2 * sigma_2 * mean, rel=1e-3
    )


def test_units_and_scale(tmp_path: Path) -> None:
    mm = write(tmp_path / "mm.csv", "frequency_1_mm,psd_nm2_mm2\n1,1e-3\n10000,1e-7\n")
    um = write(tmp_path / "um.csv", "# the same\nfrequency_1_um,psd_um4\n0.001,1e-3\n10,1e-7\n")
    f = np.array([1e-4, 1e-3, 0.03, 10.0])
    a, b, twice = PsdTable.read(mm), PsdTable.read(um), PsdTable.read(um, scale=2.0)
    np.testing.assert_allclose(a.psd(550.0)(f), b.psd(550.0)(f), rtol=1e-12)
    np.testing.assert_allclose(b.psd(550.0)(f), [1e-3, 1e-3, 1e-3 / 30, 1e-7], rtol=1e-12)
    np.testing.assert_allclose(twice.psd(550.0)(f), 2 * b.psd(550.0)(f))
    assert PsdTable.read(um, scale=0.0).lobes(550.0, 1.0, 1.5, True) == ()


def test_above_the_last_frequency() -> None:
    values: tuple[Any, ...] = ((0.01, 1.0), (1e-4, 1e-8))
    with pytest.raises(MistrayError, match=r"it ends at 1 1/µm, but light of 550 nm meets frequencies up to 3\.63636"):
        PsdTable(*values).lobes(550.0, 1.0, 1.5, True)
    f = np.array([0.5, 2.0])
    np.testing.assert_allclose(PsdTable(*values, beyond="slope").psd(550.0)(f), [4e-8, 2.5e-9], rtol=1e-12)
    np.testing.assert_allclose(PsdTable(*values, beyond="zero").psd(550.0)(f), [4e-8, 0.0], rtol=1e-12)
    assert PsdTable(*values).lobes(2001.0, 1.0, 1.0, True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f,psd_um4\n1,1\n", "its columns are f, psd_um4; give frequency_1_um or frequency_1_mm, and psd_um4"),
        ("", "its columns are missing"),
        ("frequency_1_um,psd_um4\n1,1\n2,x\n", "line 3: could not convert"),
        ("frequency_1_um,psd_um4\n1,1\n2\n", "line 3: 1 values where 2 are needed"),
        ("frequency_1_um,psd_um4\n1,1\n", "1 frequencies and 1 values; give two or more"),
        ("frequency_1_um,psd_um4\n2,1\n1,1\n", "the frequencies must be above 0 and ascend"),
        ("frequency_1_um,psd_um4\n1,1\n2,0\n", "spectrum 0 µm⁴ at 2 1/µm; give values > 0"),
    ],
)
def test_refuses(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path / "psd.csv", text)
    with pytest.raises(MistrayError, match=message) as caught:
        PsdTable.read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
