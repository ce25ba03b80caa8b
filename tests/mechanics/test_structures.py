"""Paint and spaces by name, scene files with mechanics, and the plugin `part_mesh`."""

import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import vectors
from command_line import Captured, Patch, fails, run, succeeds
from oracles.small_scenes import write
from refusals import each_refused, refused

import mistray
from mistray.mechanics import Finish, Mechanics, finish, read_mechanics
from mistray.mechanics.ply import ply_bytes
from mistray.prescription import Coating, MeshStructure, Scatter, Structure
from mistray.scene import add_structures

ASSEMBLY = Path(__file__).parents[1] / "data" / "assembly_inch.step"
SCENE = vectors.text("structures_scene.xml")


@pytest.fixture(scope="module")
def assembly() -> Mechanics:
    return read_mechanics(ASSEMBLY)


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    return write(tmp_path, SCENE, "base.xml")


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

    def test_faces_of_a_mesh_and_one_side(self, assembly: Mechanics, tmp_path: Path) -> None:
        """Two meshes, for two paints: 2 and 10 of the 12 triangles of the block; without paint all is absorbed."""
        shapes = by_name(assembly.painted({"bracket_face_4": "flat_black"}).structures(tmp_path))
        meshes = [shape for shape in shapes.values() if isinstance(shape, MeshStructure)]
        assert [mesh.name for mesh in meshes] == ["bracket_mesh", "bracket_mesh_2"]
        sizes = {bool(m.scatter): mi.load_dict({"type": "ply", "filename": m.file}).face_count() for m in meshes}
        assert sizes == {True: 2, False: 10}
        plain = [shape for shape in shapes.values() if not shape.scatter]
        assert {(shape.coating, shape.space) for shape in plain} == {(Coating(R=0.0), -1)}
        shapes = by_name(assembly.painted({"*": "paint reflectance=0.05 side=back"}).structures(tmp_path))
        sides = {name: shape.scatter[0].properties["side"] for name, shape in shapes.items()}
        assert sides["bracket"] == "back"
        assert [sides[f"ring_front_face_{k}"] for k in range(4)] == ["front", "back", "back", "front"]
        assert len({shape.scatter[0].name for shape in shapes.values()}) == 2

    def test_finish_and_mistakes(self, assembly: Mechanics) -> None:
        assert finish("black") == Finish()
        assert finish("flat_black") == Finish(scatter=(Scatter("paint", {"preset": "flat_black"}, name="flat_black"),))
        assert finish("R=0.25") == Finish(Coating(R=0.25))
        (model,) = finish("harvey_shack rms_nm=4 l=0.01 s=-1.5").scatter
        assert dict(model.properties) == {"rms_nm": 4.0, "l": 0.01, "s": -1.5}
        assert finish("0") == finish("black")
        assert finish("0.1") == finish("paint reflectance=.1") == finish("paint reflectance=0.10")
        assert len({finish(f"paint reflectance={text}").scatter[0].name for text in (".1", "1", "0.01", "1e-5")}) == 4
        assert finish("paint reflectance=0.05 side=back").scatter[0].name == "paint_reflectance_0_05_side_back"
        assert finish("black", {"black": Finish(None)}) == Finish(None)
        layered = Finish(Coating(layers="MgF2 100", first="back", name="c")).turned()
        assert layered.coating == Coating(layers="MgF2 100", first="front", name="c_turned")
        for rules, words in vectors.toml("refusals.toml")["paint of mechanics"]:
            with refused("", words):
                assembly.painted(**rules)


class TestScenes:
    def test_added(self, assembly: Mechanics, scene_file: Path, tmp_path: Path) -> None:
        target = tmp_path / "with.xml"
        shapes = assembly.painted({"ring": "flat_black"}, space={"bracket": 4}).write(target)
        add_structures(scene_file, shapes, target, "Mechanics")
        text = target.read_text(encoding="utf-8")
        assert text.startswith(SCENE.removesuffix("</scene>\n"))
        assert text.count('<bsdf type="paint" id="flat_black">') == 1
        loaded = {shape.id(): shape for shape in mistray.load(target).shapes()}
        assert set(loaded) == {"detector"} | {shape.name for shape in shapes}
        assert (loaded["bracket"].part, loaded["bracket"].space) == ("bracket", 4)
        assert loaded["ring_side_face_1"].part == "ring_side"
        np.testing.assert_allclose(loaded["bracket"].bbox().max, [25.4, -44.45, 76.2], rtol=1e-6)

    def test_paint_of_the_scene(self, scene_file: Path, tmp_path: Path) -> None:
        """Own paint of the scene is referred to; no name may come twice, and then nothing is written."""

        def wall(number: int, name: str, reflectance: float) -> Structure:
            paint = Scatter("paint", {"reflectance": reflectance}, name=name)
            return Structure(f"wall_{number}", 9.0, 0.0, 9.0, 5.0, scatter=(paint,))

        target, mesh = tmp_path / "with.xml", tmp_path / "mesh.ply"
        each_refused(
            ([wall(1, "p", 0.1), wall(2, "p", 0.2)], "two different scatter models are called 'p', that of 'wall_2'"),
            ([wall(1, "p", 0.1), wall(1, "p", 0.1)], "it has an object 'wall_1' already"),
            ([wall(1, "barrel_paint", 0.2)], "its object 'barrel_paint' differs from the one of structure 'wall_1'"),
            by=lambda walls: add_structures(scene_file, walls, target, files={mesh: b"ply"}),
        )
        assert [path.name for path in tmp_path.iterdir()] == ["base.xml"]
        # Whether a value is the name of a file is asked where the scene goes to another folder
        layers = ", ".join(30 * ["MgF2 99.64", "TiO2 50"])
        film = f'<bsdf type="thinfilm" id="stack"><string name="layers" value="{layers}"/></bsdf>'
        scene_file.write_text(SCENE.replace("</scene>", f"{film}\n</scene>"), encoding="utf-8")
        (tmp_path / "deeper").mkdir()
        add_structures(scene_file, [wall(1, "p", 0.1)], tmp_path / "deeper" / "with.xml")
        assert "<path" not in (tmp_path / "deeper" / "with.xml").read_text(encoding="utf-8")
        add_structures(scene_file, [wall(1, "barrel_paint", 0.1)], target, files={mesh: b"ply"})
        assert target.read_text(encoding="utf-8").count('id="barrel_paint"') == 2
        assert mesh.read_bytes() == b"ply"

    def test_alone_and_in_a_prescription(self, assembly: Mechanics, scene_file: Path, tmp_path: Path) -> None:
        names = {shape.name for shape in assembly.to_xml(tmp_path / "mount.xml")}
        scene_file.write_text(
            SCENE.replace("</scene>", '    <include filename="mount.xml"/>\n</scene>'), encoding="utf-8"
        )
        parts = {"surfaces": (), "structures": assembly.structures(tmp_path), "source": mistray.Source(radius=2.0)}
        system = mistray.Prescription(name="mount", detector=mistray.Detector(z=60.0, semi_diameter=5.0), **parts)
        system = system.with_scatter({"bracket": [Scatter("paint", {"reflectance": 0.05})]})
        for scene in (mistray.load(scene_file), system.to_scene()):
            loaded = {shape.id(): shape for shape in scene.shapes()}
            assert set(loaded) == names | {"detector"}
        assert len(loaded["bracket"].bsdf().scatter) == 1


class TestPlugin:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        corners = np.array([[-2.0, -2, 1], [2, -2, 1], [2, 2, 1], [-2, 2, 1]])
        return write(tmp_path, ply_bytes(corners, np.array([[0, 1, 2], [0, 2, 3]])), "square.ply")

    def shape(self, **values: Any) -> dict[str, Any]:
        return {"type": "part_mesh", "id": "S", "bsdf": {"type": "interface", "R": 0.25, "T": 0.75}, **values}

    def test_labels_and_place(self, file: Path) -> None:
        moved = mi.ScalarTransform4f().translate([0, 0, 2])
        shape = mi.load_dict(self.shape(filename=str(file), part="P", space=7, to_world=moved))
        assert (shape.id(), shape.part, shape.space, shape.face_count()) == ("S", "P", 7, 2)
        assert float(shape.bbox().min.z) == 3.0
        plain = mi.load_dict(self.shape(filename=str(file)))
        assert (plain.part, plain.space) == ("S", -1)

    def test_trace(self, file: Path) -> None:
        scene = scene_dicts.load(
            beam={"type": "collimated", "radius": 1.0},
            wall=self.shape(filename=str(file), part="window", id="wall"),
            detector=scene_dicts.detector(3, semi_diameter=2.0),
        )
        t = mistray.trace(scene, rays=100)
        assert t.paths[0].events == "wall:T detector:A"
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx(0.75, rel=1e-6)
        assert next(row for row in t.surfaces if row.id == "wall").part == "window"

    def test_damaged_files(self, file: Path) -> None:
        far, nan = (np.array([[0, 0, 0], place, [0, 1, 0]]) for place in ([1e13, 0, 0], [np.nan, 0, 0]))
        beyond = file.read_bytes()[:-4] + (9).to_bytes(4, "little")
        each_refused(
            (ply_bytes(far, np.array([[0, 1, 2]])), "shape 'S': it reaches 1e\\+13 mm from the origin"),
            (ply_bytes(nan, np.array([[0, 1, 2]])), "mesh contains invalid vertex position data; check the path"),
            (ply_bytes(np.zeros((1, 3)), np.empty((0, 3), dtype=int)), "holds no triangles; export it again"),
            (beyond, "a triangle refers to vertex 9 of 4"),
            by=lambda content: self.load(filename=str(write(file.parent, content, file.name))),
        )
        mirrored = mi.ScalarTransform4f().scale([1, 1, -1])
        each_refused(
            ({}, "shape 'S': filename is None; name a PLY file"),
            ({"filename": "none.ply"}, "shape 'S': filename 'none.ply': file not found; check the path, or export it"),
            ({"filename": "none.ply", "to_world": mirrored}, "shape 'S': to_world scales, shears or mirrors; use a"),
            by=lambda values: self.load(**values),
        )

    def load(self, **values: Any) -> None:
        scene_dicts.load(S=self.shape(**values))


class TestCommand:
    def test_into_a_scene(self, scene_file: Path, tmp_path: Path, capsys: Captured) -> None:
        output = tmp_path / "out.xml"
        out = succeeds(
            capsys, "import", ASSEMBLY, "-o", output, "--into", scene_file, "--move-mm", 0, 0, -5,
            "--paint", "ring*=flat_black", "bracket=barrel_paint", "ring_side=mirror", "--space", "ring*=2",
        )  # fmt: skip
        assert "ring_front: 4 analytic surfaces, 0 meshes\n" in out
        assert "could be exact" not in out
        assert f"{output}: 3 parts; next: mistray ghosts {output}" in out
        loaded = {shape.id(): shape for shape in mistray.load(output).shapes()}
        assert (loaded["ring_front_face_0"].values["z0"], loaded["ring_front_face_0"].space) == (7.7, 2)
        assert float(loaded["bracket"].bbox().max.z) == pytest.approx(71.2, abs=1e-4)
        text = output.read_text(encoding="utf-8")
        assert (text.count('<ref id="mirror"/>'), text.count('<ref id="barrel_paint"/>')) == (4, 1)
        error = fails(capsys, "import", ASSEMBLY, "-o", tmp_path / "again.xml", "--into", output)
        assert "it has an object 'ring_front_face_0' already" in error
        assert not list(tmp_path.glob("again*"))

    def test_alone(self, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
        """The rings have eight exact surfaces, the block none; the limit of their number is told."""
        monkeypatch.chdir(tmp_path)
        found = json.loads(run(capsys, "import", ASSEMBLY, "--json", "--most-analytic", 3)[1])
        meshes = [f"assembly_inch_{name}.ply" for name in ("ring_front_mesh", "ring_side_mesh", "bracket")]
        assert found["files"] == ["assembly_inch.xml", *meshes]
        assert [part["name"] for part in found["parts"]] == ["ring_front", "ring_side", "bracket"]
        assert all(Path(name).is_file() for name in found["files"])
        assert found["notes"] == ["5 more surfaces could be exact; they stay meshes by --most-analytic 3"]

    def test_mistakes(self, assembly: Mechanics, tmp_path: Path, capsys: Captured, monkeypatch: Patch) -> None:
        monkeypatch.setattr(mistray.mechanics, "read_mechanics", lambda *_, **__: assembly)  # not read once more
        for arguments, words in (
            (["--paint", "rnig*=black"], "no part or face is called 'rnig*'; the nearest are ring"),
            (["--paint", "ring"], "--paint: 'ring' is not a paint; write PATTERN=PAINT, such as 'vane*=flat_black'"),
            (["--space", "ring=x"], "--space: 'x' is not a number"),
            (["--most-analytic", "-1"], "argument --most-analytic: -1 must be a whole number"),
            (["--coating", "ring=bbar3"], "--coating: parts get their coating and scatter by --paint; leave it out"),
            (["--into", "plaet"], "scene 'plaet': no such file"),
        ):
            assert words in fails(capsys, "import", ASSEMBLY, "-o", tmp_path / "out.xml", *arguments)
            assert not list(tmp_path.iterdir())
