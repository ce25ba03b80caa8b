"""Points of the surfaces of a scene in float64, on the host, and flat outlines of their apertures."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.physics.sag import sag, sag_derivative
from mistray.trace.host_rays import normals
from mistray.trace.surfaces import SurfaceTable
from mistray.trace.targets import Target
from mistray.trace.upload import upload

AREA_NODES = 128  # of the quadrature over a curved detector


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


def outline(shape: Any) -> Target:
    """
    The clear aperture of a shape as a flat target.

    Of an `asphere` it lies in the plane of its rim, of a `frustum` in that of its larger rim. Of a stock shape that is
    neither a rectangle nor a disk it is the circle around its bounding box, at right angles to the shortest edge of the
    box.
    """
    if hasattr(shape, "outer_radius"):
        v, matrix = shape.values, shape.matrix
        x, y, z = matrix[:3, :3].T
        if shape.kind == "asphere" and shape.rectangular:
            return Target("parallelogram", matrix[:3, 3], v["half_width"] * x, v["half_height"] * y)
        outer = shape.outer_radius
        if shape.kind == "asphere":
            inner, height = v["inner_semi_diameter"], float(shape.sag(np.array(outer)))
        else:
            inner = min(v["r0"], v["r1"]) if shape.flat else 0.0
            height = v["z0"] if v["r0"] >= v["r1"] else v["z1"]
        return Target("ellipse", matrix[:3, 3] + height * z, outer * x, outer * y, hole=inner / outer)
    for name, kind in (("Rectangle", "parallelogram"), ("Disk", "ellipse")):
        if str(shape).startswith(name):
            placed = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
            return Target(kind, placed[:3, 3], placed[:3, 0], placed[:3, 1])
    low, high = (np.array(corner, dtype=np.float64) for corner in (shape.bbox().min, shape.bbox().max))
    u, v = 0.5 * np.linalg.norm(high - low) * across(np.eye(3)[np.argmin(high - low)]).T
    return Target("ellipse", 0.5 * (low + high), u, v)


def detector_area(table: SurfaceTable) -> float:
    """Area of the detector, mm²; of a curved one that of its surface."""
    shape: Any = table.shapes[table.detector]
    if table.detector >= len(table.pieces):
        return outline(shape).area
    piece = table.pieces[table.detector]
    nodes, weights = np.polynomial.legendre.leggauss(AREA_NODES)

    def stretch(r2: np.ndarray) -> np.ndarray:
        """Area of the surface over that of its projection."""
        slope = sag_derivative(r2, *piece.conic, piece.coefficients)
        return np.sqrt(1 + 4 * r2 * np.square(slope))

    if piece.outer:
        half = 0.5 * (piece.outer - piece.inner)
        r = piece.inner + half * (nodes + 1)
        return float(half * np.sum(weights * 2 * np.pi * r * stretch(r * r)))
    a, b = piece.half_size
    x, y = a * nodes, b * nodes[:, None]
    return float(a * b * np.sum(weights * weights[:, None] * stretch(x * x + y * y)))
