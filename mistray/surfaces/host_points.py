"""Points of the surfaces of a scene in float64, on the host."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.physics.sag import sag
from mistray.surfaces.host_rays import normals
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload


def across(axis: np.ndarray) -> np.ndarray:
    """(3, 2) float64: two unit vectors at right angles to a unit vector and to each other."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=1)


def sphere_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) float64: uniform points of the unit sphere."""
    points = rng.normal(size=(count, 3))
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def lambertian_directions(outward: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) float64: random directions about unit vectors, (n, 3), as a Lambertian surface sends light."""
    d = outward + sphere_points(rng, len(outward))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def box_corners(boxes: Iterable[Any]) -> np.ndarray:
    """(8, 3) float64: corners of the box around some bounding boxes, mm, from the least to the greatest coordinates."""
    ends = np.array([[box.min, box.max] for box in boxes], dtype=np.float64)
    return np.array(list(product(*zip(ends[:, 0].min(axis=0), ends[:, 1].max(axis=0), strict=True))))


def surface_points(
    table: SurfaceTable, surface: int, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """
    Random points of a surface, about uniform over its area, and the normals there.

    Returns
    -------
    points, normals : (count, 3) float64
        mm; unit vectors from front to back.
    """
    u, v = rng.random((2, count))
    if surface >= len(table.pieces):
        sample = mi.Point2f(upload(mi.Float, u), upload(mi.Float, v))
        found = table.shapes[surface].sample_position(0.0, sample)
        p, n = (np.broadcast_to(np.array(v, dtype=np.float64).T, (count, 3)).copy() for v in (found.p, found.n))
        return p, n
    piece = table.pieces[surface]
    if piece.kind == "cone":
        r0, slope = piece.r0, piece.slope
        low, high = piece.z_range
        rims = r0 + slope * low, r0 + slope * high
        r = np.sqrt(rims[0] ** 2 + u * (rims[1] ** 2 - rims[0] ** 2))
        z = (r - r0) / slope if slope else low + u * (high - low)
    elif piece.outer:
        r = np.sqrt(piece.inner**2 + u * (piece.outer**2 - piece.inner**2))
        z = np.asarray(sag(r * r, *piece.conic, piece.coefficients)) + np.zeros(count)
    if piece.kind == "cone" or piece.outer:
        x, y = r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v)
    else:
        x, y = piece.half_size[0] * (2 * u - 1), piece.half_size[1] * (2 * v - 1)
        z = np.asarray(sag(x * x + y * y, *piece.conic, piece.coefficients)) + np.zeros(count)
    p = table.vertices[surface] + np.stack([x, y, z], axis=1) @ table.rotations[surface].T
    return p, normals(table, surface, p)
