"""Arguments that are none, and letters that no font has: a line says what to do."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from command_line import fails

from mistray.cli.program import COMMANDS
from mistray.errors import MistrayWarning
from mistray.report import writable_directory
from mistray.report.figures.figure import Figure

# An option of every kind
KINDS = {
    (str(option.type), option.nargs): (module.COMMAND.name, word)
    for module in COMMANDS
    for option in module.COMMAND.options
    for word in option.name.split()
    if word.startswith("--") and option.type is not bool
}


@pytest.mark.quick
def test_two_dashes_are_no_value(capsys: pytest.CaptureFixture[str]) -> None:
    """argparse of Python 3.11 makes an empty list of them."""
    assert len(KINDS) > 30
    for command, option in KINDS.values():
        line = fails(capsys, command, f"{option}=--")
        assert option in line
        assert "'--' is no value" in line or "expected" in line


@pytest.mark.quick
def test_a_name_that_is_empty(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for words in (("ghosts", "plate", "--out", ""), ("import", "a.zmx", "-o", " "), ("view", "plate", "--layout=")):
        assert "names nothing" in fails(capsys, *words)
    with pytest.raises(ValueError, match="no name"):
        writable_directory("")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["(" * 5000 + "H" + ")" * 5000, "!" * 20_000 + "H", "(" * 101 + "H" + ")" * 101])
def test_a_filter_that_is_too_deep(capsys: pytest.CaptureFixture[str], text: str) -> None:
    line = fails(capsys, "ghosts", "plate", "--filter", text)
    assert "filter '" in line
    assert "100 are the most" in line
    assert len(line) < 400


def test_a_message_about_content_without_sense_is_short(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("zeros.csv").write_bytes(b"\0" * 5000)
    Path("digits.toml").write_text(f"[trace]\nrays = {'9' * 5000}\n")
    assert "column" in (line := fails(capsys, "coating", "zeros.csv"))
    assert len(line) < 600
    line = fails(capsys, "optimize", "plate", "digits.toml")
    assert "'digits.toml'" in line
    assert "correct the TOML" in line


def test_letters_that_a_font_does_not_have() -> None:
    figure = Figure()
    figure.headed("L\N{COLLISION SYMBOL}_front", "\N{COLLISION SYMBOL}")
    with pytest.warns(MistrayWarning, match="COLLISION SYMBOL") as caught:
        figure.savefig(io.BytesIO(), format="png", bbox_inches="tight")
    assert len(caught) == 1
