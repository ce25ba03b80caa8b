"""Our shapes as Mitsuba plugins, and radiance through glass by stock integrators, as thermodynamics says."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles.geometry import Asphere, Frustum
from oracles.object_scenes import painted_tube_text
from oracles.scatter_integrals import disc_to_disc
from oracles.small_scenes import STEEP_REAR, write
from oracles.statistics import assert_z
from scene_dicts import BLACK, at

import mistray
from mistray._mitsuba_compat import mesh_arrays
from mistray.surfaces.surfaces import SurfaceTable

T = mi.ScalarTransform4f
GREY = {"pixel_format": "luminance"}
FILM = scene_dicts.film(8, **GREY)
PATH = {"type": "path", "max_depth": 100, "rr_depth": 1000}
SKY = {"type": "constant", "radiance": 1.0}


def glass(front: str, back: str, **coating: Any) -> dict[str, Any]:
    return {"type": "interface", "front": front, "back": back, **coating}


def mitsuba_scene(**parts: Any) -> mi.Scene:
    return mi.load_dict({"type": "scene", **parts}, optimize=False, parallel=False)


def camera(eye: list[float], target: list[float], fov: float = 30.0, film: Any = FILM) -> dict[str, Any]:
    return {"type": "perspective", "fov": fov, "to_world": T().look_at(eye, target, [0, 1, 0]), "film": film}


def render(eye: list[float], target: list[float], integrator: Any = PATH, **shapes: Any) -> np.ndarray:
    view = camera(eye, target, film=scene_dicts.film(24, **GREY))
    return np.array(mi.render(mitsuba_scene(integrator=integrator, sky=SKY, camera=view, **shapes), spp=128))[:, :, 0]


def wide(bsdf: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"type": "asphere", "semi_diameter": 50.0, "bsdf": bsdf, **more}


def lens(**coating: Any) -> dict[str, Any]:
    rim = float(20 - np.sqrt(400 - 64))
    out, into = glass("1.5", "air", **coating), glass("air", "1.5", **coating)
    face = {"type": "asphere", "semi_diameter": 8.0}
    return {
        "front": face | {"radius": 20.0, "bsdf": into},
        "rear": face | {"radius": -20.0, "to_world": at(6), "bsdf": out},
        "edge": {"type": "frustum", "r0": 8.0, "z0": rim, "r1": 8.0, "z1": 6 - rim, "bsdf": out},
    }


@pytest.mark.parametrize("coating", [{}, {"R": 0.2, "T": 0.8}, {"R": 1.0, "T": 0.0}])
def test_white_furnace(coating: dict[str, float]) -> None:
    """A lossless lens in even light is invisible, ray by ray: R + T = 1 leaves nothing to chance."""
    np.testing.assert_allclose(render([0, 0, -40], [0, 0, 3], **lens(**coating)), 1.0, rtol=1e-5)


def test_even_light() -> None:
    """L/n² is invariant: n² inside of glass. Behind a surface R + T of it, by `path` and `direct`."""
    np.testing.assert_allclose(render([0, 0, 3], [0, 0, 5], **lens()), 1.5**2, rtol=1e-5)
    direct = {"type": "direct", "bsdf_samples": 1, "emitter_samples": 0}
    for shares, integrator in (({"R": 0.3, "T": 0.5}, PATH), ({"R": 0.0}, PATH), ({"R": 0.9}, direct)):
        image = render([0, 0, -40], [0, 0, 0], integrator, plate=wide(glass("air", "air", **shares)))
        np.testing.assert_allclose(image, sum(shares.values()), rtol=1e-5)
    # Seen from the front, a detector of glass: R + T/n², the eye sees the sky in the glass divided by n²
    plate = wide(glass("air", "1.5"), sensor={"type": "irradiancemeter", "film": FILM})
    middle = render([0, 0, -40], [0, 0, 0], plate=plate)[8:16, 8:16].mean()
    assert middle == pytest.approx(0.04 + 0.96 / 1.5**2, rel=0.01)


INCIDENCE_DEG, GLASS = 40.0, "1.5168"


def window(film: dict[str, Any]) -> dict[str, Any]:
    size = {"type": "asphere", "half_width": 30.0, "half_height": 30.0}
    coated = {"coating": {"type": "ref", "id": "ar"}}
    return {
        "ar": {"type": "thinfilm", **film},
        "front": {**size, "bsdf": glass("air", GLASS, **coated)},
        "rear": {**size, "to_world": at(3), "bsdf": glass(GLASS, "air", **coated)},
    }


@pytest.mark.parametrize(
    "film", [{"preset": "bbar3"}, {"layers": "2.1+0.3i 20, 1.46 90"}, {"layers": "2.3 0.25w, 1.38 0.25w, 2.3 0.25w"}]
)
def test_a_coated_window_under_path_and_straylight(film: dict[str, Any]) -> None:
    """A screen seen through it by `path` is as bright as `straylight` says, all orders; false alarm 1e-3."""
    beam = scene_dicts.load(
        beam={"type": "collimated", "radius": 2.0, "field_deg": INCIDENCE_DEG},
        **window(film),
        detector=scene_dicts.detector(10, half_width=40.0, half_height=40.0),
    )
    # `path` carries no polarisation from one face to the other
    unpolarized = {"polarization": "unpolarized", "max_reflections": 20, "flux_threshold": 1e-9}
    energy = mistray.trace(beam, rays=500, **unpolarized).energy
    along = np.array([0.0, np.sin(np.radians(INCIDENCE_DEG)), np.cos(np.radians(INCIDENCE_DEG))])
    eye = T().look_at((-40 * along).tolist(), [0, 0, 0], [1, 0, 0]).scale([2, 2, 1])
    place = T().translate([0, 0, 20]).rotate([1, 0, 0], 180).scale(200.0)
    dark, light = {"type": "diffuse", "reflectance": 0.0}, {"type": "area", "radiance": 1.0}
    scene = mitsuba_scene(
        integrator=PATH,
        camera={"type": "orthographic", "to_world": eye, "film": scene_dicts.film(16, **GREY)},
        **window(film),
        screen={"type": "rectangle", "to_world": place, "bsdf": dark, "light": light},
    )
    pixels = np.array(mi.render(scene, spp=8192, seed=3)).ravel().astype(float)
    error = pixels.std(ddof=1) / np.sqrt(pixels.size)
    assert error < 4e-4
    # What straylight leaves out beyond 20 reflections, and float32
    passed = energy.detected_W / energy.launched_W
    assert_z("radiance of the screen", pixels.mean(), passed, error, false_alarm=1e-3, floor=1e-6)


def lit_plate(integrator: dict[str, Any], film: Any) -> mi.Scene:
    lamp, abg = {"type": "area", "radiance": 10.0}, {"type": "abg", "A": 0.01, "B": 0.05, "g": 2.0}
    return mitsuba_scene(
        integrator=integrator,
        lamp={"type": "rectangle", "to_world": T().look_at([4, 0, -4], [0, 0, 0], [0, 1, 0]), "light": lamp},
        plate={"type": "rectangle", "to_world": T().rotate([1, 0, 0], 180), "bsdf": glass("air", "air", R=0.9, s=abg)},
        camera=camera([0, 0, -5], [0, 0, 0], 20.0, film),
    )


@pytest.mark.parametrize("kind", ["prb", "prb_basic", "prbvolpath", "prb_projective", "direct_projective"])
def test_gradients_while_another_scene_lives(kind: str) -> None:
    other = scene_dicts.load(beam={"type": "collimated", "radius": 2.0}, window=wide(glass("air", "1.5")))
    scene = lit_plate({"type": kind}, scene_dicts.film(8))
    params = mi.traverse(scene)
    dr.enable_grad(params["plate.bsdf.abg.A"])
    params.update()
    dr.backward(dr.mean(mi.render(scene, params, spp=16, seed=1).array))
    assert float(dr.grad(params["plate.bsdf.abg.A"])[0]) > 0
    assert len(other.emitters()) == 1


@pytest.mark.parametrize("key", ["plate.bsdf.abg.A", "plate.bsdf.abg.B"])
def test_gradient_of_a_rendering(key: str) -> None:
    """`prb` differentiates by the parameters of a nested model: against central differences, same seeds."""
    scene = lit_plate({"type": "prb", "max_depth": 2}, FILM)
    params = mi.traverse(scene)
    at_value = float(params[key][0])

    def brightness(value: float) -> float:
        params[key] = mi.Float(value)
        params.update()
        return float(dr.mean(mi.render(scene, spp=512, seed=3).array)[0])

    step = 0.02 * at_value
    expected = (brightness(at_value + step) - brightness(at_value - step)) / (2 * step)
    brightness(at_value)
    dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.mean(mi.render(scene, params, spp=512, seed=3).array))
    assert abs(expected) > 1e-3, "a case that shows nothing"
    assert float(dr.grad(params[key])[0]) == pytest.approx(expected, rel=0.02)


def detector(**size: Any) -> dict[str, Any]:
    return {"type": "asphere", **size, "bsdf": BLACK, "sensor": {"type": "irradiancemeter", "film": FILM}}


def irradiance(spp: int, **parts: Any) -> tuple[float, float]:
    pixels = np.array(mi.render(mitsuba_scene(**parts), integrator=mi.load_dict(PATH), spp=spp, seed=7), float).ravel()
    return float(pixels.mean()), float(pixels.std(ddof=1) / np.sqrt(pixels.size))


class TestStockSensor:
    def test_sky_and_lamp(self) -> None:
        """π times the radiance of the sky; a round lamp of 1 W/mm²/sr in closed form, one behind is not seen."""
        for size in ({"semi_diameter": 3.0}, {"half_width": 2.0, "half_height": 3.0}):
            assert irradiance(64, sky=SKY, d=detector(**size))[0] == pytest.approx(np.pi, rel=1e-5)

        def lamp(z: float, turned: float) -> dict[str, Any]:
            place = T().translate([0, 0, z]).rotate([1, 0, 0], turned).scale(3.0)
            return {"type": "disk", "to_world": place, "light": {"type": "area", "radiance": 1.0}}

        found, error = irradiance(4096, d=detector(semi_diameter=2.0), lamp=lamp(-6.0, 0.0))
        exact = np.pi * disc_to_disc(2.0, 3.0, 6.0)
        assert error < 0.01 * exact
        assert_z("lamp", found, exact, error, floor=1e-3 * exact)  # the mesh is a polygon of 96 sides
        assert irradiance(64, d=detector(semi_diameter=2.0), lamp=lamp(6.0, 180.0))[0] == 0

    def test_a_painted_tube_under_path_and_straylight(self, tmp_path: Path) -> None:
        """The sky through a painted tube: `path` against the PST of `straylight`, integrated over the hemisphere."""
        text = painted_tube_text(3.0, 1.0, 1.0, 0.3)
        pst = mistray.pst(mistray.load(write(tmp_path, text)), field_deg=range(0, 91, 2), rays=100_000, max_scatters=12)
        value, se = pst.curve()
        cells = pst.grid.solid_angle
        assert cells.sum() == pytest.approx(2 * np.pi, rel=1e-6)
        painted = glass("air", "air", R=0.0, paint={"type": "paint", "reflectance": 0.3})
        tube = {"type": "frustum", "r0": 1.0, "z0": 0.0, "r1": 1.0, "z1": 3.0, "bsdf": painted}
        found, error = irradiance(4096, sky=SKY, tube=tube, d=detector(semi_diameter=1.0, to_world=at(3)))
        expected, both = float(value @ cells), np.hypot(error, float(np.linalg.norm(se * cells)))
        assert both < 0.01 * expected
        assert_z("sky", found, expected, both, floor=1e-3 * expected)

    def test_a_shared_interface(self) -> None:
        shared = mi.load_dict(glass("air", "1.5"))
        with pytest.raises(Exception, match="shared by a detector and another shape"):
            mitsuba_scene(d={**detector(semi_diameter=1.0), "bsdf": shared}, e=wide(shared))


class TestCollimated:
    @pytest.mark.parametrize("field_deg", [0.0, 40.0])
    @pytest.mark.parametrize("kind", ["path", "direct"])
    def test_a_white_screen(self, kind: str, field_deg: float) -> None:
        """Radiance ρ E cos θ / π where the beam lands, and nothing beside it."""
        eye = T().look_at([0, 0, -9], [0, 0, 0], [0, 1, 0]).scale([6, 6, 1])
        white = {"type": "diffuse", "reflectance": 0.6}
        scene = mitsuba_scene(
            beam={"type": "collimated", "radius": 2.0, "field_deg": field_deg, "irradiance": 3.0},
            screen={"type": "rectangle", "to_world": T().rotate([1, 0, 0], 180).scale(9.0), "bsdf": white},
            camera={"type": "orthographic", "to_world": eye, "film": scene_dicts.film(64, **GREY)},
        )
        image = np.array(mi.render(scene, integrator=mi.load_dict({"type": kind}), spp=64)).squeeze()
        cosine = np.cos(np.radians(field_deg))
        exact = 0.6 * 3.0 * cosine / np.pi
        np.testing.assert_allclose(image[30:34, 30:34], exact, rtol=1e-4)
        assert image[0, 0] == 0
        # The lit area, an ellipse of 2 mm by 2 mm / cos θ; 64 points a pixel put it to 1 %
        assert image.mean() * 144 == pytest.approx(exact * np.pi * 4 / cosine, rel=0.01)

    @pytest.mark.parametrize("plane", ["beam", "axis"])
    @pytest.mark.parametrize(
        "size", [{"radius": 2.0}, {"radius": 2.0, "inner_radius": 1.5}, {"half_width": 2.0, "half_height": 0.5}]
    )
    def test_rays_and_shadow_rays_agree(self, size: dict[str, float], plane: str) -> None:
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
        _, found = light(mi.Point3f(1, 2, 3) + frame.s * mi.Float(u) + frame.t * mi.Float(v))
        share = emitter.power() / emitter.irradiance / (2 * half) ** 2
        assert_z("area", np.mean(found > 0), share, np.sqrt(share / count))


@pytest.mark.parametrize("light", ["area", "constant"])
def test_stock_light_under_path_and_in_a_trace(light: str) -> None:
    """A painted plate, glass over the detector, and a lamp or a sky: the same irradiance; false alarm 1e-3 for both."""
    white = {"type": "interface", "R": 0.0, "scatter": {"type": "abg", "A": 0.2, "B": 1.0, "g": 0.0}}
    tilted = T().translate([0, 14, -10]).rotate([1, 0, 0], 60)
    square = {"type": "asphere", "half_width": 9.0, "half_height": 9.0}
    value = {"type": "spectrum", "value": 2.0}
    place, turned = T().translate([0, -6, -40]).scale([4, 7, 1]), T().rotate([0, 1, 0], 180).scale([5, 5, 1])
    meter = {"type": "irradiancemeter", "film": scene_dicts.film(1, **GREY)}
    lamp = {"type": "rectangle", "to_world": place, "bsdf": BLACK, "emitter": {"type": "area", "radiance": value}}
    scene = scene_dicts.load(
        plate=square | {"half_width": 15.0, "half_height": 15.0, "to_world": tilted, "bsdf": white},
        lid={"type": "asphere", "semi_diameter": 60.0, "z": 0.1, "bsdf": BLACK},  # the meter looks one way only
        front=square | {"z": -4.0, "bsdf": glass("air", "1.5")},
        rear=square | {"z": -2.0, "bsdf": glass("1.5", "air")},
        detector={"type": "rectangle", "to_world": turned, "bsdf": BLACK, "sensor": meter},
        light=lamp if light == "area" else {"type": "constant", "radiance": value},
    )
    t = mistray.trace(scene, rays=400_000, max_scatters=10, max_reflections=20, scatter_threshold=1e-9, ledger=False)
    assert abs(t.energy.closure) < 1e-6
    path = mi.load_dict({"type": "path", "max_depth": 40})
    seen = [float(np.mean(mi.render(scene, spp=16_000, seed=seed, integrator=path))) for seed in range(16)]
    both = float(np.hypot(np.std(seen, ddof=1) / 4, t.energy.detected_se_W / 100))
    assert_z(light, t.energy.detected_W / 100, np.mean(seen), both, false_alarm=5e-4)
    assert both < 0.02 * np.mean(seen)


FIGURE = {"radius": 20.0, "conic": -0.5, "a4": 1e-4, "a6": -2e-7}
ASPHERE = {"type": "asphere", **FIGURE, "semi_diameter": 6.0, "bsdf": BLACK}
FRUSTUM = {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 3.0, "z1": 4.0, "bsdf": BLACK}
PLANE = {"type": "asphere", "semi_diameter": 2.0, "bsdf": BLACK}


@pytest.mark.quick
def test_defaults() -> None:
    plane = mi.load_dict(PLANE)
    assert (plane.plane, plane.sag(np.linspace(0, 2, 5)).any(), plane.space) == (True, False, -1)
    flat, bent = ({}, {"radius": 0.0}, {"radius": -np.inf}), ({"curvature": 0.05}, {"radius": 20})
    assert [mi.load_dict(PLANE | given).values["curvature"] for given in (*flat, *bent)] == [0, 0, 0, 0.05, 0.05]
    named = mi.load_dict(ASPHERE | {"id": "S1", "part": "L1", "space": 3})
    assert (named.id(), named.part, named.space) == ("S1", "L1", 3)


class TestParameters:
    def test_updates_make_the_mesh_again_and_change_the_trace(self) -> None:
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
        # A plate that becomes a lens of f = 60/0.5 = 120 mm, 15 mm before the screen, and a plate again
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


# What stock integrators and viewers see, and the exact surface
MESHES = {
    "asphere": (ASPHERE, Asphere(0.05, -0.5, ((2, 1e-4), (3, -2e-7)), 6.0)),
    "steep": (PLANE | {"radius": 3.482, "conic": 8.701, "semi_diameter": STEEP_REAR.outer}
              | {f"a{2 * power}": value for power, value in STEEP_REAR.coefficients}, STEEP_REAR),
    "clipped": ({"type": "asphere", "radius": -12.0, "half_width": 4.0, "half_height": 2.0, "bsdf": BLACK},
                Asphere(-1 / 12, half_width=4.0, half_height=2.0)),
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


FLINT = {"type": "interface", "back": "1.5"}
RAYS = 4000
POSE = {"x": 0.2, "y": -0.1, "z": 0.3, "tilt_x": 2.0, "tilt_y": -3.0, "tilt_z": 20.0}
SHAPES = {
    "asphere": {"type": "asphere", "radius": 30.0, "conic": -0.5, "a4": 1e-5, "semi_diameter": 4.0, "bsdf": FLINT},
    "rectangle": {"type": "asphere", "radius": -30.0, "half_width": 4.0, "half_height": 3.0, "bsdf": FLINT},
    "frustum": {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 1.5, "z1": 0.5, "bsdf": FLINT},
    "annulus": {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 1.5, "z1": -1.0, "bsdf": FLINT},
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
    there = scene_dicts.load(
        a={"type": "asphere", "semi_diameter": 2.0, "bsdf": FLINT, "to_world": turned},
        b=scene_dicts.detector(0, semi_diameter=2.0, to_world=turned.translate([0, 0, 5]), tilt_x=1 / 3600),
    )
    table = SurfaceTable(there, 550.0)
    assert len(table.frames) == 3  # with that of the world
    angle = np.arccos(np.clip(table.rotations[0][:, 2] @ table.rotations[1][:, 2], -1, 1))
    assert np.degrees(angle) == pytest.approx(1 / 3600, rel=1e-3)
