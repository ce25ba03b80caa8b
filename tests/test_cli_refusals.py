"""What the commands themselves refuse: one line that names the option and the remedy, before anything is traced."""

import shlex
import sys
from pathlib import Path

import pytest
import vectors
from command_line import Captured, Patch, fails
from test_every_command import INPUTS, STUDY

REFUSED = vectors.toml("cli_refusals.toml")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, text in (("lens.xml", INPUTS["coated.xml"]), ("study.toml", STUDY), ("media.yaml", "")):
        Path(name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("command", REFUSED)
def test_one_line_and_nothing_is_written(command: str, folder: Path, capsys: Captured) -> None:
    before = sorted(folder.rglob("*"))
    for arguments, words in REFUSED[command]:
        line = fails(capsys, *([command] if command else []), *shlex.split(arguments))
        assert words in line, arguments
    assert sorted(folder.rglob("*")) == before


@pytest.mark.usefixtures("folder")
def test_a_missing_package_is_told_before_the_trace(capsys: Captured, monkeypatch: Patch) -> None:
    monkeypatch.setattr("mistray.scene.load", None)
    for name in {"astropy", *(name for name in sys.modules if name.startswith("astropy."))}:  # other tests import it
        monkeypatch.setitem(sys.modules, name, None)
    assert "astropy" in fails(capsys, "ghosts", "x", "--out", "out", "--formats", "fits")
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    assert "pip install 'mistray[view]'" in fails(capsys, "view", "x", "--out", "v.html")
    assert not Path("out").exists()
