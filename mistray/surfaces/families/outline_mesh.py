"""Triangle mesh of the area within an outline, for meshes and pictures."""

from __future__ import annotations

import numpy as np

from mistray.physics.geometry.outline import Outline

CELLS = 64  # cells across the longer side of the box
HALVINGS = 30  # bisections of a side of a triangle that leaves the outline


def outline_mesh(outline: Outline, cells: int = CELLS) -> tuple[np.ndarray, np.ndarray]:
    """
    Return a triangle mesh of the area within an outline, made from a grid cut off at the rim.

    Parameters
    ----------
    outline : Outline
        Outline to fill.
    cells : int
        Number of cells across the longer side of its box.

    Returns
    -------
    points : (n, 2) float64
        Corners of the triangles, mm.
    faces : (m, 3) uint32
        Indices of the three corners of each triangle, counterclockwise.
    """
    x0, x1, y0, y1 = outline.bounds()
    step = max(x1 - x0, y1 - y0) / cells
    nx, ny = max(1, round((x1 - x0) / step)), max(1, round((y1 - y0) / step))
    x, y = np.meshgrid(np.linspace(x0, x1, nx + 1), np.linspace(y0, y1, ny + 1))
    points = np.column_stack([x.ravel(), y.ravel()])
    # Points on the very rim count as inside
    middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
    inside = _inside(outline, middle + (1 - 1e-9) * (points - middle))
    i, j = np.meshgrid(np.arange(nx), np.arange(ny))
    a = (j * (nx + 1) + i).ravel()
    faces = np.concatenate([np.column_stack([a, a + 1, a + nx + 2]), np.column_stack([a, a + nx + 2, a + nx + 1])])
    count = inside[faces].sum(axis=1)
    whole, one, two = faces[count == 3], faces[count == 1], faces[count == 2]
    # Turned so that the odd corner comes first
    one = _turned(one, np.argmax(inside[one], axis=1))
    two = _turned(two, np.argmin(inside[two], axis=1))
    parts, corners, start = [whole], [points], len(points)
    for face, odd_inside in ((one, True), (two, False)):
        if not len(face):
            continue
        cuts = [_cut(outline, points[face[:, 0]], points[face[:, k]], odd_inside) for k in (1, 2)]
        first, second = start + np.arange(len(face)), start + len(face) + np.arange(len(face))
        start += 2 * len(face)
        corners += cuts
        if odd_inside:
            parts.append(np.column_stack([face[:, 0], first, second]))
        else:
            parts += [np.column_stack([first, face[:, 1], face[:, 2]]), np.column_stack([first, face[:, 2], second])]
    points, faces = np.concatenate(corners), np.concatenate(parts)
    used, faces = np.unique(faces, return_inverse=True)
    return points[used], faces.reshape(-1, 3).astype(np.uint32)


def _inside(outline: Outline, points: np.ndarray) -> np.ndarray:
    return np.asarray(outline.contains(points[:, 0], points[:, 1]))


def _turned(faces: np.ndarray, first: np.ndarray) -> np.ndarray:
    return np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)


def _cut(outline: Outline, a: np.ndarray, b: np.ndarray, a_inside: bool) -> np.ndarray:
    """
    Return the points, (n, 2), mm, at which segments from a to b, (n, 2), cross the edge of the outline, by bisection.

    `a_inside` says whether the points a lie inside, and b outside, or the reverse.
    """
    low, high = np.zeros(len(a)), np.ones(len(a))
    for _ in range(HALVINGS):
        half = 0.5 * (low + high)
        like_a = _inside(outline, a + half[:, None] * (b - a)) == a_inside
        low, high = np.where(like_a, half, low), np.where(like_a, high, half)
    return np.asarray(a + low[:, None] * (b - a))
