"""`mistray optimize`: report, files, progress, interruption, bad input."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from typing import Any

import json_units
import pytest
from oracles.small_scenes import plates_text, write

import mistray.optimize
from mistray import cli
from mistray.optimize.study.searches import TIME_USED

SECONDS, DRAWING_SECONDS = 4.0, 10.0  # the pictures come on top of the time that is given

STUDY = """
[[term]]
name = "ghosts"
kind = "path_power"
goal = "minimise"
wavelength_nm = 550
rays = 32

[[term]]
kind = "total_thickness"
goal = "at_most"
limit = 59
tolerance = 0.1

[[coating]]
name = "AR"
surfaces = "all"
layers = "1.38 60"
thickness_nm = [20, 180]

[optimizer]
starts = 1
steps = 3
"""


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str, str]:
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    return str(write(tmp_path, plates_text(1))), str(study), str(tmp_path / "out")


def run(capsys: Any, *arguments: str) -> tuple[int, str, str]:
    code = cli.main(["optimize", *arguments, "--verification-seeds", "2"])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_report_and_files(capsys: Any, files: tuple[str, str, str]) -> None:
    scene, study, out = files
    code, printed, errors = run(capsys, scene, study, "--out", out, "--formats", "parquet")
    assert (code, errors) == (0, "")
    assert "before / after" in printed
    assert "search from start 1: all steps used" in printed
    assert {
        "scene.xml",
        "terms.csv",
        "terms.parquet",
        "variables.csv",
        "variables.parquet",
        "history.csv",
        "history.parquet",
        "search.png",
        "variables.png",
        "reflectance.png",
        "report.html",
        "checkpoint.json",
    } == {path.name for path in Path(out).iterdir()}
    code, printed, _ = run(capsys, scene, study, "--out", out, "--resume", "--steps", "5", "--quiet")
    assert (code, printed) == (0, "")
    assert len((Path(out) / "history.csv").read_text().splitlines()) > 5


@pytest.mark.long
def test_a_time_budget(capsys: Any, files: tuple[str, str, str]) -> None:
    """A search without an end of its own ends in time, says why, and leaves all files; later it goes on from there."""
    scene, study, out = files
    endless = STUDY.replace("steps = 3", 'steps = 10000\ntolerance = 0\nmethod = "adam"\ndecay = 1.0\nstep_size = 1e-4')
    Path(study).write_text(endless)
    began = time.perf_counter()
    code, printed, errors = run(capsys, scene, study, "--out", out, "--seconds", str(SECONDS))
    spent = time.perf_counter() - began
    assert (code, errors) == (0, "")
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


def test_help(capsys: Any) -> None:
    assert cli.main(["optimize", "--help"]) == 0
    assert "mistray optimize cooke_triplet examples/triplet_ar.toml" in capsys.readouterr().out


def test_without_a_folder_nothing_is_written(capsys: Any, files: tuple[str, str, str]) -> None:
    scene, study, _ = files
    before = sorted(Path(scene).parent.iterdir())
    assert run(capsys, scene, study, "--steps", "0")[0] == 0
    assert sorted(Path(scene).parent.iterdir()) == before


def test_progress_on_a_terminal(capsys: Any, files: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    scene, study, _ = files
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    _, _, errors = run(capsys, scene, study, "--steps", "1")
    first, second = (line for line in re.split(r"[\r\n]+", errors) if line.startswith("start 1 (given), step "))
    assert first.startswith("start 1 (given), step 0: merit 1.3677 ± "), "1.3677 = (1 + 1/5.9)²"
    assert "; ghosts 0.0005104, total_thickness 60 (!); |gradient| " in first, "beyond its limit"
    assert " step 1: " in second
    assert "search from start 1, merit " in errors


class TestInterruption:
    def interrupt(self, monkeypatch: pytest.MonkeyPatch, after: int) -> None:
        """Ctrl-C while a step is computed."""
        from mistray.optimize.study.merit import Merit

        evaluate, calls = Merit.evaluate, []

        def evaluated(self: Any, y: Any, number: int) -> Any:
            calls.append(y)
            if len(calls) > after:
                raise KeyboardInterrupt
            return evaluate(self, y, number)

        monkeypatch.setattr(Merit, "evaluate", evaluated)

    def test_the_checkpoint_stays(
        self, capsys: Any, files: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
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

    def test_without_a_folder(self, capsys: Any, files: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch) -> None:
        scene, study, _ = files
        self.interrupt(monkeypatch, 1)
        code, _, errors = run(capsys, scene, study)
        assert (code, errors) == (130, "mistray: interrupted, nothing was written\n")

    def test_before_the_first_step(
        self, capsys: Any, files: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        scene, study, out = files
        self.interrupt(monkeypatch, 0)
        code, _, errors = run(capsys, scene, study, "--out", out)
        assert (code, errors) == (130, "mistray: interrupted, nothing was written\n")


VARIABLE = '[[variable]]\nparameters = ["p0_front.{key}"]\nlow = {low}\nhigh = {high}\n[optimizer]'


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("rays = 32", "ray = 32"), "term[1].ray is unknown; did you mean 'rays'?"),
        (('"all"', '["p9_front"]'), "coating 'AR': the scene has no surface 'p9_front'; choose from p0_front, p0_rear"),
        (("[20, 180]", "[70, 180]"), "starts with 60 nm; widen the bounds or change the start"),
        (("[optimizer]", VARIABLE.format(key="curvatur", low=-1e-3, high=1e-3)), "p0_front.curvature"),
        (("[optimizer]", VARIABLE.format(key="curvature", low=1e-3, high=-1e-3)), "low must be less than high"),
        (("[optimizer]", VARIABLE.format(key="curvature", low=1e-3, high=2e-3)), "starts with 0; widen the bounds"),
        (
            ('kind = "path_power"', 'kind = "path_power"\nselection = "structure"'),
            "its value is 0 at the start (AR.thickness_nm[0]",
        ),
        (
            ('goal = "minimise"', 'goal = "at_least"\nlimit = 1e-9'),
            "the merit is 0, nothing is to be minimised and all limits hold",
        ),
    ],
)
def test_bad_studies(capsys: Any, files: tuple[str, str, str], change: tuple[str, str], message: str) -> None:
    """One line, exit status 2, and nothing is written."""
    scene, study, out = files
    Path(study).write_text(STUDY.replace("limit = 59", "limit = 70").replace(*change))
    code, printed, errors = run(capsys, scene, study, "--out", out)
    assert (code, printed, errors.count("\n")) == (2, "", 1)
    assert errors.startswith(f"mistray: error: study '{study}'")
    assert message in errors
    assert not Path(out).exists()


def test_an_empty_study(capsys: Any, files: tuple[str, str, str]) -> None:
    scene, study, out = files
    Path(study).write_text(STUDY[: STUDY.index("[[term]]\nkind")])
    code, _, errors = run(capsys, scene, study, "--out", out)
    assert code == 2
    assert "variable is missing: nothing may change; add a section [[variable]] or [[coating]]" in errors


def test_json(capsys: Any, files: tuple[str, str, str]) -> None:
    scene, study, out = files
    code, printed, _ = run(capsys, scene, study, "--out", out, "--json")
    record = json_units.read(printed)
    assert code == 0
    assert record["holds"] == {"ghosts": True, "total_thickness": True}
    assert [row["name"] for row in record["variables"]] == ["AR.thickness_nm[0]"]
    assert f"{Path(out) / 'report.html'}" in record["files"]


def test_bad_arguments(capsys: Any, files: tuple[str, str, str]) -> None:
    scene, study, out = files
    assert "--resume needs the folder of the checkpoint; give --out" in run(capsys, scene, study, "--resume")[2]
    assert "run without resuming" in run(capsys, scene, study, "--out", out, "--resume")[2]
    assert "no such file" in run(capsys, "no_scene.xml", study)[2]
    assert "No such file" in run(capsys, scene, "no_study.toml")[2]
    assert "is a file; name a directory" in run(capsys, scene, study, "--out", study)[2]
    assert mistray.optimize.read_study(study).optimizer.steps == 3
