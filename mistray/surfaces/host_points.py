"""Random and evenly spread points on the surfaces of a scene, in float64 on the host."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from mistray.surfaces.host_rays import normals
from mistray.surfaces.upload import download, upload

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

STEPS, MARGIN = 256, 1.05  # steps over the unit square for areas; factor above the largest density found


def across(axis: np.ndarray) -> np.ndarray:
    """Return two unit vectors at right angles to a unit vector and to each other, as columns, (3, 2)."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=1)


def sphere_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random points, uniform on the unit sphere, (count, 3)."""
    points = rng.normal(size=(count, 3))
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def lambertian_directions(outward: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return random unit directions, (n, 3), with cosine (Lambertian) density about outward unit vectors, (n, 3)."""
    d = outward + sphere_points(rng, len(outward))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def box_corners(boxes: Iterable[Any]) -> np.ndarray:
    """Return the corners of the smallest box around bounding boxes, (8, 3), mm, in ascending order."""
    ends = np.array([[box.min, box.max] for box in boxes], dtype=np.float64)
    return np.array(list(product(*zip(ends[:, 0].min(axis=0), ends[:, 1].max(axis=0), strict=True))))


def stock_points(shape: Any, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return world points (n, 3), mm, on one of Mitsuba's own shapes, and the unit normals there, from front to back.

    `u` and `v` are numbers of 0 … 1, (n,) each, such as random ones.
    """
    found = shape.sample_position(0.0, mi.Point2f(upload(mi.Float, u), upload(mi.Float, v)))
    p, n = (np.broadcast_to(download(one), (len(u), 3)).copy() for one in (found.p, found.n))
    return p, n


def surface_points(
    table: SurfaceTable, surface: int, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return random points of a surface, approximately uniform over its area, and the unit normals there.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    surface : int
        Index of the surface in the table.
    count : int
        Number of points.
    rng : Generator
        Source of random numbers.

    Returns
    -------
    points, normals : (count, 3) float64
        Points in the world, mm, and unit normals from front to back.
    """
    u, v = rng.random((2, count))
    if surface >= len(table.pieces):
        return stock_points(table.shapes[surface], u, v)
    piece = table.pieces[surface]
    p = table.vertices[surface] + piece.points(u, v) @ table.rotations[surface].T
    return p, normals(table, surface, p)


def even_points(
    table: SurfaceTable, surface: int, draw: Callable[[], np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return points of a surface, uniform over its area, and the unit normals there.

    The other parameters and the results are described at `surface_points`.

    Parameters
    ----------
    draw : callable
        Returns `count` random numbers of 0 … 1 at each call.
    """
    if surface >= len(table.pieces):
        return stock_points(table.shapes[surface], draw(), draw())
    piece = table.pieces[surface]
    most = MARGIN * float(_shares(table, surface).max())
    q, left = np.zeros((count, 3)), np.ones(count, dtype=bool)
    while left.any():
        points, share = piece.proposals(draw(), draw())
        if share.max() > most:  # those before were taken by a bound that is none
            most, left = MARGIN * float(share.max()), np.ones(count, dtype=bool)
        taken = left & (draw() * most < share)
        q[taken], left = points[taken], left & ~taken
    p = table.vertices[surface] + q @ table.rotations[surface].T
    return p, normals(table, surface, p)


def area(table: SurfaceTable, surface: int) -> float:
    """Return the area of the surface with a given index in a table, mm²."""
    if surface >= len(table.pieces):
        return float(np.array(table.shapes[surface].surface_area()).ravel()[0])
    return float(_shares(table, surface).mean())


def _shares(table: SurfaceTable, surface: int) -> np.ndarray:
    """Return the area per unit of the unit square, mm², at `STEPS`² points, (n,); see `TracedSurface.proposals`."""
    steps = (np.arange(STEPS) + 0.5) / STEPS
    return table.pieces[surface].proposals(*(values.ravel() for values in np.meshgrid(steps, steps)))[1]
