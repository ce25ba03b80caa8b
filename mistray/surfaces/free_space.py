"""Space without Mitsuba shapes: segments that stay within it need no search of Mitsuba's acceleration structure.

Mitsuba shapes mostly stand around the optics, such as a tube or a housing. For each slice of z there is a radius about
the optical axis within which none stands. The distance from an axis is convex along a segment. So a segment meets no
such shape if both of its ends are nearer to the axis than the free radius of every slice that it crosses. Most segments
within a lens are of this kind.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import mesh_arrays
from mistray.cache.remembered import remembered
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

SLICES = 64
SLACK = 1e-4  # margin in units of the size of the shapes: far above the rounding of float32 near the origin

_known: dict[bytes, tuple[np.ndarray, ...]] = {}


class FreeSpace:
    """
    Radius, mm, free of Mitsuba shapes about the axis that most analytic surfaces share, for each slice of z.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene, with at least one analytic and one Mitsuba shape.

    Attributes
    ----------
    some : bool
        Whether any slice has a free radius.
    """

    def __init__(self, table: SurfaceTable) -> None:
        common = Counter(piece.axis for piece in table.pieces).most_common(1)[0][0]
        frame, x, y = table.axes[common]
        rotation = table.frames[frame]
        low, high, radius = stock_extents(table.shapes[len(table.pieces) :], table.centre, rotation, (x, y))
        slack = max(SLACK * float(max(np.ptp([low.min(), high.max()]), radius.max())), 4 * table.mitsuba_epsilon)
        self._first, last = low.min() - slack, high.max() + slack
        # Slice 0 is all space before the shapes, the last one all space behind them
        per_mm = SLICES / (last - self._first)
        start = np.clip(((low - slack - self._first) * per_mm).astype(int), 0, SLICES - 1)
        end = np.clip(((high + slack - self._first) * per_mm).astype(int), 0, SLICES - 1)
        free = np.full(SLICES + 2, np.inf)
        for k in range(int((end - start).max(initial=0)) + 1):
            reached = start + k <= end
            np.minimum.at(free, 1 + start[reached] + k, radius[reached])
        free = np.maximum(free - slack, 0.0)
        numbers = range(SLICES + 2)
        between = np.array([[free[min(i, j) : max(i, j) + 1].min() for j in numbers] for i in numbers])
        self.some = bool(np.any(free[1:-1] > 0))
        self._squares = upload(mi.Float, np.minimum(between**2, 1e30))
        self._rows = [mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in axis)) for axis in rotation.T]
        self._x, self._y, self._z, self._per_mm = (dr.opaque(mi.Float, float(v)) for v in (x, y, self._first, per_mm))

    def holds(self, o: mi.Vector3f, d: mi.Vector3f, t: mi.Float) -> mi.Bool:
        """
        Return a mask of segments that stay clear of all Mitsuba shapes for certain; False for infinite ones.

        They start at o, mm, relative to `SurfaceTable.centre`, and have the unit direction d and the length t, mm.
        """
        a = [dr.dot(row, o) for row in self._rows]
        b = [dr.fma(t, dr.dot(row, d), start) for row, start in zip(self._rows, a, strict=True)]
        outer = dr.maximum(*(dr.square(p[0] - self._x) + dr.square(p[1] - self._y) for p in (a, b)))
        first, last = (self._slice(p[2]) for p in (a, b))
        finite = dr.isfinite(t)
        return finite & (outer < dr.gather(mi.Float, self._squares, first * (SLICES + 2) + last, finite))

    def _slice(self, z: mi.Float) -> mi.UInt32:
        return mi.UInt32(dr.clip((z - self._z) * self._per_mm + 1, 0, SLICES + 1))


def stock_extents(
    shapes: Sequence[Any], centre: np.ndarray, rotation: np.ndarray, axis: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the extents along an axis and the least distances from it, mm, of the triangles of Mitsuba shapes.

    A shape that is no mesh has all triangles between corners of its bounding box, which fill the box.

    Parameters
    ----------
    shapes : sequence of mi.Shape
        Mitsuba's own shapes.
    centre : (3,) float64
        Origin of the frame in the world, mm.
    rotation : (3, 3) float64
        Columns: axes of the frame; the third one is parallel to the axis.
    axis : (2,) float
        Coordinates x and y of the axis in the frame, mm.

    Returns
    -------
    low, high : (n,) float64
        Smallest and largest z of each triangle of all shapes, mm.
    radius : (n,) float64
        Least distance of each triangle from the axis, mm.
    """
    found = []
    for shape in shapes:
        points, faces = _triangles(shape)
        key = hashlib.sha256(points.tobytes() + faces.tobytes() + repr((centre, rotation, axis)).encode()).digest()

        def extents(points: np.ndarray = points, faces: np.ndarray = faces) -> tuple[np.ndarray, ...]:
            local = (points.astype(np.float64) - centre) @ rotation - (*axis, 0.0)
            z = local[:, 2][faces]
            return z.min(axis=1), z.max(axis=1), _distance(local[:, :2][faces])

        # A million triangles take half a second
        found.append(remembered(_known, key, extents))
    low, high, radius = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return low, high, radius


def _triangles(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """
    Return corners (n, 3), mm, and triangles (m, 3), as indices of corners, of a mesh in the world frame.

    For any other shape, and a mesh without triangles, these are the corners of its bounding box, and all triangles
    between them.
    """
    if isinstance(shape, mi.Mesh) and not str(shape).startswith("Rectangle"):  # which keeps its triangles to itself
        points, faces = mesh_arrays(shape)
        if len(faces):
            return points, faces
    box = shape.bbox()
    corners = np.array([[(box.min, box.max)[k >> j & 1][j] for j in range(3)] for k in range(8)], dtype=np.float64)
    # All triangles between corners fill the box, so that a line through it meets one
    return corners, np.array(list(combinations(range(8), 3)))


def _distance(corners: np.ndarray) -> np.ndarray:
    """Return the distances of plane triangles, (n, 3, 2), mm, from the origin, (n,), mm; 0 if they hold it."""
    sides = np.roll(corners, -1, axis=1) - corners
    turn = corners[..., 0] * sides[..., 1] - corners[..., 1] * sides[..., 0]
    inside = (np.all(turn >= 0, axis=1) | np.all(turn <= 0, axis=1)) & np.any(turn != 0, axis=1)
    squares = np.maximum(np.sum(sides**2, axis=2), 1e-300)
    along = np.clip(-np.sum(corners * sides, axis=2) / squares, 0.0, 1.0)
    nearest = np.linalg.norm(corners + along[..., None] * sides, axis=2).min(axis=1)
    return np.where(inside, 0.0, nearest)
