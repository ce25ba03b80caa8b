"""`mistray pst`: a run that is saved, interrupted, killed and goes on; a detector in the dark."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import json_units
import numpy as np
import pytest
from command_line import Captured, fails, run, succeeds
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write

from mistray.files.saved_state import load_state

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

    @pytest.mark.long
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

    @pytest.mark.long
    def test_killed_it_leaves_the_last_state(self, capfd: Captured, tmp_path: Path) -> None:
        state, log = tmp_path / "state.npz", tmp_path / "log"
        process = self.start(state, log)
        time.sleep(np.random.default_rng(1).uniform(0.1, 1.0))
        process.kill()
        assert process.wait(timeout=60) == -signal.SIGKILL
        self.goes_on_like_one_run(capfd, state)

    def test_another_run_or_a_damaged_state_is_one_line(self, capfd: Captured, tmp_path: Path) -> None:
        """Other differences are in analysis/test_pst_state.py."""
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
