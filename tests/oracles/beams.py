"""Deterministic start rays of the sources ``collimated`` and ``point_source``."""

from dataclasses import dataclass

import numpy as np

from .geometry import Array
from .scene_xml import Emitter, SceneModel


@dataclass(frozen=True)
class Beam:
    """Start rays: positions and unit directions (n, 3) in mm, powers (n,) in W."""

    origin: Array
    direction: Array
    power: Array


def field_direction(field_deg: float, azimuth_deg: float = 0.0) -> Array:
    """Rz(azimuth) (0, sin field, cos field)."""
    theta, phi = np.radians(field_deg), np.radians(azimuth_deg)
    return np.array([-np.sin(phi) * np.sin(theta), np.cos(phi) * np.sin(theta), np.cos(theta)])


def disc_points(rays: int, radius: float, inner_radius: float = 0.0) -> Array:
    """Equal-area sunflower pattern, (rays, 2) in mm (Vogel 1979)."""
    k = np.arange(rays) + 0.5
    r = np.sqrt(inner_radius**2 + (radius**2 - inner_radius**2) * k / rays)
    phi = np.pi * (3 - np.sqrt(5)) * k
    return np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1)


def rectangle_points(rays: int, half_width: float, half_height: float) -> Array:
    """Equal-area points of a rank-1 lattice with the golden ratio, (rays, 2) in mm."""
    k = np.arange(rays)
    u, v = (k + 0.5) / rays, (k * (np.sqrt(5) - 1) / 2 + 0.5) % 1
    return np.stack([(2 * u - 1) * half_width, (2 * v - 1) * half_height], axis=1)


def start_distance(model: SceneModel, emitter: Emitter) -> float:
    """The emitter's own ``distance`` in mm, or one that puts the whole start disc outside of the scene."""
    own = float(emitter.values.get("distance", 0.0))
    return own if own > 0 else 1.01 * model.radius_about(emitter.to_world[:3, 3])


def collimated(emitter: Emitter, rays: int, distance: float, field_deg: float | None = None) -> Beam:
    """Start rays of a collimated source, ``distance`` mm upstream of its pivot; None takes the scene's own field."""
    values = emitter.values

    def number(name: str, default: float) -> float:
        return float(values.get(name, default))

    theta_deg = number("field_deg", 0.0) if field_deg is None else field_deg
    phi_deg = number("azimuth_deg", 0.0)
    direction = field_direction(theta_deg, phi_deg)
    if "radius" in values:
        outer, inner = number("radius", 0.0), number("inner_radius", 0.0)
        points, area = disc_points(rays, outer, inner), np.pi * (outer**2 - inner**2)
    else:
        half_width, half_height = number("half_width", 0.0), number("half_height", 0.0)
        points, area = rectangle_points(rays, half_width, half_height), 4 * half_width * half_height
    if str(values.get("plane", "beam")) == "axis":
        offset = np.column_stack([points, np.zeros(rays)])
        area *= direction[2]
    else:
        phi = np.radians(phi_deg)
        across = np.array([np.cos(phi), np.sin(phi), 0.0])
        offset = points[:, :1] * across + points[:, 1:] * np.cross(direction, across)
    rotation, pivot = emitter.to_world[:3, :3], emitter.to_world[:3, 3]
    origin = (offset - distance * direction) @ rotation.T + pivot
    power = number("irradiance", 1.0) * area / rays
    return Beam(origin, np.tile(rotation @ direction, (rays, 1)), np.full(rays, power))


def cone(emitter: Emitter, rays: int, field_deg: float = 0.0) -> Beam:
    """Start rays of a point of light, even in solid angle within its cone; the field moves it in its plane."""
    z, intensity, half_angle_deg = (float(emitter.values[name]) for name in ("z", "intensity", "half_angle_deg"))
    k = np.arange(rays) + 0.5
    cosine = 1 - (1 - np.cos(np.radians(half_angle_deg))) * k / rays
    sine, phi = np.sqrt(1 - cosine**2), np.pi * (3 - np.sqrt(5)) * k
    direction = np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=1)
    rotation, pivot = emitter.to_world[:3, :3], emitter.to_world[:3, 3]
    towards = field_direction(field_deg)
    origin = rotation @ (z * towards / towards[2]) + pivot
    power = intensity * 2 * np.pi * (1 - np.cos(np.radians(half_angle_deg))) / rays
    return Beam(np.tile(origin, (rays, 1)), direction @ rotation.T, np.full(rays, power))


def start(model: SceneModel, rays: int, field_deg: float = 0.0) -> Beam:
    emitter = model.emitters[0]
    if emitter.kind == "point_source":
        return cone(emitter, rays, field_deg)
    return collimated(emitter, rays, start_distance(model, emitter), field_deg)
