"""`mistray objects`: tables, files, JSON, one-line errors."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import json_units
import pytest
from oracles.object_scenes import open_tube_text
from oracles.small_scenes import write

from mistray import cli

FEW = ("--rays", "2e3")


def run(capsys: Any, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of one command in this process."""
    code = cli.main(["objects", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def fails(capsys: Any, *arguments: str) -> str:
    """The one line that a command with bad input prints."""
    code, out, err = run(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("mistray: error: ")
    return err.strip().removeprefix("mistray: error: ")


@pytest.fixture
def tube(tmp_path):
    return str(write(tmp_path, open_tube_text(3.0, 1.0, 0.7)))


DOCS = Path(__file__).parents[1] / "docs"
COMMANDS = [
    line
    for page in ("objects.md", "validation/phone_camera_objects.md")
    for block in re.findall(r"^```sh\n(.*?)^```", (DOCS / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
]


def test_there_are_commands_in_the_docs():
    assert len(COMMANDS) == 3


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_of_the_docs(capsys, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    _, name, *arguments = shlex.split(command)
    assert name == "objects"
    code, out, err = run(capsys, *arguments, *(() if "--rays" in arguments else ("--rays", "1e5")))
    assert (code, err) == (0, "")
    assert "Common objects" in out


def test_tables_and_warning_of_an_open_tube(capsys, tube):
    code, out, err = run(capsys, tube, *FEW)
    assert (code, err) == (0, "")
    for part in ("Critical objects: 1", "Illuminated objects: 2", "Common objects: 1", "wall", "W per W started"):
        assert part in out
    assert "warning: the detector sees the outside with no surface in between" in out


def test_options_reach_the_search(capsys, tube):
    code, out, _ = run(
        capsys, tube, *FEW, "--field-deg", "10", "20:40:10", "--azimuth-deg", "30", "--view-half-angle-deg", "45",
        "--threshold", "1e-3", "--ray-control", "halt_all", "--no-total-reflection", "--seed", "7", "--max-events", "9",
        "--wavelength-nm", "600", "--stop", "wall", "--detector", "detector", "--json",
    )  # fmt: skip
    assert code == 0
    record = json_units.read(out)
    assert record["angles_deg"] == [10, 20, 30, 40]
    facts = record["facts"]
    assert {key: facts[key] for key in ("rays", "azimuth_deg", "view_half_angle_deg", "threshold", "ray_control")} == {
        "rays": 2000, "azimuth_deg": 30, "view_half_angle_deg": 45, "threshold": 1e-3, "ray_control": "halt_all",
    }  # fmt: skip
    assert (facts["seed"], facts["max_events"], facts["wavelength_nm"]) == (7, 9, 600)
    assert facts["total_reflection"] is False
    assert record["stop"] == "wall"


def test_a_disc_as_source(capsys, tube):
    code, out, _ = run(capsys, tube, *FEW, "--disc", "-1", "0.5", "--half-angle-deg", "5", "--json")
    record = json_units.read(out)
    assert code == 0
    assert record["facts"]["source"].startswith("disc")
    detector = record["optics"][0]
    assert detector["id"] == "detector"
    assert detector["illuminated_power"] > 0.5  # it is narrower than the detector


def test_files(capsys, tube, tmp_path):
    code, out, _ = run(capsys, tube, *FEW, "--out", str(tmp_path / "out"))
    assert code == 0
    assert out.splitlines()[-1].endswith("objects.html")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"objects.html", "objects.png", "objects.json", "objects_common.csv", "objects_critical.csv"} <= written
    record = json.loads((tmp_path / "out" / "objects.json").read_text())
    assert record["command"].startswith("mistray objects ")


def test_quiet(capsys, tube):
    assert run(capsys, tube, *FEW, "--quiet") == (0, "", "")


def test_help_names_units(capsys):
    assert cli.main(["objects", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for part in ("example", "W for each W that starts", "--disc Z RADIUS", "mm", "DEG"):
        assert part in text


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--half-angle-deg", "0"), "must lie between 1e-6 and 90"),
        (("--half-angle-deg", "95"), "--half-angle-deg: 95 must lie"),
        (("--field-deg", "95"), "must lie between -90 and 90"),
        (("--field-deg", "90"), "--field-deg: 90 must lie"),
        (("--field-deg", "10", "--half-angle-deg", "5"), "two kinds of source"),
        (("--field-deg", "10", "--disc", "0", "1"), "two kinds of source"),
        (("--azimuth-deg", "10"), "--azimuth-deg is about --field-deg"),
        (("--disc", "0", "-1"), "radius = -1 mm"),
        (("--view-half-angle-deg", "100"), "--view-half-angle-deg: 100 must lie"),
        (("--threshold", "2"), "--threshold: 2 must lie"),
        (("--rays", "0"), "--rays: 0 must"),
        (("--rays", "many"), "'many' is not a number"),
        (("--stop", "pupil"), "called 'pupil'"),
        (("--detector", "wall"), "'wall' is no detector"),
        (("--ray-control", "some"), "ray_control is 'some'"),
        (("--max-events", "0"), "--max-events: 0 must"),
    ],
)
def test_bad_input_is_one_line(capsys, tube, arguments, text):
    assert text in fails(capsys, tube, *FEW, *arguments)


def test_missing_scene_and_bad_directory(capsys, tube, tmp_path):
    assert "no such file" in fails(capsys, str(tmp_path / "nothing.xml"))
    (tmp_path / "file").write_text("x")
    assert "is a file" in fails(capsys, tube, *FEW, "--out", str(tmp_path / "file"))
