"""`mistray.load` and Mitsuba's own loaders: where a scene may come from, and that what comes back is whole."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from command_line import Patch
from oracles import scene_xml
from oracles.small_scenes import plates_text

import mistray
from mistray import Metric, MistrayError
from mistray.mechanics.ply import ply_bytes
from mistray.scene import find

XML_TEXT = '<scene version="3.0.0">\n    <integrator type="straylight"/>\n</scene>\n'
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


@pytest.mark.parametrize("text", ["\n" + 200 * XML_TEXT, f"\ufeff<?xml version='1.0'?>\n{XML_TEXT}"])
def test_the_text_of_a_scene_is_no_file(text: str) -> None:
    with pytest.raises(mistray.MistrayError, match=r"^scene '.*': this is XML text; write it to a file") as caught:
        mistray.load(text)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 150


@pytest.mark.parametrize("name", ["pancake", "plate" * 1000, "two\nlines", "zero\0byte"])
def test_what_is_no_name_is_one_line(name: str) -> None:
    with pytest.raises(mistray.MistrayError, match=r"no such file; give a scene XML file") as caught:
        find(name)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 250


def test_a_file_wins_over_a_shipped_name(tmp_path: Path, monkeypatch: Patch) -> None:
    """A folder `plate` in the working directory is the user's own."""
    mine = tmp_path / "plate"
    mine.mkdir()
    text = find("plate").read_text(encoding="utf-8").replace('id="plate_rear"', 'id="my_rear"')
    (mine / "scene.xml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert "my_rear" in [shape.id() for shape in mistray.load("plate/scene.xml").shapes()]


def test_an_interrupt_while_a_plugin_is_made_is_one(monkeypatch: Patch) -> None:
    """Mitsuba makes a RuntimeError of it."""

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mistray.plugins.shapes.asphere.Asphere.__init__", interrupted)
    for source in ("plate", {"type": "scene", "a": {"type": "asphere"}}):
        with pytest.raises(KeyboardInterrupt):
            mistray.load(source)


def test_scenes_are_loaded_one_shape_after_the_other(monkeypatch: Patch) -> None:
    """In parallel, Mitsuba may begin one Python plugin inside of another one's constructor, which has crashed."""
    from mistray.plugins.shapes import formula_shape

    build, now, most = formula_shape.build_mesh, [], [0]

    def watched(*arguments: Any) -> None:
        now.append(None)
        most.append(len(now))
        build(*arguments)
        now.pop()

    monkeypatch.setattr(formula_shape, "build_mesh", watched)
    for _ in range(3):
        mistray.load("newtonian")
    assert max(most) == 1


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


T = mi.ScalarTransform4f
WALL = {"type": "interface", "R": 0.1}


def lens(**others: Any) -> dict[str, Any]:
    """A plano-convex lens of f = 100 mm and its detector."""
    face, back = {"type": "asphere", "semi_diameter": 10.0}, {"type": "interface", "front": "1.5"}
    return {
        "type": "scene",
        "front": face | {"radius": 50.0, "bsdf": {"type": "interface", "back": "1.5"}},
        "rear": face | {"z": 4.0, "bsdf": back},
        "detector": scene_dicts.detector(101.3, semi_diameter=5.0),
        "beam": {"type": "collimated", "radius": 5.0, "to_world": scene_dicts.at(-20), "wavelength_nm": "550"},
        **others,
    }


def test_parts_from_cad_keep_their_names_and_parts(tmp_path: Path) -> None:
    """Two meshes of one paint in one object: they would be one shape without a name."""
    file = tmp_path / "sheet.ply"
    file.write_bytes(ply_bytes(9 * np.eye(3), np.array([[0, 1, 2]])))
    mesh = {"type": "part_mesh", "filename": str(file), "part": "mount", "bsdf": {"type": "ref", "id": "black"}}
    far = mesh | {"to_world": T().translate([0, 0, 500])}
    scene = mi.load_dict({"type": "scene", "black": WALL, "a": mesh, "b": far})
    assert {(shape.id(), shape.part) for shape in scene.shapes()} == {("a", "mount"), ("b", "mount")}


def test_exact_surfaces_beside_stock_meshes_are_traced_as_they_are() -> None:
    """Two boxes of one paint are merged, and the lens is not: its image is as sharp as without merging, ray by ray."""
    boxes = {f"box_{x}": {"type": "cube", "to_world": T().translate([x, 0, 50]), "bsdf": WALL} for x in (-30, 30)}
    images = []
    for optimize in (False, True):
        scene = mi.load_dict(lens(**boxes), optimize=optimize)
        assert {"front", "rear", "detector"} <= {shape.id() for shape in scene.shapes()}
        assert len(scene.shapes()) == (4 if optimize else 5)
        t = mistray.trace(scene, rays=2000, max_scatters=0)
        images.append((t.paths[0].power_W, t.paths[0].rms_radius_mm))
    assert images[1] == pytest.approx(images[0], rel=1e-6)
    assert images[0][1] < 0.05  # mm; a lens of facets spreads its light over more than a millimetre


def test_renders_and_gradients_of_a_scene_by_load_dict() -> None:
    """The image of `straylight` is the trace's, and its derivative by a curvature is that of the scene as given."""
    integrator = {"type": "straylight", "rays": 2000, "max_scatters": 0}
    found = []
    for optimize in (False, True):
        scene = mi.load_dict(lens(integrator=integrator), optimize=optimize)
        metric = Metric(scene, lambda seen: seen[0].power("direct"), settings={"rays": 2000})
        gradient = mistray.gradient(metric, mi.traverse(scene), ["front.curvature"])
        found.append((float(np.sum(mi.render(scene))), float(gradient.gradient["front.curvature"][0])))
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def test_equal_sensors_of_two_detectors_are_refused_by_name() -> None:
    """Mitsuba takes equal sensors for one, which cannot belong to two shapes; as given, they are two."""
    second = scene_dicts.detector(150.0, semi_diameter=5.0)
    with pytest.raises(RuntimeError, match=r"shape '(detector|second)': its sensor .*optimize=False") as caught:
        mi.load_dict(lens(second=second))
    assert MistrayError.__name__ in str(caught.value)
    assert len(mi.load_dict(lens(second=second), optimize=False).sensors()) == 2


def test_the_folder_of_plugins_registers_them_by_itself(tmp_path: Path) -> None:
    program = (
        "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import plugins;"
        "print(type(mi.load_dict({'type': 'asphere', 'semi_diameter': 5.0, 'bsdf': {'type': 'interface'}})).__name__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parents[1], check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["Asphere"]


def test_a_folder_that_led_to_a_file_may_go(tmp_path):
    """The scene is traced again, at another wavelength, after the folder that its path led through is removed."""
    (tmp_path / "glass.csv").write_text("wavelength_nm,n,k\n400,1.5,0\n700,1.5,0\n")
    folder = tmp_path / "gone"
    folder.mkdir()
    head, tag, rest = plates_text(1).replace('"1.5"', '"glass.csv"').partition(">")
    (folder / "scene.xml").write_text(f'{head}{tag}<path value=".."/>{rest}')
    scene = mistray.load(folder / "scene.xml")
    shutil.rmtree(folder)
    for wavelength_nm in (500, 600):
        assert mistray.trace(scene, rays=100, wavelength_nm=wavelength_nm).energy.detected_W > 0
