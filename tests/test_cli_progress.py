"""Progress on stderr: a line or a bar on a terminal after a second, nothing where there is none or with --quiet."""

from __future__ import annotations

import argparse
import io
import math
import re
import sys
import time

import pytest
from command_line import Patch

from mistray.analyses.pst.state import PstProgress
from mistray.cli import progress as shown
from mistray.cli.options import Options
from mistray.cli.progress import progress_bar, working


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def on_a_terminal(monkeypatch: Patch) -> Terminal:
    """Within the test, because pytest puts its own stream in place after the fixtures."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(shown, "FIRST_SECOND", 0.05)
    return stream


def test_what_takes_long_says_so_and_leaves_nothing_behind(monkeypatch: Patch) -> None:
    for stream, quiet in ((on_a_terminal(monkeypatch), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        with working("loading plate", quiet=quiet):
            time.sleep(0.2)
        with progress_bar(argparse.Namespace(quiet=quiet)) as progress:
            assert progress is None
        assert stream.getvalue() == ""
    terminal = on_a_terminal(monkeypatch)

    def fails() -> None:
        with working("loading phone_camera"):
            time.sleep(0.3)
            raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        fails()
    written = terminal.getvalue()
    assert "loading phone_camera … 00:00" in written
    assert written.rstrip(" ").endswith("\r")
    time.sleep(0.2)
    assert terminal.getvalue() == written


def test_the_bar_counts(monkeypatch: Patch) -> None:
    terminal = on_a_terminal(monkeypatch)
    with progress_bar(argparse.Namespace(quiet=False)) as progress:
        assert progress is not None
        progress(0.5, 2.0)
        progress(0.1, 2.0)  # a bar does not go back
        progress(0.6, 2.0)
        progress(2.0, 2.0)
    assert re.findall(r"(\d+)%", terminal.getvalue()) == ["0", "25", "25", "30", "100"]


def test_bars_say_at_once_what_is_done(monkeypatch: Patch) -> None:
    """Right after the start and after each other: the next step may take hours."""
    from mistray.analyses.pst import command as pst
    from mistray.analyses.study import command as study

    terminal, options = on_a_terminal(monkeypatch), Options(quiet=False)
    with study.bar(options) as progress:
        assert progress is not None
        progress(1, "checking", 0.0)
        progress(2, "finding objects", 0.1)
    assert "step 1 of 8, checking:   0%" in terminal.getvalue()
    assert "step 2 of 8, finding objects:  10%" in terminal.getvalue()
    for state, text in (
        (PstProgress(0, 4000, math.inf, 0.02, 60.0, math.nan), "the pilot is done"),
        (PstProgress(1000, 4000, math.inf, None, 60.0, 7265.0), "no light yet at some angles, 2:01:05 left"),
        (PstProgress(1000, 4000, 0.031, 0.02, 60.0, 83.0), "error 3.1 % of 2 %, 01:23 left"),
    ):
        with pst._progress(options, []) as draw:
            draw(state)
        assert text in terminal.getvalue()
    assert "tracing:  25%" in terminal.getvalue()
