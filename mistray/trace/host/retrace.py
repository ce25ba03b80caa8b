"""
Recomputation of recorded rays in float64, along the surfaces that the kernel has found.

The kernel's hits are float32 and good to a few 1e-7 of the system's size. From the same start ray, along the recorded
events, each hit is computed again by Newton's method from the recorded one. No law gives the direction after a scatter
event: there the ray goes from the exact hit towards the next recorded one.
"""

from __future__ import annotations

import numpy as np

from mistray.events import (
    ABSORBED,
    AIMED_TRANSMITTED,
    FIRST_SCATTERED,
    RANDOM_TRANSMITTED,
    TRANSMITTED,
    kind_of,
    place_of,
)
from mistray.surfaces.host_rays import indices_along, specular
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable

THROUGH = (TRANSMITTED, RANDOM_TRANSMITTED, AIMED_TRANSMITTED)


def retrace(
    table: SurfaceTable,
    origin: np.ndarray,
    direction: np.ndarray,
    codes: np.ndarray,
    lengths: np.ndarray,
    hits: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Trace rays again in float64, through the events and near the hits that were recorded.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    origin, direction : (n, 3) float64
        Origins, mm, and directions of the start rays.
    codes : (n, k) uint32
        Events, see `mistray.events`.
    lengths : (n,) int
        Number of events of each ray; entries after them are not used.
    hits : (n, k, 3) float64
        Recorded hits, mm.

    Returns
    -------
    points : (n, k + 1, 3) float64
        Start and hits, mm.
    directions : (n, k + 1, 3) float64
        Unit direction in which a ray leaves each point; zero at the last.
    opl_mm : (n, k + 1) float64
        Optical path length from the start, mm.
    """
    count, longest = codes.shape
    surfaces, what = place_of(codes).astype(np.int64), kind_of(codes)
    points, directions = np.zeros((2, count, longest + 1, 3))
    steps = np.zeros((longest, count))  # mm
    before, behind = np.full((2, longest, count), np.nan)
    points[:, 0] = origin
    directions[:, 0] = _unit(direction)
    for k in range(longest):
        # Rays of different paths that meet the same surface at this step go together
        here = np.where(lengths > k, np.minimum(surfaces[:, k], table.count), -1)
        for surface in np.unique(here[here >= 0]).tolist():
            rays = np.flatnonzero(here == surface)
            start, d = points[rays, k], directions[rays, k]
            onward = lengths[rays] > k + 1
            towards = hits[rays, min(k + 1, longest - 1)]
            if surface == table.count:  # within a medium: the recorded distance is all there is
                steps[k, rays] = np.einsum("ij,ij->i", hits[rays, k] - start, d)
                p = start + steps[k, rays][:, None] * d
                leaving = towards - p
            else:
                p, normal = _hit(table, surface, start, d, hits[rays, k])
                steps[k, rays] = np.linalg.norm(p - start, axis=1)
                side = np.einsum("ij,ij->i", d, normal) > 0
                front, back = table.interfaces[surface].indices(table.wavelength_nm)
                n_i, n_t = np.where(side, front, back), np.where(side, back, front)
                event = what[rays, k]
                if not table.optics.host_words[surface] & OPAQUE:
                    before[k, rays] = n_i
                    behind[k, rays] = np.where(np.isin(event, THROUGH), n_t, n_i)
                onward &= event != ABSORBED
                reflected, transmitted, _ = specular(d, normal, n_i / n_t)
                leaving = np.where((event == TRANSMITTED)[:, None], transmitted, reflected)
                leaving = np.where((event >= FIRST_SCATTERED)[:, None], towards - p, leaving)
            points[rays, k + 1] = p
            directions[rays[onward], k + 1] = _unit(leaving[onward])
    opl = np.zeros((count, longest + 1))
    optical = steps * np.nan_to_num(indices_along(before, behind), nan=1.0)
    opl[:, 1:] = np.cumsum(optical, axis=0).T
    return points, directions, opl


def _unit(v: np.ndarray) -> np.ndarray:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _hit(
    table: SurfaceTable, surface: int, origin: np.ndarray, d: np.ndarray, recorded: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the exact hits, mm, nearest to `recorded` ones, and the unit normals there, (n, 3) float64 each.

    The rays come from `origin`, mm, along unit vectors `d`, (n, 3). Normals point to the back of the surface. On a mesh
    the hits are the recorded ones.
    """
    if surface >= len(table.pieces):  # a mesh: Mitsuba's hit is all there is
        return recorded, table.mitsuba_normals(recorded, d)
    piece = table.pieces[surface]
    rotation = table.rotations[surface]
    o, dl = (origin - table.vertices[surface]) @ rotation, d @ rotation
    t = np.einsum("ij,ij->i", recorded - origin, d)
    for _ in range(8):
        q = o + t[:, None] * dl
        gradient = piece.gradient(q)
        # Newton's method; the gradient of a piece is half that of its residual
        step = piece.residual(q) / (2 * np.einsum("ij,ij->i", gradient, dl))
        t = t - step
        if np.all(np.abs(step) < 1e-14 * (1 + np.abs(t))):
            break
    return origin + t[:, None] * d, _unit(gradient @ rotation.T * piece.sign)
