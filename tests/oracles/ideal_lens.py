"""A plano-hyperbolic lens of index 21 (conic -n²), all but ideal and thin, and scattered light behind and before it."""

from collections.abc import Sequence

import numpy as np

from .geometry import Array, Asphere
from .interface import Interface, interact
from .scatter_integrals import Profile, gauss_legendre
from .scatter_scenes import placed_xml
from .small_scenes import interface_xml

INDEX = 21.0
THICKNESS = 0.5
STOP = -0.6  # z of the aperture before the front face


def lens_texts(focal: float, radius: float, R: float = 0.0, T: float = 1.0) -> list[str]:
    """The shapes: a thin black stop of this radius just before the lens, and its two faces."""
    # Nothing that comes past the outer rim of the stop, at some ten degrees, is to meet what lies behind the lens
    stop = placed_xml("asphere", "stop", at=(0.0, 0.0, STOP), semi_diameter=8 * radius, inner_semi_diameter=radius)
    return [stop, *_faces(focal, 1.1 * radius, R, T)]


def telecentric_texts(focal: float, radius: float, least: float, field: float) -> list[str]:
    """The lens with its stop, an annulus of light, in the front focal plane, for images to ``field`` mm."""
    wide = radius + 2 * field
    return [
        placed_xml("asphere", "stop", at=(0.0, 0.0, -focal), semi_diameter=wide, inner_semi_diameter=radius),
        placed_xml("asphere", "middle", at=(0.0, 0.0, -focal), semi_diameter=least),
        placed_xml("frustum", "tube", r0=wide, z0=-focal, r1=wide, z1=0.0),
        *_faces(focal, wide),
    ]


def _faces(focal: float, semi_diameter: float, R: float = 0.0, T: float = 1.0) -> list[str]:
    into, out = (interface_xml(*media, R=R, T=T) for media in (("air", str(INDEX)), (str(INDEX), "air")))
    rear = {"radius": -(INDEX - 1) * focal, "conic": -(INDEX**2)}
    return [
        placed_xml("asphere", "front", into, at=(0.0, 0.0, -THICKNESS), semi_diameter=semi_diameter),
        placed_xml("asphere", "rear", out, semi_diameter=semi_diameter, **rear),
    ]


def through_lens(points: Array, direction: Array, focal: float) -> tuple[Array, Array]:
    """Points and unit directions behind the rear face of rays (n, 3) that start in the plane of the stop."""
    d = np.broadcast_to(direction, points.shape)
    o = points + ((-THICKNESS - points[:, 2]) / d[:, 2])[:, None] * d
    out = interact(Interface("air", str(INDEX)), 1.0, INDEX, 550.0, d, np.tile([0.0, 0.0, 1.0], (len(o), 1)))
    rear = Asphere(-1 / ((INDEX - 1) * focal), -(INDEX**2), outer=2 * focal)
    p = o + rear.first_hit(o, out.transmitted, np.zeros(len(o), dtype=bool))[:, None] * out.transmitted
    return p, interact(Interface(str(INDEX), "air"), INDEX, 1.0, 550.0, out.transmitted, rear.normal(p)).transmitted


def plate_behind(
    profile: Profile, plate_z: float, angles_deg: Sequence[float], focal: float, radius: float, detector_z: float
) -> Array:
    """Irradiance on the axis per irradiance across the beam at each angle, scattered by a plate behind the lens."""
    h, wh = gauss_legendre(np.linspace(0.0, radius, 7), 8)
    phi = (np.arange(96) + 0.5) * np.pi / 96  # the other half is its mirror image
    points = np.stack([h[:, None] * np.cos(phi), h[:, None] * np.sin(phi), np.full((len(h), len(phi)), STOP)], axis=-1)
    weight = np.repeat(wh * h, len(phi)) * 2 * np.pi / 96
    found = []
    for angle in np.radians(angles_deg):
        p, d = through_lens(points.reshape(-1, 3), np.array([np.sin(angle), 0.0, np.cos(angle)]), focal)
        at = p + ((plate_z - p[:, 2]) / d[:, 2])[:, None] * d
        out = np.array([0.0, 0.0, detector_z]) - at
        length = np.linalg.norm(out, axis=1)
        out = out / length[:, None]
        value = profile(np.hypot(d[:, 0] - out[:, 0], d[:, 1] - out[:, 1])) * out[:, 2] ** 2 / length**2
        found.append(np.cos(angle) * np.sum(weight * value))
    return np.array(found)


def plate_before(profile: Profile, angles_deg: Sequence[float], focal: float, radius: float) -> Array:
    """The same of a plate before the lens, for the detector in its focus: BSDF(sin θ) cos θ π NA², exactly."""
    # Light that is scattered along the axis is all that a point on the axis gets; the rim is at the height of the stop
    rim, _ = through_lens(np.array([[radius, 0.0, STOP]]), np.array([0.0, 0.0, 1.0]), focal)
    aperture = radius**2 / (radius**2 + (focal - rim[0, 2]) ** 2)
    angle = np.radians(angles_deg)
    return profile(np.sin(angle)) * np.cos(angle) * np.pi * aperture


def over_cells(value: Array, cell_edges_deg: Array) -> Array:
    """Means over the solid angle of cells (n, 2) of values (n, k) at the angles of `cell_nodes`."""
    x, w = np.polynomial.legendre.leggauss(value.shape[1])
    weight = w * np.sin(np.radians(cell_nodes(cell_edges_deg, len(x))))
    return np.sum(weight * value, axis=1) / np.sum(weight, axis=1)


def cell_nodes(cell_edges_deg: Array, count: int = 3) -> Array:
    """(n, count) field angles of a Gauss-Legendre rule over each cell."""
    x, _ = np.polynomial.legendre.leggauss(count)
    low, high = np.asarray(cell_edges_deg).T
    return 0.5 * (low + high)[:, None] + 0.5 * (high - low)[:, None] * x
