"""`mistray.load`: where a scene may come from, and that what comes back is whole."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from oracles import scene_xml

import mistray
from mistray.scene import find

SCENES = sorted((Path(__file__).parents[1] / "scenes").glob("*/scene.xml"))


@pytest.mark.parametrize("path", SCENES, ids=[path.parent.name for path in SCENES])
def test_shipped_scenes_by_name_file_and_folder(path: Path, tmp_path: Path) -> None:
    """All shapes arrive under their own names, in the file's order, with what the file says."""
    copy = tmp_path / path.parent.name
    shutil.copytree(path.parent, copy)
    model = scene_xml.read_scene(path)
    found = [find(source) for source in (path.parent.name, path, str(path), copy, copy / "scene.xml")]
    assert find(getattr(mistray.scenes, path.parent.name)).samefile(path)
    assert found[1:] == [path, path, copy / "scene.xml", copy / "scene.xml"]
    assert found[0].samefile(path)
    scene = mistray.load(copy)
    assert isinstance(scene, mi.Scene)
    assert [shape.id() for shape in scene.shapes()] == [shape.shape_id for shape in model.shapes]
    for shape, expected in zip(scene.shapes(), model.shapes, strict=True):
        assert shape.part == expected.part
        assert shape.space == expected.space
        assert shape.is_sensor() == expected.detector
        assert shape.bsdf().opaque == expected.interface.opaque
        assert shape.bsdf().mirror == expected.interface.mirror
        assert shape.matrix == pytest.approx(expected.to_world, abs=1e-9)
    assert len(scene.emitters()) == len(model.emitters)
    assert scene.integrator().settings.max_events == 64


def test_find(tmp_path: Path) -> None:
    assert find("plate").name == "scene.xml"
    assert find(SCENES[0]) == SCENES[0]
    assert find(SCENES[0].parent) == SCENES[0]
    with pytest.raises(mistray.MistrayError, match="scene 'pancake': no such file"):
        find("pancake")
    with pytest.raises(mistray.MistrayError, match="no such file"):
        mistray.load(tmp_path)


XML_TEXT = '<scene version="3.0.0">\n    <integrator type="straylight"/>\n</scene>\n'


@pytest.mark.parametrize("text", [XML_TEXT, "\n" + 200 * XML_TEXT, f"\ufeff<?xml version='1.0'?>\n{XML_TEXT}"])
def test_the_text_of_a_scene_is_no_file(text: str) -> None:
    with pytest.raises(mistray.MistrayError) as caught:
        mistray.load(text)
    message = str(caught.value)
    assert message.startswith("scene '")
    assert message.endswith("': this is XML text; write it to a file and give its path")
    assert message.isprintable()
    assert len(message) < 150


@pytest.mark.parametrize("name", ["plate" * 1000, "two\nlines", "zero\0byte"])
def test_what_is_no_name_is_one_line(name: str) -> None:
    with pytest.raises(mistray.MistrayError, match=r"no such file; give a scene XML file") as caught:
        find(name)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 250


def test_a_file_wins_over_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder `plate` in the working directory is the user's own."""
    mine = tmp_path / "plate"
    mine.mkdir()
    text = find("plate").read_text(encoding="utf-8").replace('id="plate_rear"', 'id="my_rear"')
    (mine / "scene.xml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names = [shape.id() for shape in mistray.load("plate/scene.xml").shapes()]
    assert "my_rear" in names


def test_an_interrupt_while_a_plugin_is_made_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mitsuba makes a RuntimeError of it."""

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mistray.plugins.shapes.asphere.Asphere.__init__", interrupted)
    with pytest.raises(KeyboardInterrupt):
        mistray.load("plate")
    with pytest.raises(KeyboardInterrupt):
        mistray.load({"type": "scene", "a": {"type": "asphere"}})


def test_scenes_are_loaded_one_shape_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """In parallel, Mitsuba may begin one Python plugin inside of another one's constructor, on the same thread, while
    this one waits for Dr.Jit. That has ended in a segmentation fault.
    """
    depth = {"now": 0, "most": 0}
    from mistray.plugins.shapes import formula_shape

    build = formula_shape.build_mesh

    def watched(*arguments: Any) -> None:
        depth["now"] += 1
        depth["most"] = max(depth["most"], depth["now"])
        build(*arguments)
        depth["now"] -= 1

    monkeypatch.setattr(formula_shape, "build_mesh", watched)
    for _ in range(3):
        mistray.load("newtonian")
    assert depth["most"] == 1


def test_a_sky_of_an_exr_file_is_read_with_one_thread(tmp_path: Path) -> None:
    """Mitsuba's reader of EXR files waits for other threads, and waited for ever where there were none."""
    mi.Bitmap(np.ones((4, 8, 3), np.float32)).write(str(tmp_path / "sky.exr"))
    scene = {"type": "scene", "sky": {"type": "envmap", "filename": str(tmp_path / "sky.exr")}}
    program = f"""if True:
        import mistray, drjit
        from mistray._variant import set_threads
        set_threads(1)
        print(len(mistray.load({scene!r}).emitters()), drjit.thread_count())
    """
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() == ["1", "1"]
