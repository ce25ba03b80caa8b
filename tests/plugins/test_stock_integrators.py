"""Stock integrators see our shapes and our interface: radiance through glass is what thermodynamics says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.object_scenes import painted_tube_text
from oracles.scatter_integrals import disc_to_disc
from oracles.small_scenes import write
from oracles.statistics import assert_z

import mistray

T = mi.ScalarTransform4f


def glass(front: str, back: str, **coating: Any) -> dict[str, Any]:
    return {"type": "interface", "front": front, "back": back, **coating}


def lens(index: str = "1.5", **coating: Any) -> dict[str, Any]:
    """A closed biconvex lens, 6 mm thick, with a polished edge between its rims."""
    rim = 20 - np.sqrt(400 - 64)
    return {
        "front": {"type": "asphere", "radius": 20.0, "semi_diameter": 8.0, "bsdf": glass("air", index, **coating)},
        "rear": {
            "type": "asphere", "radius": -20.0, "semi_diameter": 8.0, "to_world": T().translate([0, 0, 6]),
            "bsdf": glass(index, "air", **coating),
        },
        "edge": {
            "type": "frustum", "r0": 8.0, "z0": float(rim), "r1": 8.0, "z1": float(6 - rim),
            "bsdf": glass(index, "air", **coating),
        },
    }  # fmt: skip


def render(shapes: dict[str, Any], eye: list[float], target: list[float], **integrator: Any) -> np.ndarray:
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "path", "max_depth": 100, "rr_depth": 1000},
            "sky": {"type": "constant", "radiance": 1.0},
            "camera": {
                "type": "perspective", "fov": 30.0, "to_world": T().look_at(eye, target, [0, 1, 0]),
                "film": {
                    "type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                },
            },
            **shapes,
        },
        optimize=False, parallel=False,
    )  # fmt: skip
    return np.array(mi.render(scene, spp=128))[:, :, 0]


@pytest.mark.long
@pytest.mark.parametrize("coating", [{}, {"R": 0.2, "T": 0.8}, {"R": 1.0, "T": 0.0}])
def test_white_furnace(coating: dict[str, float]) -> None:
    """A lossless lens in even light is invisible, ray by ray: R + T = 1 leaves nothing to chance."""
    image = render(lens(**coating), [0, 0, -40], [0, 0, 3])
    np.testing.assert_allclose(image, 1.0, rtol=1e-5)


def test_radiance_inside_of_glass() -> None:
    """L/n² is invariant: an eye in the glass sees n² times the radiance of the sky."""
    image = render(lens(), [0, 0, 3], [0, 0, 5])
    np.testing.assert_allclose(image, 1.5**2, rtol=1e-5)


def test_absorption() -> None:
    """Behind one surface that passes 0.5 and reflects 0.3 the sky has 0.8 of its radiance."""
    plate = {"plate": {"type": "asphere", "semi_diameter": 50.0, "bsdf": glass("air", "air", R=0.3, T=0.5)}}
    image = render(plate, [0, 0, -40], [0, 0, 0])
    np.testing.assert_allclose(image, 0.8, rtol=1e-5)
    black = {"plate": {"type": "asphere", "semi_diameter": 50.0, "bsdf": glass("air", "air", R=0.0)}}
    assert not render(black, [0, 0, -40], [0, 0, 0]).any()


def test_direct_illumination() -> None:
    """The `direct` integrator: a mirror shows the sky, a window does not scatter it."""
    mirror = {"m": {"type": "asphere", "semi_diameter": 50.0, "bsdf": glass("air", "air", R=0.9)}}
    image = render(mirror, [0, 0, -40], [0, 0, 0], type="direct", bsdf_samples=1, emitter_samples=0)
    np.testing.assert_allclose(image, 0.9, rtol=1e-5)


@pytest.mark.long
def test_a_lens_magnifies() -> None:
    """Refraction by the mesh and the interface: a bright disk behind a strong lens looks larger."""
    disk = {
        "disk": {
            "type": "disk", "to_world": T().translate([0, 0, 12]).rotate([1, 0, 0], 180).scale(2.0),
            "bsdf": {"type": "diffuse", "reflectance": 0.0}, "light": {"type": "area", "radiance": 50.0},
        }
    }  # fmt: skip
    bare = render(disk, [0, 0, -40], [0, 0, 3]) > 20
    magnified = render({**disk, **lens()}, [0, 0, -40], [0, 0, 3]) > 20
    assert magnified.sum() > 1.5 * bare.sum()


INCIDENCE_DEG, GLASS = 40.0, "1.5168"


def window(film: dict[str, Any]) -> dict[str, Any]:
    """A plane plate of 3 mm with a coating on both faces, 60 mm wide."""
    size = {"type": "asphere", "half_width": 30.0, "half_height": 30.0}
    return {
        "ar": {"type": "thinfilm", **film},
        "front": {**size, "bsdf": glass("air", GLASS, coating={"type": "ref", "id": "ar"})},
        "rear": {
            **size,
            "to_world": T().translate([0, 0, 3]),
            "bsdf": glass(GLASS, "air", coating={"type": "ref", "id": "ar"}),
        },
    }


@pytest.mark.long
@pytest.mark.parametrize(
    "film", [{"preset": "bbar3"}, {"layers": "2.1+0.3i 20, 1.46 90"}, {"layers": "2.3 0.25w, 1.38 0.25w, 2.3 0.25w"}]
)
def test_a_coated_window_under_path_and_straylight(film: dict[str, Any]) -> None:
    """
    A screen behind a coated window, seen by `path` at 40°, has the brightness that `straylight` gives a beam.

    Both follow the reflections inside of the plate. False-alarm probability 1e-3.
    """
    beam = mistray.load(
        {
            "type": "scene",
            "beam": {"type": "collimated", "radius": 2.0, "field_deg": INCIDENCE_DEG},
            **window(film),
            "detector": {
                "type": "asphere", "half_width": 40.0, "half_height": 40.0, "to_world": T().translate([0, 0, 10]),
                "bsdf": glass("air", "air", R=0.0),
                "sensor": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
            },
        }
    )  # fmt: skip
    # `path` carries no polarisation from one face to the other
    unpolarized = {"polarization": "unpolarized", "max_reflections": 20, "flux_threshold": 1e-9}
    energy = mistray.trace(beam, rays=500, **unpolarized).energy
    passed = energy.detected_W / energy.launched_W
    along = np.array([0.0, np.sin(np.radians(INCIDENCE_DEG)), np.cos(np.radians(INCIDENCE_DEG))])
    screen = {
        "screen": {
            "type": "rectangle", "to_world": T().translate([0, 0, 20]).rotate([1, 0, 0], 180).scale(200.0),
            "bsdf": {"type": "diffuse", "reflectance": 0.0}, "light": {"type": "area", "radiance": 1.0},
        }
    }  # fmt: skip
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 50, "rr_depth": 1000},
            "camera": {
                "type": "orthographic",
                "to_world": T().look_at((-40 * along).tolist(), [0, 0, 0], [1, 0, 0]).scale([2, 2, 1]),
                "film": {
                    "type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                },
            },
            **window(film), **screen,
        },
        optimize=False, parallel=False,
    )  # fmt: skip
    pixels = np.array(mi.render(scene, spp=8192, seed=3)).ravel().astype(float)
    error = pixels.std(ddof=1) / np.sqrt(pixels.size)
    assert error < 4e-4
    # what straylight leaves out beyond 20 reflections, and float32
    assert_z("radiance of the screen", pixels.mean(), passed, error, false_alarm=1e-3, floor=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["prb", "prb_basic", "prbvolpath", "prb_projective", "direct_projective"])
def test_gradients_while_another_scene_lives(kind: str) -> None:
    """Mitsuba's virtual calls trace every emitter and BSDF of the process, those of other scenes too."""
    other = mistray.load(
        {
            "type": "scene",
            "beam": {"type": "collimated", "radius": 2.0},
            "window": {"type": "asphere", "semi_diameter": 5.0, "bsdf": glass("air", "1.5")},
        }
    )  # fmt: skip
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": kind},
            "lamp": {
                "type": "rectangle", "to_world": T().look_at([4, 0, -4], [0, 0, 0], [0, 1, 0]),
                "light": {"type": "area", "radiance": 10.0},
            },
            "plate": {
                "type": "rectangle", "to_world": T().rotate([1, 0, 0], 180),
                "bsdf": glass("air", "air", R=0.9, s={"type": "abg", "A": 0.01, "B": 0.05, "g": 2.0}),
            },
            "camera": {
                "type": "perspective", "fov": 20.0, "to_world": T().look_at([0, 0, -5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
            },
        },
        optimize=False, parallel=False,
    )  # fmt: skip
    params = mi.traverse(scene)
    key = next(name for name in params.keys() if name.endswith("abg.A"))  # noqa: SIM118
    dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.mean(mi.render(scene, params, spp=16, seed=1).array))
    assert float(dr.grad(params[key])[0]) > 0
    assert len(other.emitters()) == 1


FILM = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}, "pixel_format": "luminance"}


def detector(**size: float) -> dict[str, Any]:
    return {
        "type": "asphere", **size, "bsdf": glass("air", "air", R=0.0),
        "sensor": {"type": "irradiancemeter", "film": FILM},
    }  # fmt: skip


def irradiance(scene: mi.Scene, spp: int = 4096, **integrator: Any) -> tuple[float, float]:
    """Mean over the detector by a stock integrator, and its standard error from the pixels, which are independent."""
    stock = mi.load_dict(integrator or {"type": "path", "max_depth": 64, "rr_depth": 1000})
    pixels = np.array(mi.render(scene, integrator=stock, spp=spp, seed=7), dtype=float).ravel()
    return float(pixels.mean()), float(pixels.std(ddof=1) / np.sqrt(pixels.size))


def stock_scene(**shapes: Any) -> mi.Scene:
    return mi.load_dict({"type": "scene", **shapes}, optimize=False, parallel=False)


class TestStockSensor:
    """The `irradiancemeter` of a detector looks to the front, where the light of a trace comes from."""

    @pytest.mark.parametrize("size", [{"semi_diameter": 3.0}, {"half_width": 2.0, "half_height": 3.0}])
    def test_sky(self, size: dict[str, float]) -> None:
        """π times the radiance of the sky."""
        sky = {"type": "constant", "radiance": 1.0}
        assert irradiance(stock_scene(sky=sky, d=detector(**size)), 64)[0] == pytest.approx(np.pi, rel=1e-5)

    def test_lamp(self) -> None:
        """A round lamp of 1 W/mm²/sr in front of the detector, in closed form; one behind it is not seen."""

        def lamp(z: float, turned: float) -> dict[str, Any]:
            place = T().translate([0, 0, z]).rotate([1, 0, 0], turned).scale(3.0)
            return {"type": "disk", "to_world": place, "light": {"type": "area", "radiance": 1.0}}

        found, error = irradiance(stock_scene(d=detector(semi_diameter=2.0), lamp=lamp(-6.0, 0.0)))
        exact = np.pi * disc_to_disc(2.0, 3.0, 6.0)
        assert error < 0.01 * exact
        # The mesh is a polygon of 96 sides
        assert_z("lamp", found, exact, error, floor=1e-3 * exact)
        assert irradiance(stock_scene(d=detector(semi_diameter=2.0), lamp=lamp(6.0, 180.0)), 64)[0] == 0

    @pytest.mark.long
    def test_a_painted_tube_under_path_and_straylight(self, tmp_path: Path) -> None:
        """The sky through a painted tube: `path` against the PST of `straylight`, integrated over the hemisphere."""
        text = painted_tube_text(3.0, 1.0, 1.0, 0.3)
        pst = mistray.pst(mistray.load(write(tmp_path, text)), field_deg=range(0, 91, 2), rays=100_000, max_scatters=12)
        value, se = pst.curve()
        cells = pst.grid.solid_angle
        assert cells.sum() == pytest.approx(2 * np.pi, rel=1e-6)
        tube = {
            "type": "frustum", "r0": 1.0, "z0": 0.0, "r1": 1.0, "z1": 3.0,
            "bsdf": glass("air", "air", R=0.0, paint={"type": "paint", "reflectance": 0.3}),
        }  # fmt: skip
        end = {**detector(semi_diameter=1.0), "to_world": T().translate([0, 0, 3])}
        found, error = irradiance(stock_scene(sky={"type": "constant", "radiance": 1.0}, tube=tube, d=end))
        expected, expected_se = float(value @ cells), float(np.linalg.norm(se * cells))
        both = np.hypot(error, expected_se)
        assert both < 0.01 * expected
        assert_z("sky", found, expected, both, floor=1e-3 * expected)

    def test_sides_of_a_detector(self) -> None:
        """Seen from the front, a detector of glass reflects and refracts as its front and back say."""
        plate = {
            "type": "asphere", "semi_diameter": 50.0, "bsdf": glass("air", "1.5"),
            "sensor": {"type": "irradiancemeter", "film": FILM},
        }  # fmt: skip
        image = render({"plate": plate}, [0, 0, -40], [0, 0, 0])
        # R + T/n²: the sky has the same radiance in the glass, which the eye sees divided by n²
        r = 0.04
        middle = image[8:16, 8:16].mean()
        assert middle == pytest.approx(r + (1 - r) / 1.5**2, rel=0.01)

    def test_a_shared_interface(self) -> None:
        shared = mi.load_dict(glass("air", "1.5"))
        scene = {"d": {**detector(semi_diameter=1.0), "bsdf": shared}, "e": {"type": "asphere", "semi_diameter": 2.0}}
        with pytest.raises(Exception, match="shared by a detector and another shape"):
            stock_scene(**scene | {"e": {**scene["e"], "bsdf": shared}})


class TestCollimated:
    """What stock integrators see of a beam: what it lights in the open, not what it lights through glass."""

    @pytest.mark.parametrize("field_deg", [0.0, 40.0])
    @pytest.mark.parametrize("kind", ["path", "direct"])
    def test_a_white_screen(self, kind: str, field_deg: float) -> None:
        """Radiance ρ E cos θ / π where the beam lands, and nothing beside it."""
        scene = stock_scene(
            beam={"type": "collimated", "radius": 2.0, "field_deg": field_deg, "irradiance": 3.0},
            screen={"type": "rectangle", "to_world": T().rotate([1, 0, 0], 180).scale(9.0),
                    "bsdf": {"type": "diffuse", "reflectance": 0.6}},
            camera={"type": "orthographic", "to_world": T().look_at([0, 0, -9], [0, 0, 0], [0, 1, 0]).scale([6, 6, 1]),
                    "film": FILM | {"width": 64, "height": 64}},
        )  # fmt: skip
        image = np.array(mi.render(scene, integrator=mi.load_dict({"type": kind}), spp=64)).squeeze()
        cosine = np.cos(np.radians(field_deg))
        exact = 0.6 * 3.0 * cosine / np.pi
        np.testing.assert_allclose(image[30:34, 30:34], exact, rtol=1e-4)
        assert image[0, 0] == 0
        # The lit area, an ellipse of 2 mm by 2 mm / cos θ; 64 points a pixel put it to 1 %
        assert image.mean() * 144 == pytest.approx(exact * np.pi * 4 / cosine, rel=0.01)

    @pytest.mark.long
    def test_particles(self) -> None:
        """`ptracer` follows the same beam; the screen is seen from aside. One of a thousand such tests fails."""
        scene = stock_scene(
            beam={"type": "collimated", "half_width": 2.0, "half_height": 1.0, "field_deg": 20.0, "plane": "axis"},
            screen={"type": "rectangle", "to_world": T().rotate([1, 0, 0], 180).scale(9.0),
                    "bsdf": {"type": "diffuse", "reflectance": 0.6}},
            camera={"type": "perspective", "fov": 40.0, "to_world": T().look_at([6, 0, -12], [0, 0, 0], [0, 1, 0]),
                    "film": FILM},
        )  # fmt: skip
        path, particles = (
            np.array([
                np.array(mi.render(scene, integrator=mi.load_dict({"type": kind}), spp=256, seed=k)).mean()
                for k in range(8)
            ])
            for kind in ("path", "ptracer")
        )  # fmt: skip
        error = np.hypot(path.std(ddof=1), particles.std(ddof=1)) / np.sqrt(8)
        assert error < 0.02 * path.mean()
        assert_z("particles", particles.mean(), path.mean(), error, k=5.4)  # Student's t, 7 degrees of freedom

    @pytest.mark.long
    def test_behind_glass(self) -> None:
        """A shadow ray to the beam ends at the first face: `path` sees no screen behind a window."""
        scene = stock_scene(
            beam={"type": "collimated", "radius": 2.0},
            window={"type": "asphere", "semi_diameter": 9.0, "to_world": T().translate([0, 0, -2]),
                    "bsdf": glass("air", "1.5")},
            screen={"type": "rectangle", "to_world": T().rotate([1, 0, 0], 180).scale(9.0),
                    "bsdf": {"type": "diffuse", "reflectance": 0.6}},
            camera={"type": "perspective", "to_world": T().look_at([0, 0, -1], [0, 0, 0], [0, 1, 0]), "film": FILM},
        )  # fmt: skip
        assert not np.array(mi.render(scene, integrator=mi.load_dict({"type": "path"}), spp=16)).any()


@pytest.mark.parametrize("plane", ["beam", "axis"])
@pytest.mark.parametrize(
    "size", [{"radius": 2.0}, {"radius": 2.0, "inner_radius": 1.5}, {"half_width": 2.0, "half_height": 0.5}]
)
def test_rays_and_shadow_rays_of_a_beam_agree(size: dict[str, float], plane: str) -> None:
    """Every point that a ray of the beam reaches is lit from there, and as much area as the beam has is lit."""
    beam = {"type": "collimated", **size, "plane": plane, "field_deg": 35.0, "azimuth_deg": 70.0, "irradiance": 2.5}
    emitter = mi.load_dict(beam | {"to_world": T().translate([1, 2, 3]).rotate([0.6, 0.8, 0], 30)})
    rng = np.random.default_rng(3)

    def light(p: mi.Point3f) -> tuple[mi.DirectionSample3f, np.ndarray]:
        it = dr.zeros(mi.SurfaceInteraction3f, dr.width(p))
        it.p = p
        ds, spectrum = emitter.sample_direction(it, mi.Point2f(0.5))
        return ds, np.array(spectrum)[0]

    ray, _ = emitter.sample_ray(0.0, 0.5, mi.Point2f(*(0.001 + 0.998 * rng.random((2, 2000)))), mi.Point2f(0.5))
    ds, found = light(ray(3.7))
    assert np.mean(found == 2.5) > 0.998  # rounding at the rim
    np.testing.assert_allclose(np.array(ds.d)[:, 0], -np.array(ray.d)[:, 0], atol=1e-6)
    np.testing.assert_allclose(np.array(ds.dist), 3.7, rtol=1e-3)
    assert not light(ray(-3.7))[1].any()
    count, half = 200_000, 6.0
    frame = mi.Frame3f(mi.Vector3f(ray.d[0][0], ray.d[1][0], ray.d[2][0]))
    u, v = half * (2 * rng.random((2, count)) - 1)
    pivot = mi.Point3f(1, 2, 3)
    _, found = light(pivot + frame.s * mi.Float(u) + frame.t * mi.Float(v))
    share = emitter.power() / emitter.irradiance / (2 * half) ** 2
    assert_z("area", np.mean(found > 0), share, np.sqrt(share / count))


def _irradiance(scene: mi.Scene, samples: int = 16_000) -> tuple[float, float]:
    """Mean irradiance on the detector by `path`, with its standard error from 16 renderings."""
    path = mi.load_dict({"type": "path", "max_depth": 40})
    images = [np.array(mi.render(scene, spp=samples, seed=seed, integrator=path)) for seed in range(16)]
    found = [float(image[..., 0].mean()) for image in images]
    return float(np.mean(found)), float(np.std(found, ddof=1) / 4)


@pytest.mark.parametrize("light", ["area", "constant"])
def test_stock_light_under_path_and_in_a_trace(light: str) -> None:
    """
    A painted plate beside the detector, a glass plate over it, and a lamp or a sky: the same irradiance both ways.

    False-alarm probability 1e-3 for both.
    """
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}, "pixel_format": "luminance"}
    white = {"type": "interface", "R": 0.0, "scatter": {"type": "abg", "A": 0.2, "B": 1.0, "g": 0.0}}
    shapes: dict[str, Any] = {
        "plate": {
            "type": "asphere",
            "half_width": 15.0,
            "half_height": 15.0,
            "to_world": T().translate([0, 14, -10]).rotate([1, 0, 0], 60),
            "bsdf": white,
        },
        # The meter looks one way, a detector of a trace both
        "lid": {"type": "asphere", "semi_diameter": 60.0, "z": 0.1, "bsdf": glass("air", "air", R=0.0)},
        "front": {"type": "asphere", "half_width": 9.0, "half_height": 9.0, "z": -4.0, "bsdf": glass("air", "1.5")},
        "rear": {"type": "asphere", "half_width": 9.0, "half_height": 9.0, "z": -2.0, "bsdf": glass("1.5", "air")},
        "detector": {
            "type": "rectangle",
            "to_world": T().rotate([0, 1, 0], 180).scale([5, 5, 1]),
            "bsdf": glass("air", "air", R=0.0),
            "sensor": {"type": "irradiancemeter", "film": film},
        },
    }
    value = {"type": "spectrum", "value": 2.0}
    if light == "constant":
        shapes["sky"] = {"type": "constant", "radiance": value}
    else:
        shapes["lamp"] = {
            "type": "rectangle",
            "to_world": T().translate([0, -6, -40]).scale([4, 7, 1]),
            "bsdf": glass("air", "air", R=0.0),
            "emitter": {"type": "area", "radiance": value},
        }
    scene = mistray.load({"type": "scene", **shapes})
    t = mistray.trace(scene, rays=400_000, max_scatters=10, max_reflections=20, scatter_threshold=1e-9, ledger=False)
    assert abs(t.energy.closure) < 1e-6
    path, error = _irradiance(scene)
    both = float(np.hypot(error, t.energy.detected_se_W / 100))
    assert_z(light, t.energy.detected_W / 100, path, both, false_alarm=5e-4)
    assert both < 0.02 * path
