"""Rays traced in float64 on the host through the kernel's surfaces, a few hundred to set up a trace."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.optics import MIRROR, OPAQUE
from mistray.surfaces.surface import (
    NO_SURFACE,
    Bounds,
    TracedSurface,
    asphere_crossings,
    asphere_gradient,
    quadric_crossings,
    quadric_gradient,
    within_bounds,
)
from mistray.surfaces.upload import download, upload

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

BOX_ROOM = 1e-6  # margin around the boxes of surfaces, in units of their size
AT_ONCE = 4  # boxes that a ray enters next, whose surfaces are tested together
TINY = 1e-150  # least direction cosine; a ray with a smaller one counts as parallel to the sides of a box


def local(table: SurfaceTable, surface: int, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return world points, mm, and directions, (n, 3) each, in the vertex frame of an analytic surface."""
    return _place(table, surface, o), d @ table.rotations[surface]


def crossings(table: SurfaceTable, surface: int, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """
    Return the distances at which lines cross the unbounded sheet of an analytic surface, mm.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    surface : int
        Index of the surface.
    o, d : (n, 3) float64
        Points on the lines, mm, and their unit directions.

    Returns
    -------
    (n, k) float64
        Distances along the lines, mm, of either sign; NaN where there is no crossing.
    """
    o, d = local(table, surface, o, d)
    with np.errstate(all="ignore"):
        t = table.pieces[surface].crossings(o, d)
    return np.where(np.isfinite(t), t, np.nan)


def inside(table: SurfaceTable, surface: int, p: np.ndarray) -> np.ndarray:
    """
    Return a mask, (n,), of world points (n, 3), mm, on an analytic surface's sheet, that lie within its bounds.

    It is False for NaN.
    """
    with np.errstate(invalid="ignore"):
        return table.pieces[surface].inside(_place(table, surface, p))


def normals(table: SurfaceTable, surface: int, p: np.ndarray) -> np.ndarray:
    """Return the unit normals, (n, 3), from front to back, at world points, (n, 3), mm, of an analytic surface."""
    piece = table.pieces[surface]
    q = _place(table, surface, p)
    normal = piece.sign * piece.gradient(q) @ table.rotations[surface].T
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def first_hit(
    table: SurfaceTable, o: np.ndarray, d: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the first surface that each ray meets, the point of the hit, mm, and the unit normal there.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    o, d : (n, 3) float64
        Origins (mm) and unit directions.
    last : (n,) int
        Index of the surface that each ray leaves; -1 for none.

    Returns
    -------
    surface : (n,) int
        Indices of the surfaces; -1 without a hit.
    p : (n, 3) float64
        Points of the hits, mm; the origins without a hit.
    normal : (n, 3) float64
        Unit normals, from front to back; without meaning where nothing is hit.
    """
    best = np.full(len(o), np.inf)
    surface = np.full(len(o), -1)
    host = table.host
    for rays, members in _nearest_first(table, o, d, best):
        hit, t = host.hits(o[rays], d[rays], members, last[rays])
        rays, members = rays[hit], members[hit]
        order = np.argsort(-t, kind="stable")  # of the hits of a ray the nearest is written last
        order = order[t[order] < best[rays[order]]]
        best[rays[order]], surface[rays[order]] = t[order], members[order]
    # Mitsuba aborts the process when it is asked for the hits of no rays
    stock = _stock_hit(table, o, d) if table.mitsuba_scene is not None and len(o) else None
    if stock is not None:
        nearer = stock[0] < best
        best, surface = np.where(nearer, stock[0], best), np.where(nearer, stock[1], surface)
    p = o + np.where(surface >= 0, best, 0.0)[:, None] * d
    normal = np.zeros_like(p) if stock is None else stock[2]
    own = np.flatnonzero((surface >= 0) & (surface < len(table.pieces)))
    normal[own] = host.normals(p[own], surface[own])
    return surface, p, normal


def _place(table: SurfaceTable, surface: int, p: np.ndarray) -> np.ndarray:
    """Return world points (n, 3), mm, in the vertex frame of an analytic surface."""
    return np.asarray((p - table.vertices[surface]) @ table.rotations[surface])


def _nearest_first(
    table: SurfaceTable, o: np.ndarray, d: np.ndarray, best: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """
    Yield pairs of arrays, (n,) int each: ray indices, and a surface that each of these rays may meet.

    Surfaces of the tree come first, then those whose boxes a ray enters, the nearest first, up to `best`, mm, the
    nearest hit of each ray so far.
    """
    if table.tree:
        near = table.tree.candidates(o - table.centre, d, table.frames)
        if near:
            yield (
                np.concatenate(list(near.values())),
                np.repeat(list(near), [len(rays) for rays in near.values()]),
            )
    entry = np.concatenate([boxes.entries(o, d) for boxes in table.host.boxes] or [np.empty((len(o), 0))], axis=1)
    members = np.concatenate([boxes.members for boxes in table.host.boxes] or [np.empty(0, dtype=np.int64)])
    order = np.argsort(entry, axis=1, kind="stable")
    rays = np.arange(len(o))
    for first in range(0, len(members), AT_ONCE):
        columns = order[rays, first : first + AT_ONCE]
        distance = entry[rays[:, None], columns]
        near = np.isfinite(distance) & (distance <= best[rays, None])
        row, column = np.nonzero(near)
        if not len(row):
            break
        yield rays[row], members[columns[row, column]]
        rays = rays[near.any(axis=1)]


@dataclass(frozen=True)
class _Boxes:
    """
    Bounding boxes of surfaces with the same orientation, aligned with their frame.

    Attributes
    ----------
    members : (m,) int
        Indices of the surfaces.
    frame : (3, 3) float64
        Axes of the orientation as columns.
    middle, corners : (m, 3) float64
        Middles of the boxes, and their half sides, mm, along the axes of the orientation.
    """

    members: np.ndarray
    frame: np.ndarray
    middle: np.ndarray
    corners: np.ndarray

    @staticmethod
    def of(table: SurfaceTable, pieces: list[TracedSurface]) -> _Boxes:
        """Return the bounding boxes, with a margin, of surfaces that share one frame."""
        frame = table.frames[pieces[0].frame]
        size = np.array([piece.size for piece in pieces])
        low, high = np.array([piece.z_range for piece in pieces]).T
        room = BOX_ROOM * (size + high - low) + np.array([piece.overlap for piece in pieces])
        members = np.array([piece.index for piece in pieces])
        return _Boxes(
            members,
            frame,
            table.vertices[members] @ frame + np.stack([0 * size, 0 * size, 0.5 * (high + low)], axis=1),
            np.stack([size + room, size + room, 0.5 * (high - low) + room], axis=1),
        )

    def entries(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """
        Return the distances, (n, m), mm, at which rays enter the boxes; infinity for boxes that they miss.

        A distance is negative if the ray starts in the box. `o`, mm, and `d` are (n, 3) in the world.
        """
        first, last = np.full((len(o), len(self.members)), -np.inf), np.full((len(o), len(self.members)), np.inf)
        for start, way, middle, corner in zip(
            (o @ self.frame).T, (d @ self.frame).T, self.middle.T, self.corners.T, strict=True
        ):
            slope = 1 / np.where(np.abs(way) < TINY, np.copysign(TINY, way), way)[:, None]
            centre, half = (middle - start[:, None]) * slope, np.abs(slope) * corner
            np.maximum(first, centre - half, out=first)
            np.minimum(last, centre + half, out=last)
        return np.where((first <= last) & (last >= 0), first, np.inf)


class HostSurfaces:
    """
    Analytic surfaces of a scene as arrays, for float64 intersection of many rays with many quadrics at once.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.

    Attributes
    ----------
    boxes : list of _Boxes
        Boxes around the surfaces that are in no tree, one item for each orientation.
    """

    def __init__(self, table: SurfaceTable) -> None:
        looped = set(table.tree.members) if table.tree else set()
        by_frame: dict[int, list[TracedSurface]] = {}
        for piece in table.pieces:
            if piece.index not in looped:
                by_frame.setdefault(piece.frame, []).append(piece)
        self.boxes = [_Boxes.of(table, pieces) for pieces in by_frame.values()]
        self._pieces = table.pieces
        self._vertices, self._rotations = table.vertices, table.rotations
        self._rotated = table.rotated
        self._self_hit = np.array([piece.self_hit for piece in table.pieces])
        self._quadric = np.array([piece.quadric for piece in table.pieces]).reshape(-1, 4)
        self._bounds = np.array([piece.bounds or Bounds() for piece in table.pieces]).reshape(-1, len(Bounds._fields))
        self._asphere = np.array([piece.searched and piece.bounds is not None for piece in table.pieces], dtype=bool)
        self._pooled = np.array([piece.bounds is not None for piece in table.pieces], dtype=bool)
        # Curvature, conic constant and coefficients of the aspheres, a row for each surface
        shapes = [(p.curvature, p.conic, *p.coefficients) if isinstance(p, SagSurface) else () for p in table.pieces]
        self._shapes = np.zeros((len(shapes), max(map(len, shapes), default=0)))
        for row, shape in zip(self._shapes, shapes, strict=True):
            row[: len(shape)] = shape
        self._reaches = np.array([p.host_reach if isinstance(p, SagSurface) else (0.0,) * 3 for p in table.pieces])
        self._sign = np.array([piece.sign for piece in table.pieces])

    def _inward(self, v: np.ndarray, members: np.ndarray) -> np.ndarray:
        """
        Return world vectors, (n, 3), each in the frame of the surface whose index `members` gives for it.

        If no surface of the scene is rotated, these are the vectors themselves.
        """
        return np.einsum("ij,ijk->ik", v, self._rotations[members]) if self._rotated else v

    def hits(
        self, o: np.ndarray, d: np.ndarray, members: np.ndarray, last: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the hits of rays with one candidate surface each.

        Parameters
        ----------
        o, d : (n, 3) float64
            Origins (mm) and unit directions in the world.
        members, last : (n,) int
            Indices of the surface that each ray may meet, and of the surface that it leaves.

        Returns
        -------
        rays : (k,) int
            Index of the ray of each hit; a ray may hit a surface twice.
        t : (k,) float64
            Distance along the ray, mm.
        """
        start, way = self._inward(o - self._vertices[members], members), self._inward(d, members)
        nearest = np.where(last == members, self._self_hit[members], 0.0)
        pooled, asphere = self._pooled[members], self._asphere[members]
        found = [(np.empty(0, dtype=np.int64), np.empty(0))]

        def meet(chosen: np.ndarray, t: np.ndarray, inside: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
            # Crossings ahead, and of these the ones within the bounds of the surface
            some, crossing = np.nonzero((t > nearest[chosen, None]) & (t < np.inf))
            t, rays = t[some, crossing], chosen[some]
            hit = inside(start[rays] + t[:, None] * way[rays], some)
            found.append((rays[hit], t[hit]))

        with np.errstate(all="ignore"):
            for chosen in (np.flatnonzero(pooled & ~asphere), np.flatnonzero(asphere)):
                if not len(chosen):
                    continue
                own, o, d = members[chosen], start[chosen], way[chosen]
                bounds = self._bounds[own].T
                if asphere[chosen[0]]:
                    t = asphere_crossings(self._shapes[own].T, self._reaches[own].T, o, d)
                else:
                    t = quadric_crossings(self._quadric[own].T, bounds[0], o, d)
                meet(chosen, t, lambda q, some, bounds=bounds: within_bounds(bounds[:, some], q))  # type: ignore[misc]
            for number in sorted(set(members[~pooled].tolist())):
                chosen, piece = np.flatnonzero(members == number), self._pieces[number]
                meet(chosen, piece.crossings(start[chosen], way[chosen]), lambda q, _, piece=piece: piece.inside(q))  # type: ignore[misc]
        return np.concatenate([rays for rays, _ in found]), np.concatenate([t for _, t in found])

    def normals(self, p: np.ndarray, members: np.ndarray) -> np.ndarray:
        """Return unit normals, (n, 3), from front to back, at world points p, mm, each on the surface in `members`."""
        q = self._inward(p - self._vertices[members], members)
        a, b, e, _ = self._quadric[members].T
        normal = quadric_gradient(a, b, e, q)
        if len(curved := np.flatnonzero(self._asphere[members])):
            normal[curved] = asphere_gradient(self._shapes[members[curved]].T, q[curved])
        for number in sorted(set(members[~self._pooled[members]].tolist())):
            here = members == number
            normal[here] = self._pieces[number].gradient(q[here])
        normal *= self._sign[members, None]
        if self._rotated:
            normal = np.einsum("ij,ikj->ik", normal, self._rotations[members])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _stock_hit(table: SurfaceTable, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the hits of rays with Mitsuba shapes: distances, (n,), mm, surface indices, (n,), and unit normals, (n, 3).

    Normals are from front to back. Without a hit the distance is infinite and the index `NO_SURFACE`.
    """
    start = o + table.mitsuba_epsilon * d
    assert table.mitsuba_scene is not None
    origin, direction = ([upload(mi.Float, column) for column in v.T] for v in (start, d))
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
    si = table.mitsuba_scene.ray_intersect(ray)
    found = np.array(si.is_valid())
    number = dr.gather(mi.UInt32, table.mitsuba_lookup, dr.reinterpret_array(mi.UInt32, si.shape), si.is_valid())
    t = np.where(found, np.array(si.t, dtype=np.float64) + table.mitsuba_epsilon, np.inf)
    normal = np.broadcast_to(download(si.n), o.shape).copy()
    return t, np.where(found, np.array(number, dtype=np.int64), NO_SURFACE), normal


def specular(d: np.ndarray, normal: np.ndarray, eta: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the directions into which rays are specularly reflected and refracted at surfaces.

    Parameters
    ----------
    d, normal : (n, 3) float64
        Directions of incidence and unit normals, which may point to either side.
    eta : (n,) or float
        Refractive index on the side of incidence divided by that on the other side.

    Returns
    -------
    reflected, transmitted : (n, 3) float64
        Unit directions; beyond the critical angle `transmitted` grazes the surface.
    total : (n,) bool
        Whether the angle of incidence is beyond the critical angle.
    """
    along = np.where((np.einsum("ij,ij->i", d, normal) > 0)[:, None], normal, -normal)
    cosine = np.einsum("ij,ij->i", d, along)
    eta = np.broadcast_to(eta, cosine.shape)
    square = 1 - eta**2 * (1 - cosine**2)
    through = eta[:, None] * d + (np.sqrt(np.maximum(square, 0)) - eta * cosine)[:, None] * along
    return d - 2 * cosine[:, None] * along, through, square < 0


def onward(
    table: SurfaceTable, surface: np.ndarray, d: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the directions in which rays leave surfaces along the design path, and a mask of the reflected ones.

    They are reflected at mirrors, at opaque surfaces that reflect more than half of the light, and in total reflection.
    Other opaque surfaces absorb them, and all others transmit them.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    surface : (n,) int
        Indices of the surfaces that the rays are at.
    d, normal : (n, 3) float64
        Directions of incidence and unit normals from front to back.

    Returns
    -------
    directions : (n, 3) float64
        Unit directions; NaN where the surface absorbs the ray.
    reflects : (n,) bool
        Whether each ray is reflected.
    """
    words, optics = table.optics.host_words[surface], table.optics.host_indices[surface]
    opaque = (words & OPAQUE) != 0
    # An opaque surface that reflects most of the light is a mirror, declared or not
    reflects = ((words & MIRROR) != 0) | table.optics.mostly_reflects[surface]
    from_front = np.einsum("ij,ij->i", d, normal) > 0
    eta = np.where(from_front, optics[:, 0] / optics[:, 1], optics[:, 1] / optics[:, 0])
    back, through, total = specular(d, normal, eta)
    reflects = reflects | (total & ~opaque)
    after = np.where(reflects[:, None], back, through)
    after[opaque & ~reflects] = np.nan
    return after / np.linalg.norm(after, axis=1, keepdims=True), reflects


def indices_along(before: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """
    Return the refractive index of the medium in which light arrives at each surface along its path.

    The materials of an opaque surface do not count, and a mirror does not change the medium. The index before such a
    surface is that of the medium the ray was in, or else the index before the next refracting surface.

    Parameters
    ----------
    before, behind : (k, …) float or complex
        Refractive indices before and behind the surfaces, in the direction of the light; NaN for opaque ones.

    Returns
    -------
    (k, …) float or complex
        Refractive indices before the surfaces; NaN if no surface defines any, as in a system of mirrors alone.
    """
    found = np.array(before)
    last = np.full_like(found[0], np.nan)
    for k in range(len(found)):
        found[k] = np.where(np.isnan(found[k]), last, found[k])
        last = np.where(np.isnan(behind[k]), found[k], behind[k])
    for k in range(len(found) - 2, -1, -1):
        found[k] = np.where(np.isnan(found[k]), found[k + 1], found[k])
    return found
