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
FLAT = 1e-12  # area by its longest side squared below which a triangle is only a line
MOST_FACES = 20_000  # faces of a mesh that is compared; larger meshes take part in no contact


@dataclass(frozen=True)
class Rim:
    """
    Rim of a surface: a circle, or a part of a polygon that turns by less than 20° from its chord.

    Attributes
    ----------
    points : (n, 3) float64
        Points on the rim, mm.
    inward : (n, k, 3) float64
        Points of a line inward from each of these points, mm: along the profile of a surface of revolution, else
        straight to the mean of the corners.
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
        for line in _sides(vertices, faces):
            points = _along(line, share)
            rims.append(Rim(points, points[:, None] + share[:, None] * (middle - points)[:, None]))
        super().__init__(shape, rims, vertices[np.unique(faces)])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distances of points (n, 3), mm, from the surface, (n,), mm, see `SpaceOutline.distance`."""
        a, b, c = (self._corners[:, k] for k in range(3))
        found = np.minimum.reduce([_to_segments(points, p, q) for p, q in ((a, b), (b, c), (c, a))])
        normal = np.cross(b - a, c - a)
        area = np.linalg.norm(normal, axis=1)
        wide = area > FLAT * np.max([np.einsum("ij,ij->i", q - p, q - p) for p, q in ((a, b), (b, c), (c, a))], axis=0)
        for k, point in enumerate(points):
            above = np.einsum("ij,ij->i", point - a, normal)
            over = wide.copy()
            for p, q in ((a, b), (b, c), (c, a)):
                over &= np.einsum("ij,ij->i", np.cross(q - p, point - p), normal) >= 0
            if over.any():
                found[k] = min(found[k], (np.abs(above[over]) / area[over]).min())
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


def _along(line: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return points, (n, 3), on a polyline, (k, 3), at shares of its length, (n,)."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    return np.stack([np.interp(share * way[-1], way, place) for place in line.T], axis=1)


def _sides(vertices: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """
    Return the rims of a triangle mesh as polylines, (k, 3), mm.

    They are sides of only one triangle, joined by `_joined`. `vertices`, (n, 3), are in mm, `faces` indices, (m, 3).
    Triangles with two corners at one place have no part in it.
    """
    _, same = np.unique(vertices.round(6), axis=0, return_inverse=True)
    corners = same.ravel()[faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    sides = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    single, count = np.unique(sides, axis=0, return_counts=True)
    place = np.zeros((int(same.max()) + 1, 3))
    place[same.ravel()] = vertices
    return _joined([(place[i], place[j]) for i, j in single[count == 1]])


def _joined(sides: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """
    Return sides, pairs of end points, as polylines, (k, 3), after joining those that continue each other; all in mm.

    A side is joined if it turns by less than 20° (`CORNER`) from the chord of those before.
    """
    at: dict[bytes, list[int]] = {}
    for number, side in enumerate(sides):
        for end in side:
            at.setdefault(end.tobytes(), []).append(number)
    found, used = [], np.zeros(len(sides), dtype=bool)
    for number, side in enumerate(sides):
        if used[number]:
            continue
        used[number] = True
        line = list(side)
        for _ in range(2):  # onwards from the last point, then, in reverse, from the first
            while True:
                here = line[-1]
                way = (here - line[0]) / np.linalg.norm(here - line[0])
                for beside in at[here.tobytes()]:
                    a, b = sides[beside]
                    onward = b if np.array_equal(a, here) else a
                    step = onward - here
                    if not used[beside] and step @ way > CORNER * np.linalg.norm(step):
                        used[beside] = True
                        line.append(onward)
                        break
                else:
                    break
            line.reverse()
        found.append(np.array(line))
    return found
