"""What options of commands make of a result, in text, JSON and files; PSTs and searches that are saved and go on."""

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import json_units
import numpy as np
import pandas as pd
import pytest
import vectors
from command_line import Captured, Patch, fails, run, succeeds
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml, write
from test_every_command import BUDGET, INPUTS, STUDY

from mistray.analyses.optimize.study.searches import TIME_USED
from mistray.errors import UnfinishedError
from mistray.files.saved_state import load_state

SHARES = ("--parameter", "p0_*.bsdf.[RT]")
ASKED = ("--field-deg", "0", "10", "--wavelength-nm", "500", "600", "--rays", "64")
STATES = vectors.text("sweep_states.toml")


@pytest.fixture
def plate(tmp_path: Path, monkeypatch: Patch) -> str:
    monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path / "cache"))
    return str(write(tmp_path, plates_text(1, R=0.1, T=0.8)))


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


class TestObjects:
    def test_options_reach_the_search(self, capsys: Captured, tmp_path: Path) -> None:
        given = {
            "rays": 2000, "azimuth_deg": 30, "view_half_angle_deg": 45, "threshold": 1e-3, "ray_control": "halt_all",
            "seed": 7, "max_events": 9, "wavelength_nm": 600,
        }  # fmt: skip
        words = [word for name, value in given.items() for word in (f"--{name.replace('_', '-')}", value)]
        more = ("--field-deg", "10", "20:40:10", "--no-total-reflection", "--stop", "wall", "--detector", "detector")
        tube = write(tmp_path, INPUTS["tube.xml"])
        record = json_units.read(succeeds(capsys, "objects", tube, *words, *more, "--json"))
        assert record["angles_deg"] == [10, 20, 30, 40]
        assert {name: record["facts"][name] for name in given} == given
        assert record["facts"]["total_reflection"] is False
        assert record["stop"] == "wall"

    def test_a_disc_as_source(self, capsys: Captured, tmp_path: Path) -> None:
        tube = write(tmp_path, INPUTS["tube.xml"])
        disc = ("--rays", "2e3", "--disc", "-1", "0.5", "--half-angle-deg", "5", "--json")
        record = json_units.read(succeeds(capsys, "objects", tube, *disc))
        assert record["facts"]["source"].startswith("disc")
        assert record["optics"][0]["illuminated_power"] > 0.5  # it is narrower than the detector
        told = succeeds(capsys, "objects", tube, "--rays", "2e3")
        assert "warning: the detector sees the outside with no surface in between" in told


def test_findings_of_a_study_and_the_same_pst_again(capsys: Captured, tmp_path: Path) -> None:
    few = ("--rays", "2000", "--pst-field-deg", "0:60:20", "--field-deg", "0", "20")
    out, command = tmp_path / "new" / "out", ("study", "plate_and_wall", *few)
    record = json_units.read(succeeds(capsys, *command, "--out", out, "--json"))
    curve = record["steps"][7]["tables"]["pst"]
    assert [row["angle_deg"] for row in curve] == [0, 20, 40, 60]
    assert curve[0]["pst_total"] > curve[-1]["pst_total"] > 0
    focal = next(fact for fact in record["steps"][0]["facts"] if fact["name"] == "focal length")
    assert focal["value"] is None  # a flat plate: infinite
    verdict = record["verdict"]["pst"]
    assert verdict["main_cause"]["cause"] == "screen"
    assert 50 < verdict["main_cause"]["percent_of_stray"] < 100
    assert verdict["main_cause"]["pst_left"] < verdict["main_cause"]["pst_stray"]
    assert any("screen" in text for text in verdict["sentences"])
    assert record["verdict"]["ghosts"]["remedy"]["deed"] == "reflects"
    html = (out / "report.html").read_text(encoding="utf-8")
    assert html.count("<section ") == len(record["steps"]) + 3
    # The answer comes first: of all angles, of the ghosts, and the table of the worst
    order = ["Change <b>screen</b> first", "Ghosts, without scatter", 'id="worst"', 'id="findings"']
    assert sorted(map(html.index, order)) == [html.index(text) for text in order]
    before = (out / "8_pst.csv").read_text()
    printed = succeeds(capsys, *command, "--out", out, "--resume")
    assert (out / "8_pst.csv").read_text() == before
    assert printed.index("Change screen first") < printed.index(f"\n1 {record['steps'][0]['title']}\n")
    assert re.search(r"Main cause by angle: .*screen", printed)


class TestSweep:
    def test_configurations_of_a_file_and_of_the_line(self, capsys: Captured, plate: str, tmp_path: Path) -> None:
        """Those of the line stand behind those of the file; a second time all rows come from the cache."""
        states, out = tmp_path / "states.toml", tmp_path / "new" / "out"
        states.write_text(STATES)
        command = ("sweep", plate, states, "--set", "p0_*.bsdf.R=0.3", "p0_*.bsdf.T=0.6", *ASKED)
        printed = succeeds(capsys, *command, "--out", out)
        lines = [line.split() for line in printed.splitlines()]
        assert sum(line[:1] == ["weak"] for line in lines) == sum(line[:1] == ["strong"] for line in lines) == 4
        assert "12 rows, 0 of them from the cache in" in printed
        table = pd.read_csv(out / "sweep.csv")
        assert list(table.columns[:3]) == ["configuration", "field_deg", "wavelength_nm"]
        assert list(table.ghost_to_signal.round(6)) == [0.01] * 4 + [0.09] * 8
        values = pd.read_csv(out / "configurations.csv")
        assert list(values[values.key == "p0_rear.bsdf.R"].value.round(6)) == [0.3, 0.3]
        assert "p0_rear.bsdf.T = 0.6" in (out / "report.html").read_text(encoding="utf-8")
        record = json_units.read(succeeds(capsys, *command, "--json"))
        assert record["rows_from_cache"] == 12
        assert record["rows"] == json.loads((out / "sweep.json").read_text())["rows"]
        row = record["rows"][7]
        assert (row["configuration"], row["field_deg"], row["wavelength_nm"]) == ("strong", 10, 600)
        assert row["ghost_to_signal_se"] < 1e-6  # all rays carry the same
        assert record["rows"][8]["configuration"] == "p0_*.bsdf.R = 0.3, p0_*.bsdf.T = 0.6"
        assert {item["unit"] for item in record["configurations"][1]["values"]} == {"1"}

    def test_its_pst(self, capsys: Captured, plate: str) -> None:
        """Half the reflectance of a face halves the ghost, a PST of 0.005, and a black face takes it."""
        asked = ("--pst-field-deg", "0", "--rays", "2000", "--json")
        for change, lost in ((("--set", "p0_front.bsdf.R=0.05"), 0.0025), (("--paint", "p0_front=black"), 0.005)):
            (row,) = json_units.read(succeeds(capsys, "sweep", plate, *change, *asked))["rows"]
            assert row["configuration"] == change[1].replace("=", " = ")
            assert row["before"] - row["after"] == pytest.approx(lost, rel=0.15)

    def test_a_dark_field_is_drawn(self, capsys: Captured, plate: str, tmp_path: Path) -> None:
        """Light that misses the detector: no direct image, no stray light, nothing to divide by."""
        out = tmp_path / "out"
        succeeds(capsys, "sweep", plate, "--field-deg", "0", "88.8", "--rays", "64", "--out", out)
        dark = json.loads((out / "sweep.json").read_text())["rows"][1]
        assert (dark["direct_W"], dark["ghost_to_signal"], dark["worst_path"]) == (0.0, None, None)

    def test_a_cache_that_cannot_be(self, capsys: Captured, plate: str, monkeypatch: Patch) -> None:
        assert "1 rows, all traced" in succeeds(capsys, "sweep", plate, "--rays", "64", "--no-cache")
        assert not (Path(plate).parent / "cache").exists()
        monkeypatch.setenv("MISTRAY_CACHE", f"{plate}/below")
        code, printed, errors = run(capsys, "sweep", plate, "--rays", "64", "--json")
        assert (code, errors.count("\n"), len(json_units.read(printed)["rows"])) == (0, 1, 1)
        assert errors.startswith("mistray: warning: cache '")
        assert "Not a directory; results are not kept" in errors
        monkeypatch.setenv("MISTRAY_CACHE_MB", "much")
        assert fails(capsys, "cache", "info").startswith("MISTRAY_CACHE_MB is 'much'; give the size of the cache in MB")

    def test_workers_that_are_gone(self, capsys: Captured, plate: str, tmp_path: Path, monkeypatch: Patch) -> None:
        running, out = importlib.import_module("mistray.analyses.sweep.run"), tmp_path / "out"
        real, calls = running.trace, []

        def gone(*arguments: Any, **more: Any) -> Any:
            calls.append(more)
            if len(calls) > 2:
                raise UnfinishedError("scheduler tcp://host:1 is gone; start it again")
            return real(*arguments, **more)

        with monkeypatch.context() as patch:
            patch.setattr(running, "trace", gone)
            line = fails(capsys, "sweep", plate, *ASKED, "--out", out)
        assert "configuration 'as it is', field 0 deg, 600 nm: scheduler tcp://host:1 is gone; start it again" in line
        assert f"the rows that are finished are in {out}" in line
        assert list(pd.read_csv(out / "sweep.csv").field_deg) == [0, 10]
        assert "4 rows, 2 of them from the cache" in succeeds(capsys, "sweep", plate, *ASKED)

    def test_interrupted(self, capsys: Captured, plate: str, monkeypatch: Patch) -> None:
        traced = Mock(side_effect=[({"number": 1}, True), ({"number": 1}, True), KeyboardInterrupt()])
        monkeypatch.setattr(importlib.import_module("mistray.analyses.sweep.run"), "_traced", traced)
        code, printed, errors = run(capsys, "sweep", plate, *ASKED)
        assert (code, printed, errors.count("\n")) == (130, "", 1)
        assert "finished rows are in the cache, the same command goes on" in errors


class TestSensitivity:
    def test_systems_and_groups(self, capsys: Captured, plate: str, tmp_path: Path) -> None:
        out = tmp_path / "new" / "out"
        more = ("--rays", "64", "--monte-carlo", "4", "--together", "p0_*.R", "--formats", "parquet")
        printed = succeeds(capsys, "sensitivity", plate, *SHARES, *more, "--out", out)
        for words in (
            "in a group", "2 changes that lower it", "together 'p0_*.R' (2 parameters): ", "4 perturbed systems",
            "not in the derivatives: branches below flux_threshold",
        ):  # fmt: skip
            assert words in printed
        tables = {"sensitivity.parquet", "propagation.parquet", "draws.parquet"}
        assert tables | {"draws.csv", "monte_carlo.png"} <= names_in(out)
        draws = pd.read_parquet(out / "draws.parquet")
        assert draws.ratio.tolist() == pytest.approx(pd.read_csv(out / "draws.csv").ratio.tolist(), rel=1e-8)
        assert list(pd.read_csv(out / "sensitivity.csv").change_percent.round(3)) == [20, 20, 5, 5]
        assert (out / "report.html").read_text(encoding="utf-8").count("data:image/png") == 2

    def test_a_time_and_a_saved_run(self, capsys: Captured, plate: str, tmp_path: Path) -> None:
        """What had no time is told; the run goes on in its folder."""
        command = ("sensitivity", plate, *SHARES, "--rays", "2e6", "--out", tmp_path / "out", "--json")
        code, printed, _ = run(capsys, *command, "--monte-carlo", "100000", "--seconds", "5")
        short = json.loads(printed)
        assert code == 0
        assert any("perturbed systems" in text for text in short["not_traced"])
        code, printed, _ = run(capsys, *command, "--monte-carlo", "3", "--seconds", "0.1", "--resume")
        assert code == 0
        assert json.loads(printed)["metric"] == short["metric"]

    def test_a_kind(self, capsys: Captured, plate: str) -> None:
        more = ("--rays", "64", "--kind", "index", "--no-check", "--metric", "transmission")
        printed = succeeds(capsys, "sensitivity", plate, *more)
        assert "index of 1.5" in printed
        assert "no derivative is known well enough to propose a change" in printed


def test_the_scene_of_a_budget_is_that_of_its_table(capsys: Captured, tmp_path: Path) -> None:
    rough, study, out = write(tmp_path, INPUTS["rough.xml"]), tmp_path / "budget.toml", tmp_path / "out"
    study.write_text(BUDGET)
    assert "met by" in succeeds(capsys, "budget", rough, study, "--out", out, "--formats", "parquet")
    assert {"budget.parquet", "requirements.parquet"} <= names_in(out)
    record, table = json.loads((out / "budget.json").read_text()), pd.read_csv(out / "budget.csv")
    assert list(table.surfaces) == ["front", "rear"]
    assert f'name="rms_nm" value="{record["numbers"][0]["after"]!r}"' in (out / "scene.xml").read_text()
    again = json_units.read(succeeds(capsys, "budget", out / "scene.xml", study, "--json"))["numbers"]
    assert [row["before"] for row in again] == pytest.approx(list(table.after), rel=1e-6)
    study.write_text(BUDGET.replace("1e-4", "1e-12"))
    assert "times the limit 1e-12" in fails(capsys, "budget", rough, study)


class TestThermal:
    @pytest.mark.long
    def test_a_time_budget_is_kept_and_the_result_says_so(self, capsys: Captured, tmp_path: Path) -> None:
        began, warm = time.monotonic(), write(tmp_path, INPUTS["warm.xml"])
        code, text, _ = run(capsys, "thermal", warm, "--rays", "1e9", "--seconds", "3", "--json")
        assert code == 0
        assert time.monotonic() - began < 15  # others may use the machine, too
        found = json.loads(text)
        assert any("rays were traced" in note for note in found["notes"])
        assert found["total_W_mm2"] > found["total_W_mm2_se"] > 0

    def test_noise(self, capsys: Captured, tmp_path: Path) -> None:
        out, warm = tmp_path / "out", write(tmp_path, INPUTS["warm.xml"])
        pixel = ("--pixel-um", "15", "--bandwidth-hz", "500", "--quantum-efficiency", "0.6")
        command = ("thermal", warm, *pixel, "--rays", "2e4")
        text = succeeds(capsys, *command, "--out", out)
        assert any(line.startswith("NETD by the noise of photons") for line in text.splitlines())
        assert "NETD by D*" not in text
        assert (out / "netd.csv").exists()
        assert "quantum efficiency 0.6" in (out / "report.html").read_text(encoding="utf-8")
        record = json_units.read(succeeds(capsys, *command, "--detectivity", "1e11", "--json"))["netd"]
        assert (record["pixel_um"], record["detectivity"]) == (15, 1e11)
        assert 0 < record["by_photons_K_se"] < 0.05 * record["by_photons_K"]
        assert record["by_detectivity_K"] == pytest.approx(500**0.5 / 0.015 / 1e12 / record["per_kelvin_W_mm2"])


ANGLES = "0:80:20"


def test_a_detector_in_a_closed_box_has_the_pst_0_and_a_line_says_why(capfd: Captured, tmp_path: Path) -> None:
    box = f'<shape type="sphere" id="box"><float name="radius" value="3"/>{interface_xml(R=0.3)}</shape>'
    detector = shape_xml("asphere", "detector", sensor=True, half_width=1.0, half_height=1.0)
    scene = str(write(tmp_path, scene_text(box, detector)))
    out = tmp_path / "out"
    text = succeeds(capfd, "pst", scene, "--field-deg", ANGLES, "--rays", "1e4", "--out", out)
    assert text.count("warning: ") == 1
    assert "warning: no light was seen at" in text
    assert "sets no upper limit" in text
    assert "No light was seen at any angle." in (out / "report.html").read_text(encoding="utf-8")


class TestSavedRun:
    """Only a scene that scatters and a second of tracing are needed; `plate_and_wall` is one."""

    scene = "plate_and_wall"

    def command(self, state: Path, *more: str) -> list[str]:
        return ["pst", self.scene, "--field-deg", ANGLES, "--state", str(state), *more]

    def start(self, state: Path, log: Path) -> subprocess.Popen:
        """The command without an end, in a process of its own, when its first state is on disk."""
        command = [sys.executable, "-m", "mistray", *self.command(state, "--rays", "2e9")]
        with log.open("wb") as stream:
            process = subprocess.Popen(command, stdout=stream, stderr=stream)
        deadline = time.monotonic() + 300
        while not state.exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
        assert state.exists(), log.read_text()
        return process

    def numbers(self, capfd: Captured, *arguments: str) -> tuple[list[dict[str, Any]], float]:
        answer = json_units.read(succeeds(capfd, *arguments, "--json"))
        return answer["curve"], answer["facts"]["rays"]

    def goes_on_like_one_run(self, capfd: Captured, state: Path) -> None:
        """One pass more, and the same passes at once: equal to 1e-9 in every number, and in the paths."""
        done = load_state(state)[1]["rays"]
        rays = str(int(1.01 * done) + 1)
        resumed, rays_of_both = self.numbers(capfd, *self.command(state, "--rays", rays, "--resume"))
        assert rays_of_both > done
        once, rays_at_once = self.numbers(capfd, *self.command(state.with_name("once.npz"), "--rays", rays))
        assert rays_at_once == rays_of_both
        for row, other in zip(resumed, once, strict=True):
            assert row.keys() == other.keys()
            for key in row.keys() - {"paths", "causes"}:
                assert row[key] == pytest.approx(other[key], rel=1e-9), key
            for cause, same in zip(row["causes"], other["causes"], strict=True):
                assert cause["cause"] == same["cause"]
                assert cause["percent_of_stray"] == pytest.approx(same["percent_of_stray"], rel=1e-9)
            assert [path["events"] for path in row["paths"]] == [path["events"] for path in other["paths"]]
            for path, same in zip(row["paths"], other["paths"], strict=True):
                assert path["pst"] == pytest.approx(same["pst"], rel=1e-9)
                assert path["rays"] == same["rays"]

    def test_interrupted_it_says_how_to_go_on(self, capfd: Captured, tmp_path: Path) -> None:
        state, log = tmp_path / "run" / "state.npz", tmp_path / "log"
        process = self.start(state, log)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == 130
        *warnings, line = log.read_text().splitlines()
        # Improbable scatter, as the scene has it; how long the run takes; that a pass ends first, where it takes long
        known = "ABg 'polish'", "the PST takes about", "under way ends first"
        assert all(any(words in text for words in known) for text in warnings)
        assert line.startswith("mistray: interrupted; ")
        assert line.endswith(f"are in {state}, go on with --resume")
        assert " start rays" in line
        self.goes_on_like_one_run(capfd, state)

    def test_killed_it_leaves_the_last_state(self, capfd: Captured, tmp_path: Path) -> None:
        state, log = tmp_path / "state.npz", tmp_path / "log"
        process = self.start(state, log)
        time.sleep(np.random.default_rng(1).uniform(0.1, 1.0))
        process.kill()
        assert process.wait(timeout=60) == -signal.SIGKILL
        self.goes_on_like_one_run(capfd, state)

    def test_another_run_or_a_damaged_state_is_one_line(self, capfd: Captured, tmp_path: Path) -> None:
        """Other differences are in analyses/pst/test_pst_tables.py."""
        state = tmp_path / "state.npz"
        assert run(capfd, *self.command(state, "--rays", "1e4", "--quiet"))[0] == 0
        message = fails(capfd, *self.command(state, "--rays", "1e4", "--resume"), "--seed", "3")
        assert message.startswith(f"state '{state}' belongs to another run: ")
        assert "seed was 0 and is 3" in message
        self.scene = "plate"
        message = fails(capfd, *self.command(state, "--rays", "1e4", "--resume"))
        assert "the scene is another one or has changed" in message
        state.write_bytes(state.read_bytes()[:-100])
        assert "is damaged" in fails(capfd, *self.command(state, "--rays", "1e4", "--resume"))


SECONDS, DRAWING_SECONDS = 4.0, 10.0  # the pictures come on top of the time that is given

LONGER = vectors.text("thickness_term.toml") + STUDY.replace("steps = 1", "steps = 3")


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str, str]:
    study = tmp_path / "study.toml"
    study.write_text(LONGER)
    return str(write(tmp_path, plates_text(1))), str(study), str(tmp_path / "out")


def searched(capsys: Captured, *arguments: str) -> tuple[int, str, str]:
    return run(capsys, "optimize", *arguments, "--verification-seeds", "2")


def test_a_time_budget(capsys: Captured, files: tuple[str, str, str]) -> None:
    """A search without an end of its own ends in time, says why, and leaves all files; later it goes on from there."""
    scene, study, out = files
    many = 'steps = 10000\ntolerance = 0\nmethod = "adam"\ndecay = 1.0\nstep_size = 1e-4'
    Path(study).write_text(LONGER.replace("steps = 3", many))
    began = time.perf_counter()
    more = ("--out", out, "--seconds", str(SECONDS), "--formats", "parquet")
    code, printed, errors = searched(capsys, scene, study, *more)
    spent = time.perf_counter() - began
    assert code == 0
    assert all("compilation of kernels" in line for line in errors.splitlines())  # told where nothing is in the cache
    assert f"search from start 1: {TIME_USED}" in printed
    assert spent < SECONDS + DRAWING_SECONDS
    written = {"scene.xml", "terms.csv", "history.csv", "report.html", "checkpoint.json"}
    assert written | {"terms.parquet", "variables.parquet", "history.parquet"} <= names_in(Path(out))
    steps = len((Path(out) / "history.csv").read_text().splitlines()) - 2  # its heading and the start
    assert 1 <= steps < 10000
    assert searched(capsys, scene, study, "--out", out, "--resume", "--steps", str(steps + 1), "--quiet") == (0, "", "")
    assert len((Path(out) / "history.csv").read_text().splitlines()) - 2 == steps + 1


def test_progress_on_a_terminal(capsys: Captured, files: tuple[str, str, str], monkeypatch: Patch) -> None:
    scene, study, _ = files
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    _, _, errors = searched(capsys, scene, study, "--steps", "1")
    first, second = (line for line in re.split(r"[\r\n]+", errors) if line.startswith("start 1 (given), step "))
    assert first.startswith("start 1 (given), step 0: merit 1.3677 ± "), "1.3677 = (1 + 1/5.9)²"
    assert "; total_thickness 60 (!), ghosts 0.0005104; |gradient| " in first, "beyond its limit"
    assert " step 1: " in second
    assert "search from start 1, merit " in errors


class TestInterruption:
    """Ctrl-C while a step is computed."""

    def interrupt(self, monkeypatch: Patch, after: int) -> None:
        from mistray.analyses.optimize.study.merit import Merit

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
            code, printed, errors = searched(capsys, scene, study, "--out", out)
        assert (code, printed) == (130, "")
        place = Path(out) / "checkpoint.json"
        assert errors == f"mistray: interrupted; all steps are in {place}, go on with --resume\n"
        code, printed, _ = searched(capsys, scene, study, "--out", out, "--resume")
        assert code == 0
        assert "before / after" in printed

    @pytest.mark.parametrize(("steps", "kept"), [(1, False), (0, True)])
    def test_nothing_to_go_on_from(
        self, capsys: Captured, files: tuple[str, str, str], monkeypatch: Patch, steps: int, kept: bool
    ) -> None:
        scene, study, out = files
        self.interrupt(monkeypatch, steps)
        code, _, errors = searched(capsys, scene, study, *(["--out", out] if kept else []))
        assert (code, errors) == (130, "mistray: interrupted, nothing was written\n")


QUICK = ("app", "singlet_window_detector", "--rays", "500", "--no-browser", "--field-deg", "0")


def test_the_address_is_printed(capsys: Captured, tmp_path: Path) -> None:
    code, out, err = run(capsys, *QUICK, "--seconds", "1", "--json")
    assert code == 0
    # With kernels in no cache one line says what their compilation took
    assert all("compilation" in line for line in err.splitlines())
    found = json_units.read(out)
    assert found["address"].startswith(f"http://127.0.0.1:{found['port']}/")
    (tmp_path / "explored_scene.xml").write_text("mine")
    assert "explored_scene.xml" in fails(capsys, *QUICK, "--seconds", "1", "--out", tmp_path)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(number: signal.Signals) -> None:
    command = [sys.executable, "-m", "mistray", *QUICK, "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    try:
        text = ""
        while not text.rstrip().endswith("}"):
            text += process.stdout.readline()
        address = json.loads(text)["address"]
        with urllib.request.urlopen(address, timeout=20) as reply:
            assert reply.status == 200
        time.sleep(1.0)
        process.send_signal(number)
        _, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 0
    assert err == ""
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address, timeout=5)
