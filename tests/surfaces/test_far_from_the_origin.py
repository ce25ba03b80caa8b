"""A lens far from the origin of its coordinates is the same lens; gaps that float32 does not resolve are told."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray.optimize.metrics import metric as metrics

FAR = (-3e4, 5e4, -1e5)
PLACES = [(0.0, 0.0, 1e4), (0.0, 0.0, 1e5), FAR]


def lens(place: tuple[float, float, float]) -> mi.Scene:
    """A lens of 60 mm in a scattering tube."""
    base = mi.ScalarTransform4d().translate(list(place))
    behind, rear = base.translate([0, 0, 57]), {"type": "interface", "front": "1.5"}
    grey = {"type": "interface", "R": 0.05}
    wall = {"type": "interface", "R": 0.1, "model": {"type": "abg", "A": 0.01, "B": 0.01, "g": 1.0}}
    face, back = {"type": "asphere", "semi_diameter": 15.0, "to_world": base}, {"type": "interface", "back": "1.5"}
    tube = {"type": "frustum", "r0": 15.0, "z0": 0.0, "r1": 12.0, "z1": 50.0, "to_world": base}
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 10.0, "field_deg": 3.0, "to_world": base},
        front=face | {"radius": 60.0, "bsdf": back},
        rear=face | {"radius": -60.0, "conic": -2.0, "a4": 1e-7, "to_world": base.translate([0, 0, 6]), "bsdf": rear},
        tube=tube | {"bsdf": wall},
        detector=scene_dicts.detector(0, half_width=12.0, half_height=12.0, to_world=behind, bsdf=grey),
    )


def plates(z: float, gap: float, stop: bool = False) -> mi.Scene:
    """Two plates of index 1.7 with a gap; with `stop` a ring at the origin belongs to the scene."""
    ring = {"type": "frustum", "r0": 24.0, "r1": 30.0, "z0": 0.0, "z1": 0.0, "bsdf": scene_dicts.BLACK}
    surfaces = {
        f"s{i}": {
            "type": "asphere",
            "semi_diameter": 25.0,
            "to_world": scene_dicts.at(height),
            "bsdf": {"type": "interface", "back" if i % 2 == 0 else "front": "1.7"},
        }
        for i, height in enumerate([z, z + 2, z + 2 + gap, z + 4 + gap])
    }
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 1.0, "to_world": scene_dicts.at(z)},
        **surfaces,
        **({"stop": ring} if stop else {}),
        detector=scene_dicts.detector(z + 10, semi_diameter=30.0),
    )


@pytest.mark.parametrize("place", PLACES)
def test_paths_and_rays(place: tuple[float, float, float]) -> None:
    here, there = (
        mistray.trace(lens(p), rays=3000, field_deg=25.0, max_reflections=1, max_scatters=1, seed=1)
        for p in ((0.0, 0.0, 0.0), place)
    )
    assert len(here.paths) == len(there.paths) > 4
    for a, b in zip(here.paths, there.paths, strict=True):
        assert (a.events, a.rays) == (b.events, b.rays)
        scattered = any(event.startswith(("Rand", "Imp")) for _, event in a.event_list)  # roundings grow
        assert b.power_W == pytest.approx(a.power_W, rel=1e-4 if scattered else 1e-6)
        assert (b.x_mm, b.y_mm) == pytest.approx((a.x_mm, a.y_mm), abs=1e-3 if scattered else 1e-5)
        assert b.rms_radius_mm == pytest.approx(a.rms_radius_mm, rel=1e-3 if scattered else 1e-5, abs=1e-5)
    rays = [t.history(t.paths[0].path_id, n=4).to_pandas() for t in (here, there)]
    xyz = [table[["x_mm", "y_mm", "z_mm"]].to_numpy() for table in rays]
    assert np.abs(xyz[1] - xyz[0] - place).max() < 1e-5  # the start rays are rounded
    assert rays[1].opl_mm.to_numpy() == pytest.approx(rays[0].opl_mm.to_numpy(), abs=1e-5)


def test_backward_trace() -> None:
    """The same rays to float32, but for one in many thousands that the rounding of its start moves past a rim."""
    here, there = (
        mistray.pst(lens(p), field_deg=[0, 10, 30], method="adjoint", rays=20_000, seed=1)
        for p in ((0.0, 0.0, 0.0), FAR)
    )
    np.testing.assert_allclose(there.value[:2], here.value[:2], rtol=1e-4)
    _, se = here.curve("total")
    assert np.all(np.abs(there.value - here.value) < 1e-5 * here.value + 0.05 * se)


def test_gradients() -> None:
    found = []
    for place in ((0.0, 0.0, 0.0), FAR):
        scene = lens(place)
        metric = metrics.rms_spot(scene, rays=1000, max_reflections=0, max_scatters=0, field_deg=[3.0])
        gradient = mistray.gradient(
            metric, mi.traverse(scene), ["front.curvature", "rear.a4", "rear.tilt_x", "front.z"]
        )
        found.append([float(np.ravel(value)[0]) for value in gradient.gradient.values()])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)


@pytest.mark.parametrize(("z", "gap"), [(3000.0, 3e-4), (3000.0, 1e-4), (300.0, 1e-5), (1e5, 1e-4)])
def test_thin_gap(z: float, gap: float) -> None:
    """Incoherent: all orders between four faces of R = (0.7/2.7)² pass 1 / (1 + 4 R / (1 - R)) of the light."""
    t = mistray.trace(plates(z, gap), rays=500, max_reflections=20)
    reflectance = (0.7 / 2.7) ** 2
    assert t.energy.detected_W / t.energy.launched_W == pytest.approx(
        1 / (1 + 4 * reflectance / (1 - reflectance)), rel=1e-4
    )
    assert t.own_notes == []


def test_unresolved_gap() -> None:
    """The stop at the origin makes the scene 3 m long."""
    scene = plates(3000.0, 1e-4, stop=True)
    line, lost = mistray.trace(scene, rays=500, max_reflections=2).own_notes
    assert lost.startswith("no light reaches the detector")
    assert "'s1'" in line
    assert "'s2'" in line
    assert "0.0001 mm" in line
    report = mistray.ghosts(scene, field_deg=[0.0], rays=500)
    assert line in report.notes
    assert not mistray.trace(plates(3000.0, 1e-2, stop=True), rays=500, max_reflections=2).own_notes


@pytest.mark.parametrize(("field_deg", "azimuth_deg"), [(0.0, 0.0), (17.3, 0.0), (35.0, 61.0)])
def test_optical_path_of_an_oblique_ray(field_deg: float, azimuth_deg: float) -> None:
    """Closed form through a plate, from the table's own start: Σ n t / cos θ; the kernel's directions are float32."""
    t = mistray.trace(
        plates(40.0, 2.0), rays=200, field_deg=field_deg, azimuth_deg=azimuth_deg, max_reflections=0, seed=2
    )
    table = t.history(t.paths[0].path_id, n=20).to_pandas()
    theta = np.radians(field_deg)
    inside = np.sqrt(1 - (np.sin(theta) / 1.7) ** 2)
    for _, ray in table.groupby("ray"):
        start, z = ray.z_mm.iloc[0], ray.z_mm.to_numpy()
        assert z[1:] == pytest.approx([40.0, 42.0, 44.0, 46.0, 50.0], abs=1e-11)
        expected = (50.0 - start - 4.0) / np.cos(theta) + 4.0 * 1.7 / inside
        assert ray.opl_mm.iloc[-1] == pytest.approx(expected, rel=1e-12)
        phi = np.radians(azimuth_deg)
        direction = [-np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi), np.cos(theta)]
        assert ray[["dx", "dy", "dz"]].iloc[0].to_numpy() == pytest.approx(direction, abs=1e-15)
    # All rays start on one plane across the beam
    starts = table[table.node == 0][["x_mm", "y_mm", "z_mm"]].to_numpy()
    assert np.ptp(starts @ direction) < 1e-11
