"""`collimated`: power, direction and cross-section of the beam, its start, its errors."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.execute.tracer import prepare
from mistray.settings import Settings

pytestmark = pytest.mark.quick

BLACK = {"type": "interface", "R": 0.0}


def emitter(**values: Any) -> Any:
    return mi.load_dict({"type": "collimated", "id": "sun", **values})


def scene_with(values: dict[str, Any], z: float = 0.0) -> Any:
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    return mistray.load(
        {
            "type": "scene",
            "sun": {"type": "collimated", **values},
            "detector": {
                "type": "asphere", "half_width": 50.0, "half_height": 50.0, "bsdf": BLACK,
                "to_world": mi.ScalarTransform4f().translate([0, 0, z]),
                "meter": {"type": "irradiancemeter", "film": film},
            },
        }
    )  # fmt: skip


def start_rays(scene: Any, rays: int = 4000, **field: float) -> tuple[np.ndarray, np.ndarray]:
    (run,) = prepare(scene, Settings(rays=rays), **field)
    return run.start_rays(np.arange(run.rays))


class TestBeam:
    @pytest.mark.parametrize(
        ("values", "area"),
        [
            ({"radius": 2.0}, 4 * np.pi),
            ({"radius": 2.0, "inner_radius": 1.0}, 3 * np.pi),
            ({"half_width": 2.0, "half_height": 0.5}, 4.0),
        ],
    )
    def test_power(self, values: dict[str, float], area: float) -> None:
        assert emitter(**values).power() == pytest.approx(area, rel=1e-12)
        assert emitter(**values, irradiance=3.0, field_deg=60.0).power() == pytest.approx(3 * area, rel=1e-12)
        axis = emitter(**values, irradiance=3.0, field_deg=60.0, plane="axis")
        assert axis.power() == pytest.approx(1.5 * area, rel=1e-12)
        assert axis.power(0.0) == pytest.approx(3 * area, rel=1e-12)
        t = mistray.trace(scene_with({**values, "field_deg": 60.0, "plane": "axis"}), rays=500)
        assert t.energy.launched_W == pytest.approx(area / 2, rel=1e-12)
        assert t.energy.detected_W == pytest.approx(area / 2, rel=1e-6)

    @pytest.mark.parametrize("plane", ["beam", "axis"])
    @pytest.mark.parametrize(("field_deg", "azimuth_deg"), [(0, 0), (20, 0), (-20, 0), (35, 90), (35, -60)])
    def test_direction_and_cross_section(self, plane: str, field_deg: float, azimuth_deg: float) -> None:
        """Through the pivot, along Rz(azimuth) (0, sin θ, cos θ), uniform in its plane."""
        pivot = np.array([1.0, -2.0, 3.0])
        to_world = mi.ScalarTransform4f().translate(pivot.tolist())
        scene = scene_with({"radius": 2.0, "plane": plane, "to_world": to_world}, z=9.0)
        origin, direction = start_rays(scene, field_deg=field_deg, azimuth_deg=azimuth_deg)
        theta, phi = np.radians(field_deg), np.radians(azimuth_deg)
        expected = np.array([-np.sin(phi) * np.sin(theta), np.cos(phi) * np.sin(theta), np.cos(theta)])
        np.testing.assert_allclose(direction, np.tile(expected, (len(direction), 1)), atol=1e-7)
        # all start on one plane normal to the beam, outside of the scene
        along = (origin - pivot) @ expected
        assert np.ptp(along) < 1e-5
        normal = expected if plane == "beam" else np.array([0.0, 0.0, 1.0])
        t = ((pivot - origin) @ normal) / (direction @ normal)
        place = origin + t[:, None] * direction - pivot
        assert np.abs(place @ normal).max() < 1e-5
        assert np.linalg.norm(place, axis=1).max() < 2.0 + 1e-5
        # a uniform disc: mean 0, mean square radius 2, each to 4 standard errors
        assert np.abs(place.mean(axis=0)).max() < 4 * 1.0 / np.sqrt(len(place))
        assert np.mean(np.sum(place**2, axis=1)) == pytest.approx(2.0, abs=4 * 2 / np.sqrt(3 * len(place)))

    def test_annulus_and_rectangle(self) -> None:
        origin, _ = start_rays(scene_with({"radius": 2.0, "inner_radius": 1.5}))
        r = np.hypot(origin[:, 0], origin[:, 1])
        assert r.min() > 1.5 - 1e-6
        assert r.max() < 2 + 1e-6
        assert np.mean(r**2) == pytest.approx((2**2 + 1.5**2) / 2, abs=4 * 1.75 / np.sqrt(12 * len(r)))
        origin, _ = start_rays(scene_with({"half_width": 3.0, "half_height": 0.5}))
        assert np.abs(origin[:, :2]).max(axis=0) == pytest.approx([3.0, 0.5], rel=1e-2)
        assert np.mean(origin[:, 0] ** 2) == pytest.approx(3.0, abs=4 * 3 * np.sqrt(0.8 / len(origin)))

    def test_turned_frame(self) -> None:
        """to_world turns axis, field and azimuth together."""
        to_world = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
        _, direction = start_rays(scene_with({"radius": 1.0, "field_deg": 10.0, "to_world": to_world}))
        local = np.array([0, np.sin(np.radians(10)), np.cos(np.radians(10))])
        np.testing.assert_allclose(direction[0], [0, -local[2], local[1]], atol=1e-6)

    def test_start_is_outside_of_the_scene(self) -> None:
        for field in (0.0, 40.0, -75.0):
            scene = scene_with({"radius": 2.0}, z=-30.0)
            origin, direction = start_rays(scene, field_deg=field)
            corners = np.array([[x, y, -30.0] for x in (-50, 50) for y in (-50, 50)])
            assert (corners @ direction[0]).min() > (origin @ direction[0]).max()

    def test_distance(self) -> None:
        origin, _ = start_rays(scene_with({"radius": 2.0, "distance": 7.0}, z=9.0))
        np.testing.assert_allclose(origin[:, 2], -7.0, atol=1e-6)

    def test_grid(self) -> None:
        """A square number of rays, the same for every seed, spread evenly."""
        values = {"half_width": 1.0, "half_height": 2.0, "pattern": "grid"}
        scene = scene_with(values)
        t = mistray.trace(scene, rays=1000)
        assert t.settings["rays"] == 31**2
        origin, _ = start_rays(scene, rays=1000)
        assert len(np.unique(origin[:, 0].round(5))) == len(np.unique(origin[:, 1].round(5))) == 31
        np.testing.assert_allclose(np.sort(np.unique(origin[:, 0].round(5)))[[0, -1]], [-30 / 31, 30 / 31], atol=1e-5)
        assert t.energy.detected_W == pytest.approx(8.0, rel=1e-6)
        disc, _ = start_rays(scene_with({"radius": 2.0, "pattern": "grid"}), rays=10_000)
        assert np.mean(np.sum(disc[:, :2] ** 2, axis=1)) == pytest.approx(2.0, rel=1e-3)
        assert np.abs(disc[:, :2].mean(axis=0)).max() < 1e-5

    def test_wavelengths(self) -> None:
        many = emitter(radius=1.0, wavelength_nm="486.1, 587.6,656.3", weights="1, 2, 1")
        assert many.wavelengths_nm.tolist() == [486.1, 587.6, 656.3]
        assert many.weights.tolist() == [0.25, 0.5, 0.25]
        assert emitter(radius=1.0, wavelength_nm=600.0).wavelengths_nm.tolist() == [600.0]
        assert emitter(radius=1.0, wavelength_nm="500 600").weights.tolist() == [0.5, 0.5]
        assert emitter(radius=1.0).wavelengths_nm.tolist() == [550.0]
        assert str(many) == "Collimated[field = 0 deg, 3.14159 W, 486.1, 587.6, 656.3 nm]"


class TestErrors:
    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ({}, "source 'sun': radius is 0; it must lie between 1e-15 and 1e12 mm"),
            ({"radius": -1.0}, "radius is -1; it must"),
            ({"radius": float("nan")}, "radius is nan; it must"),
            ({"radius": float("inf")}, "radius is inf; it must"),
            ({"radius": 1.0, "inner_radius": 1.0}, "inner_radius is 1 mm; it must lie between 0 and radius = 1 mm"),
            ({"half_width": 1.0}, "half_height is 0; it must lie between 1e-15 and 1e12 mm"),
            ({"radius": 1.0, "half_width": 1.0, "half_height": 1.0}, "give radius or half_width and half_height"),
            ({"radius": 1.0, "field_deg": 90.0}, "field_deg is 90; it must lie between -90 and 90 degrees"),
            ({"radius": 1.0, "azimuth_deg": float("nan")}, "azimuth_deg is nan; it must lie between -360"),
            ({"radius": 1.0, "irradiance": 0.0}, "irradiance is 0; it must lie between 1e-30 and 1e30"),
            ({"radius": 1.0, "irradiance": float("inf")}, "irradiance is inf; it must lie"),
            ({"radius": 1.0, "distance": -1.0}, "distance is -1; it must lie between 0 and 1e12 mm"),
            ({"radius": 1.0, "plane": "disc"}, "plane is 'disc'; use 'beam' or 'axis'"),
            ({"radius": 1.0, "pattern": "hexapolar"}, "pattern is 'hexapolar'; use 'random' or 'grid'"),
            ({"radius": 1.0, "wavelength_nm": -1.0}, "wavelength_nm is -1; it must lie between 10 and 1e7 nm"),
            ({"radius": 1.0, "wavelength_nm": "500, nan"}, "wavelength_nm is nan; it must lie between 10 and 1e7 nm"),
            ({"radius": 1.0, "wavelength_nm": "green"}, "wavelength_nm is 'green'; give one number or a list"),
            ({"radius": 1.0, "weights": "1, 2"}, "2 weights for 1 wavelengths"),
            ({"radius": 1.0, "wavelength_nm": "500, 600", "weights": "0, 0"}, "give one above 0"),
        ],
    )
    def test_message(self, values: dict[str, Any], message: str) -> None:
        with pytest.raises((mistray.MistrayError, RuntimeError)) as caught:
            emitter(**values)
        assert message in str(caught.value)

    def test_unknown_parameter(self) -> None:
        with pytest.raises(RuntimeError, match="diameter"):
            emitter(radius=1.0, diameter=2.0)

    def test_only_rigid_motions(self) -> None:
        with pytest.raises(RuntimeError, match="to_world scales, shears or mirrors"):
            emitter(radius=1.0, to_world=mi.ScalarTransform4f().scale(2.0))


def test_nothing_to_traverse() -> None:
    """Its numbers are those of the scene file or of the call; none is a Dr.Jit variable that an update could miss."""
    assert not mi.traverse(emitter(radius=1.0)).keys()
