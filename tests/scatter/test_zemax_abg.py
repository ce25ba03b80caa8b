"""ABg catalogues of OpticStudio: entries by name, in a scene and on the command line, and what is refused, by line."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import pytest

import mistray  # noqa: F401
from mistray.cli.program import main
from mistray.errors import MistrayError
from mistray.prescription import Scatter
from mistray.scatter.abg import ABg
from mistray.scatter.measured.zemax_abg import abg_from_catalogue, read_abg_data

CATALOGUE = """! shop catalogue
NAME Polish 1
WAVE 0.6328
0.0  2e-5  1E-6  2.0

NAME LAMBERT
ABG 0 0.1 0 0
45 0.1 0 0
# two angles
name steep
wave 0
0 1e-4 1e-3 2
60 2e-4 1e-3 2
"""


@pytest.fixture
def catalogue(tmp_path: Path) -> Path:
    file = tmp_path / "ABG_DATA.DAT"
    file.write_text(CATALOGUE, encoding="utf-8")
    return file


def test_entries(catalogue: Path) -> None:
    entries = read_abg_data(catalogue)
    assert [(entry.name, entry.line, len(entry.rows)) for entry in entries.values()] == [
        ("Polish 1", 2, 1),
        ("LAMBERT", 6, 2),
        ("steep", 10, 2),
    ]
    model = abg_from_catalogue(f"{catalogue}:polish 1", side="front")
    assert (model.A, model.B, model.g, model.side) == (2e-5, 1e-6, 2.0, "front")
    assert model.reference_nm == pytest.approx(632.8, rel=1e-12)
    assert abg_from_catalogue(f"{catalogue}:Lambert") == ABg(0.1, 0.0, 0.0)


def test_in_a_scene(catalogue: Path) -> None:
    """The numbers of the entry are the plugin's, with derivatives."""
    bsdf = mi.load_dict({"type": "interface", "R": 0.9, "s": {"type": "abg", "file": f"{catalogue}:POLISH 1"}})
    (model,) = bsdf.scatter
    assert (model.A, model.B, model.g) == pytest.approx((2e-5, 1e-6, 2.0), rel=1e-6)
    assert model.reference_nm == pytest.approx(632.8, rel=1e-12)
    assert float(mi.traverse(bsdf)["abg.B"][0]) == pytest.approx(1e-6)
    assert Scatter("abg", {"file": "ABG_DATA.DAT:POLISH 1", "event": "reflection"}).model() is None
    with pytest.raises(RuntimeError, match="file and B given"):
        mi.load_dict({"type": "abg", "file": f"{catalogue}:POLISH 1", "B": 1.0})


def test_on_the_command_line(catalogue: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bsdf", f"{catalogue}:polish 1", "--angles-deg", "0", "--wavelength-nm", "632.8"]) == 0
    assert "0.08681" in capsys.readouterr().out  # π A ln(1 + 1/B), percent
    assert main(["bsdf", f"{catalogue}:polish 1", "--A", "1"]) == 2


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        (CATALOGUE, "polsh 1", "no entry 'polsh 1'; did you mean 'Polish 1'"),
        (CATALOGUE, "steep", "line 10: A, B and g of 'steep' change with the angle"),
        ("0 1 1 1\n", "x", "line 1: '0 1 1 1' before the first NAME"),
        ("NAME x\n0 1 1\n", "x", "line 2, angle A B g: 3 values where 4"),
        ("NAME x\n95 1 1 1\n", "x", "line 2: angle of incidence 95°"),
        ("NAME x\nWAVE -1\n", "x", "line 2: wavelength -1 µm"),
        ("NAME x\nWAVE 1\n", "x", "line 1: 'x' has no line"),
        ("NAME x\n0 1 1 1\nNAME X\n", "x", "line 3: NAME X"),
        ("NAME x\n0 1 0 2\n", "x", "line 1: ABg: B is 0"),
    ],
)
def test_refuses(tmp_path: Path, text: str, name: str, words: str) -> None:
    file = tmp_path / "abg.dat"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(MistrayError) as caught:
        abg_from_catalogue(f"{file}:{name}")
    assert words in str(caught.value)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_the_form(tmp_path: Path) -> None:
    with pytest.raises(MistrayError, match=r"which entry\? Write ABG_DATA\.DAT:NAME"):
        abg_from_catalogue("ABG_DATA.DAT")
    with pytest.raises(MistrayError, match="No such file"):
        abg_from_catalogue(f"{tmp_path}/none.dat:x")
