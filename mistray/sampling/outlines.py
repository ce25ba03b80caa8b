"""Clear apertures as flat targets, and their areas."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from mistray.kernel.targets import Target
from mistray.surfaces.host_points import across
from mistray.surfaces.surfaces import SurfaceTable, is_analytic

AREA_PARTS = 8  # of a curved detector, each way


def outline(shape: Any) -> Target:
    """
    The clear aperture of a shape as a flat target.

    Of a stock shape that is
    neither a rectangle nor a disk it is the circle around its bounding box, at right angles to the shortest edge of the
    box.
    """
    if is_analytic(shape):
        opening, frame = shape.surface(shape.values).opening, shape.vertex_frame(shape.values, shape.matrix)
        x, y, z = frame[:3, :3].T
        (a, b), place = opening.half_size, frame[:3, 3] + opening.height * z
        return Target("parallelogram" if opening.rectangular else "ellipse", place, a * x, b * y, hole=opening.hole)
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
    return float(table.pieces[table.detector].areas(AREA_PARTS, AREA_PARTS).sum())
