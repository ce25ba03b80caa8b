"""`collimated`: power, direction and cross-section of the beam, its start, its errors."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts

import mistray
from mistray.execute.tracer import prepare
from mistray.light import Light
from mistray.settings import Settings

pytestmark = pytest.mark.quick


def emitter(**values: Any) -> Any:
    return mi.load_dict({"type": "collimated", "id": "sun", **values})


def scene_with(values: dict[str, Any], z: float = 0.0) -> Any:
    sun = {"type": "collimated", **values}
    return scene_dicts.load(sun=sun, detector=scene_dicts.detector(z, half_width=50.0, half_height=50.0))


def start_rays(scene: Any, rays: int = 4000, **field: float) -> tuple[np.ndarray, np.ndarray]:
    (run,) = prepare(scene, Settings(rays=rays), Light(**field))
    return run.start_rays(np.arange(run.rays))


@pytest.mark.parametrize(
    ("values", "area"),
    [
        ({"radius": 2.0}, 4 * np.pi),
        ({"radius": 2.0, "inner_radius": 1.0}, 3 * np.pi),
        ({"half_width": 2.0, "half_height": 0.5}, 4.0),
    ],
)
def test_power(values: dict[str, float], area: float) -> None:
    assert emitter(**values, irradiance=3.0, field_deg=60.0).power() == pytest.approx(3 * area, rel=1e-12)
    axis = emitter(**values, irradiance=3.0, field_deg=60.0, plane="axis")
    assert axis.power() == pytest.approx(1.5 * area, rel=1e-12)
    assert axis.power(0.0) == pytest.approx(3 * area, rel=1e-12)
    t = mistray.trace(scene_with({**values, "field_deg": 60.0, "plane": "axis"}), rays=500)
    assert t.energy.launched_W == pytest.approx(area / 2, rel=1e-12)
    assert t.energy.detected_W == pytest.approx(area / 2, rel=1e-6)


@pytest.mark.parametrize("plane", ["beam", "axis"])
@pytest.mark.parametrize(("field_deg", "azimuth_deg"), [(0, 0), (20, 0), (-20, 0), (35, 90), (35, -60)])
def test_direction_and_cross_section(plane: str, field_deg: float, azimuth_deg: float) -> None:
    """Through the pivot, along Rz(azimuth) (0, sin θ, cos θ) of its turned frame, uniform in its plane."""
    pivot = np.array([1.0, -2.0, 3.0])
    to_world = mi.ScalarTransform4d().translate(pivot.tolist()).rotate([1, 0, 0], 15)
    turn = np.array(to_world.matrix)[:3, :3]
    scene = scene_with({"radius": 2.0, "plane": plane, "to_world": to_world}, z=9.0)
    origin, direction = start_rays(scene, field_deg=field_deg, azimuth_deg=azimuth_deg)
    theta, phi = np.radians(field_deg), np.radians(azimuth_deg)
    expected = turn @ [-np.sin(phi) * np.sin(theta), np.cos(phi) * np.sin(theta), np.cos(theta)]
    np.testing.assert_allclose(direction, np.tile(expected, (len(direction), 1)), atol=1e-7)
    # All start on one plane normal to the beam
    assert np.ptp((origin - pivot) @ expected) < 1e-5
    normal = expected if plane == "beam" else turn[:, 2]
    t = ((pivot - origin) @ normal) / (direction @ normal)
    place = origin + t[:, None] * direction - pivot
    assert np.abs(place @ normal).max() < 1e-5
    assert np.linalg.norm(place, axis=1).max() < 2.0 + 1e-5
    # A uniform disc: mean 0, mean square radius 2, each to 4 standard errors
    assert np.abs(place.mean(axis=0)).max() < 4 * 1.0 / np.sqrt(len(place))
    assert np.mean(np.sum(place**2, axis=1)) == pytest.approx(2.0, abs=4 * 2 / np.sqrt(3 * len(place)))


def test_annulus_rectangle_and_start() -> None:
    """Uniform, outside of the scene, or at a distance that is given."""
    origin, _ = start_rays(scene_with({"radius": 2.0, "inner_radius": 1.5}))
    r = np.hypot(origin[:, 0], origin[:, 1])
    assert r.min() > 1.5 - 1e-6
    assert r.max() < 2 + 1e-6
    assert np.mean(r**2) == pytest.approx((2**2 + 1.5**2) / 2, abs=4 * 1.75 / np.sqrt(12 * len(r)))
    origin, _ = start_rays(scene_with({"half_width": 3.0, "half_height": 0.5}))
    assert np.abs(origin[:, :2]).max(axis=0) == pytest.approx([3.0, 0.5], rel=1e-2)
    assert np.mean(origin[:, 0] ** 2) == pytest.approx(3.0, abs=4 * 3 * np.sqrt(0.8 / len(origin)))
    for field in (0.0, 40.0, -75.0):
        origin, direction = start_rays(scene_with({"radius": 2.0}, z=-30.0), field_deg=field)
        corners = np.array([[x, y, -30.0] for x in (-50, 50) for y in (-50, 50)])
        assert (corners @ direction[0]).min() > (origin @ direction[0]).max()
    origin, _ = start_rays(scene_with({"radius": 2.0, "distance": 7.0}, z=9.0))
    np.testing.assert_allclose(origin[:, 2], -7.0, atol=1e-6)


def test_grid() -> None:
    scene = scene_with({"half_width": 1.0, "half_height": 2.0, "pattern": "grid"})
    t = mistray.trace(scene, rays=1000)
    assert t.settings["rays"] == 31**2
    origin, _ = start_rays(scene, rays=1000)
    x, y = (np.unique(column.round(5)) for column in origin[:, :2].T)
    assert len(x) == len(y) == 31
    np.testing.assert_allclose(x[[0, -1]], [-30 / 31, 30 / 31], atol=1e-5)
    assert t.energy.detected_W == pytest.approx(8.0, rel=1e-6)
    disc, _ = start_rays(scene_with({"radius": 2.0, "pattern": "grid"}), rays=10_000)
    assert np.mean(np.sum(disc[:, :2] ** 2, axis=1)) == pytest.approx(2.0, rel=1e-3)
    assert np.abs(disc[:, :2].mean(axis=0)).max() < 1e-5


def test_wavelengths() -> None:
    for given, wavelengths, weights in (
        ({"wavelength_nm": "486.1, 587.6,656.3", "weights": "1, 2, 1"}, [486.1, 587.6, 656.3], [0.25, 0.5, 0.25]),
        ({"wavelength_nm": 600.0}, [600.0], [1.0]),
        ({"wavelength_nm": "500 600"}, [500.0, 600.0], [0.5, 0.5]),
        ({}, [550.0], [1.0]),
    ):
        many = emitter(radius=1.0, **given)
        assert (many.wavelengths_nm.tolist(), many.weights.tolist()) == (wavelengths, weights)
    assert not mi.traverse(many).keys(), "none of its numbers is a Dr.Jit variable that an update could miss"
