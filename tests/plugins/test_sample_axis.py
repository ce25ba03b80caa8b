"""Anisotropic tables as Mitsuba BSDFs: density and weights of samples, radiance under `path`, and what is refused."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
from oracles import brushed
from oracles.chi_square import Chart, p_value
from refusals import refused
from scatter_surfaces import IMPORTANCE, RADIANCE, context, direction, interaction, surface, vectors

import mistray

SAMPLES = 200_000
FALSE_ALARM = 1e-4  # of each χ²


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    rotations, incidence = np.arange(0.0, 361.0, 20.0), np.array([0.0, 20.0, 40.0, 60.0, 80.0])
    file = brushed.write_asymmetrical_4d(tmp_path_factory.mktemp("bsdf") / "brushed.bsdf", rotations, incidence)
    return {"type": "tabulated", "file": str(file), "anisotropy": "keep"}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    file = brushed.write_two_fold(tmp_path_factory.mktemp("bsdf") / "two.csv", 0.1, 0.05, step=90.0)
    return {"type": "tabulated", "file": str(file), "anisotropy": "keep"}


def interaction_of(wi: np.ndarray, count: int) -> mi.SurfaceInteraction3f:
    si = interaction(wi, count)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    return si


class TestSampling:
    @pytest.mark.parametrize(("angle", "mode"), [*((a, IMPORTANCE) for a in (0.0, 50.0, 80.0)), (50.0, RADIANCE)])
    def test_chi_square(self, table: dict[str, Any], angle: float, mode: Any) -> None:
        bsdf, wi = surface(table | {"rotation_deg": 30.0}, R=0.0, T=0.0), direction(angle, True)
        rng = mi.PCG32(SAMPLES, 3)
        u, v = rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
        sample, _ = bsdf.sample(context(mode, "reflection"), interaction_of(wi, SAMPLES), u, v)
        wo, pdf = np.array(sample.wo, dtype=float).T, np.array(sample.pdf, dtype=float)

        def density(directions: np.ndarray) -> np.ndarray:
            si, ctx = interaction_of(wi, len(directions)), context(mode, "reflection")
            return np.array(bsdf.pdf(ctx, si, vectors(directions)), dtype=float)

        charts = [Chart(np.array([-wi[0], -wi[1], wi[2]]), np.sign(wi[2]), True, 8)]
        assert p_value(wo[pdf > 0], SAMPLES, density, charts) > FALSE_ALARM

        def wrong(directions: np.ndarray) -> np.ndarray:
            return density(directions) * (1 + 0.1 * np.sign(directions[:, 0]))

        assert p_value(wo[pdf > 0], SAMPLES, wrong, charts) < 1e-10

    def test_values(self, table: dict[str, Any]) -> None:
        """Value against the closed form, in both modes and from either side: the sample is seen from where light is."""
        bsdf, rng = surface(table | {"rotation_deg": 30.0}, R=0.0, T=0.0), np.random.default_rng(2)
        x_axis = np.array([np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 0.0])  # turned by 30°
        for front in (True, False):
            normal = np.array([0.0, 0.0, -1.0 if front else 1.0])
            for mode in (IMPORTANCE, RADIANCE):
                wi, wo = (direction(*rng.random(2) * [70, 1], rng.random() * 6) for _ in range(2))
                wi[2], wo[2] = (abs(v[2]) * normal[2] for v in (wi, wo))
                light, seen = (wo, wi) if mode == RADIANCE else (wi, wo)
                si = interaction_of(wi, 1)
                value = float(np.array(bsdf.eval(context(mode, "reflection"), si, vectors(wo[None])))[0, 0])
                exact = brushed.bsdf(np.array([-light[0], -light[1], light[2]]), seen, x_axis, normal)
                assert value / abs(wo[2]) == pytest.approx(exact, abs=0.02 * brushed.A)


class TestRefused:
    @pytest.mark.parametrize(
        ("values", "words"),
        [
            ({"anisotropy": "mean", "rotation_deg": 10.0}, "rotation_deg is given, but its scatter is isotropic"),
            ({"sample_axis": "y"}, "sample_axis is 'y'"),
            ({"rotation_deg": float("nan")}, "rotation_deg is nan"),
            ({}, "sample axes of its models are x turned by 0° and x turned by 30°"),
        ],
    )
    def test_wrong_values(self, small: dict[str, Any], values: dict[str, Any], words: str) -> None:
        with pytest.raises(Exception, match=words):
            surface(small | values, **({} if values else {"second": small | {"rotation_deg": 30.0}}))
        both = surface(small | {"rotation_deg": 30.0}, second=small | {"rotation_deg": 30.0}, R=0.0, T=0.0)
        assert str(both.sample_axis) == "x turned by 30°"
        surface(small | {"rotation_deg": -90.0}, second=small | {"rotation_deg": 270.0}, R=0.0, T=0.0)  # one axis

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
        with refused(message):
            mistray.trace(scene, rays=10)


def test_the_axis_of_shapes(small: dict[str, Any]) -> None:
    """x or the meridian of each kind of shape; two may share a plugin, and a shape that is tilted takes it along."""

    def interface(**axis: Any) -> Any:
        return mi.load_dict({"type": "interface", "R": 0.0, "m": small | axis})

    shared, turned, meridian = interface(), interface(rotation_deg=25.0), interface(sample_axis="meridian")
    one = {"type": "asphere", "semi_diameter": 5.0, "bsdf": shared}
    place = mi.ScalarTransform4f().translate([60, 0, 0]).scale([5, 4, 1])
    scene = scene_dicts.load(
        one=one,
        two={**one, "x": 20.0, "tilt_z": 40.0},
        detector=scene_dicts.detector(0, semi_diameter=5.0, x=40.0, bsdf=interface()),
        rectangle={"type": "rectangle", "to_world": place, "bsdf": turned},
        ring={"type": "frustum", "r0": 0.0, "z0": 0.0, "r1": 5.0, "z1": 0.0, "x": 80.0, "bsdf": meridian},
    )

    def angle(x: float) -> float:
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, 0.5, -10), mi.Vector3f(0, 0, 1)))
        world = si.sh_frame.to_world(si.bsdf()[0].sample_axis.local(si, False))
        return float(dr.atan2(world.y, world.x)[0] * 180 / np.pi)

    for x, expected in ((0.5, 0.0), (20.5, 40.0), (40.5, 0.0), (60.5, 25.0), (80.5, 45.0), (81.0, 26.565)):
        assert angle(x) == pytest.approx(expected, abs=1e-3)
    params = mi.traverse(scene)
    params["one.tilt_z"] = mi.Float(-25.0)
    params.update()
    assert angle(0.5) == pytest.approx(-25.0, abs=1e-3)
