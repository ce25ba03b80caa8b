from __future__ import annotations

import pytest

from mistray.errors import MistrayError
from mistray.materials import (
    GLASSES,
    LINE_C_NM,
    LINE_D_NM,
    LINE_F_NM,
    cauchy_index,
    refractive_index,
    sellmeier_index,
)

# nd and Vd as the catalogues print them
CATALOGUE = {
    "N-BK7": (1.51680, 64.17),
    "N-SK16": (1.62041, 60.32),
    "N-LAK9": (1.69100, 54.71),
    "F2": (1.62004, 36.37),
    "N-F2": (1.62005, 36.43),
    "N-SF5": (1.67271, 32.25),
    "SF6": (1.80518, 25.43),
    "N-SF6": (1.80518, 25.36),
    "N-SF11": (1.78472, 25.68),
    "fused silica": (1.45846, 67.82),
    "sapphire": (1.7682, 72.3),
}


def nd_vd(name):
    nd, nf, nc = (refractive_index(name, line) for line in (LINE_D_NM, LINE_F_NM, LINE_C_NM))
    return nd, (nd - 1) / (nf - nc)


def test_catalogue_covers_every_glass():
    assert set(CATALOGUE) == set(GLASSES)


@pytest.mark.parametrize("name", CATALOGUE)
def test_catalogue_values(name):
    nd, vd = nd_vd(name)
    digits = 6e-5 if name == "sapphire" else 6e-6
    assert nd == pytest.approx(CATALOGUE[name][0], abs=digits)
    assert vd == pytest.approx(CATALOGUE[name][1], abs=0.05 if name == "sapphire" else 6e-3)


def test_malitson_table():
    """Malitson 1965, computed indices."""
    for wavelength_nm, n in [(404.656, 1.46962), (546.074, 1.46008), (656.273, 1.45637)]:
        assert refractive_index("fused silica", wavelength_nm) == pytest.approx(n, abs=6e-6)


@pytest.mark.parametrize(
    ("text", "n"),
    [("air", 1.0), (" Vacuum ", 1.0), ("1.5168", 1.5168), ("1", 1.0), ("n-bk7", 1.5168), ("nd=1.544 Vd=56.1", 1.544),
     ("ND = 1.544, VD = 56.1", 1.544)],
)  # fmt: skip
def test_forms(text, n):
    assert refractive_index(text, LINE_D_NM) == pytest.approx(n, abs=5e-6)


def test_cauchy_keeps_nd_and_vd():
    nd, vd = nd_vd("nd=1.632 Vd=23.3")
    assert nd == pytest.approx(1.632, abs=1e-15)
    assert vd == pytest.approx(23.3, rel=1e-12)


@pytest.mark.parametrize("name", GLASSES)
def test_cauchy_error_is_as_documented(name):
    nd, vd = nd_vd(name)
    bounds = {(480, 660): (1.1e-4, 7e-4), (430, 700): (2.5e-4, 3.5e-3), (400, 1000): (2e-3, 7.5e-3)}
    for (low, high), (crown, flint) in bounds.items():
        for wavelength_nm in range(low, high + 1, 10):
            error = cauchy_index(nd, vd, wavelength_nm) - sellmeier_index(GLASSES[name], wavelength_nm)
            assert abs(error) < (crown if vd > 50 else flint)


@pytest.mark.parametrize(
    ("text", "wavelength_nm", "message"),
    [
        ("N-BK8", 550.0, "did you mean N-BK7"),
        ("unobtainium", 550.0, "use air, a number"),
        ("", 550.0, "unknown"),
        ("0.9", 550.0, "at least 1"),
        ("nd=1.5 Vd=0", 550.0, "Vd = 0"),
        ("nd=1.5 Vd=60", 250.0, "400 … 1000 nm"),
        ("N-BK7", 200.0, "310 … 2325 nm"),
        ("air", 0.0, "greater than 0"),
        ("air", float("nan"), "greater than 0"),
    ],
)
def test_errors_name_the_remedy(text, wavelength_nm, message):
    with pytest.raises(MistrayError, match=message) as caught:
        refractive_index(text, wavelength_nm)
    assert "\n" not in str(caught.value)
