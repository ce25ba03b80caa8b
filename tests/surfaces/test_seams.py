"""No ray passes where two surfaces meet, and segments that need no look-up among stock shapes meet none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.mechanics.ply import ply_bytes
from mistray.plugins.shapes.implicit import Implicit, sqrt
from mistray.ranges import RADIUS_MM, Range
from mistray.surfaces import seams, shell_tree
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick

RAYS = 200_000  # to each seam
PLACE = 131.3  # of the vessels along z, mm: it costs digits
FRONT, REAR, HOLE = 9.7, 14.9, 6.1  # radii, mm
RADIUS, A4 = 31.3, 2.3e-6  # of the front
LENGTH = 83.7  # mm
FRONTS = {
    "disc": {"type": "asphere"},
    "conic": {"type": "asphere", "radius": RADIUS},
    "asphere": {"type": "asphere", "radius": RADIUS, "a4": A4},
    "freeform": {"type": "freeform", "radius": RADIUS, "a4": A4},
}
CONIC = RADIUS - np.sqrt(RADIUS**2 - FRONT**2)
SAGS = {"disc": 0.0, "conic": CONIC, "asphere": CONIC + A4 * FRONT**4, "freeform": CONIC + A4 * FRONT**4}


class Drum(Implicit):
    """A tube by its formula."""

    numbers = ("radius",)
    ranges = {"radius": RADIUS_MM, "low": Range(-1e6, 1e6), "high": Range(-1e6, 1e6)}

    @staticmethod
    def residual(x: Any, y: Any, z: Any, n: Any) -> Any:
        return sqrt(x * x + y * y) - n["radius"]

    @staticmethod
    def gradient(x: Any, y: Any, z: Any, n: Any) -> tuple[Any, Any, Any]:
        r = sqrt(x * x + y * y)
        return x / r, y / r, 0 * z

    @staticmethod
    def coordinate(x: Any, y: Any, z: Any, n: Any) -> Any:
        return z

    @staticmethod
    def generatrix(u: Any, n: Any) -> tuple[Any, Any]:
        return n["radius"] + 0 * u, u

    @staticmethod
    def ends(values: Any) -> tuple[float, float]:
        return values["low"], values["high"]


mi.register_shape("test_drum", Drum)


def vessel(front: str, wall: str) -> tuple[SurfaceTable, list[tuple[float, float]]]:
    """A front, a wall around it, a ring and the detector in its hole, and the radii and places of their seams, mm."""
    black = scene_dicts.BLACK
    rear = REAR if wall == "cone" else FRONT
    ends = {"z0": PLACE + SAGS[front], "z1": PLACE + LENGTH}
    side: dict[str, Any] = {"type": "frustum", "r0": FRONT, "r1": rear, **ends}
    if wall == "drum":
        side = {"type": "test_drum", "radius": FRONT, "low": ends["z0"], "high": ends["z1"]}
    scene = scene_dicts.load(
        beam={"type": "collimated", "radius": 5.0},
        front={**FRONTS[front], "semi_diameter": FRONT, "to_world": scene_dicts.at(PLACE), "bsdf": black},
        side={**side, "bsdf": black},
        ring={"type": "frustum", "r0": rear, "z0": ends["z1"], "r1": HOLE, "z1": ends["z1"], "bsdf": black},
        detector=scene_dicts.detector(PLACE + LENGTH, semi_diameter=HOLE),
    )
    return SurfaceTable(scene, 550.0), [(FRONT, ends["z0"]), (rear, ends["z1"]), (HOLE, ends["z1"])]


def passed(table: SurfaceTable, seams: list[tuple[float, float]]) -> int:
    """Rays from points within a vessel, to points of its seams, that meet nothing there."""
    rng, found = np.random.default_rng(3), 0
    intersector = Intersector(table)
    for radius, z in seams:
        angle = rng.uniform(0, 2 * np.pi, RAYS)
        start = rng.uniform((-4, -4, PLACE + 5), (4, 4, PLACE + LENGTH - 1), (RAYS, 3))
        way = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(RAYS, z)]) - start
        far = np.linalg.norm(way, axis=1)
        along = mi.Vector3f(*(mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in (way / far[:, None]).T))
        none = dr.full(mi.UInt32, NO_SURFACE, RAYS)
        t, _ = intersector.nearest(table.upload_points(start), along, none, mi.Bool(True))
        found += int(np.count_nonzero(np.array(t) > 1.01 * far))
    return found


VESSELS = [("disc", "tube"), ("conic", "cone"), ("asphere", "tube"), ("freeform", "tube"), ("conic", "drum")]


@pytest.mark.parametrize(("front", "wall"), VESSELS)
def test_no_ray_leaves_a_closed_vessel(front: str, wall: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert passed(*vessel(front, wall)) == 0
    if (front, wall) in VESSELS[:3]:  # nor one of many surfaces
        with monkeypatch.context() as patch:
            patch.setattr(shell_tree, "MOST_UNROLLED", 0)
            patch.setattr(shell_tree, "MOST_ASPHERES", 0)
            assert passed(*vessel(front, wall)) == 0
    monkeypatch.setattr(seams, "ROUNDINGS", 0)
    assert passed(*vessel(front, wall)) > 100  # the rays do try the seams


def test_light_at_a_seam_does_not_come_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """A beam some roundings wide at a corner: the wall is met before the board inside, by less than a rounding."""
    radius, end = 14.0, PLACE + 41.704
    paint = {"type": "interface", "R": 0.0, "model": {"type": "paint", "reflectance": 0.9}}
    place = mi.ScalarTransform4f().translate([0, -radius, end])

    def light() -> float:
        scene = scene_dicts.load(
            beam={"type": "collimated", "radius": 3e-5, "to_world": place},
            lid={"type": "frustum", "r0": radius, "z0": PLACE, "r1": 0.1, "z1": PLACE, "bsdf": paint},
            wall={"type": "frustum", "r0": radius, "z0": PLACE, "r1": radius, "z1": end, "bsdf": paint},
            board={"type": "frustum", "r0": radius, "z0": end, "r1": HOLE, "z1": end, "bsdf": paint},
            detector=scene_dicts.detector(end, semi_diameter=HOLE),
        )
        found = mistray.trace(scene, rays=100_000, field_deg=50.0, seed=1, max_scatters=3)
        assert found.energy.absorbed["wall"][0] > 0.1 * found.energy.launched_W
        return float(found.energy.detected_W)

    assert light() == 0
    monkeypatch.setattr(seams, "RIM_ROUNDINGS", 0)
    assert light() > 0


def housing_text(folder: Path, shift: float = 0.0) -> str:
    """A lens-like pair of surfaces and a detector in a cone of triangles with a bracket; all displaced by `shift`."""
    phi = 2 * np.pi * np.arange(24) / 24
    rings = [(9.0 + 0.1 * z, z) for z in np.linspace(-20.0, 40.0, 7)]
    points = np.concatenate([np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(24, z)]) for r, z in rings])
    a = (24 * np.arange(6)[:, None] + np.arange(24)).ravel()
    b = (24 * np.arange(6)[:, None] + np.roll(np.arange(24), -1)).ravel()
    faces = np.concatenate([np.stack([a, b, b + 24], axis=1), np.stack([a, b + 24, a + 24], axis=1)])
    bracket = np.array([[2.0, -1.0, 25.0], [9.0, 0.5, 24.0], [9.0, -2.0, 26.0]])
    faces = np.concatenate([faces, [[len(points), len(points) + 1, len(points) + 2]]])
    points = np.concatenate([points, bracket]) + np.array([shift, 0, 0])
    (folder / "housing.ply").write_bytes(ply_bytes(points, faces))
    mesh = f'<shape type="ply" id="housing"><string name="filename" value="housing.ply"/>{interface_xml(R=0.2)}</shape>'
    shapes = (
        shape_xml("asphere", "front", 0.0, interface_xml("air", "1.5"), semi_diameter=6.0, curvature=0.02),
        shape_xml("asphere", "rear", 3.0, interface_xml("1.5", "air"), semi_diameter=6.0, curvature=-0.02),
        shape_xml("asphere", "detector", 30.0, sensor=True, half_width=3.0, half_height=3.0),
    )
    moved = (shape.replace("<translate z=", f'<translate x="{shift}" z=') for shape in shapes)
    text = scene_text(mesh, *moved, radius=5.0)
    place = f'<float name="distance" value="10"/><transform name="to_world"><translate x="{shift}"/></transform>'
    return text.replace('<float name="radius"', f'{place}<float name="radius"', 1) if shift else text


@pytest.mark.parametrize("shift", [0.0, 500.0])
def test_no_segment_meets_a_shape(tmp_path, shift: float) -> None:
    """300,000 random segments: those that are said to be clear are so by Mitsuba's own intersection."""
    (tmp_path / "scene.xml").write_text(housing_text(tmp_path, shift))
    table = SurfaceTable(mistray.load(tmp_path / "scene.xml"), 550.0)
    assert table.free_space is not None
    rng = np.random.default_rng(2)
    o, end = rng.uniform((-15, -15, -30), (15, 15, 50), (2, 300_000, 3)) + np.array([shift, 0, 0])
    length = np.linalg.norm(end - o, axis=1)
    origin, d, t = table.upload_points(o), mi.Vector3f(((end - o) / length[:, None]).T), mi.Float(length)
    clear = np.array(table.free_space.holds(origin, d, t))
    ray = mi.Ray3f(mi.Point3f(origin + table.mitsuba_offset), d)
    ray.maxt = t
    met = np.array(table.mitsuba_scene.ray_test(ray))
    assert 0.05 < clear.mean() < 0.95
    assert not np.any(clear & met)
    # Most of what meets nothing near the axis is known to be clear
    near = np.maximum(*(np.hypot(p[:, 0] - shift, p[:, 1]) for p in (o, end))) < 5
    before = near & (o[:, 2] < 20) & (end[:, 2] < 20)
    assert clear[before].mean() > 0.99
    assert not np.any(np.array(table.free_space.holds(origin, d, dr.full(mi.Float, dr.inf, len(o)))))


def test_a_shape_on_the_axis(load_text) -> None:
    """Where a stock shape stands across the axis there is nothing to leave out but what lies beside it along z."""
    disc = '<shape type="disk" id="disc"><transform name="to_world"><scale value="2"/><translate z="5"/></transform>'
    text = scene_text(disc + interface_xml(R=0.0) + "</shape>",
                      shape_xml("asphere", "detector", 9.0, sensor=True, half_width=3.0, half_height=3.0))  # fmt: skip
    scene, _ = load_text(text)
    assert SurfaceTable(scene, 550.0).free_space is None
    assert mistray.trace(scene, rays=100).energy.absorbed["disc"][0] == pytest.approx(np.pi)
