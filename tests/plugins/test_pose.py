"""Displaced and tilted shapes: the same as shapes that `to_world` has placed so."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray._mitsuba_compat import mesh_arrays
from mistray.surfaces.surfaces import SurfaceTable

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
    """The motion, by Mitsuba's own transforms."""
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
    """Power (in rays) and centroid of the light that passes the shape once."""
    trace = mistray.trace(there, rays=RAYS, max_reflections=0)
    row = next(row for row in trace.paths if row.events == "one:T detector:A")
    return np.array([RAYS * row.power_W / trace.energy.launched_W, row.x_mm, row.y_mm])


def assert_same(ours: np.ndarray, theirs: np.ndarray) -> None:
    """The frames differ by 1e-16, which the rounding of one ray at a rim may see: 1 of RAYS, moved by up to 8 mm."""
    assert np.all(np.abs(ours - theirs) < [1.5, 8 / RAYS * 1.5, 8 / RAYS * 1.5])


@pytest.mark.parametrize("name", SHAPES)
def test_frame_and_mesh(name: str) -> None:
    """No motion leaves every bit."""
    ours = mi.load_dict(SHAPES[name] | POSE | {"to_world": BASE})
    theirs = mi.load_dict(SHAPES[name] | {"to_world": chain(POSE)})
    np.testing.assert_allclose(ours.matrix, np.array(chain(POSE).matrix), atol=1e-14)
    np.testing.assert_array_equal(ours.base, np.array(BASE.matrix))
    np.testing.assert_allclose(mesh_arrays(ours)[0], mesh_arrays(theirs)[0], atol=2e-6)
    plain, still = (mi.load_dict(SHAPES[name] | more | {"to_world": BASE}) for more in ({}, dict.fromkeys(POSE, 0)))
    for shape in (plain, still):
        np.testing.assert_array_equal(shape.matrix, np.array(BASE.matrix))
    np.testing.assert_array_equal(mesh_arrays(still)[0], mesh_arrays(plain)[0])


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
    """Two surfaces of one orientation at 45 degrees: the table had taken them for one although one was tilted."""
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


def test_values() -> None:
    params = mi.traverse(mi.load_dict(SHAPES["frustum"] | {"x": 0.5}))
    assert {key: float(params[key][0]) for key in POSE} == dict.fromkeys(POSE, 0.0) | {"x": 0.5}
    for key, value, words in (("x", float("inf"), "x is inf"), ("tilt_z", "5 deg", "tilt_z is '5 deg'")):
        with pytest.raises(Exception, match=f"shape 'S': {words}"):
            mi.load_dict(SHAPES["asphere"] | {"id": "S", key: value})
