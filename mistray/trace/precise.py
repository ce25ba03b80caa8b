"""Recorded rays again in float64: the kernel says which surfaces, this says exactly where.

The kernel's hits are float32 and good to a few 1e-7 of the system's size. Starting from the same start ray and
following the recorded events, each hit is found again by Newton's method from the recorded one. No law gives the
direction after a scatter event: there the ray goes from the exact hit towards the next recorded one.
"""

from __future__ import annotations

import numpy as np

from mistray.recorders.path_events import FIRST_SCATTERED
from mistray.recorders.path_key import (
    ABSORBED,
    AIMED_TRANSMITTED,
    EVENT_BITS,
    EVENT_MASK,
    RANDOM_TRANSMITTED,
    TRANSMITTED,
)
from mistray.surfaces.host_rays import indices_along, specular
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable


def retrace(
    table: SurfaceTable, origin: np.ndarray, direction: np.ndarray, codes: np.ndarray, hits: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Follow rays through recorded events, the same for all of them.

    Parameters
    ----------
    table : SurfaceTable
    origin, direction : (n, 3) float64
        Start rays, mm.
    codes : (k,) uint32
        Events, surface << EVENT_BITS | what.
    hits : (n, k, 3) float64
        Recorded hits, mm.

    Returns
    -------
    points : (n, k + 1, 3) float64
        Start and hits.
    directions : (n, k + 1, 3) float64
        Direction in which a ray leaves each point; zero at the last.
    opl_mm : (n, k + 1) float64
        Optical path length from the start.
    """
    d = _unit(direction)
    points, directions = [origin], []
    lengths, before, behind = (np.full((len(codes), len(d)), np.nan) for _ in range(3))
    for k, code in enumerate(codes):
        surface, what = int(code) >> EVENT_BITS, int(code) & EVENT_MASK
        directions.append(d)
        if surface >= table.count:  # within a medium: the recorded distance is all there is
            lengths[k] = np.einsum("ij,ij->i", hits[:, k] - points[-1], d)
            points.append(points[-1] + lengths[k][:, None] * d)
            d = _unit(hits[:, k + 1] - points[-1])
            continue
        p, normal = _hit(table, surface, points[-1], d, hits[:, k])
        side = np.einsum("ij,ij->i", d, normal) > 0
        front, back = table.interfaces[surface].indices(table.wavelength_nm)
        n_i, n_t = np.where(side, front, back), np.where(side, back, front)
        lengths[k] = np.linalg.norm(p - points[-1], axis=1)
        points.append(p)
        if not table.optics.host_words[surface] & OPAQUE:
            before[k] = n_i
            behind[k] = n_t if what in (TRANSMITTED, RANDOM_TRANSMITTED, AIMED_TRANSMITTED) else n_i
        if what == ABSORBED:
            break
        if what >= FIRST_SCATTERED:
            d = hits[:, k + 1] - p
        else:
            reflected, transmitted, _ = specular(d, normal, n_i / n_t)
            d = transmitted if what == TRANSMITTED else reflected
        d = _unit(d)
    directions.append(np.zeros_like(d))
    opl = np.zeros((len(d), len(points)))
    optical = lengths * np.nan_to_num(indices_along(before, behind), nan=1.0)
    opl[:, 1:] = np.cumsum(optical[: len(points) - 1], axis=0).T
    return np.stack(points, axis=1), np.stack(directions, axis=1), opl


def _unit(v: np.ndarray) -> np.ndarray:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _hit(
    table: SurfaceTable, surface: int, origin: np.ndarray, d: np.ndarray, recorded: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Exact hits next to recorded ones, and the normals there, (n, 3) each."""
    if surface >= len(table.pieces):  # a mesh: Mitsuba's hit is all there is
        return recorded, table.stock_normals(recorded, d)
    piece = table.pieces[surface]
    rotation = table.rotations[surface]
    o, dl = (origin - table.vertices[surface]) @ rotation, d @ rotation
    t = np.einsum("ij,ij->i", recorded - origin, d)
    for _ in range(8):
        q = o + t[:, None] * dl
        gradient = piece.gradient(q)
        step = piece.residual(q) / (2 * np.einsum("ij,ij->i", gradient, dl))
        t = t - step
        if np.all(np.abs(step) < 1e-14 * (1 + np.abs(t))):
            break
    return origin + t[:, None] * d, _unit(gradient @ rotation.T * piece.sign)
