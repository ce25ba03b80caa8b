"""What Save writes is a scene and a study of the state that is shown; no file is lost."""

import shutil
from pathlib import Path

import pytest
from command_line import succeeds

import mistray
from mistray.analyses.explorer.explorer import Explorer
from mistray.analyses.explorer.saving import SCENE_FILE, STUDY_FILE
from mistray.metrics.parameters import parameters


@pytest.fixture
def saving(at_start, tmp_path):
    at_start.saving.folder, at_start.saving.force = tmp_path, False
    at_start.saving._own.clear()
    yield at_start
    at_start.saving.folder = Path()


def test_the_scene_has_the_coatings_and_numbers_that_were_turned(saving, tmp_path):
    saving.move({"coating window": "bbar3", "layers": 110.0, "detector.bsdf.R": 0.1})
    scene = mistray.load(saving.save_scene())
    for shape in scene.shapes():
        if shape.id() in saving.controls["coating window"].surfaces:
            thickness = [layer.thickness_nm for layer in shape.bsdf().coating.layers]
            assert thickness[0] == pytest.approx(1.1 * 550 / 4 / 1.38, rel=1e-5)
    assert parameters(scene)["detector.bsdf.R"].value[0] == pytest.approx(0.1, rel=1e-6)
    shown = saving.settle()
    t = mistray.trace(scene, rays=2000, field_deg=0.0, max_reflections=2)
    assert sum(row.power_W for row in t.paths if row.kind != "direct") == pytest.approx(shown["stray_W"][0], rel=1e-4)


def test_nothing_is_replaced_but_its_own_files(saving, tmp_path):
    (tmp_path / SCENE_FILE).write_text("mine")
    with pytest.raises(mistray.MistrayError, match=SCENE_FILE):
        saving.save_scene()
    assert (tmp_path / SCENE_FILE).read_text() == "mine"
    saving.saving.force = True
    saving.save_scene()
    saving.saving.force = False
    saving.save_scene()  # that of before
    assert not list(tmp_path.glob(".*"))
    (tmp_path / STUDY_FILE).symlink_to(tmp_path / "nowhere")
    saving.move({"detector.bsdf.R": 0.1})
    with pytest.raises(mistray.MistrayError, match=STUDY_FILE):
        saving.save_study()
    saving.saving.folder = tmp_path / SCENE_FILE
    with pytest.raises(mistray.MistrayError, match=SCENE_FILE):
        saving.save_scene()
    saving.saving.folder = tmp_path / "new" / "folder"
    assert saving.save_scene().is_file()
    scene = tmp_path / SCENE_FILE  # which is explored, is never replaced
    shutil.copy(saving.path, scene)
    other = Explorer(scene, field_deg=[0.0], rays=200)
    other.saving.folder, other.saving.force = tmp_path, True
    before = scene.read_bytes()
    with pytest.raises(mistray.MistrayError, match="explored"):
        other.save_scene()
    assert scene.read_bytes() == before


def test_names_of_any_kind(saving, tmp_path):
    """Blanks, brackets, quotation marks and letters of other scripts in names of surfaces, parts and the file."""
    text = saving.path.read_text(encoding="utf-8")
    for old, new in (("window_front", "窓 [1] &quot;front&quot;"), ("window_rear", "a*b? c")):
        text = text.replace(old, new)
    text = text.replace('value="window"', "value=\"p [a] \\ 'b'\"")
    odd = tmp_path / "odd [scene] ü.xml"
    odd.write_text(text, encoding="utf-8")
    other = Explorer(odd, field_deg=[0.0], rays=500)
    other.saving.folder = tmp_path
    other.settle()
    (name,) = [name for name, one in other.controls.items() if "a*b? c" in one.surfaces and one.choices]
    other.move({name: "bbar3"})
    shown = other.settle()
    scene = mistray.load(other.save_scene())
    t = mistray.trace(scene, rays=500, field_deg=0.0)
    assert sum(row.power_W for row in t.paths if row.kind != "direct") == pytest.approx(shown["stray_W"][0], rel=1e-4)
    assert "窓 [1]" in other.save_study().read_text(encoding="utf-8")


def test_the_study_runs_on_both_scenes(saving, capsys):
    saving.move({"coating window": "bare"})
    with pytest.raises(mistray.MistrayError, match="control"):
        saving.save_study()  # there is nothing to vary
    saving.move({"coating window": "bbar3", "layers": 105.0, "detector.bsdf.R": 0.15})
    scene, study = saving.save_scene(), saving.save_study()
    assert {"detector.bsdf.R", "window_front"} <= set(study.read_text().replace('"', " ").split())
    for path in (scene, saving.path):
        succeeds(capsys, "optimize", path, study, "--steps", 1, "--verification-seeds", 2, "--quiet")
