"""Stock shapes and meshes beside analytic surfaces are hit, split and booked like these."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles import nonsequential
from oracles.small_scenes import interface_xml, meter_xml, scene_text, shape_xml

import mistray
from mistray.mechanics.ply import ply_bytes

GLASS = interface_xml("air", "1.5")
BALL = interface_xml("1.5", "air")  # the normal of a sphere points outwards


def stock(kind: str, shape_id: str, inside: str, transform: str = "", bsdf: str | None = None) -> str:
    """A stock shape's XML with its own parameters and steps of to_world."""
    pose = f'<transform name="to_world">{transform}</transform>' if transform else ""
    return f'<shape type="{kind}" id="{shape_id}">{inside}{pose}{bsdf or interface_xml(R=0.0)}</shape>'


def detector_rectangle(transform: str) -> str:
    return stock("rectangle", "detector", meter_xml(64), transform)


SCREEN = shape_xml("asphere", "detector", 9.0, sensor=True, half_width=2.0, half_height=2.0)


def prism_ply(path: Path) -> Path:
    """A right-angle prism of 10 mm: entrance at z = 0, hypotenuse from (y -5, z 0) to (y 5, z 10), exit at y = -5."""
    corners = [(x, y, z) for x in (-5.0, 5.0) for y, z in ((-5.0, 0.0), (5.0, 0.0), (-5.0, 10.0))]
    # outward normals: entrance -z, exit -y, hypotenuse +y +z, and the two sides
    quads = [(0, 1, 4, 3), (0, 3, 5, 2), (1, 2, 5, 4)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))] + [(0, 2, 1), (3, 4, 5)]
    centre = np.mean(corners, axis=0)
    outward = []
    for t in triangles:
        a, b, c = (np.array(corners[i]) for i in t)
        outside = np.dot(np.cross(b - a, c - a), (a + b + c) / 3 - centre) > 0
        outward.append(t if outside else t[::-1])
    path.write_bytes(ply_bytes(np.array(corners), np.array(outward)))
    return path


def by_events(t: Any) -> dict[str, Any]:
    return {row.events: row for row in t.paths}


class TestDetector:
    @pytest.mark.parametrize("turn", ["", '<rotate z="1" angle="30"/><rotate x="1" angle="20"/>'])
    def test_rectangle_and_asphere_see_the_same(self, load_text, turn: str) -> None:
        lens = [
            shape_xml("asphere", "front", 0.0, GLASS, radius=40.0, semi_diameter=8.0),
            shape_xml("asphere", "rear", 4.0, interface_xml("1.5", "air"), radius=-40.0, semi_diameter=8.0),
        ]
        place = f'{turn}<translate x="0.5" z="30"/>'
        ours = shape_xml("asphere", "detector", 30.0, sensor=True, half_width=6.0, half_height=4.0)
        ours = ours.replace('<translate z="30.0"/>', place)
        a, b = (
            mistray.trace(load_text(scene_text(*lens, d, radius=6.0))[0], rays=4000, field_deg=2.0)
            for d in (ours, detector_rectangle(f'<scale x="6" y="4"/>{place}'))
        )
        assert a.extent == pytest.approx(b.extent, rel=1e-6)
        assert set(by_events(a)) == set(by_events(b))
        for events, row in by_events(a).items():
            other = by_events(b)[events]
            assert abs(other.rays - row.rays) <= 1
            assert other.power_W == pytest.approx(row.power_W, rel=1e-3)
            assert (other.x_mm, other.y_mm) == pytest.approx((row.x_mm, row.y_mm), abs=1e-3)
            assert other.rms_radius_mm == pytest.approx(row.rms_radius_mm, abs=1e-3)
        rough = np.abs(a.irradiance - b.irradiance).sum() / a.irradiance.sum()
        assert rough < 2e-3  # rays that change the pixel

    def test_what_is_refused(self, load_scene) -> None:
        for ball, words in (
            (stock("sphere", "detector", meter_xml(8)), "detector 'detector' is Sphere"),
            (stock("sphere", "ball", "", bsdf='<bsdf type="diffuse"/>') + SCREEN, "shape 'ball' carries the BSDF .*"),
            (stock("sphere", "ball", "", bsdf="<!-- none -->") + SCREEN, "nest an 'interface' in it"),
        ):
            scene = load_scene(scene_text(ball))
            with pytest.raises(mistray.MistrayError, match=words):
                mistray.trace(scene, rays=10)


def test_ball_lens_against_the_float64_oracle(load_text) -> None:
    ball = stock("sphere", "ball", '<float name="radius" value="5"/>', bsdf=BALL)
    screen = shape_xml("asphere", "detector", 9.0, sensor=True, half_width=12.0, half_height=12.0)
    scene, model = load_text(scene_text(ball, screen, radius=3.0))
    t = mistray.trace(scene, rays=400, max_reflections=4, polarization="unpolarized")
    (run,) = t.runs
    origin, direction = run.start_rays(np.arange(400))
    power = np.full(400, run.unit)
    ledger = nonsequential.trace(
        model, origin, direction, power, 550.0, max_reflections=4, max_events=64, flux_threshold=1e-8
    )
    theirs = {record.text.replace(":TIR", ":I"): record for record in ledger.paths}
    assert set(by_events(t)) == set(theirs)
    for events, row in by_events(t).items():
        record = theirs[events]
        assert row.rays == record.rays
        assert row.power_W == pytest.approx(record.power_W, rel=1e-4)
        assert row.x_mm == pytest.approx(record.x_mm, abs=1e-3)
        assert row.rms_radius_mm == pytest.approx(record.rms_radius_mm, abs=1e-3)


def test_prism_turns_the_light_by_total_reflection(load_scene, tmp_path: Path) -> None:
    prism = prism_ply(tmp_path / "prism.ply")
    mesh = stock("ply", "prism", f'<string name="filename" value="{prism}"/>', bsdf=BALL)
    below = shape_xml("asphere", "detector", 0.0, sensor=True, half_width=4.0, half_height=4.0)
    below = below.replace('<translate z="0.0"/>', '<rotate x="1" angle="90"/><translate y="-9" z="5"/>')
    t = mistray.trace(load_scene(scene_text(mesh, below, radius=2.0)), rays=5000)
    direct = t.paths[0]
    assert (direct.events, direct.kind, direct.rays) == ("prism:T prism:I prism:T detector:A", "TIR", 5000)
    assert direct.power_W / t.energy.launched_W == pytest.approx(0.96**2, rel=1e-5)
    assert t.energy.cut["medium"] == 0
    assert abs(t.energy.closure) < 1e-6
    # y of the entrance becomes z of the exit, and the prism does not scale
    assert direct.rms_radius_mm == pytest.approx(2 / np.sqrt(2), abs=4 * direct.rms_radius_se_mm)
    for points in t.history(0, 10).rays:
        x, y = points[0, :2]
        np.testing.assert_allclose(points[1:4], [[x, y, 0], [x, y, 5 - y], [x, -5, 5 - y]], atol=1e-4)
    rows = {row.id: row for row in t.surfaces}
    # entrance, hypotenuse, exit; then back and forth between exit and entrance once more
    assert rows["prism"].hits == 5000 * 7


class TestMixtures:
    def test_nearest_of_both_kinds(self, load_text) -> None:
        """Planes of both kinds in turn, in an order that differs from the file's: each ray meets them by distance."""
        weak = interface_xml(R=0.1, T=0.9)
        ours = [shape_xml("asphere", f"ours_{z}", float(z), weak, semi_diameter=3.0) for z in (6, 2, 4)]
        theirs = [
            stock("rectangle", f"theirs_{z}", "", f'<scale value="3"/><translate z="{z}"/>', weak) for z in (5, 1, 3)
        ]
        screen = shape_xml("asphere", "detector", 8.0, sensor=True, half_width=3.0, half_height=3.0)
        scene, model = load_text(scene_text(*theirs, *ours, screen))
        t = mistray.trace(scene, rays=300, flux_threshold=0.0)
        order = ["theirs_1", "ours_2", "theirs_3", "ours_4", "theirs_5", "ours_6"]
        assert t.paths[0].events == " ".join(f"{name}:T" for name in order) + " detector:A"
        assert len(t.paths) == 1 + 15
        (run,) = t.runs
        origin, direction = run.start_rays(np.arange(300))
        ledger = nonsequential.trace(model, origin, direction, np.full(300, run.unit), 550.0, flux_threshold=0.0)
        assert {row.events for row in t.paths} == {record.text for record in ledger.paths}
        for row in t.paths:
            assert row.power_W == pytest.approx(ledger.find(*row.events.split()).power_W, rel=1e-6)

    def test_cylinder(self, load_scene) -> None:
        """A stock cylinder and a frustum as the wall of a rod: the normal of both points outwards."""
        ends = [
            shape_xml("asphere", "rod_front", 0.0, GLASS, semi_diameter=2.0),
            shape_xml("asphere", "rod_rear", 20.0, interface_xml("1.5", "air"), semi_diameter=2.0),
            shape_xml("asphere", "detector", 20.5, sensor=True, half_width=8.0, half_height=8.0),
        ]
        ends_of_side = '<point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="0" z="20"/>'
        theirs = stock("cylinder", "rod_side", f'{ends_of_side}<float name="radius" value="2"/>', bsdf=BALL)
        ours = shape_xml("frustum", "rod_side", 0.0, BALL, r0=2.0, z0=0.0, r1=2.0, z1=20.0)
        scenes = (load_scene(scene_text(*ends, wall, radius=1.5)) for wall in (ours, theirs))
        a, b = (mistray.trace(scene, rays=3000, field_deg=30.0) for scene in scenes)
        assert b.energy.detected_W == pytest.approx(a.energy.detected_W, rel=2e-3)
        assert b.energy.cut["medium"] < 1e-3 * b.energy.launched_W
        assert b.paths[0].events == a.paths[0].events

    def test_mesh_in_a_dict(self) -> None:
        mesh = mi.Mesh("wall", 4, 2)
        params = mi.traverse(mesh)
        params["vertex_positions"] = [-2, -2, 1, 2, -2, 1, 2, 2, 1, -2, 2, 1]
        params["faces"] = [0, 1, 2, 0, 2, 3]
        params.update()
        mesh.set_bsdf(mi.load_dict({"type": "interface", "R": 0.25, "T": 0.75}))
        beam, film = {"type": "collimated", "radius": 1.0}, scene_dicts.detector(3, type="rectangle")
        t = mistray.trace(scene_dicts.load(beam=beam, wall=mesh, detector=film), rays=100)
        assert t.paths[0].events == "wall:T detector:A"
        assert t.paths[0].power_W / t.energy.launched_W == pytest.approx(0.75, rel=1e-6)
        assert t.paths[0].source == "beam"
