"""Arguments that are none, streams, folders and homes that are not there: a line says what to do, or all is well."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mistray.cli.program import COMMANDS, main
from mistray.errors import MistrayWarning
from mistray.report import writable_directory
from mistray.report.figures.figure import Figure

MISTRAY = [sys.executable, "-m", "mistray"]
# An option of every kind
KINDS = {
    (str(option.type), option.nargs): (module.COMMAND.name, word)
    for module in COMMANDS
    for option in module.COMMAND.options
    for word in option.name.split()
    if word.startswith("--") and option.type is not bool
}


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    return err


@pytest.mark.quick
def test_two_dashes_are_no_value(capsys: pytest.CaptureFixture[str]) -> None:
    """argparse of Python 3.11 makes an empty list of them."""
    assert len(KINDS) > 30
    for command, option in KINDS.values():
        line = refused(capsys, command, f"{option}=--")
        assert option in line
        assert "'--' is no value" in line or "expected" in line


@pytest.mark.quick
def test_a_name_that_is_empty(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for words in (("ghosts", "plate", "--out", ""), ("import", "a.zmx", "-o", " "), ("view", "plate", "--layout=")):
        assert "names nothing" in refused(capsys, *words)
    with pytest.raises(ValueError, match="no name"):
        writable_directory("")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["(" * 5000 + "H" + ")" * 5000, "!" * 20_000 + "H", "(" * 101 + "H" + ")" * 101])
def test_a_filter_that_is_too_deep(capsys: pytest.CaptureFixture[str], text: str) -> None:
    line = refused(capsys, "ghosts", "plate", "--filter", text)
    assert "filter '" in line
    assert "100 are the most" in line
    assert len(line) < 400


def test_a_message_about_content_without_sense_is_short(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("zeros.csv").write_bytes(b"\0" * 5000)
    Path("digits.toml").write_text(f"[trace]\nrays = {'9' * 5000}\n")
    assert "column" in (line := refused(capsys, "coating", "zeros.csv"))
    assert len(line) < 600
    line = refused(capsys, "optimize", "plate", "digits.toml")
    assert "'digits.toml'" in line
    assert "correct the TOML" in line


def test_letters_that_a_font_does_not_have() -> None:
    figure = Figure()
    figure.headed("L\N{COLLISION SYMBOL}_front", "\N{COLLISION SYMBOL}")
    with pytest.warns(MistrayWarning, match="COLLISION SYMBOL") as caught:
        figure.savefig(io.BytesIO(), format="png", bbox_inches="tight")
    assert len(caught) == 1


@pytest.mark.long
def test_closed_streams(tmp_path: Path) -> None:
    """What is for stderr comes neither on stdout nor into a file that is written."""
    for closed, out in (("2>&-", '"fields"'), ("<&- 2>&-", '"fields"'), (">&-", "")):
        words = " ".join([*MISTRAY, f"ghosts plate --rays 100 --json --force --out {tmp_path / 'out'} {closed}"])
        done = subprocess.run(words, shell=True, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert out in done.stdout if out else done.stdout == ""
        assert "mistray: " not in done.stdout
    done = subprocess.run(f"{' '.join(MISTRAY)} ghosts nothing 2>&-", shell=True, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "")


@pytest.mark.long
def test_a_deleted_working_folder(tmp_path: Path) -> None:
    place = tmp_path / "place"
    for words in ("ghosts plate --rays 100", "pst plate", "import lens.zmx", "bsdf abg --A 0.01 --B 0.01 --g 2"):
        place.mkdir()
        script = f"cd {place} && rmdir {place} && {' '.join(MISTRAY)} {words}"
        done = subprocess.run(script, shell=True, capture_output=True, text=True)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
        assert "working folder was deleted" in done.stderr


@pytest.mark.long
def test_no_home() -> None:
    surroundings = {name: value for name, value in os.environ.items() if name != "HOME"}
    done = subprocess.run([*MISTRAY, "ghosts", "plate", "--rays", "100"], env=surroundings, capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")
