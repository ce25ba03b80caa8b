"""Narrow cones of light in frames of single precision: flux, size and solid angle beside closed forms."""

from __future__ import annotations

import warnings
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, meter

import mistray
from mistray.errors import MistrayError
from mistray.physics.geometry.pose import rigid_motion
from mistray.sampling.emission_laws import cosine_power_angle

pytestmark = pytest.mark.quick

SPOT = 8.0  # mm, radius of the light on the detector
TURNS = [
    ([0, 1, 0], 0.0),
    ([0, 1, 0], 5.0),
    ([0, 1, 0], -12.0),
    ([1, 0, 0], 30.0),
    ([1, 2, 3], 47.0),
    ([2, -1, 5], 171.0),
]


def turned(axis: list[int], angle: float) -> mi.ScalarTransform4f:
    """A rotation in single precision, as scene dicts have it."""
    unit = np.array(axis) / np.linalg.norm(axis)
    return mi.ScalarTransform4f().rotate(unit.tolist(), angle)


def scene(source: dict[str, Any], frame: mi.ScalarTransform4f) -> mi.Scene:
    detector = {"type": "asphere", "semi_diameter": 10.0, "bsdf": BLACK, "sensor": meter(), "to_world": frame}
    return lit({"id": "source", **source, "to_world": frame}, detector=detector)


@pytest.mark.filterwarnings("ignore:source 'source'. to_world is in single precision")
@pytest.mark.parametrize("half_angle_deg", [3.0, 0.02, 0.00458, 1e-3, 1e-4])
def test_a_turned_scene_has_the_same_light(half_angle_deg: float) -> None:
    """Uniform in solid angle, tan² θ is sec α - 1 on average; the error of the strata is 5 times below the 1e-3."""
    half_angle = np.radians(half_angle_deg)
    distance = SPOT / np.tan(half_angle)
    rms = distance * np.sqrt(2 * np.sin(half_angle / 2) ** 2 / np.cos(half_angle))
    source = {"type": "point_source", "z": -distance, "half_angle_deg": half_angle_deg}
    for axis, angle in TURNS:
        found = mistray.trace(scene(source, turned(axis, angle)), rays=40_000, seed=1)
        assert found.energy.detected_W == pytest.approx(1.0, rel=1e-5), (axis, angle)
        assert found.paths[0].rms_radius_mm == pytest.approx(rms, rel=1e-3), (axis, angle)


@pytest.mark.parametrize("half_angle_deg", [90.0, 40.0, 3.0, 0.02, 1e-4, 1e-6])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.5, 1e4])
def test_solid_angle_of_a_cone(exponent: float, half_angle_deg: float) -> None:
    """By Gauss and Legendre in 200 parts of the angle."""
    edges = np.linspace(0, np.radians(half_angle_deg), 201)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    half = 0.5 * np.diff(edges)[:, None]
    theta = edges[:-1, None] + half * (1 + nodes)
    log_cosine = np.log1p(-2 * np.sin(theta / 2) ** 2)
    expected = 2 * np.pi * float(np.sum(half * weights * np.exp(exponent * log_cosine) * np.sin(theta)))
    assert cosine_power_angle(exponent, float(np.radians(half_angle_deg))) == pytest.approx(expected, rel=1e-9)


def test_a_rough_axis_is_named() -> None:
    """1e-7 rad is 6 % of 1e-4 degrees; frames without a turn, or in double precision, are exact."""
    source = {"type": "point_source", "z": -100.0, "half_angle_deg": 1e-4}
    laser = {"type": "gaussian_beam", "waist_x": 50.0, "waist_y": 1.0, "wavelength_nm": 500.0}  # 3.2e-6 rad
    turn = turned([0, 1, 0], 5.0)
    for given in (source, laser):
        with pytest.warns(mistray.MistrayWarning, match="source 'source'.* 1e-07 rad, (6|3) % of the half angle"):
            scene(given, turn)
    double = mi.ScalarTransform4d().rotate([0, 1, 0], 5.0)
    quarter = mi.ScalarTransform4f([[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene(source, double)
        scene(source, quarter)
        scene({**source, "half_angle_deg": 1e-3}, turn)


@pytest.mark.parametrize("part", [(0, 0), (0, 1)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rigid_motions_are_made_exact(part: tuple[int, int], sign: float) -> None:
    """Scale or shear of 1e-5 is rounding; what is left of it, and a rotation that was exact, is exact."""
    turn = np.array(mi.ScalarTransform4d().rotate([0.6, 0.0, 0.8], 33.0).matrix)
    for strain, refused in ((0.8e-5, False), (1.2e-5, True)):
        given = turn.copy()
        given[:3, :3] @= np.eye(3) + sign * strain * np.outer(np.eye(3)[part[0]], np.eye(3)[part[1]])
        if refused:
            with pytest.raises(MistrayError, match="shape 'a': to_world scales, shears or mirrors"):
                rigid_motion(given, "shape 'a'")
            continue
        found = rigid_motion(given, "shape 'a'")[:3, :3]
        np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(found, turn[:3, :3], atol=strain)
    np.testing.assert_array_equal(rigid_motion(np.eye(4), "a"), np.eye(4))
    with pytest.raises(MistrayError, match="mirrors"):
        rigid_motion(np.diag([1.0, 1.0, -1.0, 1.0]), "a")
    with pytest.raises(MistrayError, match="scales"):
        rigid_motion(np.full((4, 4), np.nan), "a")
