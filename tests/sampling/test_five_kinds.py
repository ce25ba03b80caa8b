"""Importance sampling of all kinds of rays, also through a window: the flux as without, with less variance."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, hazy_block, square, towards_origin
from oracles.statistics import assert_z, z_limit

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


INDEX, THICK, RADIUS = 1.5, 6.0, 12.5  # of the window, mm
DIFFUSE, BEAM_MM, AWAY, ASIDE_MM, HALF = 0.02, 2.0, 100.0, 40.0, 1.0  # share scattered; beam and detector, mm


def window(scattering: str, z: float, **more: Any) -> mi.Scene:
    # Without reflections, so that the closed form has one term
    faces = {"front": {"type": "interface", "back": f"{INDEX}", "R": 0.0, "T": 0.9},
             "rear": {"type": "interface", "front": f"{INDEX}", "R": 0.0, "T": 1.0}}  # fmt: skip
    faces.get(scattering, {})["paint"] = {"type": "paint", "reflectance": DIFFUSE, "event": "transmission"}
    shapes = {
        "front": {"type": "asphere", "semi_diameter": RADIUS, "bsdf": faces["front"]},
        "rear": {"type": "asphere", "semi_diameter": RADIUS, "z": THICK, "bsdf": faces["rear"]},
        "edge": {"type": "frustum", "r0": RADIUS, "z0": 0.0, "r1": RADIUS, "z1": THICK, "bsdf": BLACK},
    }
    beam = {"type": "collimated", "radius": BEAM_MM, "irradiance": 1 / (np.pi * BEAM_MM**2)}
    given = {"lamp": beam, **shapes, "detector": square(HALF, y=ASIDE_MM, z=z)}
    return mistray.load({"type": "scene"} | given | more)


def through_the_window() -> float:
    """Power at the detector for 1 W: light at g in the glass lands at r(g) = t tan g + z tan(asin(n sin g)) from where
    it is scattered, so that a Lambertian share ρ gives dP/dA = ρ/π · cos g · sin g / (r dr/dg)."""
    g = np.linspace(1e-4, 0.9999 * np.arcsin(1 / INDEX), 200_001)
    r = THICK * np.tan(g) + AWAY * np.tan(np.arcsin(INDEX * np.sin(g)))
    density = DIFFUSE / np.pi * np.cos(g) * np.sin(g) / (r * np.gradient(r, g))
    x, w = np.polynomial.legendre.leggauss(6)
    rho, phi = BEAM_MM * np.sqrt(0.5 * (x + 1)), 2 * np.pi * (np.arange(12) + 0.5) / 12
    total = 0.0
    for a, w_a in zip(x, w, strict=True):
        for b, w_b in zip(x, w, strict=True):
            px, py = rho[:, None] * np.cos(phi), rho[:, None] * np.sin(phi)
            away = np.hypot(HALF * a - px, ASIDE_MM + HALF * b - py)
            total += HALF**2 * w_a * w_b * float(0.5 * w @ np.interp(away, r, density).mean(axis=1))
    return total


def measured(scene: mi.Scene, rays: int, **settings: str) -> tuple[float, float]:
    energy = mistray.trace(scene, rays=rays, **settings).energy
    assert abs(energy.closure) < 1e-6
    return energy.detected_W, energy.detected_se_W


def test_scatter_at_the_front_of_a_window_finds_the_detector_through_its_rear() -> None:
    """The closed form within a z of two-sided chance 1e-4 and within 2 %; unaimed, this many rays find nothing."""
    scene, expected = window("front", THICK + AWAY), through_the_window()
    power, se = measured(scene, 10_000)
    assert se < 0.02 * expected
    assert abs(power - expected) < z_limit(1, 1e-4) * se


def test_a_diffuser_behind_a_window_finds_the_detector_before_it() -> None:
    """An opaque wall that sees the detector through both faces: as by rays without aim, 4 errors (6e-5) of a fifth."""
    paint = {**BLACK, "paint": {"type": "paint", "reflectance": 0.5}}
    wall = {"type": "asphere", "semi_diameter": 10.0, "z": 20.0, "bsdf": paint}
    beam = {"type": "collimated", "radius": BEAM_MM, "to_world": mi.ScalarTransform4f().translate([0, 0, -10])}
    scene = window("none", -AWAY, lamp=beam, wall=wall)
    (aimed, se), (blind, error) = measured(scene, 10_000), measured(scene, 100_000, aim="none")
    assert abs(aimed - blind) < 4 * np.hypot(se, error)
    assert se < 0.2 * error
