"""Rays in float64 on the host: a few hundred of them, to set a trace up, through the same surfaces as the kernel's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.physics.sag import sag, sag_derivative
from mistray.surfaces.optics import IDEAL, MIRROR, OPAQUE
from mistray.surfaces.pieces import NO_SURFACE, SELF_HIT, Piece
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

NEWTON_STEPS = 8
SETTLED = 1e-10  # last step of Newton's method, relative, below which it has found a hit


def local(table: SurfaceTable, surface: int, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and directions (n, 3) of the world in the frame of an analytic surface's vertex."""
    rotation = table.rotations[surface]
    return (o - table.vertices[surface]) @ rotation, d @ rotation


def crossings(table: SurfaceTable, surface: int, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """
    Where lines cross the unbounded sheet of an analytic surface.

    Parameters
    ----------
    table : SurfaceTable
    surface : int
    o, d : (n, 3) float64
        Points (mm) and unit directions.

    Returns
    -------
    (n, 2) float64
        Distances along the lines, of either sign; NaN where there is no crossing.
    """
    piece = table.pieces[surface]
    o, d = local(table, surface, o, d)
    a, b, e, g = piece.quadric
    with np.errstate(all="ignore"):
        A = a * (d[:, 0] ** 2 + d[:, 1] ** 2) + b * d[:, 2] ** 2
        B = a * (o[:, 0] * d[:, 0] + o[:, 1] * d[:, 1]) + (b * o[:, 2] + 0.5 * e) * d[:, 2]
        C = a * (o[:, 0] ** 2 + o[:, 1] ** 2) + (b * o[:, 2] + e) * o[:, 2] + g
        q = -(B + np.copysign(np.sqrt(B * B - A * C), B))
        t = np.stack([C / q, q / A], axis=1)
        if piece.coefficients:
            flat = -o[:, 2] / d[:, 2]
            t[:, 0] = np.where(np.isfinite(t[:, 0]), t[:, 0], flat)
            t = _onto_polynomial(piece, o, d, t)
        elif piece.kind == "conic":  # a quadric has a second sheet
            t = np.where(1 - b * (o[:, 2:] + t * d[:, 2:]) > 0, t, np.nan)
    return np.where(np.isfinite(t), t, np.nan)


def _onto_polynomial(piece: Piece, o: np.ndarray, d: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Newton's method from crossings of the conic to crossings of the asphere; NaN where it does not settle."""
    (c, k), coefficients = piece.conic, piece.coefficients
    found = np.full(t.shape, np.nan)
    going = np.flatnonzero(np.isfinite(t))  # few need more than some steps: the others are left out of the rest
    ray, t = going // t.shape[1], t.ravel()[going]
    for _ in range(NEWTON_STEPS):
        (x, y, z), (dx, dy, dz) = o[ray].T, d[ray].T
        x, y = x + t * dx, y + t * dy
        r2 = x * x + y * y
        slope = 2 * sag_derivative(r2, c, k, coefficients)
        step = (sag(r2, c, k, coefficients) - z - t * dz) / (slope * (x * dx + y * dy) - dz)
        t = t - step
        settled = np.abs(step) < SETTLED * (1 + np.abs(t))
        found.flat[going[settled]] = t[settled]
        on = ~settled & np.isfinite(step)
        going, ray, t = going[on], ray[on], t[on]
        if not len(going):
            break
    return found


def inside(table: SurfaceTable, surface: int, p: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) of the sheet of an analytic surface lie within its bounds; NaN does not."""
    piece = table.pieces[surface]
    q, _ = local(table, surface, p, p)
    with np.errstate(invalid="ignore"):
        if piece.kind == "cone":
            return (q[:, 2] >= piece.z_range[0]) & (q[:, 2] <= piece.z_range[1])
        if piece.outer:
            r2 = q[:, 0] ** 2 + q[:, 1] ** 2
            return (r2 <= piece.outer**2) & (r2 >= piece.inner**2)
        return (np.abs(q[:, 0]) <= piece.half_size[0]) & (np.abs(q[:, 1]) <= piece.half_size[1])


def normals(table: SurfaceTable, surface: int, p: np.ndarray) -> np.ndarray:
    """Unit normals, from front to back, at points (n, 3) of an analytic surface."""
    piece = table.pieces[surface]
    q, _ = local(table, surface, p, p)
    a, b, e, _ = piece.quadric
    gradient = np.stack([a * q[:, 0], a * q[:, 1], b * q[:, 2] + 0.5 * e], axis=1)
    if piece.coefficients:
        slope = sag_derivative(q[:, 0] ** 2 + q[:, 1] ** 2, *piece.conic, piece.coefficients)
        gradient = np.stack([2 * slope * q[:, 0], 2 * slope * q[:, 1], -np.ones(len(q))], axis=1)
    normal = piece.sign * gradient @ table.rotations[surface].T
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def first_hit(
    table: SurfaceTable, o: np.ndarray, d: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    The nearest surface that rays meet.

    Parameters
    ----------
    table : SurfaceTable
    o, d : (n, 3) float64
        Origins (mm) and unit directions.
    last : (n,) int
        Surface that each ray comes from; -1: none.

    Returns
    -------
    surface : (n,) int
        -1 where there is none.
    p : (n, 3) float64
        The hits, mm.
    normal : (n, 3) float64
        Unit normals, from front to back.
    """
    best = np.full(len(o), np.inf)
    surface = np.full(len(o), -1)
    for piece, rays in _near(table, o, d):
        from_here, along = o[rays], d[rays]
        t = crossings(table, piece.index, from_here, along)
        size = piece.outer or float(np.hypot(*piece.half_size))
        nearest = np.where(last[rays] == piece.index, SELF_HIT * size, 0.0)
        for k in range(2):
            with np.errstate(invalid="ignore"):
                nearer = (t[:, k] > nearest) & (t[:, k] < best[rays])
            some = np.flatnonzero(nearer)
            some = some[inside(table, piece.index, from_here[some] + t[some, k, None] * along[some])]
            best[rays[some]], surface[rays[some]] = t[some, k], piece.index
    # Mitsuba aborts the process when it is asked for the hits of no rays
    stock = _stock_hit(table, o, d, best) if table.stock_scene is not None and len(o) else None
    if stock is not None:
        nearer = stock[0] < best
        best, surface = np.where(nearer, stock[0], best), np.where(nearer, stock[1], surface)
    p = o + np.where(surface >= 0, best, 0.0)[:, None] * d
    normal = np.zeros_like(p) if stock is None else stock[2]
    for number in np.unique(surface[(surface >= 0) & (surface < len(table.pieces))]):
        here = surface == number
        normal[here] = normals(table, int(number), p[here])
    return surface, p, normal


def _near(table: SurfaceTable, o: np.ndarray, d: np.ndarray) -> Iterator[tuple[Piece, np.ndarray]]:
    """The analytic surfaces and the numbers of the rays that may meet each."""
    looped = set(table.tree.members) if table.tree else set()
    near = table.tree.candidates(o - table.centre, d, table.frames) if table.tree else {}
    for piece in table.pieces:
        if piece.index not in looped:
            yield piece, np.arange(len(o))
        elif piece.index in near:
            yield piece, near[piece.index]


def _stock_hit(
    table: SurfaceTable, o: np.ndarray, d: np.ndarray, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance, surface and normal of the nearest hit of the stock shapes; distance inf where there is none."""
    start = o + table.stock_epsilon * d
    assert table.stock_scene is not None
    origin, direction = ([upload(mi.Float, column) for column in v.T] for v in (start, d))
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
    si = table.stock_scene.ray_intersect(ray)
    found = np.array(si.is_valid())
    number = dr.gather(mi.UInt32, table.stock_lookup, dr.reinterpret_array(mi.UInt32, si.shape), si.is_valid())
    t = np.where(found, np.array(si.t, dtype=np.float64) + table.stock_epsilon, np.inf)
    normal = np.broadcast_to(np.array(si.n, dtype=np.float64).T, o.shape).copy()
    return t, np.where(found, np.array(number, dtype=np.int64), NO_SURFACE), normal


def specular(d: np.ndarray, normal: np.ndarray, eta: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Reflection and refraction.

    Parameters
    ----------
    d, normal : (n, 3) float64
        Directions of incidence, and unit normals to either side.
    eta : (n,) or float
        Index on the side of incidence over that on the other.

    Returns
    -------
    reflected, transmitted : (n, 3) float64
        Directions; beyond the critical angle `transmitted` grazes the surface.
    total : (n,) bool
        Whether the light is beyond the critical angle.
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
    The child of rays that follow the design: reflected at mirrors, else transmitted, in total reflection reflected.

    Parameters
    ----------
    table : SurfaceTable
    surface : (n,) int
    d, normal : (n, 3) float64
        Directions of incidence, and unit normals from front to back.

    Returns
    -------
    directions : (n, 3) float64
        NaN where the surface swallows the ray.
    reflects : (n,) bool
    """
    words, optics = table.optics.host_words[surface], table.optics.host_indices[surface]
    opaque = (words & OPAQUE) != 0
    # An opaque surface that reflects most of the light is a mirror whether it says so or not
    reflects = ((words & MIRROR) != 0) | (opaque & ((words & 3) == IDEAL) & (optics[:, 2] > 0.5))
    from_front = np.einsum("ij,ij->i", d, normal) > 0
    eta = np.where(from_front, optics[:, 0] / optics[:, 1], optics[:, 1] / optics[:, 0])
    back, through, total = specular(d, normal, eta)
    reflects = reflects | (total & ~opaque)
    after = np.where(reflects[:, None], back, through)
    after[opaque & ~reflects] = np.nan
    return after / np.linalg.norm(after, axis=1, keepdims=True), reflects
