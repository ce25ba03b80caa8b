"""Paint and spaces by name, scene files with mechanics, and the plugin `part_mesh`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray import MistrayError, cli
from mistray.cli import import_mechanics
from mistray.mechanics import Finish, Mechanics, finish, read_mechanics
from mistray.mechanics.ply import ply_bytes
from mistray.prescription import Coating, MeshStructure, Scatter, Structure
from mistray.scene import add_structures

DATA = Path(__file__).parents[1] / "data"
SCENE = """\
<scene version="3.0.0">
    <integrator type="straylight"/>
    <emitter type="collimated"><float name="radius" value="2"/></emitter>
    <!-- barrel -->
    <bsdf type="paint" id="barrel_paint"><float name="reflectance" value="0.1"/></bsdf>
    <bsdf type="thinfilm" id="mirror"><float name="R" value="0.9"/></bsdf>
    <shape type="asphere" id="detector">
        <float name="semi_diameter" value="5"/>
        <transform name="to_world"><translate z="60"/></transform>
        <bsdf type="interface"><float name="R" value="0"/></bsdf>
        <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor>
    </shape>
</scene>
"""


@pytest.fixture(scope="module")
def assembly() -> Mechanics:
    return read_mechanics(DATA / "assembly_inch.step")


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "base.xml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def by_name(shapes: Any) -> dict[str, Any]:
    return {shape.name: shape for shape in shapes}


class TestPaint:
    def test_patterns(self, assembly: Mechanics, tmp_path: Path) -> None:
        """A product names all its instances, a title one, a path what is below it, and the last that matches counts."""
        painted = assembly.painted(
            {"mount/*": "good_black_paint", "ring": "flat_black", "ring_side": "R=0.1", "ring_front_face_2": "black"},
            space={"ring*": 2, "bracket": 3},
        )
        shapes = by_name(painted.structures(tmp_path))
        assert shapes["bracket"].scatter[0].name == "good_black_paint"
        assert {shapes[f"ring_front_face_{k}"].scatter[0].name for k in (0, 1, 3)} == {"flat_black"}
        assert shapes["ring_front_face_2"].scatter == ()
        assert {shapes[f"ring_side_face_{k}"].coating.R for k in range(4)} == {0.1}
        assert [shapes[name].space for name in ("ring_front_face_0", "ring_side_face_3", "bracket")] == [2, 2, 3]
        assert {shape.part for shape in shapes.values()} == {"ring_front", "ring_side", "bracket"}

    def test_faces_of_a_mesh(self, assembly: Mechanics, tmp_path: Path) -> None:
        """Two meshes, for two paints: 2 and 10 of the 12 triangles of the block."""
        shapes = by_name(assembly.painted({"bracket_face_4": "flat_black"}).structures(tmp_path))
        meshes = [shape for shape in shapes.values() if isinstance(shape, MeshStructure)]
        assert [mesh.name for mesh in meshes] == ["bracket_mesh", "bracket_mesh_2"]
        sizes = {bool(m.scatter): mi.load_dict({"type": "ply", "filename": m.file}).face_count() for m in meshes}
        assert sizes == {True: 2, False: 10}

    def test_without_paint_everything_is_absorbed(self, assembly: Mechanics, tmp_path: Path) -> None:
        for shape in assembly.structures(tmp_path):
            assert shape.coating == Coating(R=0.0)
            assert not shape.scatter
            assert shape.space == -1

    def test_one_side(self, assembly: Mechanics, tmp_path: Path) -> None:
        """Paint on the outside: behind a mesh; in front of a bore, whose normal points into the body."""
        shapes = by_name(assembly.painted({"*": "paint reflectance=0.05 side=back"}).structures(tmp_path))
        sides = {name: shape.scatter[0].properties["side"] for name, shape in shapes.items()}
        assert sides["bracket"] == "back"
        assert [sides[f"ring_front_face_{k}"] for k in range(4)] == ["front", "back", "back", "front"]
        assert len({shape.scatter[0].name for shape in shapes.values()}) == 2

    def test_finish(self) -> None:
        assert finish("black") == Finish()
        assert finish("flat_black") == Finish(scatter=(Scatter("paint", {"preset": "flat_black"}, name="flat_black"),))
        assert finish("R=0.25") == Finish(Coating(R=0.25))
        (model,) = finish("harvey_shack rms_nm=4 l=0.01 s=-1.5").scatter
        assert dict(model.properties) == {"rms_nm": 4.0, "l": 0.01, "s": -1.5}
        assert finish("0.1") == finish("paint reflectance=0.1")
        assert finish("0") == finish("black")
        assert finish("paint reflectance=.1") == finish("paint reflectance=0.10")
        names = {finish(f"paint reflectance={text}").scatter[0].name for text in (".1", "1", "0.01", "1e-5")}
        assert len(names) == 4
        assert finish("paint reflectance=0.05 side=back").scatter[0].name == "paint_reflectance_0_05_side_back"
        assert finish("black", {"black": Finish(None)}) == Finish(None)
        layered = Finish(Coating(layers="MgF2 100", first="back", name="c")).turned()
        assert layered.coating == Coating(layers="MgF2 100", first="front", name="c_turned")

    @pytest.mark.parametrize(
        ("rules", "words"),
        [
            ({"paint": {"rnig*": "black"}}, "no part or face is called 'rnig*'; the nearest are ring, "),
            ({"paint": {"brakcet": "black"}}, "the nearest are bracket, "),
            ({"space": {"zzz": 1}}, "no part or face is called 'zzz'; the nearest are ring_front, ring, "),
            (
                {"paint": {"ring": "flatblack"}},
                "paint 'flatblack': there is none of this name; did you mean flat_black",
            ),
            ({"paint": {"ring": ""}}, "paint '': there is none of this name"),
            ({"paint": {"ring": "R=x"}}, "paint 'R=x'"),
            ({"paint": {"ring": "R=2"}}, "R = 2"),
            ({"paint": {"ring": "1.5"}}, "reflectance is 1.5"),
            ({"paint": {"ring": "nan"}}, "reflectance is nan"),
            (
                {"paint": {"ring": "paint reflectance=0.1 reflectance=0.2"}},
                "scatter 'paint reflectance=0.1 reflectance=0.2': reflectance stands there twice; keep one",
            ),
            ({"paint": {"ring": "paint reflectanc=1"}}, "there is no 'reflectanc'"),
        ],
    )
    def test_mistakes(self, assembly: Mechanics, rules: dict[str, Any], words: str) -> None:
        with pytest.raises(MistrayError) as caught:
            assembly.painted(**rules)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


class TestScenes:
    def test_added(self, assembly: Mechanics, scene_file: Path, tmp_path: Path) -> None:
        """Everything that was there stays, byte for byte; the shapes follow."""
        target = tmp_path / "with.xml"
        shapes = assembly.painted({"ring": "flat_black"}, space={"bracket": 4}).write(target)
        add_structures(scene_file, shapes, target, "Mechanics")
        text = target.read_text(encoding="utf-8")
        assert text.startswith(SCENE.removesuffix("</scene>\n"))
        assert text.count('<bsdf type="paint" id="flat_black">') == 1
        scene = mistray.load(target)
        loaded = {shape.id(): shape for shape in scene.shapes()}
        assert set(loaded) == {"detector"} | {shape.name for shape in shapes}
        assert (loaded["bracket"].part, loaded["bracket"].space) == ("bracket", 4)
        assert loaded["ring_side_face_1"].part == "ring_side"
        np.testing.assert_allclose(loaded["bracket"].bbox().max, [25.4, -44.45, 76.2], rtol=1e-6)

    def test_twice(self, assembly: Mechanics, scene_file: Path) -> None:
        shapes = assembly.write(scene_file)
        add_structures(scene_file, shapes, scene_file)
        with pytest.raises(MistrayError, match="it has an object 'ring_front_face_0' already"):
            add_structures(scene_file, shapes, scene_file)

    def test_paint_of_the_scene(self, scene_file: Path, tmp_path: Path) -> None:
        """A structure that names the scene's own paint refers to it; another paint of that name is refused."""
        own = Scatter("paint", {"reflectance": 0.1}, name="barrel_paint")
        target = tmp_path / "with.xml"
        add_structures(scene_file, [Structure("wall", 9.0, 0.0, 9.0, 5.0, scatter=(own,))], target)
        assert target.read_text(encoding="utf-8").count('id="barrel_paint"') == 2
        other = Scatter("paint", {"reflectance": 0.2}, name="barrel_paint")
        with pytest.raises(MistrayError, match="its object 'barrel_paint' differs from the one of structure 'wall'"):
            add_structures(scene_file, [Structure("wall", 9.0, 0.0, 9.0, 5.0, scatter=(other,))], target)

    def test_one_name_for_two_paints_is_refused(self, scene_file: Path, tmp_path: Path) -> None:
        """One of them would be lost."""
        walls = [
            Structure(f"wall_{k}", 9.0, 0.0, 9.0, 5.0, scatter=(Scatter("paint", {"reflectance": k / 10}, name="p"),))
            for k in (1, 2)
        ]
        target, mesh = tmp_path / "with.xml", tmp_path / "mesh.ply"
        with pytest.raises(MistrayError, match="two different scatter models are called 'p', that of 'wall_2' is one"):
            add_structures(scene_file, walls, target, files={mesh: b"ply"})
        with pytest.raises(MistrayError, match="it has an object 'wall_1' already"):
            add_structures(scene_file, [walls[0], walls[0]], target, files={mesh: b"ply"})
        assert [path.name for path in tmp_path.iterdir()] == ["base.xml"]
        add_structures(scene_file, walls[:1], target, files={mesh: b"ply"})
        assert mesh.read_bytes() == b"ply"

    def test_long_lists_of_layers(self, scene_file: Path, tmp_path: Path) -> None:
        """Whether a value is the name of a file is asked where the scene goes to another folder."""
        layers = ", ".join(30 * ["MgF2 99.64", "TiO2 50"])
        film = f'<bsdf type="thinfilm" id="stack"><string name="layers" value="{layers}"/></bsdf>'
        scene_file.write_text(SCENE.replace("</scene>", f"{film}\n</scene>"), encoding="utf-8")
        (tmp_path / "deeper").mkdir()
        target = tmp_path / "deeper" / "with.xml"
        add_structures(scene_file, [Structure("wall", 9.0, 0.0, 9.0, 5.0)], target)
        assert "<path" not in target.read_text(encoding="utf-8")

    def test_included(self, assembly: Mechanics, scene_file: Path, tmp_path: Path) -> None:
        """A file of mechanics alone is part of a scene by <include>."""
        shapes = assembly.to_xml(tmp_path / "mount.xml")
        including = SCENE.replace("</scene>", '    <include filename="mount.xml"/>\n</scene>')
        scene_file.write_text(including, encoding="utf-8")
        assert {shape.id() for shape in mistray.load(scene_file).shapes()} == {"detector", *(s.name for s in shapes)}

    def test_in_a_prescription(self, assembly: Mechanics, tmp_path: Path) -> None:
        system = mistray.Prescription(
            name="mount",
            surfaces=(),
            structures=assembly.structures(tmp_path),
            detector=mistray.Detector(z=60.0, semi_diameter=5.0),
            source=mistray.Source(radius=2.0),
        )
        system = system.with_scatter({"bracket": [Scatter("paint", {"reflectance": 0.05})]})
        system.to_xml(tmp_path / "scene.xml")
        assert 'type="paint"' in (tmp_path / "scene.xml").read_text(encoding="utf-8")
        for scene in (system.to_scene(), mistray.load(tmp_path / "scene.xml")):
            assert {shape.id() for shape in scene.shapes()} == {shape.name for shape in system.shapes()}


class TestPlugin:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        path = tmp_path / "square.ply"
        corners = np.array([[-2.0, -2, 1], [2, -2, 1], [2, 2, 1], [-2, 2, 1]])
        path.write_bytes(ply_bytes(corners, np.array([[0, 1, 2], [0, 2, 3]])))
        return path

    def shape(self, **values: Any) -> dict[str, Any]:
        return {"type": "part_mesh", "id": "S", "bsdf": {"type": "interface", "R": 0.25, "T": 0.75}, **values}

    def test_labels_and_place(self, file: Path) -> None:
        moved = mi.ScalarTransform4f().translate([0, 0, 2])
        shape = mi.load_dict(self.shape(filename=str(file), part="P", space=7, to_world=moved))
        assert (shape.id(), shape.part, shape.space, shape.face_count()) == ("S", "P", 7, 2)
        assert float(shape.bbox().min.z) == 3.0
        assert "PartMesh[id = S, 2 triangles" in str(shape)
        plain = mi.load_dict(self.shape(filename=str(file)))
        assert (plain.part, plain.space) == ("S", -1)

    def test_trace(self, file: Path) -> None:
        scene = mistray.load(
            {
                "type": "scene",
                "beam": {"type": "collimated", "radius": 1.0},
                "wall": self.shape(filename=str(file), part="window", id="wall"),
                "detector": {
                    "type": "asphere", "semi_diameter": 2.0, "bsdf": {"type": "interface", "R": 0.0},
                    "to_world": mi.ScalarTransform4f().translate([0, 0, 3]),
                    "meter": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
                },
            }
        )  # fmt: skip
        t = mistray.trace(scene, rays=100)
        assert t.paths[0].events == "wall:T detector:A"
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx(0.75, rel=1e-6)
        assert next(row for row in t.surfaces if row.id == "wall").part == "window"

    @pytest.mark.parametrize(
        ("name", "corners", "triangles", "words"),
        [
            (
                "far",
                [[0, 0, 0], [1e13, 0, 0], [0, 1, 0]],
                [[0, 1, 2]],
                "shape 'S': it reaches 1e+13 mm from the origin",
            ),
            (
                "nan",
                [[0, 0, np.nan], [1, 0, 0], [0, 1, 0]],
                [[0, 1, 2]],
                "nan.ply': mesh contains invalid vertex position data; check the path, or export it again",
            ),
            ("none", [[0, 0, 0]], np.empty((0, 3), dtype=int), "none.ply' holds no triangles; export it again"),
        ],
    )
    def test_damaged_files(self, name: str, corners: Any, triangles: Any, words: str, tmp_path: Path) -> None:
        path = tmp_path / f"{name}.ply"
        path.write_bytes(ply_bytes(np.array(corners), np.array(triangles)))
        with pytest.raises(MistrayError) as caught:
            mistray.load({"type": "scene", "S": self.shape(filename=str(path))})
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_a_triangle_without_its_vertex(self, file: Path) -> None:
        file.write_bytes(file.read_bytes()[:-4] + (9).to_bytes(4, "little"))
        with pytest.raises(MistrayError, match="a triangle refers to vertex 9 of 4"):
            mistray.load({"type": "scene", "S": self.shape(filename=str(file))})

    @pytest.mark.parametrize(
        ("values", "words"),
        [
            ({}, "shape 'S': filename is None; name a PLY file"),
            ({"filename": 3.0}, "shape 'S': filename is 3.0; name a PLY file"),
            ({"filename": "none.ply"}, "shape 'S': filename 'none.ply': file not found; check the path, or export it"),
            (
                {"filename": "none.ply", "to_world": mi.ScalarTransform4f().scale([1, 1, -1])},
                "shape 'S': to_world scales, shears or mirrors; use a rigid motion and scale the file",
            ),
        ],
    )
    def test_errors(self, values: dict[str, Any], words: str) -> None:
        with pytest.raises(MistrayError) as caught:
            mistray.load({"type": "scene", "S": self.shape(**values)})
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


class TestCommand:
    @pytest.fixture
    def read_before(self, assembly: Mechanics, monkeypatch: pytest.MonkeyPatch) -> None:
        """The file is not read once more."""
        monkeypatch.setattr(mistray.mechanics, "read_mechanics", lambda *_, **__: assembly)

    def run(self, capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
        status = cli.main(["import", str(DATA / "assembly_inch.step"), *arguments])
        out, err = capsys.readouterr()
        return status, out, err

    def test_into_a_scene(self, scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        output = tmp_path / "out.xml"
        status, out, err = self.run(
            capsys, "-o", str(output), "--into", str(scene_file), "--move-mm", "0", "0", "-5",
            "--paint", "ring*=flat_black", "bracket=barrel_paint", "ring_side=mirror", "--space", "ring*=2",
        )  # fmt: skip
        assert (status, err) == (0, "")
        assert "ring_front: 4 analytic surfaces, 0 meshes\n" in out
        assert f"{output}: 3 parts; next: mistray ghosts {output}" in out
        loaded = {shape.id(): shape for shape in mistray.load(output).shapes()}
        assert loaded["ring_front_face_0"].values["z0"] == 7.7
        assert loaded["ring_front_face_0"].space == 2
        assert float(loaded["bracket"].bbox().max.z) == pytest.approx(71.2, abs=1e-4)
        text = output.read_text(encoding="utf-8")
        assert text.count('<ref id="mirror"/>') == 4
        assert text.count('<ref id="barrel_paint"/>') == 1

    def test_alone(self, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        status, out, _ = self.run(capsys, "--json")
        assert status == 0
        found = json.loads(out)
        assert found["files"] == ["assembly_inch.xml", "assembly_inch_bracket.ply"]
        assert [part["name"] for part in found["parts"]] == ["ring_front", "ring_side", "bracket"]
        assert all(Path(name).is_file() for name in found["files"])

    def test_the_limit_of_exact_surfaces_is_told(self, assembly: Mechanics, tmp_path: Path) -> None:
        """The rings have eight, the block none."""
        few = replace(assembly, most_analytic=3)
        record = import_mechanics._record(few, few.structures(tmp_path))
        assert record["notes"] == ["5 more surfaces could be exact; they stay meshes by --most-analytic 3"]
        assert "\nnote: 5 more surfaces could be exact" in import_mechanics._text(record, tmp_path, True)
        assert import_mechanics._record(assembly, assembly.structures(tmp_path))["notes"] == []

    @pytest.mark.usefixtures("read_before")
    def test_nothing_is_written_where_a_name_is_taken(
        self, scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        output = tmp_path / "out.xml"
        assert self.run(capsys, "-o", str(output), "--into", str(scene_file))[0] == 0
        again = tmp_path / "again.xml"
        status, out, err = self.run(capsys, "-o", str(again), "--into", str(output))
        assert (status, out) == (2, "")
        assert "it has an object 'ring_front_face_0' already" in err
        assert not list(tmp_path.glob("again*"))

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--paint", "rnig*=black"], "no part or face is called 'rnig*'; the nearest are ring"),
            (["--paint", "ring"], "--paint: 'ring' is no paint; write PATTERN=PAINT, such as 'vane*=flat_black'"),
            (["--paint", "ring=blakc"], "paint 'blakc': there is none of this name; did you mean black"),
            (["--space", "ring=x"], "--space: 'x' is not a number"),
            (["--most-analytic", "-1"], "argument --most-analytic: -1 must be a whole number"),
            (["--time-limit-s", "0"], "argument --time-limit-s: 0 must lie"),
            (["--coating", "ring=bbar3"], "--coating: parts get their coating and scatter by --paint; leave it out"),
            (["--into", "plaet"], "scene 'plaet': no such file"),
        ],
    )
    @pytest.mark.usefixtures("read_before")
    def test_mistakes(
        self, arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        status, out, err = self.run(capsys, "-o", str(tmp_path / "out.xml"), *arguments)
        assert (status, out) == (2, "")
        assert words in err
        assert err.count("\n") == 1
        assert not list(tmp_path.iterdir())
