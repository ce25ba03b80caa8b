"""Clear apertures of shapes as flat importance targets, and areas of shapes and of the detector."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from mistray.kernel.targets import Target
from mistray.surfaces.host_points import across
from mistray.surfaces.surfaces import SurfaceTable, is_analytic

AREA_PARTS = 8  # patches of a curved surface along each coordinate


def outline(shape: Any) -> Target:
    """
    Return the clear aperture of a shape as a flat target.

    For Mitsuba's own shapes, except rectangles and disks, it is the circle around the bounding box. Its plane is normal
    to the shortest edge of the box.
    """
    # Analytic: the opening of the surface, which is curved, lies at the height of its rim
    if is_analytic(shape):
        opening, frame = shape.surface(shape.values).opening, shape.vertex_frame(shape.values, shape.matrix)
        x, y, z = frame[:3, :3].T
        (a, b), place = opening.half_size, frame[:3, 3] + opening.height * z
        return Target("parallelogram" if opening.rectangular else "ellipse", place, a * x, b * y, hole=opening.hole)
    # Mitsuba's own flat shapes: x and y of their frames are the half axes
    for name, kind in (("Rectangle", "parallelogram"), ("Disk", "ellipse")):
        if str(shape).startswith(name):
            placed = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
            return Target(kind, placed[:3, 3], placed[:3, 0], placed[:3, 1])
    low, high = (np.array(corner, dtype=np.float64) for corner in (shape.bbox().min, shape.bbox().max))
    u, v = 0.5 * np.linalg.norm(high - low) * across(np.eye(3)[np.argmin(high - low)]).T
    return Target("ellipse", 0.5 * (low + high), u, v)


def area_of(shape: Any) -> float:
    """Return the area of a shape, mm²: of the curved surface itself if it is analytic, not of its mesh."""
    if is_analytic(shape):
        return float(shape.surface(shape.values).areas(AREA_PARTS, AREA_PARTS).sum())
    return float(np.array(shape.surface_area()).ravel()[0])


def detector_area(table: SurfaceTable) -> float:
    """Return the area of the detector, mm²: of its curved surface if analytic, else of its outline, see `outline`."""
    shape: Any = table.shapes[table.detector]
    if table.detector >= len(table.pieces):
        return outline(shape).area
    return area_of(shape)
