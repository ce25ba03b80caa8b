"""A lens file in the place of a scene: every command imports it by itself, and says what that assumed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_cli_import import ZMX

import mistray
from mistray import cli

DATA = Path(__file__).parent / "data" / "lenses" / "flaresim"


@pytest.fixture
def zmx(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "singlet.zmx"
    path.write_text(ZMX)
    return path


def test_ghosts_of_a_lens_file(capsys, zmx):
    """Numbers on stdout, what was assumed on stderr, and nothing is left behind."""
    code = cli.main(["ghosts", "singlet.zmx", "--rays", "500", "--json"])
    out, notes = capsys.readouterr()
    assert code == 0, notes
    assert json.loads(out)["fields"][0]["worst_paths"]
    assert "line 11: XYZZY 1 2 3" in notes
    assert "--coating 'detector=R=0.1'" in notes
    assert "mistray import" in notes
    assert [path.name for path in zmx.parent.iterdir()] == ["singlet.zmx"]


def test_coating_a_lens_file_writes_a_scene(capsys, zmx):
    """Without a trace; the same scene as with an import before it, and it stands alone."""
    assert cli.main(["coat", "singlet.zmx", "S?=bbar3", "-o", "coated.xml"]) == 0
    out, notes = capsys.readouterr()
    assert "bbar3: S1, S2" in out
    assert "imported as it stands" in notes
    assert mistray.load("coated.xml").shapes()
    cli.main(["import", "singlet.zmx"])
    capsys.readouterr()
    assert cli.main(["coat", "singlet.xml", "S?=bbar3", "-o", "twice.xml"]) == 0
    assert capsys.readouterr().err == ""
    assert Path("twice.xml").read_text() == Path("coated.xml").read_text()


def test_the_lens_file_is_never_overwritten(capsys, zmx):
    assert cli.main(["coat", "singlet.zmx", "S?=bbar3", "-o", "singlet.zmx", "--force"]) == 2
    assert "singlet.zmx" in capsys.readouterr().err
    assert zmx.read_text() == ZMX


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("broken.zmx", "not a lens", "broken.zmx"),
        ("none.seq", None, "none.seq"),
        ("telescope.yaml", "opticalSystem: {}", "give --wavelength-nm"),
        ("converter.lens", (DATA / "converter.lens").read_text(encoding="utf-8"), "it has no real focus"),
    ],
)
def test_a_lens_file_that_cannot_be_read(capsys, tmp_path, monkeypatch, name, text, message):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path(name).write_text(text, encoding="utf-8")
    assert cli.main(["ghosts", name]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.count("\n") == 1
