"""Stock integrators see our shapes and our interface: radiance through glass is what thermodynamics says."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
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
    energy = mistray.trace(beam, rays=500, max_reflections=20, flux_threshold=1e-9).energy
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
