"""Clear apertures as flat targets, and their areas."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from mistray.kernel.targets import Target
from mistray.physics.sag import sag_derivative
from mistray.surfaces.host_points import across
from mistray.surfaces.surfaces import SurfaceTable

AREA_NODES = 128  # of the quadrature over a curved detector


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
