"""Parts of scenes as dictionaries: black walls, detectors, and a lamp before a round black detector."""

from typing import Any

import mitsuba as mi
import numpy as np

import mistray

BLACK = {"type": "interface", "R": 0.0}
RADIUS = 10.0  # mm, of the detector in the plane z = 0
# Far behind the detector: it makes the scene larger
TUBE = {"type": "frustum", "r0": 60.0, "r1": 60.0, "z0": 300.0, "z1": 400.0, "bsdf": BLACK}


def meter(pixels: int = 4) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": pixels, "height": pixels, "rfilter": {"type": "box"}}
    return {"type": "irradiancemeter", "film": film}


def square(half: float, pixels: int = 4, **more: Any) -> dict[str, Any]:
    size = {"half_width": half, "half_height": half}
    return {"type": "asphere", **size, "bsdf": BLACK, "sensor": meter(pixels), **more}


def towards_origin(angle_deg: float, away: float) -> mi.ScalarTransform4f:
    """The place of what faces the origin, at an angle to z in the plane of x and z."""
    s, c = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    return mi.ScalarTransform4f().look_at([away * s, 0, away * c], [0, 0, 0], [0, 1, 0])


def lit(lamp: dict[str, Any], pixels: int = 4, **more: Any) -> mi.Scene:
    """A round black detector in the plane z = 0 and a lamp, with more shapes or others in their places."""
    detector = {"type": "asphere", "semi_diameter": RADIUS, "bsdf": BLACK, "sensor": meter(pixels)}
    return mistray.load({"type": "scene", "detector": detector, "lamp": lamp, **more})


def discs(distance: float, first: float, second: float = RADIUS) -> float:
    """View factor of two parallel discs on one axis, from the first (J. R. Howell, A Catalog, C-41)."""
    a, b = first / distance, second / distance
    x = 1 + (1 + b * b) / (a * a)
    return float(0.5 * (x - np.sqrt(x * x - 4 * (b / a) ** 2)))


def hazy_block(glass: str, depth: float = 10.0, radius: float = 5.0) -> dict[str, Any]:
    """The surfaces of a cylinder of a medium along z."""
    inside = {"type": "interface", "front": glass}
    return {
        "front": {"type": "asphere", "semi_diameter": radius, "bsdf": {"type": "interface", "back": glass}},
        "edge": {"type": "frustum", "r0": radius, "z0": 0.0, "r1": radius, "z1": depth, "bsdf": inside},
        "rear": {"type": "asphere", "semi_diameter": radius, "z": depth, "bsdf": inside},
    }
