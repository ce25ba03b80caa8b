"""Jumps without rims, silhouettes and the onset of total reflection, against closed forms and new traces.

Every comparison, of zones of two widths, fails by chance with a probability of 1e-3.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from oracles.scatter_scenes import placed_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from rim_gradients import check, power_parts

import mistray
from mistray.metrics.scene_values import changed

pytestmark = pytest.mark.quick

BEAM = 5.0  # mm


def detector(z: float) -> str:
    return shape_xml("asphere", "detector", z, sensor=True, half_width=40.0, half_height=40.0)


@pytest.mark.long
def test_rod_across_a_beam(load_scene) -> None:
    """A black rod of radius 2 mm, 2.5 mm off the middle of the beam, takes a strip out of it."""
    rod = placed_xml("frustum", "rod", at=(2.5, -10.0, 10.0), facing=(0.0, 1.0, 0.0), r0=2.0, r1=2.0, z0=0.0, z1=20.0)
    scene = load_scene(scene_text(rod, detector(20.0), radius=BEAM))
    found = power_parts(scene, ["rod.r0", "rod.r1", "rod.x", "rod.y"], rays=2_000_000)
    inner, outer = (2 * np.sqrt(BEAM**2 - x**2) for x in (0.5, 4.5))
    check("radius", found["rod.r0"] + found["rod.r1"], -(inner + outer))
    check("displacement", found["rod.y"], inner - outer)  # the y of the rod is the x of the world


@pytest.mark.parametrize("coefficient", [0.0, 2e-3])
def test_profile_of_a_shell(load_scene, coefficient: float) -> None:
    """A thin black shell seen from its side hides what lies inside of its profile."""
    c, k, rim = 0.25, -0.4, 2.5
    more = {"a4": coefficient} if coefficient else {}
    shell = placed_xml(
        "asphere", "shell", at=(0.0, 0.0, 10.0), facing=(1.0, 0.0, 0.0), curvature=c, conic=k, semi_diameter=rim, **more
    )
    scene = load_scene(scene_text(shell, detector(20.0), radius=BEAM))

    def area(c: float, k: float, a: float) -> float:
        r, weights = np.polynomial.legendre.leggauss(60)
        r, weights = 0.5 * rim * (r + 1), 0.5 * rim * weights
        root = np.sqrt(1 - (1 + k) * c**2 * r**2)
        return float(np.sum(weights * 2 * r * (c * r / root + 4 * a * r**3)))

    h = 1e-6
    slope = (area(c + h, k, coefficient) - area(c - h, k, coefficient)) / (2 * h)
    found = power_parts(scene, ["shell.curvature"], rays=1_000_000, seed=3)
    check("curvature", found["shell.curvature"], -slope)


def test_outline_of_a_filter(load_scene) -> None:
    """A bowl with an ideal coating, oblique to the beam: rays inside of its outline pass it twice, each time with T."""
    glass = interface_xml(R=0.1, T=0.7)
    tilt = np.radians(75.0)
    bowl = placed_xml(
        "asphere", "bowl", glass, at=(0.0, 0.0, 10.0), facing=(np.sin(tilt), 0.0, np.cos(tilt)),
        curvature=0.3, semi_diameter=3.0,
    )  # fmt: skip
    scene = load_scene(scene_text(bowl, detector(20.0), radius=BEAM))
    found = power_parts(scene, ["bowl.curvature"], rays=1_000_000, max_reflections=0)
    slope, se = difference(scene, "bowl.curvature", 0.3, 0.01)
    check("curvature", found["bowl.curvature"], slope, se)


def difference(scene: Any, key: str, value: float, step: float) -> tuple[float, float]:
    """Central difference of the detected power, W, from traces with rays of their own, and its standard error."""
    powers = []
    for number, sign in enumerate((1, -1)):
        with changed(mi.traverse(scene), {key: np.array([value + sign * step])}):
            energy = mistray.trace(scene, rays=1_000_000, max_scatters=0, max_reflections=0, seed=7 + number).energy
            powers.append((energy.detected_W, energy.detected_se_W))
    return (powers[0][0] - powers[1][0]) / (2 * step), np.hypot(powers[0][1], powers[1][1]) / (2 * step)


def test_onset_of_total_reflection(load_scene) -> None:
    """A converging beam in glass meets a tilted face about the critical angle, up to which its coating passes 0.9."""
    glass = interface_xml("air", "1.5", R=0.0, T=1.0)
    face = interface_xml("1.5", "air", R=0.1, T=0.9)
    tilt = np.radians(41.0)
    front = shape_xml("asphere", "front", 0.0, glass, curvature=0.05, semi_diameter=8.0)
    rear = placed_xml(
        "asphere", "rear", face, at=(0.0, 0.0, 14.0), facing=(0.0, -np.sin(tilt), np.cos(tilt)), semi_diameter=14.0
    )
    scene = load_scene(scene_text(front, rear, detector(40.0), radius=BEAM))
    found = power_parts(scene, ["rear.tilt_x"], max_reflections=0)
    check("tilt", found["rear.tilt_x"], *difference(scene, "rear.tilt_x", 0.0, 0.4))
