"""Distances of points from surfaces and their rims, in float64 on the host: circles, straight rims, triangles."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import mesh_arrays

TOUCH = 1e-3  # distance in mm within which surfaces meet
PROFILE = 257  # points of a curved generatrix, which is straight between them within 1e-5 of its radius
AROUND = 16  # points of a circular rim
INWARD = 8  # every eighth point of a generatrix is used for the lines inward from a rim
ALONG = 9  # points of a straight rim, and of a line from a rim to the middle of its surface
CORNER = np.cos(np.radians(20.0))  # cosine of the angle above which a rim is split
MOST_FACES = 20_000  # faces of a mesh that is compared; larger meshes take part in no contact


@dataclass(frozen=True)
class Rim:
    """
    Rim of a surface: a circle, or one side of a polygon.

    Attributes
    ----------
    points : (n, 3) float64
        Points on the rim, mm.
    inward : (n, k, 3) float64
        Points of a line over the surface, inward from each of these points, mm.
    """

    points: np.ndarray
    inward: np.ndarray


class SpaceOutline(ABC):
    """
    Surface of a scene as a shape in space, with its rims.

    Attributes
    ----------
    name : str
        Id of the shape.
    opaque : bool
        Whether no light passes the surface; True if its BSDF does not say.
    rims : list of Rim
        Rims of the surface.
    low, high : (3,) float64
        Corners of the surface's bounding box, mm.
    """

    def __init__(self, shape: Any, rims: list[Rim], box: np.ndarray) -> None:
        self.name = str(shape.id())
        self.opaque = bool(getattr(shape.bsdf(), "opaque", True))
        self.rims = rims
        self.low, self.high = box.min(axis=0), box.max(axis=0)

    @abstractmethod
    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distances of points (n, 3), mm, from the surface, (n,), mm."""

    @abstractmethod
    def cuts(self, ways: np.ndarray) -> np.ndarray:
        """Return a mask of polylines of k points, (n, k, 3), mm, that the surface crosses, (n,)."""

    def away(self, rim: Rim) -> float:
        """
        Return the largest distance of another surface's rim from this surface, mm.

        Points of the rim whose inward line crosses this surface count as 0.
        """
        far = self.distance(rim.points)
        apart = np.flatnonzero(far > TOUCH)
        if len(apart):
            far[apart[self.cuts(rim.inward[apart])]] = 0.0
        return float(far.max())


class Turned(SpaceOutline):
    """Surface of revolution in space; its profile is a polyline of distances from the axis and places along it, mm."""

    def __init__(self, shape: Any) -> None:
        straight = len(shape.profile(3)) == 3 and _straight(shape.profile(9))
        self._profile = np.asarray(shape.profile(2 if straight else PROFILE), dtype=np.float64)
        self._matrix = np.asarray(shape.matrix, dtype=np.float64)
        turn = 2 * np.pi * np.arange(AROUND) / AROUND
        about = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ways = np.empty((AROUND, len(self._profile), 3))
        ways[..., :2] = about[:, None] * self._profile[:, None, 0][None]
        ways[..., 2] = self._profile[:, 1]
        ways = ways @ self._matrix[:3, :3].T + self._matrix[:3, 3]
        ends = [(0, ways), (-1, ways[:, ::-1])]
        fewer = slice(None, None, INWARD if ways.shape[1] > INWARD else 1)  # points of the lines inwards
        rims = [Rim(way[:, 0], way[:, fewer]) for end, way in ends if self._profile[end, 0] > 0]
        radius = self._profile[:, 0].max()
        corners = np.array([[x, y, z] for x in (-radius, radius) for y in (-radius, radius)
                            for z in (self._profile[:, 1].min(), self._profile[:, 1].max())])  # fmt: skip
        super().__init__(shape, rims, corners @ self._matrix[:3, :3].T + self._matrix[:3, 3])

    def _meridian(self, points: np.ndarray) -> np.ndarray:
        """Return the distances from the axis and the positions along it, (…, 2), mm, of points (…, 3), mm."""
        local = (points - self._matrix[:3, 3]) @ self._matrix[:3, :3]
        return np.stack([np.hypot(local[..., 0], local[..., 1]), local[..., 2]], axis=-1)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distances of points (n, 3), mm, from the surface, (n,), mm, see `SpaceOutline.distance`."""
        return _to_segments(self._meridian(points), self._profile[:-1], self._profile[1:])

    def cuts(self, ways: np.ndarray) -> np.ndarray:
        """Return a mask of polylines that the surface crosses, (n,), see `SpaceOutline.cuts`."""
        flat = self._meridian(ways)
        a, b = flat[:, :-1, None], flat[:, 1:, None]
        c, d = self._profile[:-1], self._profile[1:]
        across = (_turn(a, b, c) * _turn(a, b, d) < 0) & (_turn(c, d, a) * _turn(c, d, b) < 0)
        return np.asarray(across.any(axis=(1, 2)))


class Faces(SpaceOutline):
    """Surface as triangles in space, such as a rectangular clip or a mesh. Its rims are sides of only one triangle."""

    def __init__(self, shape: Any, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._corners = vertices[faces]
        middle = vertices[np.unique(faces)].mean(axis=0)
        share = np.linspace(0.0, 1.0, ALONG)
        rims = []
        for side in _sides(vertices, faces):
            points = side[0] + share[:, None] * (side[1] - side[0])
            rims.append(Rim(points, points[:, None] + share[:, None] * (middle - points)[:, None]))
        super().__init__(shape, rims, vertices[np.unique(faces)])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distances of points (n, 3), mm, from the surface, (n,), mm, see `SpaceOutline.distance`."""
        a, b, c = (self._corners[:, k] for k in range(3))
        found = np.minimum.reduce([_to_segments(points, p, q) for p, q in ((a, b), (b, c), (c, a))])
        normal = np.cross(b - a, c - a)
        for k, point in enumerate(points):
            above = np.einsum("ij,ij->i", point - a, normal)
            over = np.ones(len(a), dtype=bool)
            for p, q in ((a, b), (b, c), (c, a)):
                over &= np.einsum("ij,ij->i", np.cross(q - p, point - p), normal) >= 0
            if over.any():
                found[k] = min(found[k], (np.abs(above[over]) / np.linalg.norm(normal[over], axis=1)).min())
        return found

    def cuts(self, ways: np.ndarray) -> np.ndarray:
        """Return a mask of polylines that the surface crosses, (n,), see `SpaceOutline.cuts`."""
        a, b, c = (self._corners[:, k] for k in range(3))
        normal = np.cross(b - a, c - a)
        found = np.zeros(len(ways), dtype=bool)
        for k, way in enumerate(ways):
            for start, end in pairwise(way):
                first, last = (np.einsum("ij,ij->i", p - a, normal) for p in (start, end))
                some = np.flatnonzero(first * last < 0)
                share = (first / (first - last + (first == last)))[some]
                point = start + share[:, None] * (end - start)
                over = np.ones(len(some), dtype=bool)
                for p, q in ((a, b), (b, c), (c, a)):
                    turn = np.cross((q - p)[some], point - p[some])
                    over &= np.einsum("ij,ij->i", turn, normal[some]) > 0
                if over.any():
                    found[k] = True
                    break
        return found


def outlines(scene: mi.Scene, names: Collection[str] | None = None) -> list[SpaceOutline]:
    """
    Return outlines, sorted by id, of the surfaces of a scene that can be tested for touching one another.

    Parameters
    ----------
    scene : mi.Scene
        Scene to read. Targets and shapes that are neither surfaces of revolution nor triangles are left out. So are
        Mitsuba's own rectangles, and meshes of more than `MOST_FACES` faces.
    names : collection of str, optional
        Ids of the surfaces; by default all.
    """
    found: list[SpaceOutline] = []
    for shape in scene.shapes():
        if getattr(shape.bsdf(), "is_target", False) or (names is not None and shape.id() not in names):
            continue
        if hasattr(shape, "profile") and not getattr(shape, "rectangular", False):
            found.append(Turned(shape))
        elif isinstance(shape, mi.Mesh) and not str(shape).startswith("Rectangle"):  # which keeps its triangles
            vertices, faces = mesh_arrays(shape)
            if 0 < len(faces) <= MOST_FACES:
                found.append(Faces(shape, vertices.astype(np.float64), faces))
    return sorted(found, key=lambda one: one.name)


def _straight(profile: np.ndarray) -> bool:
    way = profile[-1] - profile[0]
    off = _cross(profile - profile[0], way)
    return bool(np.abs(off).max() <= 1e-12 * float(way @ way))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return the cross product of b - a and c - a, points (…, 2): positive if c lies left of the line from a to b."""
    return _cross(b - a, c - a)


def _to_segments(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distances, (n,), of points (n, d) from the nearest of the segments a to b, (m, d), in their unit."""
    way, off = b - a, points[:, None] - a
    length2 = np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
    share = np.clip(np.einsum("kij,ij->ki", off, way) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(off - share[..., None] * way, axis=2).min(axis=1))


def _sides(vertices: np.ndarray, faces: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """
    Return the straight rims of a triangle mesh as pairs of end points, mm.

    They are sides of only one triangle, joined by `_joined`. `vertices`, (n, 3), are in mm, `faces` indices, (m, 3).
    """
    _, same = np.unique(vertices.round(6), axis=0, return_inverse=True)
    sides = np.sort(same.ravel()[np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])], axis=1)
    single, count = np.unique(sides, axis=0, return_counts=True)
    place = np.zeros((int(same.max()) + 1, 3))
    place[same.ravel()] = vertices
    return _joined([(place[i], place[j]) for i, j in single[count == 1]])


def _joined(sides: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """
    Return sides as pairs of end points, mm, after joining sides that continue each other.

    A side is joined if it turns by less than 20° (`CORNER`) from the chord of those before. The chord replaces them.
    """
    at: dict[bytes, list[int]] = {}
    for number, side in enumerate(sides):
        for end in side:
            at.setdefault(end.tobytes(), []).append(number)
    found, used = [], np.zeros(len(sides), dtype=bool)
    for number, (first, last) in enumerate(sides):
        if used[number]:
            continue
        used[number] = True
        ends = [first, last]
        for k in (0, 1):
            while True:
                here, other = ends[k], ends[1 - k]
                way = (here - other) / np.linalg.norm(here - other)
                for beside in at[here.tobytes()]:
                    a, b = sides[beside]
                    onward = b if np.array_equal(a, here) else a
                    step = onward - here
                    if not used[beside] and step @ way > CORNER * np.linalg.norm(step):
                        used[beside], ends[k] = True, onward
                        break
                else:
                    break
        found.append((ends[0], ends[1]))
    return found
