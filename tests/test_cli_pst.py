"""`mistray pst`: tables, files, one-line errors; interruption and going on."""

from __future__ import annotations

import importlib
import math
import re
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path
from typing import Any

import json_units
import numpy as np
import pytest
from oracles.small_scenes import interface_xml, plates_text, scene_text, shape_xml, write
from report.fake_pst import fake_pst

import mistray.analysis.pst.transmittance
import mistray.scene
from mistray import cli
from mistray.analysis.pst.state import PstProgress, load_state, save_state
from mistray.cli.commands.pst import _state_of
from mistray.trace import Settings

ANGLES = "0:80:20"


def run(capsys: Any, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of one command in this process."""
    code = cli.main(["pst", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def fails(capsys: Any, *arguments: str) -> str:
    """The one line that a command with bad input prints."""
    code, out, err = run(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("mistray: error: ")
    return err.strip().removeprefix("mistray: error: ")


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Replaces scene and PST; notes the arguments of every call."""
    calls: list[dict[str, Any]] = []

    def pst(scene: Any, field_deg: Any, *, progress: Any, **given: Any) -> Any:
        calls.append({"scene": scene, "field_deg": list(field_deg), **given})
        progress(PstProgress.after(1000, 4000, 0.031, given["relative_error"], 60.0))
        azimuths, pixels = given["azimuths_deg"], given["map_pixels"]
        return fake_pst(field_deg, azimuths, map_pixels=pixels, convention=given["convention"], paths=given["paths"])

    importlib.import_module("mistray.analysis.study.eight_steps")  # or it would keep the one below for other tests
    monkeypatch.setattr(importlib.import_module("mistray.analysis.pst.transmittance"), "pst", pst)
    monkeypatch.setattr(mistray.scene, "load", lambda source, *others: source)
    return calls


def test_it_prints_the_main_table(capsys: Any, fake: list[dict[str, Any]]) -> None:
    code, out, err = run(capsys, "lens.xml")
    assert (code, err) == (0, "")
    assert fake[0]["field_deg"] == list(range(0, 81, 2))
    assert fake[0]["azimuths_deg"] is fake[0]["state"] is None
    assert "PST = E_det/E_⊥" in out
    assert "scatter at window_front" in out
    assert "%: share of the stray light at that angle" in out
    causes = out[out.index("first scattered by") :]
    assert re.search(r"(?m)^ +40  .*window_front [\d.]+ %", causes)


def test_every_option_is_passed_on(capsys: Any, fake: list[dict[str, Any]]) -> None:
    same = {
        "cell_deg": 1.5,
        "azimuth_cell_deg": 20.0,
        "convention": "projected",
        "detector": "ccd",
        "relative_error": 0.03,
        "rays": 5000,
        "max_reflections": 4,
        "max_scatters": 3,
        "max_optical_scatters": 2,
        "max_random_scatters": 1,
        "max_generations": 5,
        "max_events": 20,
        "max_consecutive": 9,
        "max_segments": 5000,
        "scatter_rays": 2,
        "aimed_rays": 7,
        "aim": "targets",
        "flux_threshold": 1e-6,
        "cut_below": "R=1e-6, t=1e-9",
        "cut_below_W": "T=1e-3",
        "scatter_threshold": 1e-3,
        "splitting": "one",
        "below_threshold": "roulette",
        "seed": 5,
        "ray_control": "transmit_specular",
        "polarization": "stokes",
    }
    assert {setting.name for setting in fields(Settings)} <= set(same)
    arguments = [text for key, value in same.items() for text in ("--" + key.replace("_", "-"), str(value))]
    spectrum = ("--wavelength-nm", "450", "550", "--weights", "1", "3")
    directions = ("--field-deg", "0:4:2", "10", "20:40:10", "--azimuths-deg", "0:180:90")
    code, _, _ = run(
        capsys, "lens.xml", *arguments, *spectrum, *directions, "--up-to-deg", "60", "--paths-shown", "0", "--state",
        "run.npz",
    )  # fmt: skip
    assert code == 0
    assert fake[0] == same | {
        "scene": "lens.xml",
        "method": "joined",
        "field_deg": [0, 2, 4, 10, 20, 30, 40],
        "azimuths_deg": pytest.approx([0, 90, 180]),
        "wavelength_nm": [450.0, 550.0],
        "weights": [1.0, 3.0],
        "error_up_to_deg": 60.0,
        "next_order": True,
        "paths": False,
        "map_pixels": 0,
        "state": Path("run.npz"),
        "resume": False,
        "seconds": None,
    }


@pytest.mark.long
def test_it_writes_its_files(capsys: Any, fake: list[dict[str, Any]], tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["lens.xml", "--out", str(out), "--field-deg", ANGLES, "--azimuths-deg", "0:270:90"]
    code, text, _ = run(capsys, *arguments, "--map-field-deg", "20", "40", "--map-azimuth-deg", "90")
    assert code == 0
    assert fake[0]["map_pixels"] == 64
    assert fake[0]["state"] == out / "pst_state.npz"
    names = {entry.name for entry in out.iterdir()}
    assert {"pst.csv", "pst_paths.csv", "pst.png", "pst_map.png", "pst.json", "report.html"} <= names
    assert {"irradiance_20deg_90deg.png", "irradiance_40deg_90deg.png"} <= names
    assert f"{len(names)} files in {out}; open {out / 'report.html'}" in text
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "<title>PST: lens</title>" in report
    assert shlex.join(["mistray", "pst", *arguments]) in report


def test_forward_saves_no_state(capsys: Any, fake: list[dict[str, Any]], tmp_path: Path) -> None:
    assert run(capsys, "x", "--method", "forward", "--out", str(tmp_path), "--field-deg", ANGLES)[0] == 0
    assert fake[0]["method"] == "forward"
    assert fake[0]["state"] is None


def test_json_and_quiet(capsys: Any, fake: list[dict[str, Any]]) -> None:
    code, out, _ = run(capsys, "x", "--json", "--field-deg", ANGLES, "--convention", "projected")
    answer = json_units.read(out)
    assert code == 0
    assert answer["convention"] == "projected"
    assert [row["angle_deg"] for row in answer["curve"]] == [0, 20, 40, 60, 80]
    assert answer["curve"][0]["pst_total_se"] > 0
    assert len(answer["curve"][1]["paths"]) == 4
    assert answer["files"] == []
    assert run(capsys, "x", "--quiet") == (0, "", "")


def test_progress_on_a_terminal(capsys: Any, fake: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    _, _, err = run(capsys, "x", "--relative-error", "0.02", "--field-deg", ANGLES)
    assert "tracing:" in err
    assert "error 3.1 % of 2 %, 01:24 left" in err  # (3.1/2)² times the rays, of which one part took 60 s
    assert run(capsys, "x", "--quiet", "--field-deg", ANGLES)[2] == ""


@pytest.mark.parametrize(
    ("progress", "text"),
    [
        (PstProgress(1, 2, 0.031, 0.02, 1.0, 83.4), "error 3.1 % of 2 %, 01:23 left"),
        (PstProgress(1, 2, 0.031, None, 1.0, 7265.0), "error 3.1 %, 2:01:05 left"),
        (PstProgress(1, 2, math.inf, 0.02, 1.0, 5.0), "no light yet at some angles, 00:05 left"),
        (PstProgress(1, 2, 0.5, 0.02, 1.0, math.nan), "error 50 % of 2 %"),
        (PstProgress(0, 2, math.inf, 0.02, 1.0, 83.4), "the pilot is done, 01:23 left"),
    ],
)
def test_text_of_the_bar(progress: PstProgress, text: str) -> None:
    assert _state_of(progress) == text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--field-deg", "0:95:5"), "argument --field-deg: 95 must lie between -90 and 90 degrees"),
        (("--field-deg", "-95"), "argument --field-deg: -95 must lie between -90 and 90 degrees"),
        (("--field-deg", "0:80"), "'0:80' is not a range; write first:last:step, such as 0:80:2"),
        (("--field-deg", "80:0:2"), "'80:0:2' must go up: first:last:step"),
        (("--field-deg", "0:80:0"), "'0:80:0' must go up"),
        (("--field-deg", "0:80:1e-6"), "is more than 10000 angles; give a larger step"),
        (("--field-deg", "wide"), "argument --field-deg: 'wide' is not a number"),
        (("--field-deg", "20", "10"), "field_deg must ascend; sort the field angles and give each once"),
        (("--azimuths-deg", "0:360:10"), "azimuths_deg holds an azimuth twice; give each once"),
        (("--azimuth-cell-deg", "5"), "azimuth_cell_deg is given without azimuths_deg"),
        (("--cell-deg", "3"), "cell_deg is 3; it must be at most the distance of two angles, 2 degrees"),
        (("--map-field-deg", "20"), "--map-field-deg draws pictures; say with --out where they shall go"),
        (("--map-field-deg", "85", "--out", "o"), "angle 85° is in no cell; the nearest is that of 80°"),
        (("--map-pixels", "32"), "--map-pixels without --map-field-deg; say which angles to draw"),
        (("--map-field-deg", "20", "--out", "o", "--map-pixels", "0"), "--map-pixels: 0 must be a whole number"),
        (("--up-to-deg", "60"), "--up-to-deg is about --relative-error; give that too, or leave it out"),
        (("--relative-error", "0"), "argument --relative-error: 0 must lie between 1e-5 and 1"),
        (("--method", "backward"), "argument --method: invalid choice: 'backward'"),
        (("--convention", "fest"), "argument --convention: invalid choice: 'fest'"),
        (("--max-scatters", "1.5"), "argument --max-scatters: 1.5 must be a whole number"),
        (("--weights", "1"), "--weights without --wavelength-nm; give one wavelength for each weight"),
        (("--resume",), "--resume needs the saved run; give --state FILE, or the --out DIR of that run"),
        (("--resume", "--state", "none.npz"), "there is no saved run 'none.npz'; run without --resume first"),
        (("--resume", "--out", "none"), "there is no saved run 'none/pst_state.npz'; run without --resume first"),
        (("--resume", "--method", "forward"), "--resume with --method forward, which cannot go on from a saved run"),
        (("--state", "s.npz", "--method", "forward"), "--state with --method forward"),
        (("--state", "."), "--state . is a directory; name a file"),
    ],
)
def test_wrong_arguments(
    capsys: Any, fake: list[dict[str, Any]], arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails(capsys, "lens.xml", *arguments)
    assert fake == []
    assert list(tmp_path.iterdir()) == []


def test_wrong_output_directory_is_found_before_the_trace(
    capsys: Any, fake: list[dict[str, Any]], tmp_path: Path
) -> None:
    (tmp_path / "out").write_text("")
    assert "is a file; name a directory" in fails(capsys, "x", "--out", str(tmp_path / "out"))
    assert fake == []


@pytest.fixture
def plate(tmp_path: Path) -> str:
    return str(write(tmp_path, plates_text(1)))


def test_bad_scene_and_settings_are_one_line(capfd: Any, plate: str) -> None:
    assert "scene 'no_such_scene': no such file" in fails(capfd, "no_such_scene")
    assert "--relative-error: 2 must lie between 1e-5 and 1" in fails(capfd, plate, "--relative-error", "2")
    assert "--rays: 0 must" in fails(capfd, plate, "--rays", "0")
    assert "variant 'scalar_rgb' cannot run the ray tree" in fails(capfd, plate, "--variant", "scalar_rgb")


@pytest.mark.long
def test_a_real_plate(capfd: Any, tmp_path: Path) -> None:
    """
    A plate of n = 1.5 in front of a small detector, within 10° of the axis, where R is 0.04 to 0.1 %.

    On the plane of the detector, which is that of the aperture, both faces let (1 - R)² through, and the light that
    both reflect is R² of it. Six standard errors and 0.3 %: less than one false alarm in 1e8.
    """
    faces = [("front", 0.0, "air", "1.5"), ("rear", 1.0, "1.5", "air")]
    shapes = [
        shape_xml("asphere", name, z, interface_xml(before, behind), semi_diameter=50.0)
        for name, z, before, behind in faces
    ]
    shapes.append(shape_xml("asphere", "detector", 3.0, sensor=True, half_width=2.0, half_height=2.0))
    scene = write(tmp_path, scene_text(*shapes))
    out = tmp_path / "out"
    code, text, err = run(
        capfd, str(scene), "--field-deg", "5", "--cell-deg", "10", "--convention", "projected", "--rays", "2e5",
        "--out", str(out), "--json",
    )  # fmt: skip
    answer = json_units.read(text)
    assert (code, err) == (0, "")
    assert {Path(file).name for file in answer["files"]} | {"pst_state.npz"} == {file.name for file in out.iterdir()}
    (row,) = answer["curve"]
    for name, value in (("direct", 0.96**2), ("ghost", 0.96**2 * 0.04**2), ("single_scatter", 0.0)):
        error = 6 * row[f"pst_{name}_se"] + 0.003 * value
        assert row[f"pst_{name}"] == pytest.approx(value, abs=error)
    (ghost,) = row["paths"]
    assert ghost["label"] == "rear → front"
    assert ghost["percent_of_stray"] == pytest.approx(100)
    assert [cause["cause"] for cause in row["causes"]] == ["ghosts"]
    assert row["causes"][0]["percent_of_stray"] == pytest.approx(100)


def test_a_detector_in_a_closed_box_has_the_pst_0_and_a_line_says_why(capfd: Any, tmp_path: Path) -> None:
    box = f'<shape type="sphere" id="box"><float name="radius" value="3"/>{interface_xml(R=0.3)}</shape>'
    detector = shape_xml("asphere", "detector", sensor=True, half_width=1.0, half_height=1.0)
    scene = str(write(tmp_path, scene_text(box, detector)))
    out = tmp_path / "out"
    code, text, err = run(capfd, scene, "--field-deg", ANGLES, "--rays", "1e4", "--out", str(out))
    assert (code, err) == (0, "")
    assert text.count("warning: ") == 1
    assert "warning: no light was seen at" in text
    assert "sets no upper limit" in text
    assert "No light was seen at any angle." in (out / "report.html").read_text(encoding="utf-8")


class TestSavedRun:
    """Only a scene that scatters and a second of tracing are needed; `plate_and_wall` is one."""

    scene = "plate_and_wall"

    def command(self, state: Path, *more: str) -> list[str]:
        return [self.scene, "--field-deg", ANGLES, "--state", str(state), *more]

    def start(self, state: Path, log: Path) -> subprocess.Popen:
        """The command without an end, in a process of its own, when its first state is on disk."""
        command = [sys.executable, "-m", "mistray", "pst", *self.command(state, "--rays", "2e9")]
        with log.open("wb") as stream:
            process = subprocess.Popen(command, stdout=stream, stderr=stream)
        deadline = time.monotonic() + 300
        while not state.exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
        assert state.exists(), log.read_text()
        return process

    def numbers(self, capfd: Any, *arguments: str) -> tuple[list[dict[str, Any]], float]:
        code, out, err = run(capfd, *arguments, "--json")
        assert (code, err) == (0, "")
        answer = json_units.read(out)
        return answer["curve"], answer["facts"]["rays"]

    def goes_on_like_one_run(self, capfd: Any, state: Path) -> None:
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

    @pytest.mark.long
    def test_interrupted_it_says_how_to_go_on(self, capfd: Any, tmp_path: Path) -> None:
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

    @pytest.mark.long
    def test_killed_it_leaves_the_last_state(self, capfd: Any, tmp_path: Path) -> None:
        state, log = tmp_path / "state.npz", tmp_path / "log"
        process = self.start(state, log)
        time.sleep(np.random.default_rng(1).uniform(0.1, 1.0))
        process.kill()
        assert process.wait(timeout=60) == -signal.SIGKILL
        self.goes_on_like_one_run(capfd, state)

    def test_another_run_or_a_damaged_state_is_one_line(self, capfd: Any, tmp_path: Path) -> None:
        state = tmp_path / "state.npz"
        assert run(capfd, *self.command(state, "--rays", "1e4", "--quiet"))[0] == 0
        cases = [
            (("--field-deg", "0:80:10"), "had"),
            (("--max-scatters", "2"), "max_scatters was 1 and is 2"),
            (("--seed", "3"), "seed was 0 and is 3"),
            (("--wavelength-nm", "633"), "wavelength_nm was [550] and is [633]"),
        ]
        for more, text in cases:
            message = fails(capfd, *self.command(state, "--rays", "1e4", "--resume"), *more)
            assert message.startswith(f"state '{state}' belongs to another run: ")
            assert text in message
        message = fails(capfd, "plate", "--field-deg", ANGLES, "--state", str(state), "--rays", "1e4", "--resume")
        assert "the scene is another one or has changed" in message
        state.write_bytes(state.read_bytes()[:-100])
        assert "is damaged" in fails(capfd, *self.command(state, "--rays", "1e4", "--resume"))

    def test_interrupted_before_anything_is_saved(
        self, capsys: Any, fake: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        def pressed(*_: Any, **__: Any) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(importlib.import_module("mistray.analysis.pst.transmittance"), "pst", pressed)
        nothing = (130, "", "mistray: interrupted, nothing was written\n")
        assert run(capsys, "x", "--out", str(tmp_path)) == nothing
        assert run(capsys, "x") == nothing
        save_state(tmp_path / "pst_state.npz", {}, {})
        code, _, err = run(capsys, "x", "--out", str(tmp_path), "--resume")
        assert code == 130
        saved = tmp_path / "pst_state.npz"
        assert err == f"mistray: interrupted; the saved run is still in {saved}, go on with --resume\n"


@pytest.mark.long
def test_commands_of_the_page_run(capfd: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[1] / "docs" / "pst.md").read_text(encoding="utf-8")
    commands = [line for line in page.split("```sh\n")[1].split("```")[0].splitlines() if line]
    assert len(commands) == 3
    monkeypatch.chdir(tmp_path)
    for command in commands:
        program, name, *arguments = shlex.split(command)
        assert (program, name) == ("mistray", "pst")
        code, out, err = run(capfd, *arguments)
        assert (code, err) == (0, ""), command
        assert "PST = E_det/" in out
    written = {entry.name for entry in (tmp_path / "out" / "plate").iterdir()}
    listed = {"report.html", "pst.csv", "pst_paths.csv", "pst.png", "pst_causes.png", "pst.json", "pst_state.npz"}
    assert written == listed
    assert all(f"`{name}`" in page for name in listed)
