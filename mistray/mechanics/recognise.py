"""Recognition of faces that are complete bands of revolution: cylinders, cones, discs and annuli.

A face counts if its surface is a plane, a cylinder or a cone and its border consists of whole circles about the axis,
one at each end. The triangles show this: edges that belong to a single triangle must lie on these circles and go round
them once, and the triangles must have the area of the band. Faces on one surface are joined first, because many
programs cut a cylinder into halves. Faces with any other border, such as a wall with a hole or a part of a ring, stay
meshes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mistray.io.cad.part import CadPart, RoundSurface

LENGTH_DIGITS = 5  # mm: 10 nm, the single precision of a transform in metres
LARGEST_STEP_RAD = 0.11  # between corners of a circle; a polygon of fewer than 58 sides is no circle
AREA_RANGE = (0.99, 1.001)  # triangles inscribed in a band, over its area


@dataclass(frozen=True, eq=False)
class RevolvedBand:
    """
    Complete band of revolution, such as a cylinder or an annulus, made of one or more faces.

    Attributes
    ----------
    faces : tuple of int
        Indices of the faces that form the band.
    triangles : (m,) int64
        Indices of its triangles in the part.
    foot : (3,) float64
        Point of the axis nearest to the origin, mm.
    axis : (3,) float64
        Unit vector along the axis; its largest component is positive, of equal ones the first.
    r0, z0, r1, z1 : float
        Radii of the two ends, and their positions along the axis from `foot`, mm. z0 ≤ z1, and r0 < r1 for an annulus.
    outward : bool
        Whether the normal of the `Structure`, away from the axis or along it, points to the outside of the body.
    """

    faces: tuple[int, ...]
    triangles: np.ndarray
    foot: np.ndarray
    axis: np.ndarray
    r0: float
    z0: float
    r1: float
    z1: float
    outward: bool

    @property
    def area(self) -> float:
        """Area of the band, mm²."""
        return float(np.pi * (self.r0 + self.r1) * np.hypot(self.r1 - self.r0, self.z1 - self.z0))


def bands(part: CadPart) -> list[RevolvedBand]:
    """
    Return the complete bands of revolution of a part, in the order of their first faces.

    Parameters
    ----------
    part : CadPart
        Part to search.

    Returns
    -------
    list of RevolvedBand
        Bands; empty if the part has no exact surfaces.
    """
    if not part.surfaces:
        return []
    size = float(np.abs(part.vertices).max())
    tolerance = min(1e-3, 1e-4 * size) + 1e-6 * size
    groups: dict[tuple[object, ...], list[int]] = {}
    for face, surface in part.surfaces.items():
        groups.setdefault(_key(surface), []).append(face)
    found = []
    for faces in groups.values():
        surface = part.surfaces[faces[0]]
        chosen = np.flatnonzero(np.isin(part.faces, faces))
        for piece in _connected(part, chosen, tolerance):
            band = _band(part, surface, piece, tolerance)
            if band is not None:
                found.append(band)
    return sorted(found, key=lambda band: band.faces)


def _axis(axis: np.ndarray) -> np.ndarray:
    """
    Return an axis, (3,), as a unit vector with components below 1e-7 set to 0.

    The first of the components that are the largest, to 1e-6, is positive.
    """
    size = np.abs(axis)
    axis = axis * np.sign(axis[np.argmax(size > (1 - 1e-6) * size.max())])
    axis = np.where(size < 1e-7, 0.0, axis)
    return np.asarray(axis / np.linalg.norm(axis))


def _key(surface: RoundSurface) -> tuple[object, ...]:
    """Return a key that is the same for faces on one plane, cylinder or cone."""
    axis = _axis(surface.axis)
    along = float(surface.point @ axis)
    place: tuple[float, ...] = (along,) if surface.kind == "plane" else tuple(surface.point - along * axis)
    if surface.kind == "cone":
        place = (*place, along)
    rounded = (*np.round(axis, 6), *np.round(place, 4), round(surface.size, 5))
    return (surface.kind, *(float(value) + 0.0 for value in rounded))


def _connected(part: CadPart, chosen: np.ndarray, tolerance: float) -> Iterator[np.ndarray]:
    """
    Yield connected groups of triangles, (m, 4): index in the part, and indices of three welded vertices.

    `chosen` holds the indices of the triangles. Vertices less than about a tenth of `tolerance`, mm, apart are welded.
    """
    corners = part.triangles[chosen]
    used, inverse = np.unique(corners, return_inverse=True)
    cells = np.round(part.vertices[used] / (0.1 * tolerance)).astype(np.int64)
    _, welded = np.unique(cells, axis=0, return_inverse=True)
    corners = welded.ravel()[inverse.reshape(-1, 3)]
    count = int(corners.max()) + 1
    links = coo_array(
        (np.ones(2 * len(corners)), (np.repeat(corners[:, 0], 2), corners[:, 1:].ravel())), shape=(count, count)
    )
    _, label = connected_components(links, directed=False)
    for piece in np.unique(label[corners[:, 0]]):
        mine = label[corners[:, 0]] == piece
        yield np.column_stack([chosen[mine], corners[mine]])


def _band(part: CadPart, surface: RoundSurface, piece: np.ndarray, tolerance: float) -> RevolvedBand | None:
    """
    Return the band that connected triangles of one surface form, to `tolerance`, mm; None if they form none.

    `piece` is one of the groups of `_connected`.
    """
    places, welded = piece[:, 0], piece[:, 1:]
    points = np.zeros((int(welded.max()) + 1, 3))
    points[welded.ravel()] = part.vertices[part.triangles[places].ravel()]
    loops = _loops(welded)
    if loops is None or len(loops) > 2:
        return None
    axis = _axis(surface.axis)
    on_axis = surface.point
    if surface.kind == "plane":
        centre = _centre(points[loops[-1]], axis)
        if centre is None:
            return None
        on_axis = centre
    foot = on_axis - (on_axis @ axis) * axis

    def cylindrical(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z = p @ axis
        return np.linalg.norm(p - foot - z[:, None] * axis, axis=1), z

    rings = []
    for loop in loops:
        r, z = cylindrical(points[loop])
        if max(np.ptp(r), np.ptp(z)) > 2 * tolerance or not _whole_circle(points[loop] - foot, axis):
            return None
        rings.append((round(float(np.mean(r)), LENGTH_DIGITS), round(float(np.mean(z)), LENGTH_DIGITS)))
    if len(rings) == 1:  # a disc, or a cone with its tip
        if surface.kind == "cylinder":
            return None
        along = surface.point @ axis if surface.kind == "cone" else rings[0][1]
        rings.append((0.0, round(float(along), LENGTH_DIGITS)))
    flat = surface.kind == "plane"
    (r0, z0), (r1, z1) = sorted(rings, key=lambda ring: ring[0] if flat else ring[1])
    if (not flat and z0 == z1) or (flat and (r0 == r1 or abs(z0 - z1) > 2 * tolerance)):
        return None
    corners = part.vertices[part.triangles[places]]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(axis=1) - foot
    away = middle - (middle @ axis)[:, None] * axis
    facing = cross @ axis if flat else np.sum(cross * away, axis=1)
    outward = bool(np.sum(facing) > 0)
    if not (np.all(facing >= 0) if outward else np.all(facing <= 0)):
        return None
    faces = tuple(sorted({int(face) for face in part.faces[places]}))
    foot = np.round(foot, LENGTH_DIGITS) + 0.0
    band = RevolvedBand(faces, places, foot, axis, r0, z0, r1, z0 if flat else z1, outward)
    share = 0.5 * float(np.linalg.norm(cross, axis=1).sum()) / band.area
    return band if AREA_RANGE[0] <= share <= AREA_RANGE[1] else None


def _loops(triangles: np.ndarray) -> list[np.ndarray] | None:
    """
    Return the closed loops of the border of welded triangles, each as unordered vertex indices.

    The loop with the most vertices is the last. None is returned if there is no border, if it branches, or if an edge
    has more than two triangles.
    """
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    border = edges[counts == 1]
    if not len(border) or counts.max() > 2:
        return None
    vertices, degree = np.unique(border, return_counts=True)
    if np.any(degree != 2):
        return None
    index = np.searchsorted(vertices, border)
    links = coo_array((np.ones(len(index)), (index[:, 0], index[:, 1])), shape=(len(vertices),) * 2)
    count, label = connected_components(links, directed=False)
    return sorted((vertices[label == k] for k in range(count)), key=len)


def _centre(points: np.ndarray, axis: np.ndarray) -> np.ndarray | None:
    """
    Return the centre (3,), mm, of the circle through points in a plane, from a linear fit of |p|² = 2 c·p + const.

    None is returned if the points lie on a line.
    """
    mean = points.mean(axis=0)
    q = points - mean
    matrix = np.column_stack([2 * q, np.ones(len(q))])
    solution, _, rank, _ = np.linalg.lstsq(matrix, np.sum(q * q, axis=1), rcond=1e-9)
    if rank < 3:
        return None
    centre = solution[:3] - (solution[:3] @ axis) * axis
    return np.asarray(mean + centre)


def _whole_circle(offset: np.ndarray, axis: np.ndarray) -> bool:
    """True if points at `offset` from an axis leave no angular gap about it larger than `LARGEST_STEP_RAD`."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    angle = np.sort(np.arctan2(offset @ np.cross(axis, x), offset @ x))
    gaps = np.diff(angle, append=angle[:1] + 2 * np.pi)
    return bool(gaps.max() <= LARGEST_STEP_RAD)
