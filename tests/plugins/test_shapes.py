"""Shapes as Mitsuba plugins: their parameters, errors and meshes, and how they are displaced and tilted."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles.geometry import Asphere, Frustum
from oracles.small_scenes import STEEP_REAR
from scene_dicts import BLACK

import mistray
from mistray._mitsuba_compat import mesh_arrays
from mistray.surfaces.surfaces import SurfaceTable

FIGURE = {"radius": 20.0, "conic": -0.5, "a4": 1e-4, "a6": -2e-7}
ASPHERE = {"type": "asphere", **FIGURE, "semi_diameter": 6.0, "bsdf": BLACK}
FRUSTUM = {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 3.0, "z1": 4.0, "bsdf": BLACK}
PLANE = {"type": "asphere", "semi_diameter": 2.0, "bsdf": BLACK}


@pytest.mark.quick
def test_defaults() -> None:
    plane = mi.load_dict(PLANE)
    assert plane.plane
    assert not plane.sag(np.linspace(0, 2, 5)).any()
    assert plane.space == -1
    for given, curvature in (
        ({}, 0.0),
        ({"radius": 0.0}, 0.0),
        ({"radius": -np.inf}, 0.0),
        ({"curvature": 0.05}, 0.05),
        ({"radius": 20}, 0.05),
    ):
        assert mi.load_dict(PLANE | given).values["curvature"] == curvature
    named = mi.load_dict(ASPHERE | {"id": "S1", "part": "L1", "space": 3})
    assert (named.id(), named.part, named.space) == ("S1", "L1", 3)


class TestParameters:
    def test_update_makes_the_mesh_again(self) -> None:
        """float32 cannot hold 0.1: what is not changed stays as the scene gave it."""
        shape = mi.load_dict(ASPHERE | {"conic": 0.1})
        params = mi.traverse(shape)
        before = mesh_arrays(shape)[0]
        params["curvature"] = mi.Float(-0.03)
        params.update()
        assert (shape.values["conic"], shape.values["a4"], shape.values["curvature"]) == (0.1, 1e-4, np.float32(-0.03))
        after = mesh_arrays(shape)[0]
        r2 = after[:, 0] ** 2 + after[:, 1] ** 2
        expected = Asphere(-0.03, 0.1, ((2, 1e-4), (3, -2e-7)), 6.0).sag(r2.astype(float))
        np.testing.assert_allclose(after[:, 2], expected, atol=1e-6)
        assert np.abs(after - before).max() > 0.5
        assert shape.bbox().min.z == pytest.approx(float(expected.min()), abs=1e-5)
        dr.enable_grad(params["curvature"])
        params["curvature"] = params["curvature"] * 1.01
        params.update()
        assert shape.values["curvature"] == pytest.approx(-0.0303, rel=1e-6)

    def test_update_in_a_scene_changes_the_trace(self) -> None:
        """A plate that becomes a lens of f = 60/0.5 = 120 mm, 15 mm before the screen, and a plate again."""
        scene = mistray.load("plate")
        params = mi.traverse(scene)
        radii = []
        for curvature in (0.0, -1 / 60, 0.0):
            params["plate_rear.curvature"] = mi.Float(curvature)
            params.update()
            radii.append(mistray.trace(scene, rays=2000).paths[0].rms_radius_mm)
        assert radii[1] / radii[0] == pytest.approx(1 - 15 / 120, rel=2e-3)
        assert radii[2] == pytest.approx(radii[0], rel=1e-9)

    def test_frustum_update_changes_the_trace(self) -> None:
        scene = scene_dicts.load(
            beam={"type": "collimated", "radius": 2.0},
            stop={"type": "frustum", "r0": 1.0, "z0": 0.0, "r1": 5.0, "z1": 0.0, "bsdf": BLACK},
            detector=scene_dicts.detector(1.0, half_width=3.0, half_height=3.0),
        )
        params = mi.traverse(scene)
        for radius in (1.0, 0.5, 1.5):
            params["stop.r0"] = mi.Float(radius)
            params.update()
            energy = mistray.trace(scene, rays=50_000).energy
            assert energy.detected_W == pytest.approx(np.pi * radius**2, abs=4 * energy.detected_se_W)

    @pytest.mark.parametrize(
        ("key", "value", "words"),
        [
            ("semi_diameter", -1.0, "semi_diameter is -1"),
            ("curvature", 0.5, "the conic ends at"),
            ("a8", float("nan"), "a8 is nan"),
            ("inner_semi_diameter", 7.0, "inner_semi_diameter is 7 mm"),
        ],
    )
    def test_bad_update_leaves_everything(self, key: str, value: float, words: str) -> None:
        shape = mi.load_dict({**ASPHERE, "conic": 0.0, "id": "S"})
        params = mi.traverse(shape)
        values, mesh, old = dict(shape.values), mesh_arrays(shape)[0], float(params[key][0])
        params[key] = mi.Float(value)
        with pytest.raises(mistray.MistrayError, match=f"shape 'S': {words}"):
            params.update()
        assert shape.values == values
        assert float(mi.traverse(shape)[key][0]) == old
        np.testing.assert_array_equal(mesh_arrays(shape)[0], mesh)
        params["a4"] = mi.Float(2e-4)  # and the next good one is taken
        params.update()
        assert (shape.values["a4"], shape.values[key]) == (np.float32(2e-4), values[key])


# What stock integrators and viewers see, and the exact surface
MESHES = {
    "asphere": (ASPHERE, Asphere(0.05, -0.5, ((2, 1e-4), (3, -2e-7)), 6.0)),
    "steep": (
        PLANE | {"radius": 3.482, "conic": 8.701, "semi_diameter": STEEP_REAR.outer}
        | {f"a{2 * power}": value for power, value in STEEP_REAR.coefficients},
        STEEP_REAR,
    ),
    "clipped": (
        {"type": "asphere", "radius": -12.0, "half_width": 4.0, "half_height": 2.0, "bsdf": BLACK},
        Asphere(-1 / 12, half_width=4.0, half_height=2.0),
    ),
    "ring": (PLANE | {"radius": 12.0, "inner_semi_diameter": 1.0}, Asphere(1 / 12, outer=2.0, inner=1.0)),
    "plane": (PLANE, Asphere(0.0, outer=2.0)),
    "cone": (FRUSTUM, Frustum(5.0, -1.0, 3.0, 4.0)),
    "cylinder": (FRUSTUM | {"r1": 5.0}, Frustum(5.0, -1.0, 5.0, 4.0)),
    "tip": (FRUSTUM | {"r1": 0.0}, Frustum(5.0, -1.0, 0.0, 4.0)),
    "backward cone": (FRUSTUM | {"z0": 4.0, "z1": -1.0}, Frustum(5.0, 4.0, 3.0, -1.0)),
    "washer": (FRUSTUM | {"z1": -1.0}, Frustum(5.0, -1.0, 3.0, -1.0)),
    "washer outwards": (FRUSTUM | {"r0": 3.0, "r1": 5.0, "z1": -1.0}, Frustum(3.0, -1.0, 5.0, -1.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", MESHES)
def test_hits_and_normals_of_meshes(name: str) -> None:
    """The mesh lies on the surface, within its facets, and its normals point where the formula's do."""
    values, exact = MESHES[name]
    to_world = mi.ScalarTransform4f().translate([1, 2, 3]).rotate([1, 0, 0], 30)
    matrix = np.array(to_world.matrix, dtype=float)
    scene = mi.load_dict({"type": "scene", "s": {**values, "to_world": to_world}}, optimize=False)
    rng, n, reach = np.random.default_rng(3), 4000, exact.extent()
    target, direction = rng.uniform(-1, 1, (n, 3)) * reach, rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = target - 3 * reach * direction
    world = origin @ matrix[:3, :3].T + matrix[:3, 3], direction @ matrix[:3, :3].T
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(world[0].T), mi.Vector3f(world[1].T)))
    t, valid = np.array(si.t, dtype=float), np.array(si.is_valid())
    theirs = exact.first_hit(origin, direction, np.zeros(n, dtype=bool))
    hit = np.isfinite(theirs)
    assert hit.sum() > 300
    assert np.mean(hit != valid) < 0.03  # facets do not reach the rims
    both = hit & valid
    local = exact.normal((origin + theirs[:, None] * direction)[both])
    grazing = np.abs(np.einsum("ij,ij->i", local, direction[both]))
    close = np.abs(t[both] - theirs[both]) * grazing < 6e-3 * reach
    assert close.mean() > 0.97
    cosine = np.einsum("ij,ij->i", np.array(si.n, dtype=float).T[both][close], (local @ matrix[:3, :3].T)[close])
    assert np.quantile(cosine, 0.02) > 0.9
    vertices, faces = mesh_arrays(mi.load_dict(values))
    np.testing.assert_allclose(exact.implicit(vertices.astype(float))[0], 0.0, atol=3e-6)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0
    assert faces.max() < len(vertices)


GLASS = {"type": "interface", "back": "1.5"}
RAYS = 4000
POSE = {"x": 0.2, "y": -0.1, "z": 0.3, "tilt_x": 2.0, "tilt_y": -3.0, "tilt_z": 20.0}
SHAPES = {
    "asphere": {"type": "asphere", "radius": 30.0, "conic": -0.5, "a4": 1e-5, "semi_diameter": 4.0, "bsdf": GLASS},
    "rectangle": {"type": "asphere", "radius": -30.0, "half_width": 4.0, "half_height": 3.0, "bsdf": GLASS},
    "frustum": {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 1.5, "z1": 0.5, "bsdf": GLASS},
    "annulus": {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 1.5, "z1": -1.0, "bsdf": GLASS},
}
BASE = scene_dicts.at(10.0).translate([0.1, 0.2, 0.0]).rotate([1, 0, 0], 5).rotate([0, 0, 1], 30)


def chain(pose: dict[str, float], order: str = "xyz") -> Any:
    motion = BASE.translate([pose.get(axis, 0.0) for axis in "xyz"])
    for axis in order:
        motion = motion.rotate([float(axis == other) for other in "xyz"], pose.get(f"tilt_{axis}", 0.0))
    return motion


def scene(shape: dict[str, Any], to_world: Any) -> mi.Scene:
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 5.0},
        one=shape | {"to_world": to_world},
        detector=scene_dicts.detector(20, half_width=8.0, half_height=8.0),
    )


def traced(there: mi.Scene) -> np.ndarray:
    trace = mistray.trace(there, rays=RAYS, max_reflections=0)
    row = next(row for row in trace.paths if row.events == "one:T detector:A")
    return np.array([RAYS * row.power_W / trace.energy.launched_W, row.x_mm, row.y_mm])


def assert_same(ours: np.ndarray, theirs: np.ndarray) -> None:
    """The frames differ by 1e-16, which the rounding of one ray at a rim may see: 1 of RAYS, moved by up to 8 mm."""
    assert np.all(np.abs(ours - theirs) < [1.5, 8 / RAYS * 1.5, 8 / RAYS * 1.5])


@pytest.mark.parametrize("name", SHAPES)
def test_frame_and_mesh(name: str) -> None:
    ours = mi.load_dict(SHAPES[name] | POSE | {"to_world": BASE})
    theirs = mi.load_dict(SHAPES[name] | {"to_world": chain(POSE)})
    np.testing.assert_allclose(ours.matrix, np.array(chain(POSE).matrix), atol=1e-14)
    np.testing.assert_array_equal(ours.base, np.array(BASE.matrix))
    np.testing.assert_allclose(mesh_arrays(ours)[0], mesh_arrays(theirs)[0], atol=2e-6)
    plain, still = (mi.load_dict(SHAPES[name] | more | {"to_world": BASE}) for more in ({}, dict.fromkeys(POSE, 0)))
    for shape in (plain, still):
        np.testing.assert_array_equal(shape.matrix, np.array(BASE.matrix))
    np.testing.assert_array_equal(mesh_arrays(still)[0], mesh_arrays(plain)[0])
    params = mi.traverse(ours)
    assert {key: float(params[key][0]) for key in POSE} == pytest.approx(POSE)


@pytest.mark.parametrize("name", SHAPES)
def test_it_traces_like_one_that_to_world_placed(name: str) -> None:
    """By its values and by updates, which compile nothing after the first tilt, which is one more orientation."""
    there = scene(SHAPES[name], BASE)
    params, compiled = mi.traverse(there), []
    for step in (0.0, 1.0, 0.5, -0.7):
        pose = {key: step * value for key, value in POSE.items()}
        for key, value in pose.items():
            params[f"one.{key}"] = mi.Float(value)
        params.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            ours = traced(there)
            compiled.append(sum(not k["cache_hit"] for k in dr.kernel_history([dr.KernelType.JIT])))
        theirs = traced(scene(SHAPES[name], chain(pose)))
        assert_same(ours, theirs)
        if step == 1.0:
            assert_same(traced(scene(SHAPES[name] | POSE, BASE)), theirs)
            with pytest.raises(AssertionError):  # the order of the tilts matters
                assert_same(ours, traced(scene(SHAPES[name], chain(POSE, "zyx"))))
    assert compiled[2:] == [0, 0]


def test_a_second_of_arc_of_a_turned_surface_is_not_lost() -> None:
    turned = mi.ScalarTransform4d().rotate([1, 0, 0], 45)
    place = turned.translate([0, 0, 5])
    there = scene_dicts.load(
        a={"type": "asphere", "semi_diameter": 2.0, "bsdf": GLASS, "to_world": turned},
        b=scene_dicts.detector(0, semi_diameter=2.0, to_world=place, tilt_x=1 / 3600),
    )
    table = SurfaceTable(there, 550.0)
    assert len(table.frames) == 3  # with that of the world
    angle = np.arccos(np.clip(table.rotations[0][:, 2] @ table.rotations[1][:, 2], -1, 1))
    assert np.degrees(angle) == pytest.approx(1 / 3600, rel=1e-3)
