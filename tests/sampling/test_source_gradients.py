"""Derivatives by every number of a source that has them, beside differences of float64 quadratures."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, RADIUS, TUBE, lit, meter
from oracles.statistics import assert_z

import mistray
from mistray.optimize import path_power
from mistray.plugins.emitters.light_source import LightSource
from mistray.sampling.sources import scene_sources

pytestmark = pytest.mark.quick


def scene(lamp: dict[str, Any]) -> mi.Scene:
    detector = {"type": "asphere", "semi_diameter": RADIUS, "bsdf": BLACK, "sensor": meter(8)}
    return mi.load_dict({"type": "scene", "detector": detector, "lamp": lamp, "tube": TUBE}, optimize=False)


WAIST = {"waist_x": 0.2, "waist_y": 0.2, "m2_x": 2.0, "m2_y": 2.0}
LASER = {"type": "gaussian_beam", "z": -4000.0, "wavelength_nm": 1000.0, **WAIST}
POINT = {"type": "point_source", "z": -30.0}
LAMP = {**POINT, "half_angle_deg": 89.0, "exponent": 4.0}
DISC = {"type": "surface_source", "z": -15.0, "radius": 12.0}
SCREEN = {"type": "surface_source", "z": -15.0, "half_width": 12.0, "half_height": 9.0}
SUN = {"type": "distant_disc", "field_deg": 40.0}
GRADIENTS: dict[str, tuple[dict[str, Any], str, float]] = {  # what, by which numbers, a step
    "distance": ({**POINT, "half_angle_deg": 60.0}, "z", 1e-3),
    "cone": ({**POINT, "half_angle_deg": 25.0}, "half_angle_deg", 1e-3),
    "cone of a Lambertian point": ({**POINT, "half_angle_deg": 25.0, "exponent": 1.0}, "half_angle_deg", 1e-3),
    "place in x": ({**POINT, "z": -15.0, "x": 6.0, "half_angle_deg": 80.0}, "x", 1e-3),
    "place in y": ({**POINT, "z": -15.0, "x": 2.0, "y": -6.0, "half_angle_deg": 80.0}, "y", 1e-3),
    "tilt about x": ({**LAMP, "tilt_x": 25.0, "tilt_y": 5.0}, "tilt_x", 1e-2),
    "tilt about y": ({**LAMP, "tilt_x": 5.0, "tilt_y": -25.0}, "tilt_y", 1e-2),
    "radius": (DISC, "radius", 1e-3),
    "cone of a disc": ({**DISC, "radius": 6.0, "half_angle_deg": 30.0}, "half_angle_deg", 1e-3),
    "width": (SCREEN, "half_width", 1e-2),
    "height": (SCREEN, "half_height", 1e-2),
    "disc in x": ({**DISC, "x": 6.0}, "x", 1e-2),
    "disc in y": ({**DISC, "y": 6.0}, "y", 1e-2),
    "disc in z": (DISC, "z", 1e-2),
    "disc about x": ({**DISC, "tilt_x": 25.0, "exponent": 6.0}, "tilt_x", 1e-2),
    "disc about y": ({**DISC, "tilt_y": 25.0, "tilt_x": 5.0, "exponent": 6.0}, "tilt_y", 1e-2),
    "screen about y": ({**SCREEN, "tilt_y": 25.0, "exponent": 6.0}, "tilt_y", 1e-2),
    "waist in x": (LASER, "waist_x", 1e-5),
    "waist in y": (LASER, "waist_y", 1e-5),
    "quality in x": (LASER, "m2_x", 1e-4),
    "quality in y": (LASER, "m2_y", 1e-4),
    "waist place in x": ({**LASER, "offset_x": 500.0}, "offset_x", 1e-2),
    "waist place in y": ({**LASER, "offset_y": 500.0}, "offset_y", 1e-2),
    "beam in x": ({**LASER, "x": 5.0}, "x", 1e-3),
    "beam in y": ({**LASER, "y": 5.0}, "y", 1e-3),
    "beam in z": (LASER, "z", 1e-1),
    "beam about x": ({**LASER, "tilt_x": 0.07}, "tilt_x", 1e-4),
    "beam about y": ({**LASER, "tilt_y": 0.07}, "tilt_y", 1e-4),
    "direction of the sun": ({**SUN, "tilt_x": 2.0, "tilt_y": 5.0}, "tilt_x", 1e-3),
    "direction of the sun about y": ({**SUN, "tilt_y": 20.0}, "tilt_y", 1e-3),
    "size of the sun": ({"type": "distant_disc", "diameter_deg": 60.0}, "diameter_deg", 1e-2),
}


def places_of(lamp: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Where a source starts, (n, 2), and the share of each place: Gauss's quadratures."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    if lamp["type"] == "point_source":
        return np.zeros((1, 2)), np.ones(1)
    if lamp["type"] == "gaussian_beam":
        (x, w), sizes = np.polynomial.hermite_e.hermegauss(9), [0.5 * lamp[f"waist_{axis}"] for axis in "xy"]
        w = w / w.sum()
    elif "half_width" in lamp:
        x, w, sizes = nodes, weights / 2, [lamp["half_width"], lamp["half_height"]]
    else:
        rho, phi = np.sqrt(0.5 + 0.5 * nodes) * lamp["radius"], np.arange(24) * 2 * np.pi / 24
        shares = np.repeat(weights / 2 / 24, 24)
        return np.stack([np.outer(rho, np.cos(phi)).ravel(), np.outer(rho, np.sin(phi)).ravel()], axis=1), shares
    grid = np.stack(np.meshgrid(sizes[0] * x, sizes[1] * x, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid, np.outer(w, w).ravel()


def lights(lamp: dict[str, Any], at: np.ndarray, q: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Irradiance at points (n, 3) of a plane, W/mm², by the light of one place of a source of 1 W, in its own frame."""
    if lamp["type"] == "gaussian_beam":  # rays of one place of the waist have normal slopes
        found, slopes = np.ones(len(q)), np.ones((len(q), 3))
        for k, axis in enumerate("xy"):
            width = lamp[f"m2_{axis}"] * lamp["wavelength_nm"] * 1e-6 / (2 * np.pi * lamp[f"waist_{axis}"])
            away = q[:, 2] - lamp.get(f"offset_{axis}", 0.0)
            slopes[:, k] = (q[:, k] - at[k]) / away
            found *= np.exp(-0.5 * (slopes[:, k] / width) ** 2) / (np.sqrt(2 * np.pi) * width * away)
        return found * (slopes @ normal)
    away = q - np.append(at, 0.0)
    r = np.linalg.norm(away, axis=1)
    lambertian = lamp["type"] == "surface_source"
    power, half = lamp.get("exponent", float(lambertian)), lamp.get("half_angle_deg", 90.0 if lambertian else 180.0)
    edge, cosine = np.cos(np.radians(half)), away[:, 2] / r
    whole = 2 * np.pi * (1 - (max(edge, 0.0) if power else edge) ** (power + 1)) / (power + 1)
    return np.asarray(np.where(cosine >= edge, np.maximum(cosine, 0) ** power, 0) / whole * (away @ normal) / r**3)


def exact_flux(lamp: dict[str, Any]) -> float:
    """Of 1 W, what the detector gets; of 1 W/mm² of the sun."""
    turned, aside = (np.radians(lamp.get(key, 0.0)) for key in ("tilt_x", "tilt_y"))
    if lamp["type"] == "distant_disc":
        # cos of the middle; with a size times the mean of cos, as for the wide disc above
        half = np.radians(lamp.get("diameter_deg", 0.533)) / 2
        mean = 2 / 3 * (1 - np.cos(half) ** 3) / np.sin(half) ** 2
        return float(np.pi * RADIUS**2 * mean * np.cos(aside) * np.cos(np.radians(lamp.get("field_deg", 0.0)) - turned))
    place = np.array([lamp.get(key, 0.0) for key in "xyz"])
    angle = np.radians(lamp.get("half_angle_deg", 90.0))
    if angle < np.pi / 4:  # the edge of the cone is on the detector
        return cone_share(-place[2], lamp.get("radius", 0.0), angle, lamp.get("exponent", float("radius" in lamp)))
    (sx, cx), (sy, cy) = ((np.sin(tilt), np.cos(tilt)) for tilt in (turned, aside))
    axes = np.array([[cy, sx * sy, -cx * sy], [0, cx, sx], [sy, -sx * cy, cx * cy]])
    nodes, weights = np.polynomial.legendre.leggauss(48)
    rho, phi = np.sqrt(0.5 + 0.5 * nodes) * RADIUS, np.arange(96) * 2 * np.pi / 96
    q = np.stack([np.outer(rho, np.cos(phi)).ravel(), np.outer(rho, np.sin(phi)).ravel(), np.zeros(48 * 96)], axis=1)
    area = np.repeat(weights / 2 / 96 * np.pi * RADIUS**2, 96)
    parts = zip(*places_of(lamp), strict=True)
    return sum(share * float(lights(lamp, at, (q - place) @ axes.T, axes[:, 2]) @ area) for at, share in parts)


def cone_share(distance: float, size: float, angle: float, power: float) -> float:
    """Share of the light of a disc (a point) on the axis, in cones of cosⁿ θ, that meets the detector."""
    if not size:
        inner = max(np.cos(angle), distance / np.hypot(distance, RADIUS))
        return float((1 - inner ** (power + 1)) / (1 - np.cos(angle) ** (power + 1)))
    nodes, weights = np.polynomial.legendre.leggauss(200)
    rho = np.sqrt(0.5 + 0.5 * nodes)[:, None] * size
    theta = (np.arange(5000) + 0.5) / 5000 * angle
    law, s = np.sin(theta) * np.cos(theta) ** power, distance * np.tan(theta)
    within = np.arccos(np.clip((s * s + rho**2 - RADIUS**2) / (2 * s * rho), -1, 1)) / np.pi  # of each ring of light
    return float(weights / 2 @ (within @ law) / law.sum())


TWINS = ("place in y", "tilt about y", "height", "cone of a disc", "direction of the sun about y")  # of others above


# They differ from another gradient by the axis or by a source that starts in the same way
ALIKE = [one for one in GRADIENTS if one in TWINS or one.startswith(("disc", "screen", "beam")) or one.endswith("in y")]


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.long] * (one in ALIKE)) for one in GRADIENTS])
def test_gradient(name: str) -> None:
    """By numbers of the source, with what the rim of the detector takes; false alarms 0.02 % each of 31."""
    lamp, key, step = GRADIENTS[name]
    here = scene(lamp)
    metric = path_power(here, "straight shot", rays=400_000, seed=1)  # half of them go to the detector
    g = mistray.gradient(metric, mi.traverse(here), keys=[f"lamp.{key}"])
    up, down = (exact_flux({**lamp, key: lamp.get(key, 0.0) + sign * step}) for sign in (1, -1))
    (source,) = scene_sources(here)
    exact = (up - down) / (2 * step) / source.power  # the metric is a share
    found, error = (float(values[f"lamp.{key}"][0]) for values in (g.gradient, g.standard_error))
    assert_z(name, found, exact, error, false_alarm=2e-4)
    assert error < 0.15 * abs(exact)


def test_every_gradient_is_compared() -> None:
    module = "mistray.plugins.emitters."
    pending, found = [LightSource], set()
    while pending:
        kind = pending.pop()
        pending += kind.__subclasses__()
        if kind.__module__.startswith(module) and not kind.__subclasses__():
            found |= {(kind.__module__.removeprefix(module), key) for key in kind.differentiable}
    assert found == {(lamp["type"], key) for lamp, key, _ in GRADIENTS.values()}
    sources = {kind for kind, _ in found}
    assert sources == {"point_source", "surface_source", "gaussian_beam", "distant_disc"}
    here = lit({"type": "sky"})  # as of the others
    with pytest.raises(mistray.MistrayError, match="lamp"):
        mistray.gradient(path_power(here, "straight shot", rays=1000), mi.traverse(here), keys=["lamp.*"])
