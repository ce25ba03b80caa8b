"""Coatings by the strings that name them, and tables written and read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from mistray.coatings import (
    Bare,
    CoatingTable,
    Ideal,
    Layer,
    Stack,
    coating_from_text,
    preset,
    read_coating,
    spectrum,
    write_table,
)

SAMPLE = Path(__file__).parents[1] / "data" / "coating_sample.dat"
WAVELENGTHS, ANGLES = [450.0, 550.0, 650.0], [0.0, 30.0, 60.0, 85.0]
GREY = Stack((Layer("1.38", 95.0), Layer("2.2+0.2i", 20.0)), name="grey")


def test_names(tmp_path: Path) -> None:
    assert coating_from_text("bare") == Bare()
    assert coating_from_text(" bbar3 ", 600.0) == preset("bbar3", 600.0)
    assert coating_from_text("1.38 0.25w", 600.0) == Stack((Layer("1.38", 0.25 * 600 / 1.38),), name="1.38 0.25w")
    (tmp_path / "ar.csv").write_text("wavelength_nm,angle_deg,R,T\n550,0,.1,.9\n")
    assert isinstance(coating_from_text(str(tmp_path / "ar.csv")), CoatingTable)
    assert coating_from_text(f"{SAMPLE}:SPLIT") == Ideal(0.5, 0.4, "SPLIT")
    assert read_coating(f"{SAMPLE.name}:ALUM", mirror=True, resolve=lambda path: str(SAMPLE.parent / path)).opaque


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bbar5", "did you mean 'bbar4'? There are mgf2_quarter_wave"),
        ("nowhere.csv", "coating table 'nowhere.csv': No such file"),
        ("nowhere.dat:AR", "coating file 'nowhere.dat': No such file"),
        (str(SAMPLE), f"which coating? Write '{SAMPLE}:NAME' with one of AR, AR2, HR"),
        (f"{SAMPLE}:AR9", "no coating 'AR9'; did you mean 'AR'?"),
        ("MgF 100", "coating 'MgF 100', layer 1: material 'MgF' is unknown"),
    ],
)
def test_what_names_no_coating(text: str, words: str) -> None:
    with refused("", words):
        spectrum(coating_from_text(text), [550.0], [0.0])
    with refused(r"coating 'ar\.xlsx' is no file that mistray knows"):
        read_coating("ar.xlsx")


@pytest.mark.parametrize(("front", "back"), [("air", "1.5168"), ("1.5168", "air"), ("1.33", "1.33")])
@pytest.mark.parametrize("coating", [GREY, preset("bbar3"), Bare(), Ideal(0.3, 0.6, "split")])
def test_a_table_that_is_written_and_read_back(tmp_path: Path, coating, front: str, back: str) -> None:
    """At its nodes the table answers as the coating does, from both sides, phases included."""
    write_table(coating, tmp_path / "out.csv", WAVELENGTHS, ANGLES, front, back)
    table = CoatingTable.read(tmp_path / "out.csv")
    assert [file.name for file in tmp_path.iterdir()] == ["out.csv"]
    for from_front in (True, False):
        one, other = (spectrum(c, WAVELENGTHS, ANGLES, front, back, from_front, rarer=True) for c in (coating, table))
        np.testing.assert_allclose(other.R, one.R, atol=1e-9)
        np.testing.assert_allclose(other.T, one.T, atol=1e-9)
        strong = one.R.min(axis=2) > 1e-10
        np.testing.assert_allclose(np.exp(1j * other.phase_r)[strong], np.exp(1j * one.phase_r)[strong], atol=1e-6)
        np.testing.assert_allclose(np.exp(1j * other.phase_t), np.exp(1j * one.phase_t), atol=1e-6)


def test_mirrors_and_what_is_no_table(tmp_path: Path) -> None:
    file = tmp_path / "al.csv"
    for front, back in (("air", "Al"), ("Al", "air")):
        write_table(Bare(), file, WAVELENGTHS, ANGLES, front, back)
        table = CoatingTable.read(file)
        assert table.opaque
        one, other = (spectrum(c, WAVELENGTHS, ANGLES, front, back, front == "air") for c in (Bare(), table))
        np.testing.assert_allclose(other.R, one.R, atol=1e-12)
        assert file.read_text().startswith(f"# bare between {front} (front) and {back} (back)")
    for nm, angle, sides, words in (
        (550.0, 0.0, ("Al", "Ag"), "both are metals; no light gets there"),
        (550.0, -1.0, ("air", "air"), "angles lie in 0 … 90°"),
        (30000.0, 0.0, ("air", "N-BK7"), "30000 nm is outside"),
    ):
        with refused(words):
            write_table(GREY, tmp_path / "out.csv", [nm], [angle], *sides)
    assert list(tmp_path.iterdir()) == [file]


def test_spectrum() -> None:
    """Shares add up; light that enters a metal is absorbed, and none comes from it."""
    values = spectrum(GREY, WAVELENGTHS, ANGLES, back="1.5168")
    assert values.R.shape == (3, 4, 2)
    np.testing.assert_allclose(values.R + values.T + values.A, 1.0)
    np.testing.assert_allclose(values.mean("A"), values.A.mean(axis=2))
    single = GREY.response(550.0, 1 + 0j, 1.5168 + 0j, np.cos(np.radians([60.0])), True)
    np.testing.assert_array_equal(values.R[1, 2], single.R[0])
    metal = spectrum(Bare(), [550.0], [0.0], back="Al")
    assert metal.T.max() == 0
    np.testing.assert_allclose(metal.R + metal.A, 1.0)
    with refused(r"light from 'Al' \(k = 6.* at 550 nm\), in which nothing travels"):
        spectrum(Bare(), [550.0], [0.0], back="Al", from_front=False)
    inside, outside = (spectrum(Bare(), [550.0], [60.0], "1.5168", "air", rarer=rarer) for rarer in (False, True))
    assert inside.T.max() < 1e-12, "60° in glass is beyond the critical angle"
    np.testing.assert_allclose(outside.R, spectrum(Bare(), [550.0], [60.0], "air", "1.5168").R, atol=1e-12)
