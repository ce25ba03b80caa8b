"""A command run in this process, as the entry point runs it: exit code, output, and the line of an error."""

import io
import sys

import pytest

from mistray import cli

Captured = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


class Terminal(io.StringIO):
    """What stands in for stderr on a terminal."""

    def isatty(self) -> bool:
        return True


def on_a_terminal(monkeypatch: Patch) -> Terminal:
    """Within the test, because pytest puts its own stream in place after the fixtures."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr("mistray.cli.progress.FIRST_SECOND", 0.05)
    return stream


def run(capsys: Captured, *arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `mistray ARGUMENTS…`."""
    code = cli.main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def succeeds(capsys: Captured, *arguments: object) -> str:
    code, out, err = run(capsys, *arguments)
    assert (code, err) == (0, "")
    return out


def fails(capsys: Captured, *arguments: object) -> str:
    """The one line of an error, without its start."""
    code, out, err = run(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("mistray: error: ")
    return err.strip().removeprefix("mistray: error: ")
