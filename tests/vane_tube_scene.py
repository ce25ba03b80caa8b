"""The tube of `oracles.vane_tube` as a scene."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
from lit_detector import BLACK, meter
from oracles.vane_tube import VaneTube

import mistray

TUBE = VaneTube(radius=10.0, length=120.0, vanes=(40.0, 80.0), hole=4.5, detector=2.5, reflectance=0.05, scatters=3)


def vane_tube(given: VaneTube = TUBE) -> mi.Scene:
    """The tube of the oracle; light travels +z, from its opening at z = 0."""
    paint = {**BLACK, "model": {"type": "paint", "reflectance": given.reflectance}}

    def frustum(r0: float, z0: float, r1: float, z1: float) -> dict[str, Any]:
        return {"type": "frustum", "r0": r0, "z0": z0, "r1": r1, "z1": z1, "bsdf": paint}

    r, end = given.radius, given.length
    beam = {"type": "collimated", "radius": given.detector, "distance": 1.0}
    detector = {"type": "asphere", "semi_diameter": given.detector, "z": end, "bsdf": BLACK, "sensor": meter()}
    vanes = {f"vane_{k}": frustum(given.hole, end - z, r, end - z) for k, z in enumerate(given.vanes)}
    walls = {"wall": frustum(r, 0.0, r, end), "bottom": frustum(given.detector, end, r, end), **vanes}
    return mistray.load({"type": "scene", "beam": beam, **walls, "detector": detector})
