"""`mistray view`: files, options, one-line errors."""

from __future__ import annotations

import importlib
import sys
from dataclasses import fields

import json_units
import pytest
from report.fake_trace import paths_at
from report.view_scene import SCENE, RayTrace

import mistray
from mistray import cli
from mistray.report.rays.ray_files import read_rays
from mistray.trace import Settings


def run(capsys, *arguments):
    code = cli.main(["view", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "lens.xml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.fixture
def traced(monkeypatch):
    """Replaces the tracer; notes its arguments."""
    calls = []

    def trace(scene, field_deg=None, progress=None, **settings):
        calls.append({"field_deg": field_deg, **settings})
        return RayTrace(paths_at(field_deg or 0.0), field_deg or 0.0)

    monkeypatch.setattr(sys.modules["mistray.trace"], "trace", trace)
    return calls


def test_writes_the_page(capsys, scene_file, traced, tmp_path):
    page = tmp_path / "out.html"
    code, out, err = run(capsys, scene_file, "--field-deg", 10, "--out", page)
    assert (code, err) == (0, "")
    assert out.split() == [str(page)]
    text = page.read_text(encoding="utf-8")
    assert "<title>lens</title>" in text
    assert f"mistray view {scene_file} --field-deg 10" in text
    assert traced[0]["rays"] == 20_000


def test_the_page_has_a_name_of_its_own(capsys, scene_file, traced, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(capsys, scene_file, "--no-trace")[0] == 0
    assert (tmp_path / "view.html").is_file()
    assert not traced


def test_other_files_without_a_page(capsys, scene_file, traced, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = (
        "--layout",
        "lens.svg",
        "--save-rays",
        "rays.ply",
        "rays.json",
        "--path-ids",
        2,
        0,
        "--rays-per-path",
        3,
    )
    code, out, _ = run(capsys, scene_file, *arguments, "--json")
    assert code == 0
    record = json_units.read(out)
    assert not json_units.wrong(record)
    assert record["files"] == ["lens.svg", "rays.ply", "rays.json"]
    assert [row["path_id"] for row in record["paths"]] == [2, 0]
    rays = read_rays("rays.ply")
    assert [ray.path_id for ray in rays] == [2, 2, 2, 0, 0, 0]
    assert rays == read_rays("rays.json")
    assert not (tmp_path / "view.html").exists()


def test_every_setting_of_the_tracer_is_passed_on(capsys, scene_file, traced, tmp_path):
    wanted = {"rays": 500, "max_reflections": 3, "seed": 4, "splitting": "one", "aim": "none"}
    options = [word for name, value in wanted.items() for word in (f"--{name.replace('_', '-')}", value)]
    options += ["--azimuth-deg", 30, "--wavelength-nm", 500, 600, "--weights", 1, 2]
    assert run(capsys, scene_file, *options, "--quiet", "--out", tmp_path / "v.html") == (0, "", "")
    (call,) = traced
    assert {name: call[name] for name in wanted} == wanted
    assert {field.name for field in fields(Settings)} <= set(call)
    assert (call["azimuth_deg"], call["wavelength_nm"], call["weights"]) == (30.0, [500.0, 600.0], [1.0, 2.0])


def test_a_layout_has_the_paths_and_rays_asked_for(capsys, scene_file, traced, tmp_path, monkeypatch):
    calls, layout = [], importlib.import_module("mistray.report.figures.layout")
    drawn = layout.layout_figure(mistray.load(scene_file))
    monkeypatch.setattr(layout, "layout_figure", lambda scene, trace, *given: calls.append(given) or drawn)
    for options in ((), ("--paths", 1, "--rays-per-path", 2, "--rays", 100)):
        assert run(capsys, scene_file, "--layout", tmp_path / "lens.svg", "--force", *options)[0] == 0
    assert calls == [(4, None, 7, ""), (1, None, 2, "")]
    assert [call["rays"] for call in traced] == [20_000, 100]


def test_the_whole_scene(capsys, scene_file, traced, tmp_path):
    page = tmp_path / "whole.html"
    assert run(capsys, scene_file, "--no-trace", "--cut-deg", "none", "--out", page)[0] == 0
    assert "equal axes; whole" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--layout", "lens.dwg"), "layouts are written as .svg, .pdf, .eps, .png"),
        (("--save-rays", "rays.stl"), "rays are written as .ply, .obj, .json"),
        (("--no-trace", "--save-rays", "rays.ply"), "--save-rays has no effect with --no-trace"),
        (("--no-trace", "--field-deg", "3"), "--field-deg has no effect with --no-trace; leave it out"),
        (("--no-trace", "--seed", "3"), "--seed has no effect with --no-trace"),
        (("--layout", "lens.svg", "--cut-deg", "none"), "--cut-deg has no effect without a page; give --out"),
        (("--no-trace", "--colour", "flux", "--out", "v.html"), "nothing was traced"),
        (("--weights", "1"), "--weights without --wavelength-nm"),
        (("--path-ids", "77", "--out", "v.html"), "path_id 77 does not exist; this trace has the paths 0 … 4"),
        (("--cut-deg", "left"), "'left' is not a number"),
        (("--rays-per-path", "0", "--out", "v.html"), "--rays-per-path: 0 must be"),
    ],
)
def test_bad_input_is_one_line(capsys, scene_file, traced, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, scene_file, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("mistray: error: ")
    assert err.count("\n") == 1
    assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["lens.xml"]


def test_without_plotly(capsys, scene_file, traced, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    code, _, err = run(capsys, scene_file, "--out", tmp_path / "v.html")
    assert code == 2
    assert not traced  # it says so before
    assert "needs plotly, which is not installed; pip install 'mistray[view]'" in err


def test_a_path_is_drawn_once_for_all_wavelengths():
    """Three wavelengths give three rows of each path; four paths take four ways, and each row is the strongest."""
    from mistray.report.rays.path_rays import chosen_rows

    traced = mistray.trace(mistray.load("cooke_triplet"), wavelength_nm=(450, 550, 650), rays=500, max_scatters=0)
    ways = {row.events for row in traced.paths}
    assert len(traced.paths) == 3 * len(ways)
    rows = chosen_rows(traced, 4)
    assert len({row.events for row in rows}) == len(rows) == min(4, len(ways))
    for row in rows:
        assert row.power_W == max(other.power_W for other in traced.paths if other.events == row.events)
    assert len(chosen_rows(traced, 100)) == len(ways)


@pytest.mark.long
def test_walls_are_recorded_and_painted(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "walls.html"
    scene = ["plate_and_wall", "--rays", 500, "--max-scatters", 0]
    assert run(capsys, *scene, "--surface-maps", "housing*", "azimuths=8", "--out", page)[::2] == (0, "")
    text = page.read_text(encoding="utf-8")
    assert '"meta":{"wall":"housing_wall"}' in text
    assert '"wall":"screen"' not in text
    for wrong in (["--no-trace"], ["--layout", tmp_path / "layout.svg"]):
        code, _, err = run(capsys, "plate_and_wall", "--surface-maps", *wrong)
        assert code != 0
        assert "--surface-maps" in err


def test_several_fields_and_classes(capsys, tmp_path):
    page, rays = tmp_path / "classes.html", tmp_path / "rays.json"
    few = ("--rays", 64, "--rays-per-path", 3, "--quiet")
    classes = ("--classes", "direct", "blocked", "escaped", "--save-rays", rays)
    code = run(capsys, "singlet_window_detector", "--field-deg", 0, 5, *classes, "--out", page, *few)
    assert code == (0, "", "")
    text = page.read_text(encoding="utf-8")
    assert "field 0°, 5°" in text
    lines = read_rays(rays)
    ends = [line.events.split()[-1] for line in lines if line.path_id < 0]
    assert len([line for line in lines if line.path_id == 0]) == 6  # direct, at two fields
    assert 0 < sum(end.endswith(":A") for end in ends) <= 6  # blocked
    gone = [line for line in lines if len(line.points) == len(line.events.split()) + 2]
    assert len(gone) == 6  # escaped, with a piece of their way out


def test_rays_from_the_detector(capsys, tmp_path):
    """They leave the detector, cross the window and the lens backwards, and end outside or where they are swallowed."""
    page, rays = tmp_path / "back.html", tmp_path / "rays.json"
    few = ("--rays", 64, "--rays-per-path", 40, "--quiet", "--save-rays", rays, "--field-deg", 0, 5)
    code = run(capsys, "singlet_window_detector", "--classes", "backward", *few, "--out", page)
    assert code == (0, "", "")
    lines = read_rays(rays)
    assert len(lines) == 40  # once, not for each field
    scene = mistray.load("singlet_window_detector")
    z = float(scene.sensors()[0].get_shape().bbox().min.z)
    through = 0
    for line in lines:
        names = [event.split(":") for event in line.events.split()]
        assert line.points[0][2] == pytest.approx(z)
        assert [letter for _, letter in names[:-1]] == ["T"] * (len(names) - 1) or "R" in line.events
        if names[-1][1] == "A":
            assert len(line.points) == len(names) + 1
        else:
            assert len(line.points) == len(names) + 2
            through += [name for name, _ in names][-1] == "L1_front"
    assert through > 0
    text = page.read_text(encoding="utf-8")
    assert text.count('"name":"backward"') == 1
    code, _, err = run(capsys, "singlet_window_detector", "--classes", "backward", "--box", -1, 1, -1, 1, "--out", page)
    assert code == 2
    assert "backward" in err


def test_classes_are_refused_before_the_trace(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for arguments, words in (
        (("--classes", "windw"), "'window'"),
        (("--classes", "ghost", "--path-ids", 1), "--path-ids is about paths"),
        (("--box", -1, 1, -1, 1), "add --classes all"),
    ):
        code, _, err = run(capsys, "singlet_window_detector", "--rays", "1e9", *arguments)
        assert (code, err.count("\n")) == (2, 1)
        assert words in err
