"""Rays in float64 on the host: a few hundred rays that set a trace up, through the surfaces that the kernel traces."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.optics import MIRROR, OPAQUE
from mistray.surfaces.surface import NO_SURFACE, TracedSurface
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

BOX_ROOM = 1e-6  # margin around the boxes of surfaces, in units of their size
TINY = 1e-150  # least direction cosine; a ray with a smaller one counts as parallel to the sides of a box


def local(table: SurfaceTable, surface: int, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return world points, mm, and directions, (n, 3) each, in the frame of an analytic surface's vertex."""
    return _place(table, surface, o), d @ table.rotations[surface]


def crossings(table: SurfaceTable, surface: int, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """
    Return the distances at which lines cross the unbounded sheet of an analytic surface, mm.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    surface : int
        Number of the surface.
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
    """Return whether world points, (n, 3), mm, of an analytic surface's sheet lie within its bounds; False for NaN."""
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
    Return the surfaces that rays meet first, with the points of the hits, mm, and the normals there.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    o, d : (n, 3) float64
        Origins (mm) and unit directions.
    last : (n,) int
        Number of the surface that each ray leaves; -1 for none.

    Returns
    -------
    surface : (n,) int
        Numbers of the surfaces; -1 without a hit.
    p : (n, 3) float64
        Points of the hits, mm; the origins without a hit.
    normal : (n, 3) float64
        Unit normals, from front to back.
    """
    best = np.full(len(o), np.inf)
    surface = np.full(len(o), -1)
    for piece, rays, entry in _near(table, o, d):
        rays = rays[entry <= best[rays]]
        if not len(rays):
            continue
        from_here, along = o[rays], d[rays]
        t = crossings(table, piece.index, from_here, along)
        nearest = np.where(last[rays] == piece.index, piece.self_hit, 0.0)
        with np.errstate(invalid="ignore"):
            some, crossing = np.nonzero((t > nearest[:, None]) & (t < best[rays, None]))
        if not len(some):
            continue
        t = t[some, crossing]
        own = np.flatnonzero(inside(table, piece.index, from_here[some] + t[:, None] * along[some]))
        own = own[np.argsort(-t[own], kind="stable")]  # of two crossings of a ray the nearer one is written last
        best[rays[some[own]]], surface[rays[some[own]]] = t[own], piece.index
    # Mitsuba aborts the process when it is asked for the hits of no rays
    stock = _stock_hit(table, o, d, best) if table.mitsuba_scene is not None and len(o) else None
    if stock is not None:
        nearer = stock[0] < best
        best, surface = np.where(nearer, stock[0], best), np.where(nearer, stock[1], surface)
    p = o + np.where(surface >= 0, best, 0.0)[:, None] * d
    normal = np.zeros_like(p) if stock is None else stock[2]
    for number in np.unique(surface[(surface >= 0) & (surface < len(table.pieces))]):
        here = surface == number
        normal[here] = normals(table, int(number), p[here])
    return surface, p, normal


def _place(table: SurfaceTable, surface: int, p: np.ndarray) -> np.ndarray:
    """Return world points (n, 3), mm, in the frame of an analytic surface's vertex."""
    return np.asarray((p - table.vertices[surface]) @ table.rotations[surface])


def _near(table: SurfaceTable, o: np.ndarray, d: np.ndarray) -> Iterator[tuple[TracedSurface, np.ndarray, np.ndarray]]:
    """Yield each analytic surface with the numbers of the rays that may meet it, and their distances to its box, mm."""
    looped = set(table.tree.members) if table.tree else set()
    near = table.tree.candidates(o - table.centre, d, table.frames) if table.tree else {}
    for index, rays in near.items():
        yield table.pieces[index], rays, np.full(len(rays), -np.inf)
    boxed = [piece for piece in table.pieces if piece.index not in looped]
    entry = np.full((len(o), len(boxed)), np.inf)
    for number in {piece.frame for piece in boxed}:
        columns = [k for k, piece in enumerate(boxed) if piece.frame == number]
        entry[:, columns] = _entries(
            table, [boxed[k] for k in columns], o @ table.frames[number], d @ table.frames[number]
        )
    for k in np.argsort(entry.min(axis=0, initial=np.inf), kind="stable"):
        rays = np.flatnonzero(np.isfinite(entry[:, k]))
        yield boxed[k], rays, entry[rays, k]


def _entries(table: SurfaceTable, pieces: list[TracedSurface], o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the distances, (n, m), mm, at which rays enter the boxes around surfaces of one frame; else infinity."""
    size = np.array([piece.size for piece in pieces])
    low, high = np.array([piece.z_range for piece in pieces]).T
    room = BOX_ROOM * (size + high - low) + np.array([piece.overlap for piece in pieces])
    vertices = np.array([table.vertices[piece.index] for piece in pieces]) @ table.frames[pieces[0].frame]
    corners = np.stack([size + room, size + room, 0.5 * (high - low) + room], axis=1)
    middle = vertices + np.stack([0 * size, 0 * size, 0.5 * (high + low)], axis=1)
    slope = 1 / np.where(np.abs(d) < TINY, np.copysign(TINY, d), d)[:, None, :]
    centre, half = (middle - o[:, None, :]) * slope, np.abs(slope) * corners
    first, last = (centre - half).max(axis=2), (centre + half).min(axis=2)
    return np.where((first <= last) & (last >= 0), first, np.inf)


def _stock_hit(
    table: SurfaceTable, o: np.ndarray, d: np.ndarray, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return distances, (n,), mm, surface numbers and normals of the nearest hits with Mitsuba shapes; inf for none."""
    start = o + table.mitsuba_epsilon * d
    assert table.mitsuba_scene is not None
    origin, direction = ([upload(mi.Float, column) for column in v.T] for v in (start, d))
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
    si = table.mitsuba_scene.ray_intersect(ray)
    found = np.array(si.is_valid())
    number = dr.gather(mi.UInt32, table.mitsuba_lookup, dr.reinterpret_array(mi.UInt32, si.shape), si.is_valid())
    t = np.where(found, np.array(si.t, dtype=np.float64) + table.mitsuba_epsilon, np.inf)
    normal = np.broadcast_to(np.array(si.n, dtype=np.float64).T, o.shape).copy()
    return t, np.where(found, np.array(number, dtype=np.int64), NO_SURFACE), normal


def specular(d: np.ndarray, normal: np.ndarray, eta: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the directions of specular reflection and refraction at surfaces.

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
    Return the directions in which rays leave surfaces along the design path, and whether they are reflected.

    They are reflected at mirrors and in total reflection, and transmitted elsewhere.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    surface : (n,) int
        Numbers of the surfaces that the rays are at.
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
    Return the refractive indices of the media in which light arrives at each surface on its way.

    The materials of an opaque surface do not count, and a mirror does not change the medium. The index before such a
    surface is that of the medium the ray was in, or else the index before the next refracting surface.

    Parameters
    ----------
    before, behind : (k, …) float or complex
        Indices before and behind the surfaces, in the direction of the light; NaN for opaque ones.

    Returns
    -------
    (k, …) float or complex
        Indices before the surfaces; NaN if no surface defines any, as in a system of mirrors alone.
    """
    found = np.array(before)
    last = np.full_like(found[0], np.nan)
    for k in range(len(found)):
        found[k] = np.where(np.isnan(found[k]), last, found[k])
        last = np.where(np.isnan(behind[k]), found[k], behind[k])
    for k in range(len(found) - 2, -1, -1):
        found[k] = np.where(np.isnan(found[k]), found[k + 1], found[k])
    return found
