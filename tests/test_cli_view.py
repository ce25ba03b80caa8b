"""`mistray view`: the page, other files, rays by class, walls."""

import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import json_units
import pytest
from analyses.fake_trace import paths_at
from analyses.view.view_scene import SCENE, RayTrace
from command_line import Captured, Patch, succeeds

import mistray
from mistray.analyses.view.ray_files import read_rays
from mistray.trace import Settings

Calls = list[dict[str, Any]]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lens.xml").write_text(SCENE, encoding="utf-8")
    return tmp_path


@pytest.fixture
def traced(monkeypatch: Patch) -> Calls:
    """Replaces the tracer; notes its arguments."""
    calls: Calls = []

    def trace(scene: Any, field_deg: float | None = None, progress: Any = None, **settings: Any) -> RayTrace:
        calls.append({"field_deg": field_deg, **settings})
        return RayTrace(paths_at(field_deg or 0.0), field_deg or 0.0)

    monkeypatch.setattr(sys.modules["mistray.trace"], "trace", trace)
    return calls


def test_the_page(capsys: Captured, traced: Calls) -> None:
    """With a name of its own where none is given; every setting reaches the tracer."""
    wanted = {"rays": 500, "max_reflections": 3, "seed": 4, "splitting": "one", "aim": "none", "azimuth_deg": 30.0}
    options = [word for name, value in wanted.items() for word in (f"--{name.replace('_', '-')}", value)]
    options += ["--field-deg", 10, "--wavelength-nm", 500, 600, "--weights", 1, 2]
    assert succeeds(capsys, "view", "lens.xml", *options, "--out", "out.html").split() == ["out.html"]
    text = Path("out.html").read_text(encoding="utf-8")
    assert "<title>lens</title>" in text
    assert "mistray view lens.xml --rays 500" in text
    (given,) = traced
    assert given.items() >= (wanted | {"wavelength_nm": (500.0, 600.0), "weights": (1.0, 2.0)}).items()
    assert {field.name for field in fields(Settings)} <= set(given)
    assert succeeds(capsys, "view", "lens.xml", "--no-trace", "--cut-deg", "none", "--quiet") == ""
    assert "equal axes; whole" in Path("view.html").read_text(encoding="utf-8")
    assert len(traced) == 1


def test_other_files_without_a_page(capsys: Captured, traced: Calls) -> None:
    few = ("--path-ids", 2, 0, "--rays-per-path", 3)
    files = ("--layout", "lens.svg", "--save-rays", "rays.ply", "rays.json")
    record = json_units.read(succeeds(capsys, "view", "lens.xml", *files, *few, "--json"))
    assert record["files"] == ["lens.svg", "rays.ply", "rays.json"]
    assert [row["path_id"] for row in record["paths"]] == [2, 0]
    rays = read_rays("rays.ply")
    assert [ray.path_id for ray in rays] == [2, 2, 2, 0, 0, 0]
    assert rays == read_rays("rays.json")
    assert not Path("view.html").exists()


def test_a_path_is_drawn_once_for_all_wavelengths() -> None:
    """Three wavelengths give three rows of each path; four paths take four ways, and each row is the strongest."""
    from mistray.toolkit.drawings.path_polylines import chosen_rows

    traced = mistray.trace(mistray.load("cooke_triplet"), wavelength_nm=(450, 550, 650), rays=500, max_scatters=0)
    ways = {row.events for row in traced.paths}
    assert len(traced.paths) == 3 * len(ways)
    rows = chosen_rows(traced, 4)
    assert len({row.events for row in rows}) == len(rows) == min(4, len(ways))
    for row in rows:
        assert row.power_W == max(other.power_W for other in traced.paths if other.events == row.events)
    assert len(chosen_rows(traced, 100)) == len(ways)


def test_walls_are_recorded_and_painted(capsys: Captured) -> None:
    maps = ("--surface-maps", "housing*", "azimuths=8")
    code = succeeds(capsys, "view", "plate_and_wall", "--rays", 500, "--max-scatters", 0, *maps, "--out", "walls.html")
    assert code.split() == ["walls.html"]
    text = Path("walls.html").read_text(encoding="utf-8")
    assert '"meta":{"wall":"housing_wall"}' in text
    assert '"wall":"screen"' not in text


def test_several_fields_and_classes(capsys: Captured) -> None:
    few = ("--rays", 64, "--rays-per-path", 3, "--quiet", "--save-rays", "rays.json", "--field-deg", 0, 5)
    classes = ("--classes", "direct", "blocked", "escaped", "--out", "classes.html")
    assert succeeds(capsys, "view", "singlet_window_detector", *classes, *few) == ""
    assert "field 0°, 5°" in Path("classes.html").read_text(encoding="utf-8")
    lines = read_rays("rays.json")
    ends = [line.events.split()[-1] for line in lines if line.path_id < 0]
    assert len([line for line in lines if line.path_id == 0]) == 6  # direct, at two fields
    assert 0 < sum(end.endswith(":A") for end in ends) <= 6  # blocked
    gone = [line for line in lines if len(line.points) == len(line.events.split()) + 2]
    assert len(gone) == 6  # escaped, with a piece of their way out


def test_rays_from_the_detector(capsys: Captured) -> None:
    """They leave the detector, cross the window and the lens backwards, and end outside or where they are swallowed."""
    few = ("--rays", 64, "--rays-per-path", 40, "--quiet", "--save-rays", "rays.json", "--field-deg", 0, 5)
    succeeds(capsys, "view", "singlet_window_detector", "--classes", "backward", *few, "--out", "back.html")
    lines = read_rays("rays.json")
    assert len(lines) == 40  # once, not for each field
    scene = mistray.load("singlet_window_detector")  # Mitsuba's shape goes with it
    z = float(scene.sensors()[0].get_shape().bbox().min.z)
    through = 0
    for line in lines:
        names = [event.split(":") for event in line.events.split()]
        assert line.points[0][2] == pytest.approx(z)
        assert [letter for _, letter in names[:-1]] == ["T"] * (len(names) - 1) or "R" in line.events
        swallowed = names[-1][1] == "A"
        assert len(line.points) == len(names) + (1 if swallowed else 2)
        through += not swallowed and names[-1][0] == "L1_front"
    assert through > 0
    assert Path("back.html").read_text(encoding="utf-8").count('"mode":"lines","name":"backward"') == 1
