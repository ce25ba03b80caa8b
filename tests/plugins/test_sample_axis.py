"""Anisotropic tables as Mitsuba BSDFs: density and weights of samples, radiance under `path`, and what is refused."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles import brushed
from oracles.chi_square import Chart, p_value
from oracles.statistics import assert_z
from scatter_surfaces import IMPORTANCE, RADIANCE, context, direction, interaction, surface, vectors

import mistray
from mistray.errors import MistrayError

SAMPLES = 200_000
FALSE_ALARM = 1e-4  # of each χ²
FRONT_NORMAL = np.array([0.0, 0.0, -1.0])
T = mi.ScalarTransform4f


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The plugin with an Asymmetrical4D file."""
    rotations, incidence = np.arange(0.0, 361.0, 20.0), np.array([0.0, 20.0, 40.0, 60.0, 80.0])
    file = brushed.write_asymmetrical_4d(tmp_path_factory.mktemp("bsdf") / "brushed.bsdf", rotations, incidence)
    return {"type": "tabulated", "file": str(file), "anisotropy": "keep"}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The plugin with a coarse table."""
    file = brushed.write_two_fold(tmp_path_factory.mktemp("bsdf") / "two.csv", 0.1, 0.05, step=90.0)
    return {"type": "tabulated", "file": str(file), "anisotropy": "keep"}


def x_axis(rotation_deg: float) -> np.ndarray:
    turn = np.radians(rotation_deg)
    return np.array([np.cos(turn), np.sin(turn), 0.0])


def drawn(bsdf: Any, wi: np.ndarray, mode: Any, count: int = SAMPLES) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions, densities and weights of samples."""
    rng = mi.PCG32(count, 3)
    u, v = rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
    sample, weight = bsdf.sample(context(mode, "reflection"), interaction_of(wi, count), u, v)
    return np.array(sample.wo, dtype=float).T, np.array(sample.pdf, dtype=float), np.array(weight, dtype=float)[0]


def interaction_of(wi: np.ndarray, count: int) -> mi.SurfaceInteraction3f:
    """A hit whose local frame is that of the shape."""
    si = interaction(wi, count)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    return si


class TestSampling:
    @pytest.mark.long
    @pytest.mark.parametrize(
        ("angle", "mode"), [(0.0, IMPORTANCE), (50.0, IMPORTANCE), (50.0, RADIANCE), (80.0, IMPORTANCE)]
    )
    def test_chi_square(self, table: dict[str, Any], angle: float, mode: Any) -> None:
        bsdf, wi = surface(table | {"rotation_deg": 30.0}, R=0.0, T=0.0), direction(angle, True)
        wo, pdf, _ = drawn(bsdf, wi, mode)

        def density(directions: np.ndarray) -> np.ndarray:
            si, ctx = interaction_of(wi, len(directions)), context(mode, "reflection")
            return np.array(bsdf.pdf(ctx, si, vectors(directions)), dtype=float)

        charts = [Chart(np.array([-wi[0], -wi[1], wi[2]]), np.sign(wi[2]), True, 8)]
        assert p_value(wo[pdf > 0], SAMPLES, density, charts) > FALSE_ALARM

        def wrong(directions: np.ndarray) -> np.ndarray:
            return density(directions) * (1 + 0.1 * np.sign(directions[:, 0]))

        assert p_value(wo[pdf > 0], SAMPLES, wrong, charts) < 1e-10

    @pytest.mark.long
    @pytest.mark.parametrize(("angle", "azimuth"), [(0.0, 0.7), (40.0, 0.7), (40.0, 2.5), (75.0, 4.0)])
    def test_what_is_scattered_is_the_tis(self, table: dict[str, Any], angle: float, azimuth: float) -> None:
        """The mean weight of samples against the closed form, which changes with the azimuth of incidence."""
        bsdf, wi = surface(table | {"rotation_deg": 30.0}, R=0.0, T=0.0), direction(angle, True, azimuth)
        _, pdf, weight = drawn(bsdf, wi, IMPORTANCE)
        weight = np.where(pdf > 0, weight, 0)
        exact = brushed.total(np.array([-wi[0], -wi[1], wi[2]]), x_axis(30.0), FRONT_NORMAL)
        error = float(weight.std() / np.sqrt(SAMPLES))
        assert error < 5e-3 * exact
        assert_z("TIS", float(weight.mean()), float(exact), error, k=4.0)

    def test_values(self, table: dict[str, Any]) -> None:
        """Value against the closed form, in both modes and from either side: the sample is seen from where light is."""
        bsdf, rng = surface(table | {"rotation_deg": 30.0}, R=0.0, T=0.0), np.random.default_rng(2)
        for front in (True, False):
            normal = np.array([0.0, 0.0, -1.0 if front else 1.0])
            for mode in (IMPORTANCE, RADIANCE):
                wi, wo = (direction(*rng.random(2) * [70, 1], rng.random() * 6) for _ in range(2))
                wi[2], wo[2] = (abs(v[2]) * normal[2] for v in (wi, wo))
                light, seen = (wo, wi) if mode == RADIANCE else (wi, wo)
                si = interaction_of(wi, 1)
                value = float(np.array(bsdf.eval(context(mode, "reflection"), si, vectors(wo[None])))[0, 0])
                specular = np.array([-light[0], -light[1], light[2]])
                exact = brushed.bsdf(specular, seen, x_axis(30.0), normal)
                assert value / abs(wo[2]) == pytest.approx(exact, abs=0.02 * brushed.A)

    @pytest.mark.long
    def test_specular_beam_loses_by_the_azimuth(self, table: dict[str, Any]) -> None:
        """Relative to R, what is scattered is missing in the reflected beam: by azimuth, 13 % apart."""
        bsdf = surface(table | {"relative_to": "specular"}, R=0.9, T=0.0)
        ctx = mi.BSDFContext(RADIANCE)
        ctx.component = 0
        for azimuth in (0.0, 1.5, 2.5):
            wi = direction(60.0, True, azimuth)
            _, weight = bsdf.sample(ctx, interaction_of(wi, 1), mi.Float(0.5), mi.Point2f(0.5, 0.5))
            # The light that is seen at wi goes there
            tis = brushed.total(np.array([wi[0], wi[1], wi[2]]), x_axis(0.0), FRONT_NORMAL)
            assert float(weight[0][0]) == pytest.approx(0.9 * (1 - tis), rel=0.01)


def plate(kind: str, bsdf: dict[str, Any]) -> dict[str, Any]:
    """A plate of one shape or another, its normal along z."""
    return {
        "asphere": {"type": "asphere", "semi_diameter": 5.0, "bsdf": bsdf},
        "detector": {
            "type": "asphere", "semi_diameter": 5.0, "bsdf": bsdf,
            "sensor": scene_dicts.meter(1),
        },
        "frustum": {"type": "frustum", "r0": 0.0, "z0": 0.0, "r1": 5.0, "z1": 0.0, "bsdf": bsdf},
        "rectangle": {"type": "rectangle", "to_world": T().scale([5, 4, 1]), "bsdf": bsdf},
    }[kind]  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "axis"),
    [
        ("asphere", "x"),
        ("detector", "x"),
        ("rectangle", "x"),
        ("frustum", "meridian"),
    ],
)
def test_radiance_under_path(table: dict[str, Any], kind: str, axis: str) -> None:
    """A spot of an oblique beam, seen from aside: f E cos θ, with the sample as its shape and its turn put it."""
    at, rotation, field, azimuth = np.array([2.0, 1.0, 0.0]), 25.0, 35.0, 20.0
    bsdf = {"type": "interface", "R": 0.0, "m": table | {"rotation_deg": rotation, "sample_axis": axis}}
    t, p = np.radians([50.0, 70.0])
    seen = np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), -np.cos(t)])
    camera = {
        "type": "orthographic", "film": {"type": "hdrfilm", "width": 4, "height": 4, "pixel_format": "luminance"},
        "to_world": T().look_at(origin=(at + 30 * seen).tolist(), target=at.tolist(), up=[0.3, 0.4, 1]).scale(
            [0.01, 0.01, 1]
        ),
    }  # fmt: skip
    beam = {"type": "collimated", "radius": 20.0, "irradiance": 2.0, "field_deg": field, "azimuth_deg": azimuth}
    scene = mi.load_dict(
        {"type": "scene", "beam": beam, "plate": plate(kind, bsdf), "camera": camera}, optimize=False, parallel=False
    )
    path = mi.load_dict({"type": "path", "max_depth": 2})
    image = np.array(mi.render(scene, sensor=scene.sensors()[-1], integrator=path, spp=8)).ravel()
    f, a = np.radians([field, 90 + azimuth])
    specular = np.array([np.sin(f) * np.cos(a), np.sin(f) * np.sin(a), -np.cos(f)])
    x = x_axis(rotation + (np.degrees(np.arctan2(at[1], at[0])) if axis == "meridian" else 0.0))
    exact = brushed.bsdf(specular, seen, x, FRONT_NORMAL) * 2 * np.cos(f)
    assert image == pytest.approx(exact, rel=0.02)
    # A sample turned by 90° would be another one
    assert abs(brushed.bsdf(specular, seen, np.cross([0, 0, 1], x), FRONT_NORMAL) * 2 * np.cos(f) / exact - 1) > 0.1


class TestRefused:
    @pytest.mark.parametrize(
        ("values", "words"),
        [
            ({"anisotropy": "mean", "rotation_deg": 10.0}, "rotation_deg is given, but its scatter is isotropic"),
            ({"sample_axis": "y"}, "sample_axis is 'y'"),
            ({"rotation_deg": float("nan")}, "rotation_deg is nan"),
        ],
    )
    def test_wrong_values(self, small: dict[str, Any], values: dict[str, Any], words: str) -> None:
        with pytest.raises(Exception, match=words):
            surface(small | values)

    def test_two_axes_on_one_surface(self, small: dict[str, Any]) -> None:
        with pytest.raises(Exception, match="sample axes of its models are x turned by 0° and x turned by 30°"):
            surface(small, second=small | {"rotation_deg": 30.0})
        both = surface(small | {"rotation_deg": 30.0}, second=small | {"rotation_deg": 30.0}, R=0.0, T=0.0)
        assert str(both.sample_axis) == "x turned by 30°"

    @pytest.mark.long
    @pytest.mark.parametrize(
        ("shape", "message"),
        [
            ({"type": "frustum", "r0": 5.0, "z0": 0.0, "r1": 5.0, "z1": 9.0}, "a tube has not everywhere"),
            ({"type": "sphere", "radius": 5.0}, "a Sphere has none of its own"),
            ({"type": "cube"}, "a Cube has none of its own|a Mesh has none of its own"),
        ],
    )
    def test_shapes_without_an_axis(self, small: dict[str, Any], shape: dict[str, Any], message: str) -> None:
        scene = scene_dicts.load(
            beam={"type": "collimated", "radius": 1.0},
            wall=shape | {"bsdf": {"type": "interface", "R": 0.0, "m": small}},
            d=scene_dicts.detector(20, semi_diameter=5.0),
        )
        with pytest.raises(MistrayError, match=message):
            mistray.trace(scene, rays=10)


def test_the_plugin_turns_with_its_shape(small: dict[str, Any]) -> None:
    """A shape that is tilted takes the axis with it, under stock integrators too; two shapes may share a plugin."""
    shared = mi.load_dict({"type": "interface", "R": 0.0, "m": small})
    one = {"type": "asphere", "semi_diameter": 5.0, "bsdf": shared}
    scene = scene_dicts.load(one=one, two={**one, "x": 20.0, "tilt_z": 40.0})

    def angle(x: float) -> float:
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, 0.5, -10), mi.Vector3f(0, 0, 1)))
        local = shared.sample_axis.local(si, False).x
        world = si.sh_frame.to_world(mi.Vector3f(local.x, local.y, 0))
        return float(dr.atan2(world.y, world.x)[0] * 180 / np.pi)

    assert angle(0.5) == pytest.approx(0.0, abs=1e-3)
    assert angle(20.5) == pytest.approx(40.0, abs=1e-3)
    params = mi.traverse(scene)
    params["one.tilt_z"] = mi.Float(-25.0)
    params.update()
    assert angle(0.5) == pytest.approx(-25.0, abs=1e-3)
