"""Stock integrators see our shapes and our interface: radiance through glass is what thermodynamics says."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

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
