"""Surfaces that see the detector only through others, such as one face of a window through the other."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from lit_detector import BLACK, square
from oracles.statistics import z_limit

import mistray

INDEX, THICK, RADIUS = 1.5, 6.0, 12.5  # of the window, mm
DIFFUSE, BEAM, AWAY, ASIDE, HALF = 0.02, 2.0, 100.0, 40.0, 1.0  # share scattered; beam and detector, mm


def window(scattering: str, z: float, **more: Any) -> mi.Scene:
    """A window in a thin beam, of which one face or what stands behind it scatters, and a detector aside at z."""
    # Without reflections, so that the closed form has one term
    faces = {"front": {"type": "interface", "back": f"{INDEX}", "R": 0.0, "T": 0.9},
             "rear": {"type": "interface", "front": f"{INDEX}", "R": 0.0, "T": 1.0}}  # fmt: skip
    faces.get(scattering, {})["paint"] = {"type": "paint", "reflectance": DIFFUSE, "event": "transmission"}
    shapes = {
        "front": {"type": "asphere", "semi_diameter": RADIUS, "bsdf": faces["front"]},
        "rear": {"type": "asphere", "semi_diameter": RADIUS, "z": THICK, "bsdf": faces["rear"]},
        "edge": {"type": "frustum", "r0": RADIUS, "z0": 0.0, "r1": RADIUS, "z1": THICK, "bsdf": BLACK},
    }
    beam = {"type": "collimated", "radius": BEAM, "irradiance": 1 / (np.pi * BEAM**2)}
    given = {"lamp": beam, **shapes, "detector": square(HALF, y=ASIDE, z=z)}
    return mistray.load({"type": "scene"} | given | more)


def through_the_window() -> float:
    """Power at the detector for 1 W: light at g in the glass lands at r(g) = t tan g + z tan(asin(n sin g)) from where
    it is scattered, so that a Lambertian share ρ gives dP/dA = ρ/π · cos g · sin g / (r dr/dg)."""
    g = np.linspace(1e-4, 0.9999 * np.arcsin(1 / INDEX), 200_001)
    r = THICK * np.tan(g) + AWAY * np.tan(np.arcsin(INDEX * np.sin(g)))
    density = DIFFUSE / np.pi * np.cos(g) * np.sin(g) / (r * np.gradient(r, g))
    x, w = np.polynomial.legendre.leggauss(6)
    rho, phi = BEAM * np.sqrt(0.5 * (x + 1)), 2 * np.pi * (np.arange(12) + 0.5) / 12
    total = 0.0
    for a, w_a in zip(x, w, strict=True):
        for b, w_b in zip(x, w, strict=True):
            px, py = rho[:, None] * np.cos(phi), rho[:, None] * np.sin(phi)
            away = np.hypot(HALF * a - px, ASIDE + HALF * b - py)
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
    beam = {"type": "collimated", "radius": BEAM, "to_world": mi.ScalarTransform4f().translate([0, 0, -10])}
    scene = window("none", -AWAY, lamp=beam, wall=wall)
    (aimed, se), (blind, error) = measured(scene, 10_000), measured(scene, 100_000, aim="none")
    assert abs(aimed - blind) < 4 * np.hypot(se, error)
    assert se < 0.2 * error
