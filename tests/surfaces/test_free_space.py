"""Segments that need not be looked up among stock shapes: none of them meets one."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.mechanics.ply import ply_bytes
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick


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
    old, moved = "<translate z=", f'<translate x="{shift}" z='
    lens = "".join(
        shape_xml("asphere", name, z, interface_xml(*sides), semi_diameter=6.0, curvature=c).replace(
            "<translate z=", moved
        )
        for name, z, sides, c in (("front", 0.0, ("air", "1.5"), 0.02), ("rear", 3.0, ("1.5", "air"), -0.02))
    )
    detector = shape_xml("asphere", "detector", 30.0, sensor=True, half_width=3.0, half_height=3.0)
    text = scene_text(mesh, lens, detector.replace(old, moved), radius=5.0)
    place = f'<float name="distance" value="10"/><transform name="to_world"><translate x="{shift}"/></transform>'
    return text.replace('<float name="radius"', f'{place}<float name="radius"', 1) if shift else text


@pytest.mark.parametrize("shift", [0.0, 500.0])
def test_no_segment_meets_a_shape(tmp_path, shift: float) -> None:
    """300,000 random segments: those that are said to be clear are so by Mitsuba's own intersection."""
    (tmp_path / "scene.xml").write_text(housing_text(tmp_path, shift))
    table = SurfaceTable(mistray.load(tmp_path / "scene.xml"), 550.0)
    assert table.free_space is not None
    rng = np.random.default_rng(2)
    o = rng.uniform((-15, -15, -30), (15, 15, 50), (300_000, 3)) + np.array([shift, 0, 0])
    end = rng.uniform((-15, -15, -30), (15, 15, 50), (300_000, 3)) + np.array([shift, 0, 0])
    length = np.linalg.norm(end - o, axis=1)
    origin, d, t = table.upload_points(o), mi.Vector3f(((end - o) / length[:, None]).T), mi.Float(length)
    clear = np.array(table.free_space.holds(origin, d, t))
    ray = mi.Ray3f(mi.Point3f(origin + table.stock_offset), d)
    ray.maxt = t
    met = np.array(table.stock_scene.ray_test(ray))
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
