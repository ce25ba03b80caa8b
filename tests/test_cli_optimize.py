"""`mistray optimize`: a search that goes on, its time, its bar, its interruption."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from typing import Any

import command_line
import pytest
import test_every_command
from command_line import Captured, Patch
from oracles.small_scenes import plates_text, write

from mistray.analyses.design.study.searches import TIME_USED

SECONDS, DRAWING_SECONDS = 4.0, 10.0  # the pictures come on top of the time that is given

THICKNESS = """
[[term]]
kind = "total_thickness"
goal = "at_most"
limit = 59
tolerance = 0.1
"""
STUDY = THICKNESS + test_every_command.STUDY.replace("steps = 1", "steps = 3")


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str, str]:
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    return str(write(tmp_path, plates_text(1))), str(study), str(tmp_path / "out")


def run(capsys: Captured, *arguments: str) -> tuple[int, str, str]:
    return command_line.run(capsys, "optimize", *arguments, "--verification-seeds", "2")


def test_a_search_goes_on(capsys: Captured, files: tuple[str, str, str]) -> None:
    scene, study, out = files
    code, printed, errors = run(capsys, scene, study, "--out", out, "--formats", "parquet")
    assert (code, errors) == (0, "")
    assert "before / after" in printed
    assert {"terms.parquet", "variables.parquet", "history.parquet"} <= {path.name for path in Path(out).iterdir()}
    code, printed, _ = run(capsys, scene, study, "--out", out, "--resume", "--steps", "5", "--quiet")
    assert (code, printed) == (0, "")
    assert len((Path(out) / "history.csv").read_text().splitlines()) > 5


@pytest.mark.long
def test_a_time_budget(capsys: Captured, files: tuple[str, str, str]) -> None:
    """A search without an end of its own ends in time, says why, and leaves all files; later it goes on from there."""
    scene, study, out = files
    endless = STUDY.replace("steps = 3", 'steps = 10000\ntolerance = 0\nmethod = "adam"\ndecay = 1.0\nstep_size = 1e-4')
    Path(study).write_text(endless)
    began = time.perf_counter()
    code, printed, errors = run(capsys, scene, study, "--out", out, "--seconds", str(SECONDS))
    spent = time.perf_counter() - began
    assert code == 0
    assert all("compilation of kernels" in line for line in errors.splitlines())  # told where nothing is in the cache
    assert f"search from start 1: {TIME_USED}" in printed
    assert spent < SECONDS + DRAWING_SECONDS
    assert {"scene.xml", "terms.csv", "history.csv", "report.html", "checkpoint.json"} <= {
        path.name for path in Path(out).iterdir()
    }
    steps = len((Path(out) / "history.csv").read_text().splitlines()) - 2  # its heading and the start
    assert 1 <= steps < 10000
    code, _, errors = run(capsys, scene, study, "--out", out, "--resume", "--steps", str(steps + 1))
    assert (code, errors) == (0, "")
    assert len((Path(out) / "history.csv").read_text().splitlines()) - 2 == steps + 1


def test_progress_on_a_terminal(capsys: Captured, files: tuple[str, str, str], monkeypatch: Patch) -> None:
    scene, study, _ = files
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    _, _, errors = run(capsys, scene, study, "--steps", "1")
    first, second = (line for line in re.split(r"[\r\n]+", errors) if line.startswith("start 1 (given), step "))
    assert first.startswith("start 1 (given), step 0: merit 1.3677 ± "), "1.3677 = (1 + 1/5.9)²"
    assert "; total_thickness 60 (!), ghosts 0.0005104; |gradient| " in first, "beyond its limit"
    assert " step 1: " in second
    assert "search from start 1, merit " in errors


class TestInterruption:
    """Ctrl-C while a step is computed."""

    def interrupt(self, monkeypatch: Patch, after: int) -> None:
        from mistray.analyses.design.study.merit import Merit

        evaluate, calls = Merit.evaluate, []

        def evaluated(*given: Any) -> Any:
            calls.append(given)
            if len(calls) > after:
                raise KeyboardInterrupt
            return evaluate(*given)

        monkeypatch.setattr(Merit, "evaluate", evaluated)

    def test_the_checkpoint_stays(self, capsys: Captured, files: tuple[str, str, str], monkeypatch: Patch) -> None:
        scene, study, out = files
        with monkeypatch.context() as patch:
            self.interrupt(patch, 3)
            code, printed, errors = run(capsys, scene, study, "--out", out)
        assert (code, printed) == (130, "")
        assert (
            errors == f"mistray: interrupted; all steps are in {Path(out) / 'checkpoint.json'}, go on with --resume\n"
        )
        code, printed, _ = run(capsys, scene, study, "--out", out, "--resume")
        assert code == 0
        assert "before / after" in printed

    @pytest.mark.parametrize(("steps", "kept"), [(1, False), (0, True)])
    def test_nothing_to_go_on_from(
        self, capsys: Captured, files: tuple[str, str, str], monkeypatch: Patch, steps: int, kept: bool
    ) -> None:
        scene, study, out = files
        self.interrupt(monkeypatch, steps)
        code, _, errors = run(capsys, scene, study, *(["--out", out] if kept else []))
        assert (code, errors) == (130, "mistray: interrupted, nothing was written\n")
