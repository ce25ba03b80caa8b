"""Scene files with other values are what was given, and nothing else changes; improbable scatter is named."""

import difflib
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vectors
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write
from refusals import each_refused, refused

import mistray
import mistray.scenes
from mistray.coatings import preset
from mistray.errors import MistrayWarning
from mistray.scene.improbable import improbable
from mistray.scene.load import find, shipped_scenes
from mistray.scene.rewrite import rewritten, write_rewritten
from mistray.scene.unshared import SceneText

TRIPLET = find("cooke_triplet")


def values_of(scene: mi.Scene) -> dict[str, np.ndarray]:
    """All numbers of surfaces, coatings and scatter, those of shapes in double precision."""
    params = mi.traverse(scene)
    found = {}
    for key in params.keys():  # noqa: SIM118
        plugin, name = params.properties[key][2], key.rpartition(".")[2]
        if hasattr(plugin, "outer_radius") and name in plugin.values:
            found[key] = np.array([plugin.values[name]])
        elif hasattr(plugin, "complex_indices"):
            found[key] = np.array(params[key], dtype=np.float32)
    return found


def assert_loads(path: Path, expected: dict[str, np.ndarray]) -> None:
    # Surfaces may overlap here, which `mistray.load` would refuse
    found = values_of(mi.load_file(str(path), optimize=False, parallel=False))
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        np.testing.assert_array_equal(found[key], value.astype(found[key].dtype), err_msg=key)


def test_what_is_not_given_stays_and_comes_back(tmp_path: Path) -> None:
    before = values_of(mistray.load(TRIPLET))
    some = {"L2_front.curvature": -0.0451, "L2_rear.x": 7e-4, "barrel_face.bsdf.R": 0.03, "barrel_face.r0": 6.1}
    some = {key: np.array([value]) for key, value in some.items()}
    some["L1_front.bsdf.n_back_shift"] = np.float32([1e-4])
    path = write_rewritten(TRIPLET, some, tmp_path / "some.xml")
    assert_loads(path, before | some)
    assert_loads(write_rewritten(path, {key: before[key] for key in some}, tmp_path / "back.xml"), before)


SCENE = vectors.text("rewrite.xml")


def changes(before: str, after: str) -> tuple[list[str], list[str]]:
    """Lines that went and lines that came."""
    lines = list(difflib.ndiff(before.splitlines(), after.splitlines()))
    return [x[2:].strip() for x in lines if x[0] == "-"], [x[2:].strip() for x in lines if x[0] == "+"]


class TestText:
    def test_only_the_values_change(self) -> None:
        after = rewritten(TRIPLET, {"L1_front.curvature": 0.04, "L1_front.x": 0.1}, TRIPLET.parent, "for -- a test")
        gone, new = changes(TRIPLET.read_text("utf-8"), after)
        assert gone == ['<float name="radius" value="23.713"/>']
        assert new == [
            "<!-- Values set by mistray: for - - a test",
            "L1_front.curvature = 0.04 (was 0.04217096)",
            "L1_front.x = 0.1 (was 0) -->",
            '<float name="radius" value="25"/>',
            '<float name="x" value="0.1"/>',
        ]

    @pytest.mark.parametrize("values", vectors.toml("tables.toml")["values of a scene"])
    def test_where_values_go(self, values: dict[str, Any], tmp_path: Path) -> None:
        source = write(tmp_path, SCENE)
        gone, new = changes(SCENE, rewritten(source, values, tmp_path))
        assert len(gone) <= 1
        assert len([line for line in new if "(was" not in line and "Values set" not in line]) <= len(values)
        before = values_of(mistray.load(source))
        expected = before | {key: np.atleast_1d(np.asarray(value, dtype=float)) for key, value in values.items()}
        assert_loads(write_rewritten(source, values, tmp_path / "new.xml"), expected)

    @pytest.mark.parametrize(
        ("radius", "curvature"), [("radius_x", "curvature_x"), ("toroid_radius", "toroid_curvature")]
    )
    def test_a_radius_in_x_stays_one(self, radius: str, curvature: str, tmp_path: Path) -> None:
        lens = shape_xml("freeform", "lens", 0.0, interface_xml(back="1.5"), semi_diameter=5.0, **{radius: -100.0})
        source = write(tmp_path, scene_text(lens))
        _, new = changes(source.read_text(), rewritten(source, {f"lens.{curvature}": -0.0125}, tmp_path))
        assert any(f'name="{radius}" value="-80"' in line for line in new)
        path = write_rewritten(source, {f"lens.{curvature}": -0.011}, tmp_path / "new.xml")
        assert mi.traverse(mistray.load(path))[f"lens.{curvature}"][0] == -0.011

    @pytest.mark.parametrize("values", [{"B": 2e-3}, {"A": 3e-5, "B": 1e-3, "g": 2.5}])
    def test_parameters_of_an_abg_catalogue(self, values: dict[str, float], tmp_path: Path) -> None:
        (tmp_path / "ABG.DAT").write_bytes((Path(__file__).parents[1] / "data/abg_catalogue.dat").read_bytes())
        text = scene_text(shape_xml("asphere", "lens", 0.0, interface_xml(back="1.5"), semi_diameter=5.0))
        polish = '<bsdf type="abg"><string name="file" value="ABG.DAT:Polish 1"/></bsdf></bsdf>'
        source = write(tmp_path, text.replace("</bsdf>", polish, 1))
        path = write_rewritten(source, {f"lens.bsdf.abg.{key}": v for key, v in values.items()}, tmp_path / "new.xml")
        model = mistray.load(path).shapes()[0].bsdf().scatterers[0].model
        expected = {"A": 2e-5, "B": 1e-6, "g": 2.0, "reference_nm": 632.8} | values
        assert {key: getattr(model, key) for key in expected} == pytest.approx(expected, rel=1e-6)

    def test_shared_objects_stay_shared(self, tmp_path: Path) -> None:
        source = write(tmp_path, SCENE)
        thickness = [layer.thickness_nm + 1.5 for layer in preset("bbar3").layers]
        path = write_rewritten(source, {"shared.thickness_nm": thickness, "polish.rms_nm": 5.0}, tmp_path / "new.xml")
        bsdfs = {shape.id(): shape.bsdf() for shape in mistray.load(path).shapes()}
        assert bsdfs["a"].film is bsdfs["b"].film
        assert [layer.thickness_nm for layer in bsdfs["a"].coating.layers] == pytest.approx(thickness, rel=1e-7)
        materials = [[layer.material for layer in stack.layers] for stack in (bsdfs["a"].coating, preset("bbar3"))]
        assert materials[0] == materials[1]
        assert bsdfs["a"].scatter[0].rms_nm == 5.0
        mirror = bsdfs["mirror"].coating
        thickness = [layer.thickness_nm * 1.1 for layer in mirror.layers]
        path = write_rewritten(source, {"silver.thickness_nm": thickness}, tmp_path / "mirror.xml")
        after = {shape.id(): shape.bsdf().coating for shape in mistray.load(path).shapes()}["mirror"]
        assert (after.opaque, after.first, len(after.layers)) == (True, "outside", len(mirror.layers))

    def test_a_table_of_layers_keeps_its_materials(self, tmp_path: Path) -> None:
        (tmp_path / "sub").mkdir()
        (tmp_path / "COATING.DAT").write_text("MATE MYFILM\n0.4 1.40 0\n0.7 1.38 0\nCOAT AR\nMYFILM 0.1 1\n")
        text = SCENE.replace('<string name="preset" value="bbar3"/>', '<string name="table" value="COATING.DAT:AR"/>')
        path = write_rewritten(write(tmp_path, text), {"shared.thickness_nm": 88.0}, tmp_path / "sub" / "new.xml")
        assert 'value="COATING.DAT:MYFILM 88"' in path.read_text("utf-8")
        assert '<path value=".."/>' in path.read_text("utf-8")
        coating = {s.id(): s.bsdf().coating for s in mistray.load(path).shapes()}["a"]
        assert (coating.layers[0].thickness_nm, coating.indices(550.0)[0].real) == (88.0, pytest.approx(1.39, abs=1e-6))


def test_what_cannot_be_placed(tmp_path: Path) -> None:
    each_refused(
        ({"a.curvatur": 1.0}, "it has no parameter 'a.curvatur'; did you mean a.curvature"),
        ({"nothing": 1.0}, "it has no parameter 'nothing'"),
        ({"detector.sensor.shutter_open": 1.0}, "is not a value of a surface, coating or scatter"),
        ({"a.vertex_positions": 1.0}, "is not a value of a surface, coating or scatter"),
        ({"a.x": [1.0, 2.0]}, "parameter 'a.x': 2 numbers are given; it has 1"),
        ({"waves.n_shift": 0.1}, "parameter 'waves.n_shift': 1 numbers are given; it has 2"),
        ({"a.x": float("nan")}, "parameter 'a.x': nan is given; it must be finite"),
        ({"shared.R": 0.5}, "it has no parameter 'shared.R'"),
        by=lambda values: rewritten(write(tmp_path, SCENE), values, tmp_path),
    )


def test_an_included_file_is_not_changed(tmp_path: Path) -> None:
    shape = shape_xml("asphere", "z", 25.0, interface_xml(R=0.5), semi_diameter=2.0)
    (tmp_path / "lens.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    source = write(tmp_path, SCENE.replace("</scene>", '    <include filename="lens.xml"/>\n</scene>'))
    assert "z.x" in values_of(mistray.load(source))
    with refused(r"the object of parameter 'z.x' does not stand in the file"):
        rewritten(source, {"z.x": 1.0}, tmp_path)
    (tmp_path / "other").mkdir()
    path = write_rewritten(source, {"a.x": 0.5}, tmp_path / "other" / "new.xml")
    assert values_of(mistray.load(path))["z.semi_diameter"] == 2.0


MODELS = (
    '<bsdf type="harvey_shack" id="polish"><float name="rms_nm" value="4"/><float name="l" value="0.01"/></bsdf>',
    '<bsdf type="particulate" id="dust"><float name="coverage_percent" value="0.1"/></bsdf>',
    '<bsdf type="paint" id="black"><string name="preset" value="flat_black"/></bsdf>',
    '<bsdf type="interface" id="wall"><float name="R" value="0"/><ref id="black"/></bsdf>',
    '<bsdf type="thinfilm" id="AR"><string name="layers" value="1.38 0.25w"/></bsdf>',
)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    models = "".join(f'<ref id="{name}"/>' for name in ("AR", "polish", "dust")) + "</bsdf>"
    front, rear = interface_xml("air", "1.5"), interface_xml("1.5", "air")
    shapes = (
        shape_xml("asphere", "front", 0.0, front.replace("</bsdf>", models), semi_diameter=5.0),
        shape_xml("asphere", "rear", 2.0, rear.replace("</bsdf>", models), semi_diameter=5.0),
        shape_xml("frustum", "tube", 0.0, '<ref id="wall"/>', r0=6.0, z0=0.0, r1=6.0, z1=20.0),
        shape_xml("frustum", "cone", 0.0, '<ref id="black"/>', r0=7.0, z0=0.0, r1=8.0, z1=20.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=3.0, half_height=3.0),
    )
    return write(tmp_path, scene_text(*MODELS, *shapes))


def with_own(file: SceneText, folder: Path) -> mi.SceneParameters:
    return mi.traverse(mistray.load(write(folder, file.text(folder), "own.xml")))


def test_every_surface_has_its_own(source: Path) -> None:
    assert "polish.rms_nm" in mi.traverse(mistray.load(source))
    after = with_own(SceneText(source), source.parent)
    own = ("harvey_shack.rms_nm", "particulate.coverage_percent")
    keys = {f"{side}.bsdf.{rest}" for side in ("front", "rear") for rest in own}
    assert keys | {"tube.bsdf.paint.reflectance", "cone.bsdf.reflectance"} <= set(after.keys())
    assert not [key for key in after.keys() if key.startswith(("polish.", "dust.", "black."))]  # noqa: SIM118
    assert "AR.thickness_nm" in after  # a coating stays shared


def test_ids_within_a_shared_interface(tmp_path: Path) -> None:
    """Each surface has a copy of the interface, whose model had an id."""
    shared = f'<bsdf type="interface" id="glass"><string name="back" value="1.5"/>{MODELS[0]}</bsdf>'
    shapes = [shape_xml("asphere", "ab"[k], 0.0, '<ref id="glass"/>', semi_diameter=5.0, x=20.0 * k) for k in (0, 1)]
    detector = shape_xml("asphere", "detector", 20.0, sensor=True, half_width=3.0, half_height=3.0)
    after = with_own(SceneText(write(tmp_path, scene_text(shared, *shapes, detector))), tmp_path)
    assert {"a.bsdf.harvey_shack.rms_nm", "b.bsdf.harvey_shack.rms_nm"} <= set(after.keys())


def test_new_values(source: Path) -> None:
    """One value changes, and nothing else; without models of their own they stay shared."""
    for key, value in vectors.toml("tables.toml")["new values"]:
        file = SceneText(source, not key.startswith("polish"))
        before = with_own(file, source.parent)
        file.set(key, value)
        after = with_own(file, source.parent)
        assert np.array(after[key]) == pytest.approx([value], rel=1e-6)
        others = [k for k in after.keys() if k != key and isinstance(after[k], mi.Float)]  # noqa: SIM118
        assert all(np.array_equal(np.array(before[k]), np.array(after[k])) for k in others)


def test_what_cannot_be_done(source: Path, tmp_path: Path) -> None:
    with refused(r"the model of 'side\.bsdf\.paint\.reflectance' does not stand in the file"):
        SceneText(source).set("side.bsdf.paint.reflectance", 0.1)
    broken = write(tmp_path, "<scene", "broken.xml")
    each_refused((tmp_path / "nothing.xml", "No such file"), (broken, "broken XML"), by=SceneText)


def scene(*models: dict[str, Any]) -> dict[str, Any]:
    """A stack of mirrors, each with a model of scatter."""
    ring = {"type": "frustum", "r0": 1.0, "r1": 2.0}
    mirrors = {
        f"mirror_{k}": ring | {"z0": 10.0 * k, "z1": 10.0 * k, "bsdf": {"type": "interface", "R": 0.9, "model": model}}
        for k, model in enumerate(models, start=1)
    }
    return {"type": "scene", **mirrors}


def told(given: dict[str, Any]) -> list[str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        mistray.load(given)
    assert all(item.category is MistrayWarning for item in found)
    assert all(item.filename == __file__ for item in found), "the warning points at who loads"
    return [str(item.message) for item in found]


def test_names_surface_value_and_range() -> None:
    polish = {"type": "abg", "A": 1e-4, "B": 1e-3, "g": 1.8}
    harvey = {"type": "harvey_shack", "b0": 0.1, "l": 0.3, "s": -1.5}
    others = {"A": 1e-6, "B": 1e-8, "g": 2.5}, {"A": 1.0, "B": 1e-8, "g": 2.0, "relative_to": "incident"}
    found = told(scene(polish, {"type": "abg", **others[0]}, harvey, {"type": "abg", **others[1]}))
    expected = (
        ("'mirror_1'", "0.001", "1.8", "1e-10 … 1e-6"),
        ("'mirror_3'", "l 0.3", "1e-4 … 1e-2"),
        ("'mirror_4'", "57.9"),
    )
    for text, parts in zip(found, expected, strict=True):
        assert all(part in text for part in parts), text
        assert "\n" not in text
    (text,) = told({"polish": polish, **scene(*[{"type": "ref", "id": "polish"}] * 5)})
    assert "and 2 more" in text


@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_scenes_are_probable(name: str) -> None:
    """But for one, whose A, B and g are those that the webinar plots, outside of what it calls typical."""
    found = improbable(mistray.load(name))
    assert len(found) == (name == "plate_and_wall")
    assert all("B 0.001 and g 1.8" in text for text in found)


@pytest.mark.long
def test_the_command_line_shows_it(tmp_path: Path) -> None:
    values = "".join(f'<float name="{name}" value="{x}"/>' for name, x in (("A", 1e-4), ("B", 1e-3), ("g", 1.8)))
    abg = f'<bsdf type="abg">{values}</bsdf>'
    wall = interface_xml(R=0.9).replace("</bsdf>", f"{abg}</bsdf>")
    file = write(tmp_path, scene_text(shape_xml("asphere", "wall", 9.0, wall, sensor=True, semi_diameter=1.0)))
    command = [sys.executable, "-m", "mistray", "view", str(file), "--out", str(tmp_path / "view")]
    err = subprocess.run(command, capture_output=True, text=True, timeout=120).stderr
    (line,) = [line for line in err.splitlines() if "warning" in line]
    assert line.startswith("mistray: warning: surface 'wall': ABg")
