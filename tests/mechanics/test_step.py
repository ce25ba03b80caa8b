"""STEP files: units, assemblies, complete and trimmed faces, normals, damage."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mistray import MistrayError
from mistray.io.cad import step
from mistray.io.cad.part import Part, RoundSurface
from mistray.mechanics import Mechanics, read_mechanics
from mistray.mechanics.recognise import bands
from mistray.prescription import MeshStructure, Structure
from mistray.prescription.model import Placed

DATA = Path(__file__).parents[1] / "data"


def volume(part: Part) -> float:
    """mm³ inside of a closed part, by the divergence theorem; negative where normals point inwards."""
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    return float(np.sum(np.cross(a, b) * c)) / 6


def profile_volume(profile: list[tuple[float, float]]) -> float:
    """mm³ of a body of revolution with a polygonal profile: each side sweeps a frustum."""
    pairs = zip(profile, [*profile[1:], profile[0]], strict=True)
    return abs(sum(math.pi / 3 * (r0 * r0 + r0 * r1 + r1 * r1) * (z1 - z0) for (r0, z0), (r1, z1) in pairs))


def ends(structure: Structure) -> tuple[tuple[float, float], ...]:
    """(r, z) of both ends, in an order that does not depend on which is first."""
    return tuple(sorted([(structure.r0, structure.z0), (structure.r1, structure.z1)]))


def saved(tmp_path: Path, text: str, name: str = "part.step") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="ascii")
    return path


@pytest.fixture(scope="module")
def tube() -> Mechanics:
    return read_mechanics(DATA / "vane_tube.step")


@pytest.fixture(scope="module")
def halves(make_step: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Mechanics:
    return read_mechanics(saved(tmp_path_factory.mktemp("halves"), make_step.vane_tube(pieces=2)))


@pytest.fixture(scope="module")
def assembly() -> Mechanics:
    return read_mechanics(DATA / "assembly_inch.step")


def test_the_files_are_what_their_source_writes(make_step: ModuleType) -> None:
    for name, make in make_step.FILES.items():
        assert (DATA / name).read_text(encoding="ascii") == make()


class TestVaneTube:
    def test_every_face_is_analytic(self, tube: Mechanics, make_step: ModuleType, tmp_path: Path) -> None:
        """The 16 sides of the profile, to the last digit."""
        shapes = tube.structures(tmp_path)
        assert all(isinstance(shape, Structure) for shape in shapes)
        profile = make_step.vane_tube_profile()
        sides = zip(profile, [*profile[1:], profile[0]], strict=True)
        assert sorted(map(ends, shapes)) == sorted(tuple(sorted(side)) for side in sides)
        assert all((s.x, s.y, s.z, s.tilt_deg) == (0, 0, 0, (0, 0, 0)) for s in shapes)
        assert {s.part for s in shapes} == {"vane_tube"}
        assert [s.name for s in shapes] == [f"vane_tube_face_{k}" for k in range(16)]
        assert not tube.unread
        assert not list(tmp_path.iterdir())

    def test_the_mesh_is_the_body(self, tube: Mechanics, make_step: ModuleType) -> None:
        """Normals outwards, and the volume to what chords of the circles cut off."""
        (part,) = tube.parts
        assert volume(part) == pytest.approx(profile_volume(make_step.vane_tube_profile()), rel=3e-3)
        assert (part.title, part.product, part.path) == ("vane tube", "vane tube", "vane tube")

    def test_facets_keep_to_their_surfaces(self, tube: Mechanics) -> None:
        """The middle of every edge about the axis lies within 0.01 mm of the circle of its ends."""
        (part,) = tube.parts
        ends_of_edges = part.vertices[part.triangles[:, [0, 1, 1, 2, 2, 0]]].reshape(-1, 2, 3)
        radius = np.hypot(ends_of_edges[..., 0], ends_of_edges[..., 1])
        round_the_axis = (np.ptp(radius, axis=1) < 1e-6) & (np.ptp(ends_of_edges[..., 2], axis=1) < 1e-6)
        chords = ends_of_edges[round_the_axis].mean(axis=1)
        off = radius[round_the_axis].mean(axis=1) - np.hypot(chords[:, 0], chords[:, 1])
        assert len(off) > 16 * 63
        assert 1e-3 < off.max() < 0.01

    def test_outside(self, tube: Mechanics) -> None:
        """The body is outside of the inner wall and of the bevels, inside of the outer wall, behind the front."""
        by_ends = {(band.r0, band.z0, band.r1, band.z1): band.outward for band in bands(tube.parts[0])}
        assert not by_ends[20.0, 0.0, 20.0, 10.0]
        assert not by_ends[12.0, 10.0, 13.0, 11.5]
        assert by_ends[22.0, 0.0, 22.0, 80.0]
        assert not by_ends[20.0, 0.0, 22.0, 0.0]
        assert by_ends[20.0, 80.0, 22.0, 80.0]

    def test_halves_are_joined(self, halves: Mechanics, tmp_path: Path, tube: Mechanics) -> None:
        """The same body with every cylinder and cone cut into two faces."""
        assert len(halves.parts[0].surfaces) == 8 + 2 * 8
        shapes = halves.structures(tmp_path)
        assert sorted(map(ends, shapes)) == sorted(map(ends, tube.structures(tmp_path)))

    def test_halves_with_two_paints_are_meshes(self, halves: Mechanics, tmp_path: Path) -> None:
        joined = next(band for band in bands(halves.parts[0]) if len(band.faces) == 2)
        split = halves.painted({f"vane_tube_face_{joined.faces[0]}": "flat_black"}).structures(tmp_path)
        meshes = [shape for shape in split if isinstance(shape, MeshStructure)]
        assert [len(mesh.scatter) for mesh in meshes] == [1, 0]
        assert len(split) == 15 + 2

    def test_limit(self, tube: Mechanics, tmp_path: Path) -> None:
        """The largest stay analytic: the outer wall has 2π 22·80 mm²."""
        few = replace(tube, most_analytic=1).structures(tmp_path)
        assert [type(shape) for shape in few] == [Structure, MeshStructure]
        assert ends(few[0]) == ((22.0, 0.0), (22.0, 80.0))
        assert few[1].name == "vane_tube_mesh"
        assert [replace(tube, most_analytic=most).beyond_limit for most in (64, 16, 1, 0)] == [0, 0, 15, 16]
        (whole,) = replace(tube, most_analytic=0).structures(tmp_path)
        assert whole.name == "vane_tube"
        assert Path(whole.file) == tmp_path / "vane_tube.ply"

    def test_moved(self, tmp_path: Path) -> None:
        """The tube turned from z to -x."""
        moved = read_mechanics(DATA / "vane_tube.step", at=Placed(x=1.0, y=2.0, z=3.0, tilt_deg=(0.0, -90.0, 0.0)))
        outer = next(s for s in moved.structures(tmp_path) if s.r0 == s.r1 == 22.0)
        centres = outer.to_world() @ np.array([[0, 0, outer.z0, 1], [0, 0, outer.z1, 1]]).T
        found = sorted(centres[:3].T.round(5).tolist())
        assert found == [[-79.0, 2.0, 3.0], [1.0, 2.0, 3.0]]


class TestAssembly:
    """In inches: a ring at z = 0.5 in, the same turned about x at (0, 2, 1) in, and a bracket."""

    def test_units_and_places(self, assembly: Mechanics, tmp_path: Path) -> None:
        shapes = {shape.name: shape for shape in assembly.structures(tmp_path)}
        front = [shapes[f"ring_front_face_{k}"] for k in range(4)]
        profile = [(25.4, 12.7), (38.1, 12.7), (38.1, 19.05), (31.75, 19.05)]
        sides = zip(profile, [*profile[1:], profile[0]], strict=True)
        assert sorted(map(ends, front)) == sorted(tuple(sorted(side)) for side in sides)
        side = shapes["ring_side_face_1"]
        assert (side.x, side.y, side.z) == (0.0, 0.0, 25.4)
        centres = side.to_world() @ np.array([[0, 0, side.z0, 1], [0, 0, side.z1, 1]]).T
        np.testing.assert_allclose(centres[:3].T, [[0, 50.8, 25.4], [0, 57.15, 25.4]], atol=1e-6)

    def test_names(self, assembly: Mechanics) -> None:
        found = [(part.name, part.title, part.product, part.path) for part in assembly.parts]
        assert found == [
            ("ring_front", "ring_front", "ring", "mount/ring_front"),
            ("ring_side", "ring_side", "ring", "mount/ring_side"),
            ("bracket", "bracket", "bracket", "mount/bracket"),
        ]

    def test_the_block_stays_a_mesh(self, assembly: Mechanics, tmp_path: Path) -> None:
        (mesh,) = [shape for shape in assembly.structures(tmp_path) if isinstance(shape, MeshStructure)]
        assert mesh.name == "bracket"
        block = assembly.parts[2]
        assert volume(block) == pytest.approx(2 * 0.25 * 3 * 25.4**3, rel=1e-6)
        np.testing.assert_allclose(block.vertices.min(axis=0), [-25.4, -50.8, 0.0], atol=1e-5)
        np.testing.assert_allclose(block.vertices.max(axis=0), [25.4, -44.45, 76.2], atol=1e-5)

    def test_turned_parts_keep_their_outside(self, assembly: Mechanics) -> None:
        ring = profile_volume([(25.4, 0.0), (38.1, 0.0), (38.1, 6.35), (31.75, 6.35)])
        for part in assembly.parts[:2]:
            assert volume(part) == pytest.approx(ring, rel=3e-3)

    def test_mirrored_parts_too(self, assembly: Mechanics) -> None:
        """Some programs mirror an instance."""
        mirrored = assembly.parts[1].moved(np.diag([1.0, 1.0, -1.0, 1.0]))
        assert volume(mirrored) == pytest.approx(volume(assembly.parts[1]), rel=1e-9)
        assert [band.outward for band in bands(mirrored)] == [band.outward for band in bands(assembly.parts[1])]
        assert bands(mirrored)[0].foot[2] == -25.4

    def test_stretched_parts_are_no_bodies_of_revolution(self, assembly: Mechanics) -> None:
        assert not bands(assembly.parts[0].moved(np.diag([1.0, 1.5, 1.0, 1.0])))
        scaled = bands(assembly.parts[0].moved(np.diag([2.0, 2.0, 2.0, 1.0])))
        assert [band.r1 for band in scaled] == [76.2, 76.2, 76.2, 63.5]


class TestObliqueInstance:
    """A ring with a bore that narrows, in an assembly at an angle that no coordinate axis has."""

    AXIS = (0.48, -0.6, 0.64)
    ORIGIN = (3.0, -7.0, 11.0)

    @pytest.fixture(scope="class")
    @classmethod
    def ring(cls, make_step: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Mechanics:
        step = make_step.Step()
        solid = step.solid_of_revolution([(3.0, 0.0), (5.0, 0.0), (5.0, 2.0), (2.0, 2.0)])
        child, parent = step.product("ring", solid), step.product("all")
        step.place(parent, child, "", cls.ORIGIN, cls.AXIS, (0.8, 0.0, -0.6))
        step.place(parent, child, "NAUO2", (0.0, 0.0, 50.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
        return read_mechanics(saved(tmp_path_factory.mktemp("ring"), step.text("ring.step")))

    def test_instances_without_a_name_are_called_as_their_product(self, ring: Mechanics) -> None:
        assert [part.name for part in ring.parts] == ["ring", "ring_2"]

    def test_place(self, ring: Mechanics, tmp_path: Path) -> None:
        """Ends of the cone: circles of radius 3 and 2 about points on the line through the origin of the instance."""
        shapes = [shape for shape in ring.structures(tmp_path) if shape.part == "ring"]
        assert len(shapes) == 4
        (cone,) = [shape for shape in shapes if {shape.r0, shape.r1} == {2.0, 3.0} and shape.z0 != shape.z1]
        for r, z in ((cone.r0, cone.z0), (cone.r1, cone.z1)):
            centre = (cone.to_world() @ [0, 0, z, 1])[:3]
            expected = np.array(self.ORIGIN) + {3.0: 0.0, 2.0: 2.0}[r] * np.array(self.AXIS)
            np.testing.assert_allclose(centre, expected, atol=2e-5)
        np.testing.assert_allclose(np.abs(cone.to_world()[:3, 2] @ self.AXIS), 1, atol=1e-12)

    def test_upside_down(self, ring: Mechanics, tmp_path: Path) -> None:
        shapes = [shape for shape in ring.structures(tmp_path) if shape.part == "ring_2"]
        assert ((2.0, 48.0), (3.0, 50.0)) in [ends(shape) for shape in shapes]
        assert {shape.tilt_deg for shape in shapes} == {(0.0, 0.0, 0.0)}


class TestTrimmedFaces:
    """A part of a ring of triangles that is cut out: what is left is no band."""

    def faces_of(self, part: Part, keep: np.ndarray) -> Part:
        return replace(part, triangles=part.triangles[keep], faces=part.faces[keep])

    def test_a_wall_with_a_slot(self, tube: Mechanics) -> None:
        part = tube.parts[0]
        centres = part.vertices[part.triangles].mean(axis=1)
        slot = (part.faces == 15) & (np.arctan2(centres[:, 1], centres[:, 0]) > 2.9)
        assert 0 < slot.sum() < 20
        found = bands(self.faces_of(part, ~slot))
        assert sorted(band.faces for band in found) == sorted((face,) for face in range(15))

    def test_a_disc_with_a_hole_beside_its_centre(self, tube: Mechanics) -> None:
        part = tube.parts[0]
        one = np.flatnonzero(part.faces == 0)[3]
        found = bands(self.faces_of(part, np.arange(len(part.faces)) != one))
        assert (0,) not in [band.faces for band in found]

    def test_half_a_tube(self, halves: Mechanics) -> None:
        part = halves.parts[0]
        first = bands(part)
        band = next(band for band in first if len(band.faces) == 2)
        left = self.faces_of(part, part.faces != band.faces[0])
        assert len(bands(left)) == len(first) - 1

    def test_a_polygon_is_no_circle(self) -> None:
        """A regular prism of 24 sides: its corners lie on a circle, its end is no disc."""

        def disc(sides: int) -> Part:
            angle = 2 * np.pi * np.arange(sides) / sides
            rim = np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), np.full(sides, 2.0)])
            triangles = np.array([[0, k, k + 1] for k in range(1, sides - 1)])
            plane = RoundSurface("plane", np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 1.0]))
            return Part("p", "p", "p", "p", rim, triangles, np.zeros(len(triangles), dtype=np.int64), {0: plane})

        assert not bands(disc(24))
        (band,) = bands(disc(64))
        assert (band.r0, band.z0, band.r1, band.z1, band.outward) == (0.0, 2.0, 3.0, 2.0, True)

    def test_a_tip(self) -> None:
        """A whole cone, from its tip."""
        sides = 64
        angle = 2 * np.pi * np.arange(sides) / sides
        rim = np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), np.full(sides, 2.0)])
        vertices = np.vstack([rim, [[0.0, 0.0, 6.0]]])
        triangles = np.array([[k, (k + 1) % sides, sides] for k in range(sides)])
        cone = RoundSurface("cone", np.array([0.0, 0.0, 6.0]), np.array([0.0, 0.0, -1.0]), 0.75)
        (band,) = bands(Part("p", "p", "p", "p", vertices, triangles, np.zeros(sides, dtype=np.int64), {0: cone}))
        assert (band.r0, band.z0, band.r1, band.z1, band.outward) == (3.0, 2.0, 0.0, 6.0, True)


class TestDamage:
    def line(self, path: Path, **options: float) -> str:
        with pytest.raises(MistrayError) as caught:
            read_mechanics(path, **options)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    @pytest.mark.parametrize("share", [0.1, 0.5, 0.999])
    def test_cut_off(self, share: float, tmp_path: Path) -> None:
        text = (DATA / "vane_tube.step").read_text(encoding="ascii")
        message = self.line(saved(tmp_path, text[: int(share * len(text))]))
        assert "it is cut off, 'END-ISO-10303-21;' is missing" in message

    def test_something_else(self, tmp_path: Path) -> None:
        assert "does not begin with 'ISO-10303-21;'" in self.line(saved(tmp_path, "solid\n"))
        assert "files of type '.igs' cannot be read; give .step, .stp" in self.line(tmp_path / "part.igs")
        assert "No such file" in self.line(tmp_path / "other.step")

    def test_nothing_in_it(self, tmp_path: Path) -> None:
        text = (DATA / "vane_tube.step").read_text(encoding="ascii")
        head, tail = text.split("DATA;")[0], "ENDSEC;\nEND-ISO-10303-21;\n"
        message = self.line(saved(tmp_path, f"{head}DATA;\n{tail}"))
        assert message.startswith("STEP file '")
        assert "export" in message

    def test_lost_faces_are_listed(self, tmp_path: Path) -> None:
        """A face whose surface is missing in the file."""
        text = (DATA / "vane_tube.step").read_text(encoding="ascii")
        plane = next(line for line in text.splitlines() if "=PLANE(" in line)
        mechanics = read_mechanics(saved(tmp_path, text.replace(plane + "\n", "")))
        (part,) = mechanics.parts
        assert len(set(part.faces.tolist())) == 15
        number = plane.partition("=")[0]
        assert [item.text for item in mechanics.unread] == [
            f"1 entities that others refer to ({number})",
            "1 of 16 faces of the file",
        ]

    def test_a_lost_instance_is_listed(self, tmp_path: Path) -> None:
        text = (DATA / "assembly_inch.step").read_text(encoding="ascii").replace("'ring'", "'ring #999'")
        assert not read_mechanics(saved(tmp_path, text)).unread
        usage = next(line for line in text.splitlines() if "OCCURRENCE('ring_side'" in line)
        mechanics = read_mechanics(saved(tmp_path, text.replace(usage + "\n", "")))
        assert "ring_side" not in [part.name for part in mechanics.parts]
        assert [item.text for item in mechanics.unread] == [
            f"1 entities that others refer to ({usage.partition('=')[0]})"
        ]

    def test_time_limit(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        """A reader that hangs is ended."""
        slow = tmp_path / "slow.py"
        slow.write_text("import time\ntime.sleep(60)\n", encoding="ascii")
        monkeypatch.setattr(step, "PROGRAM", slow)
        start = time.monotonic()
        assert "not read within 0.1 s" in self.line(DATA / "vane_tube.step", time_limit_s=0.1)
        assert time.monotonic() - start < 10

    def test_limit_of_processor_time(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        """The process ends itself: it runs with the limits of the true one."""
        busy = tmp_path / "busy.py"
        limits = Path(step.__file__).with_name("step_process.py")
        busy.write_text(
            f"import runpy, sys\nsys.modules['cascadio'] = type(sys)('cascadio')\n"
            f"def forever(*a, **k):\n    while True:\n        pass\n"
            f"sys.modules['cascadio'].step_to_glb = forever\nrunpy.run_path({str(limits)!r}, run_name='__main__')\n",
            encoding="ascii",
        )
        monkeypatch.setattr(step, "PROGRAM", busy)
        monkeypatch.setattr(step, "PATIENCE", 1000.0)
        assert "not read within 0.5 s" in self.line(DATA / "vane_tube.step", time_limit_s=0.5)

    def test_a_crash_is_one_line(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        crash = tmp_path / "crash.py"
        crash.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n", encoding="ascii")
        monkeypatch.setattr(step, "PROGRAM", crash)
        assert "OpenCASCADE gives up on it" in self.line(DATA / "vane_tube.step")

    def test_without_cascadio(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        absent = tmp_path / "absent.py"
        absent.write_text("import sys\nsys.exit(3)\n", encoding="ascii")
        monkeypatch.setattr(step, "PROGRAM", absent)
        assert "pip install 'mistray[cad]'" in self.line(DATA / "vane_tube.step")

    def test_wrong_unit(self) -> None:
        with pytest.raises(MistrayError, match="a STEP file states its unit, leave it out"):
            read_mechanics(DATA / "vane_tube.step", unit="inch")
