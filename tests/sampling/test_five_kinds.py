"""Importance sampling of all kinds of rays: the same flux as without, with as much less variance as promised."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, hazy_block, square, towards_origin
from oracles.statistics import assert_z

import mistray

FAR = 200.0  # mm: the detector from the origin
BEAM = {"type": "collimated", "radius": 1.0}
EDGE = {"type": "interface", "R": 0.0, "T": 1.0, "model": {"type": "edge_diffraction", "width_mm": 0.02}}
PAINT = {**BLACK, "haze": {"type": "paint", "reflectance": 0.2}}
BACK = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])
ASIDE = square(10.0, to_world=towards_origin(30, FAR))
# The parts of each scene, and the share of the launched light that is emitted, scattered or diffracted
KINDS: dict[str, tuple[dict[str, Any], float]] = {
    "emitted": ({"lamp": {"type": "point_source"}, "detector": ASIDE}, 1.0),
    "in a cone": ({"lamp": {"type": "point_source", "half_angle_deg": 60.0}, "detector": ASIDE}, 1.0),
    "by a cosine": ({"lamp": {"type": "point_source", "exponent": 5.0}, "detector": ASIDE}, 1.0),
    "surface source": ({"lamp": {"type": "surface_source", "radius": 3.0}, "detector": ASIDE}, 1.0),
    "scattered": (
        {
            "lamp": {**BEAM, "to_world": BACK},
            "plate": {"type": "asphere", "semi_diameter": 2.0, "z": -1.0, "bsdf": PAINT},
            "detector": ASIDE,
        },
        0.2,
    ),
    "diffracted": (
        {
            "lamp": {**BEAM, "inner_radius": 0.98},
            "edge": {"type": "frustum", "r0": 0.98, "z0": 0.0, "r1": 1.0, "z1": 0.0, "bsdf": EDGE},
            "detector": square(2.0, to_world=towards_origin(4, FAR)),
        },
        1.0,
    ),
    "bulk": ({"lamp": BEAM, **hazy_block("1.0 scatter=0.01 g=0.5"), "detector": ASIDE}, 1 - np.exp(-0.1)),
}


@pytest.mark.quick
@pytest.mark.parametrize("kind", KINDS)
def test_aimed_rays_of_every_kind(kind: str) -> None:
    """Within 3 errors of the run without aim (2.7e-3 each), with half of the gain 1/p that a share p on the detector
    promises; an error of 32 batches is itself good to 1/8, so that 3 of these are given away."""
    parts, sent = KINDS[kind]
    scene = mistray.load({"type": "scene", **parts})
    limits = {"ledger": False, "scatter_threshold": 0.0}
    aimed = mistray.trace(scene, rays=20_000, seed=1, **limits).energy
    blind = mistray.trace(scene, rays=1_000_000, seed=2, aim="none", **limits).energy
    error = float(np.hypot(aimed.detected_se_W, blind.detected_se_W))
    assert blind.detected_se_W < 0.1 * blind.detected_W
    assert_z(kind, aimed.detected_W, blind.detected_W, error, k=3.0)
    share = aimed.detected_W / aimed.launched_W / sent
    gain = (1 - share) / (20_000 * share) / (aimed.detected_se_W / aimed.detected_W) ** 2
    assert gain > 0.5 / share * (1 - 3 / 8)
