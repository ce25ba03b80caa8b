"""Recorded rays again in float64: the kernel says which surfaces, this says exactly where.

The kernel's hits are float32 and good to a few 1e-7 of the system's size. Starting from the same start ray and
following the recorded events, each hit is found again by Newton's method from the recorded one. No law gives the
direction after a scatter event: there the ray goes from the exact hit towards the next recorded one.
"""

from __future__ import annotations

import numpy as np

from mistray.physics.sag import sag, sag_derivative
from mistray.trace.host_rays import specular
from mistray.trace.ledger import ABSORBED, AIMED_TRANSMITTED, EVENT_BITS, RANDOM_TRANSMITTED, TRANSMITTED
from mistray.trace.optics import OPAQUE
from mistray.trace.path_events import EVENT_MASK, FIRST_SCATTERED
from mistray.trace.surfaces import SurfaceTable


def retrace(
    table: SurfaceTable, origin: np.ndarray, direction: np.ndarray, codes: np.ndarray, hits: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Follow one ray through recorded events.

    Parameters
    ----------
    table : SurfaceTable
    origin, direction : (3,) float64
        Start ray, mm.
    codes : (k,) uint32
        Events, surface << EVENT_BITS | what.
    hits : (k, 3) float64
        Recorded hits, mm.

    Returns
    -------
    points : (k + 1, 3) float64
        Start and hits.
    directions : (k + 1, 3) float64
        Direction in which the ray leaves each point; zero at the last.
    opl_mm : (k + 1,) float64
        Optical path length from the start.
    """
    d = direction / np.linalg.norm(direction)
    points, directions = [origin], []
    steps: list[float] = []
    indices: list[float] = []
    medium = 1.0
    for k, (code, hit) in enumerate(zip(codes, hits, strict=True)):
        surface, what = int(code) >> EVENT_BITS, int(code) & EVENT_MASK
        if surface >= table.count:  # within a medium: the recorded distance is all there is
            steps.append(float(np.dot(hit - points[-1], d)))
            indices.append(medium)
            points.append(points[-1] + steps[-1] * d)
            directions.append(d)
            d = hits[k + 1] - points[-1]
            d = d / np.linalg.norm(d)
            continue
        p, normal = _hit(table, surface, points[-1], d, hit)
        side = np.dot(d, normal) > 0
        front, back = table.interfaces[surface].indices(table.wavelength_nm)
        n_i, n_t = (front, back) if side else (back, front)
        opaque = bool(table.optics.host_words[surface] & OPAQUE)
        # The materials of an opaque surface mean nothing: the ray is in the material it was sent into
        indices.append(medium if opaque and indices else n_i)
        steps.append(float(np.linalg.norm(p - points[-1])))
        points.append(p)
        directions.append(d)
        medium = n_t if what in (TRANSMITTED, RANDOM_TRANSMITTED, AIMED_TRANSMITTED) else indices[-1]
        if what == ABSORBED:
            break
        if what >= FIRST_SCATTERED:
            d = hits[k + 1] - p
        else:
            reflected, transmitted, _ = specular(d[None], normal[None], n_i / n_t)
            (d,) = transmitted if what == TRANSMITTED else reflected
        d = d / np.linalg.norm(d)
    directions.append(np.zeros(3))
    opl = np.concatenate([[0.0], np.cumsum(np.array(steps) * np.array(indices))])
    return np.array(points), np.array(directions), opl


def _hit(
    table: SurfaceTable, surface: int, origin: np.ndarray, d: np.ndarray, recorded: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Exact hit next to a recorded one, and the normal there."""
    if surface >= len(table.pieces):  # a mesh: Mitsuba's hit is all there is
        return recorded, table.stock_normal(recorded, d)
    piece = table.pieces[surface]
    rotation = table.rotations[surface]
    o, dl = rotation.T @ (origin - table.vertices[surface]), rotation.T @ d
    t = float(np.dot(recorded - origin, d))
    for _ in range(8):
        q = o + t * dl
        r2 = q[0] ** 2 + q[1] ** 2
        if piece.coefficients:
            value = 2 * (sag(r2, *piece.conic, piece.coefficients) - q[2])
            slope = sag_derivative(r2, *piece.conic, piece.coefficients)
            gradient = np.array([2 * slope * q[0], 2 * slope * q[1], -1.0])
        else:
            a, b, e, g = piece.quadric
            value = a * r2 + (b * q[2] + e) * q[2] + g
            gradient = np.array([a * q[0], a * q[1], b * q[2] + 0.5 * e])
        step = value / (2 * np.dot(gradient, dl))
        t -= step
        if abs(step) < 1e-14 * (1 + abs(t)):
            break
    normal = rotation @ (gradient * piece.sign)
    return origin + t * d, normal / np.linalg.norm(normal)
