"""Backward rays begin in the medium that the detector lies in: cells of glass and of haze against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.object_scenes import common_area
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import z_limit, z_score

import mistray

THICKNESS, RADIUS, CELL_DEG = 10.0, 30.0, 1.0  # mm, mm, degrees
PER_MM = 0.1  # what is lost
ANGLES_DEG = (5.0, 30.0)
ABSORBING = f"1.4+{PER_MM * 550e-6 / (4 * np.pi):.12g}i"
SCATTERING = f"1.4 scatter={PER_MM} g=0.5"


def immersed(material: str) -> str:
    """A detector at the end of a cylinder of a medium; its window reflects nothing, its wall is black."""
    window = interface_xml("air", material, R=0.0, T=1.0)
    return scene_text(
        shape_xml("asphere", "window", 0.0, window, semi_diameter=RADIUS),
        shape_xml("frustum", "wall", r0=RADIUS, r1=RADIUS, z0=0.0, z1=THICKNESS),
        shape_xml("asphere", "detector", THICKNESS, interface_xml(material, R=0.0), sensor=True, semi_diameter=RADIUS),
        radius=RADIUS,
    )


def mean_of_cell(angle_deg: float) -> float:
    """PST_normal of the direct light, the mean over the solid angle of the cell; the wall shades a part."""
    edges = np.radians([angle_deg - CELL_DEG / 2, angle_deg + CELL_DEG / 2])
    theta = np.arccos(np.linspace(*np.cos(edges), 2000))  # even in solid angle
    within = np.arcsin(np.sin(theta) / 1.4)
    lit = np.vectorize(common_area)(THICKNESS * np.tan(within) / RADIUS, 1.0, 1.0) / np.pi
    return float(np.mean(lit * np.cos(theta) * np.exp(-PER_MM * THICKNESS / np.cos(within))))


@pytest.mark.parametrize("material", [ABSORBING, SCATTERING])
@pytest.mark.parametrize("method", ["adjoint", "joined"])
def test_direct_light_is_weakened_in_front_of_the_detector(load_scene, material: str, method: str) -> None:
    """False alarm 1e-3 for all four; without the medium the light would be 2.7 times as strong, 10 errors or more."""
    scene = load_scene(immersed(material))
    pst = mistray.pst(scene, ANGLES_DEG, cell_deg=CELL_DEG, rays=1 << 20, method=method, max_scatters=0, seed=3)
    value, se = pst.curve()
    assert np.all(se < 0.05 * value)
    exact = [mean_of_cell(angle) for angle in ANGLES_DEG]
    assert np.all(np.abs(z_score(value, exact, se)) < z_limit(4 * len(ANGLES_DEG)))


@pytest.mark.long
def test_light_scattered_in_front_of_the_detector(load_scene) -> None:
    """The light of one and two scatter events by both directions alone and together; false alarm 1e-3."""
    scene = load_scene(immersed(SCATTERING))
    found = {
        method: mistray.pst(
            scene, ANGLES_DEG, cell_deg=CELL_DEG, rays=1 << 18, method=method, max_scatters=2, seed=4
        ).curve("multiple_scatter")
        for method in ("adjoint", "forward", "joined")
    }
    forward, forward_se = found.pop("forward")
    for value, se in found.values():
        assert np.all(value > 0)
        assert np.all(np.abs(z_score(value, forward, np.hypot(se, forward_se))) < z_limit(2 * len(ANGLES_DEG)))
