"""Coating tables: columns, grid, interpolation, both sides, phases, errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from mistray.coatings import CoatingTable

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
HALF = np.degrees(np.arccos(0.75))  # in the middle between 0° and 60° in the cosine


@pytest.fixture
def read(tmp_path: Path):
    def from_text(text: str) -> CoatingTable:
        path = tmp_path / "ar.csv"
        path.write_text(text, encoding="utf-8")
        return CoatingTable.read(path)

    return from_text


def at(table: CoatingTable, nm: float, degrees: float, from_front: bool = True):
    """Response at one angle in the air in front."""
    cosine = np.cos(np.radians([degrees]))
    if not from_front:
        cosine = np.sqrt(1 - (1 - cosine**2) / GLASS.real**2)
    return table.response(nm, AIR, GLASS, cosine, from_front)


def test_shares(read) -> None:
    """At the nodes, linear between them in wavelength and cosine; beyond the steepest angle the last value holds."""
    table = read(PLAIN)
    np.testing.assert_allclose(at(table, 500.0, 60.0).R, [[0.2, 0.2]], atol=1e-15)
    np.testing.assert_allclose(at(table, 600.0, 0.0).T, [[0.6, 0.6]], atol=1e-15)
    np.testing.assert_allclose(at(table, 600.0, 0.0).A, [[0.1, 0.1]], atol=1e-15)
    assert at(table, 525.0, HALF).R[0, 0] == pytest.approx(0.25 * 0.35 + 0.75 * 0.15, abs=1e-15)
    np.testing.assert_allclose(at(table, 500.0, 80.0).R, 0.2)
    head, *rows = PLAIN.splitlines()[1:]
    np.testing.assert_array_equal(read("\n".join([head, rows[2], rows[1], rows[3], rows[0]])).shares, table.shares)
    with refused(r"ar.csv': 450 nm is outside of its 500 … 600 nm"):
        at(table, 450.0, 0.0)


def test_both_polarisations_and_sides(read) -> None:
    """The angle is that in the rarer material; a table of one wavelength holds for all."""
    table = read(POLARISED)
    front, behind = at(table, 550.0, 60.0), at(table, 550.0, 60.0, from_front=False)
    np.testing.assert_allclose(front.R, [[0.3, 0.1]], atol=1e-15)
    np.testing.assert_allclose(front.T, [[0.6, 0.85]], atol=1e-15)
    np.testing.assert_allclose(behind.R, [[0.35, 0.12]], atol=1e-12)
    np.testing.assert_allclose(behind.T, front.T, atol=1e-12)
    np.testing.assert_array_equal(at(table, 400.0, 60.0).R, front.R)


def test_total_reflection_takes_the_transmitted_share_too(read) -> None:
    beyond = read(PLAIN).response(500.0, AIR, GLASS, np.array([0.2]), False)
    np.testing.assert_allclose(beyond.R, 0.9)
    np.testing.assert_allclose(beyond.T, 0.0)
    # An opaque table has the angle of the side of incidence
    table = read("wavelength_nm,angle_deg,R,T\n550,0,.1,0\n550,60,.3,0\n")
    assert table.opaque
    assert not read(PLAIN).opaque
    for from_front in (True, False):
        np.testing.assert_allclose(table.response(550.0, AIR, GLASS, np.array([0.5]), from_front).R, 0.3)


def test_phases(read) -> None:
    plain, table = at(read(PLAIN), 550.0, 30.0), read(POLARISED)
    np.testing.assert_allclose(np.exp(1j * plain.phase_r), -1, atol=1e-12)
    np.testing.assert_allclose(plain.phase_t, 0, atol=1e-12)
    assert np.degrees(at(table, 550.0, 60.0).phase_r[0]) == pytest.approx(150)
    assert np.degrees(at(table, 550.0, 60.0).phase_t[0]) == pytest.approx(-10)
    assert np.degrees(at(table, 550.0, 60.0, from_front=False).phase_r[0]) == pytest.approx(170)
    # between 180 and 150 degrees lies 165, not a value on the far side of the circle
    assert np.degrees(at(table, 550.0, HALF).phase_r[0]) == pytest.approx(165)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "column wavelength_nm, angle_deg, R or R_s and R_p, T or T_s and T_p is missing"),
        ("wavelength_nm,angle_deg,R,T_s\n", "column the partner of T_s is missing"),
        ("wavelength_nm,angle_deg,R,R_s,R_p,T\n", "columns R and R_s are both there"),
        ("wavelength_nm,angle_deg,R,T,note\n", "column 'note' is unknown; possible are wavelength_nm, angle_deg, R,"),
        ("wavelength_nm,angle_deg,R,T,T\n", "column 'T' is there twice"),
        (PLAIN.replace(".20", "n/a"), "line 4: could not convert string to float: 'n/a'; every value must be a number"),
        (PLAIN.replace("500,60,.20,.70", "500,60,.20"), "line 4: 3 values where 4 are needed"),
        (PLAIN.replace(".20", "nan"), "line 4: nan; every value must be a finite number"),
        (PLAIN.replace("600,60,.40,.50\n", ""), "3 rows for 2 wavelengths and 2 angles; give every angle once at"),
        (PLAIN.splitlines()[1], "0 rows for 0 wavelengths"),
        (PLAIN.replace(".80", ".95"), "R + T reaches 1.05 or a value is negative"),
        (PLAIN.replace(".80", "-.1"), "or a value is negative"),
        (POLARISED.replace(".35,.12", ".45,.12"), "R + T reaches 1.05"),
        (PLAIN.replace(",60,", ",95,"), "angles must lie in 0 … 90°"),
    ],
)
def test_bad_files(read, text: str, words: str) -> None:
    with refused("coating table '", words):
        read(text)
