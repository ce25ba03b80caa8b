"""A lens file in the place of a scene: every command imports it by itself, and says what that assumed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import fails, run, succeeds
from singlet_files import ZMX

import mistray


@pytest.fixture(autouse=True)
def zmx(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("singlet.zmx").write_text(ZMX)


def test_ghosts_of_a_lens_file(capsys):
    """Numbers on stdout, what was assumed on stderr, and nothing is left behind."""
    code, out, notes = run(capsys, "ghosts", "singlet.zmx", "--rays", 500, "--json")
    assert code == 0, notes
    assert json.loads(out)["fields"][0]["worst_paths"]
    for part in ("line 11: XYZZY 1 2 3", "--coating 'detector=R=0.1'", "mistray import"):
        assert part in notes
    assert [path.name for path in Path().iterdir()] == ["singlet.zmx"]


def test_coating_a_lens_file_writes_a_scene(capsys):
    """Without a trace; the same scene as with an import before it. The lens file is never written on."""
    code, out, notes = run(capsys, "coat", "singlet.zmx", "S?=bbar3", "-o", "coated.xml")
    assert code == 0
    assert "bbar3: S1, S2" in out
    assert "imported as it stands" in notes
    assert mistray.load("coated.xml").shapes()
    succeeds(capsys, "import", "singlet.zmx")
    succeeds(capsys, "coat", "singlet.xml", "S?=bbar3", "-o", "twice.xml")
    assert Path("twice.xml").read_text() == Path("coated.xml").read_text()
    assert "singlet.zmx" in run(capsys, "coat", "singlet.zmx", "S?=bbar3", "-o", "singlet.zmx", "--force")[2]
    assert Path("singlet.zmx").read_text() == ZMX


def test_a_lens_file_that_cannot_be_read(capsys):
    Path("telescope.yaml").write_text("opticalSystem: {}", encoding="utf-8")
    for name, message in (("none.seq", "none.seq"), ("telescope.yaml", "give --wavelength-nm")):
        assert message in fails(capsys, "ghosts", name)
