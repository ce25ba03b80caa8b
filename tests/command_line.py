"""A command run in this process, as the entry point runs it: exit code, output, and the line of an error."""

import pytest

from mistray import cli

Captured = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


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
