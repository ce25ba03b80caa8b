"""Coating tables: columns, grid, interpolation, both sides, phases, errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mistray.coatings import CoatingTable
from mistray.errors import MistrayError

AIR, GLASS = 1 + 0j, 1.5 + 0j
PLAIN = """# measured
wavelength_nm,angle_deg,R,T
500,0,.10,.80
500,60,.20,.70
600,0,.30,.60
600,60,.40,.50
"""
POLARISED = """wavelength_nm,angle_deg,R_s,R_p,T_s,T_p,R_back_s,R_back_p,phase_r_deg,phase_t_deg,phase_r_back_deg
550,0,.1,.1,.8,.8,.15,.15,180,0,180
550,60,.3,.1,.6,.85,.35,.12,150,-10,170
"""


@pytest.fixture
def read(tmp_path: Path):
    def from_text(text: str) -> CoatingTable:
        path = tmp_path / "ar.csv"
        path.write_text(text, encoding="utf-8")
        return CoatingTable.read(path)

    return from_text


def at(table: CoatingTable, nm: float, degrees: float, from_front: bool = True, back: complex = GLASS):
    """Response at one angle in the air in front."""
    cosine = np.cos(np.radians([degrees]))
    if not from_front:
        cosine = np.sqrt(1 - (1 - cosine**2) / back.real**2)
    return table.response(nm, AIR, back, cosine, from_front)


def test_nodes_and_both_polarisations(read) -> None:
    table = read(PLAIN)
    np.testing.assert_allclose(at(table, 500.0, 60.0).R, [[0.2, 0.2]], atol=1e-15)
    np.testing.assert_allclose(at(table, 600.0, 0.0).T, [[0.6, 0.6]], atol=1e-15)
    np.testing.assert_allclose(at(table, 600.0, 0.0).A, [[0.1, 0.1]], atol=1e-15)
    own = at(read(POLARISED), 550.0, 60.0)
    np.testing.assert_allclose(own.R, [[0.3, 0.1]], atol=1e-15)
    np.testing.assert_allclose(own.T, [[0.6, 0.85]], atol=1e-15)


def test_linear_in_wavelength_and_cosine(read) -> None:
    half = np.degrees(np.arccos(0.75))
    assert at(read(PLAIN), 525.0, half).R[0, 0] == pytest.approx(0.25 * 0.35 + 0.75 * 0.15, abs=1e-15)


def test_beyond_the_steepest_angle_the_last_value_holds(read) -> None:
    np.testing.assert_allclose(at(read(PLAIN), 500.0, 80.0).R, 0.2)


def test_the_angle_is_that_in_the_rarer_material(read) -> None:
    table = read(POLARISED)
    behind = at(table, 550.0, 60.0, from_front=False)
    np.testing.assert_allclose(behind.R, [[0.35, 0.12]], atol=1e-12)
    np.testing.assert_allclose(behind.T, at(table, 550.0, 60.0).T, atol=1e-12)


def test_total_reflection_takes_the_transmitted_share_too(read) -> None:
    table = read(PLAIN)
    beyond = table.response(500.0, AIR, GLASS, np.array([0.2]), False)
    np.testing.assert_allclose(beyond.R, 0.9)
    np.testing.assert_allclose(beyond.T, 0.0)


def test_an_opaque_table_has_the_angle_of_the_side_of_incidence(read) -> None:
    table = read("wavelength_nm,angle_deg,R,T\n550,0,.1,0\n550,60,.3,0\n")
    assert table.opaque
    assert not read(PLAIN).opaque
    for from_front in (True, False):
        own = table.response(550.0, AIR, GLASS, np.array([0.5]), from_front)
        np.testing.assert_allclose(own.R, 0.3)


def test_phases(read) -> None:
    plain = at(read(PLAIN), 550.0, 30.0)
    np.testing.assert_allclose(np.exp(1j * plain.phase_r), -1, atol=1e-12)
    np.testing.assert_allclose(plain.phase_t, 0, atol=1e-12)
    table = read(POLARISED)
    assert np.degrees(at(table, 550.0, 60.0).phase_r[0]) == pytest.approx(150)
    assert np.degrees(at(table, 550.0, 60.0).phase_t[0]) == pytest.approx(-10)
    assert np.degrees(at(table, 550.0, 60.0, from_front=False).phase_r[0]) == pytest.approx(170)
    # between 180 and 150 degrees lies 165, not a value on the far side of the circle
    half = np.degrees(np.arccos(0.75))
    assert np.degrees(at(table, 550.0, half).phase_r[0]) == pytest.approx(165)


def test_a_table_of_one_wavelength_holds_for_all(read) -> None:
    np.testing.assert_array_equal(at(read(POLARISED), 400.0, 30.0).R, at(read(POLARISED), 550.0, 30.0).R)


def test_rows_in_any_order(read) -> None:
    head, *rows = PLAIN.splitlines()[1:]
    shuffled = read("\n".join([head, rows[2], rows[1], rows[3], rows[0]]))
    np.testing.assert_array_equal(shuffled.shares, read(PLAIN).shares)


def test_outside_of_the_wavelengths(read) -> None:
    with pytest.raises(MistrayError, match=r"ar.csv': 450 nm is outside of its 500 … 600 nm"):
        at(read(PLAIN), 450.0, 0.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "column wavelength_nm, angle_deg, R or R_s and R_p, T or T_s and T_p is missing"),
        ("wavelength_nm,angle_deg,R\n", "column T or T_s and T_p is missing; it needs"),
        ("wavelength_nm,angle_deg,R,T_s\n", "column the partner of T_s is missing"),
        ("wavelength_nm,angle_deg,R,R_s,R_p,T\n", "columns R and R_s are both there"),
        ("wavelength_nm,angle_deg,R,T,note\n", "column 'note' is unknown; possible are wavelength_nm, angle_deg, R,"),
        ("wavelength_nm,angle_deg,R,T,T\n", "column 'T' is there twice"),
        (PLAIN.replace(".20", "n/a"), "line 4: could not convert string to float: 'n/a'; every cell must be a number"),
        (PLAIN.replace("500,60,.20,.70", "500,60,.20"), "line 4: 4 finite numbers are needed, as in the header"),
        (PLAIN.replace(".20", "nan"), "line 4: 4 finite numbers are needed"),
        (
            PLAIN.replace("600,60,.40,.50\n", ""),
            "3 rows for 2 wavelengths and 2 angles; give every angle once at every",
        ),
        (PLAIN.replace("600,60", "600,0"), "give every angle once at every wavelength"),
        (PLAIN.splitlines()[1], "0 rows for 0 wavelengths"),
        (PLAIN.replace(".80", ".95"), "R + T reaches 1.05 or a value is negative"),
        (PLAIN.replace(".80", "-.1"), "or a value is negative"),
        (POLARISED.replace(".35,.12", ".45,.12"), "R + T reaches 1.05"),
        (PLAIN.replace(",60,", ",95,"), "angles must lie in 0 … 90°"),
    ],
)
def test_bad_files(read, text: str, words: str) -> None:
    with pytest.raises(MistrayError) as caught:
        read(text)
    assert words in str(caught.value)
    assert "coating table '" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MistrayError, match=r"nowhere.csv': No such file or directory"):
        CoatingTable.read(tmp_path / "nowhere.csv")
    binary = tmp_path / "x.csv"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(MistrayError, match="it is no text file"):
        CoatingTable.read(binary)
