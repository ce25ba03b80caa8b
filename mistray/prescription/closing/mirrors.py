"""Mirrors of a sequential lens where the world is not sequential: cut off their axis, holes in them, beams they block.

A surface has its edges about its own axis alone. A piece of a plane or of a sphere has an axis of its own anywhere, so
that it can stand off the axis of the lens. A piece of another figure cannot: it becomes the ring or disc about the
vertex that holds it, and how much of the beam it blocks is reported.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mistray.physics.geometry.sag import sag
from mistray.prescription.closing.shadows import met_at
from mistray.prescription.sequential.rays import curvature
from mistray.prescription.sequential.table import ClearAperture, Row

if TYPE_CHECKING:
    from mistray.prescription.closing.surfaces import OpticalSurfaces
    from mistray.prescription.model import Surface

_FULL_HOLE = 0.9  # of a mirror's radius: a greater hole would leave no mirror
_RIM = 361
_ALL = 0.995  # share of the beam above which no light is left


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # huge numbers have no piece
def off_axis_piece(row: Row) -> tuple[np.ndarray, dict[str, Any]] | None:
    """
    A piece of a plane or of a sphere about its own middle.

    Parameters
    ----------
    row : Row

    Returns
    -------
    frame : (4, 4) float64
        Of the piece, to that of the row.
    clip : dict
        Of its `Surface`: of a plane exactly the aperture of the row; of a sphere, where the axis is another one, the
        smallest disc or rectangle that holds it.
    None
        If the row is no mirror with an aperture off its vertex, or its figure has but one axis.
    """
    aperture, c = row.aperture, curvature(row)
    if aperture is None or aperture.obscures or not row.mirror or math.hypot(aperture.x, aperture.y) == 0:
        return None
    if any(row.coefficients) or (c and row.conic):
        return None
    rim = _rim(aperture, outer=True)
    if not (np.all(np.isfinite(rim)) and np.all(np.hypot(*rim.T) * abs(c) < 1)):
        return None
    height = float(sag(aperture.x**2 + aperture.y**2, c, 0.0))
    turn, middle = np.eye(3), np.array([aperture.x, aperture.y, height])
    axis = np.array([-c * aperture.x, -c * aperture.y, 1 - c * height])
    # The shortest turn from z to the axis through the middle
    cross = np.array([[0, 0, axis[0]], [0, 0, axis[1]], [-axis[0], -axis[1], 0]])
    turn += cross + cross @ cross / (1 + axis[2])
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = turn, middle

    def seen(points: np.ndarray) -> np.ndarray:
        heights = sag(np.sum(points * points, axis=1), c, 0.0)
        return np.asarray(((np.column_stack([points, heights]) - middle) @ turn)[:, :2])

    own = seen(rim)
    if aperture.kind == "rectangle":
        return frame, {"half_width": float(np.abs(own[:, 0]).max()), "half_height": float(np.abs(own[:, 1]).max())}
    clip = {"semi_diameter": float(np.hypot(*own.T).max())}
    if aperture.inner > 0:
        clip["inner_semi_diameter"] = float(np.hypot(*seen(_rim(aperture, outer=False)).T).min())
    return frame, clip


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # huge numbers reach nothing
def cut_holes(table: OpticalSurfaces) -> None:
    """
    Cut holes in mirrors where a later part of the beam passes, and tell what of the beam mirrors block.

    Parameters
    ----------
    table : OpticalSurfaces
        Its mirrors are replaced, its notes added to.
    """
    weights = beam_shares(table)
    beside: list[str] = []
    for k, mirror in list(table.surfaces.items()):
        if not mirror.mirror or mirror.name in [surface.name for j, surface in table.surfaces.items() if j < k]:
            continue
        free = _free_middle(table, k, mirror)
        legs = [leg for leg in table.segments() if not any(table.surfaces.get(j - 1) is mirror for j in leg)]
        drilled = _drilled(table, k, mirror, free, legs)
        if drilled is not mirror:
            for j in [j for j, surface in table.surfaces.items() if surface is mirror]:
                table.surfaces[j] = drilled
            table.notes.append(
                f"mirror '{mirror.name}' has a hole of radius {drilled.inner_semi_diameter:.6g} mm: the beam passes "
                "there"
            )
        for begin, end in legs:
            hit = np.isfinite(met_at(table.lens.rows[k], drilled, table.beam[begin], table.beam[end]))
            share = weights[hit].sum()
            if share > 0:
                table.blocked |= hit
                table.notes.append(
                    f"mirror '{mirror.name}' stands in the beam on its way to surface {table.lens.rows[end - 1].number}"
                    f" and takes {percent(share)} of it"
                )
                if free > 0 and mirror.name not in beside:
                    beside.append(mirror.name)
    if beside:
        share = weights[table.blocked].sum()
        names = ", ".join(f"'{name}'" for name in beside)
        table.notes.insert(
            0,
            ("NO LIGHT" if share > _ALL else f"only {percent(1 - share)} of the light")
            + f" of the table reaches the image: only a piece beside the axis of {names} is meant, but the whole ring "
            "or disc about it stands here and blocks the rest",
        )


def beam_shares(table: OpticalSurfaces) -> np.ndarray:
    """Part of the light at the image that each ray of the beam carries, (n,); 0 for those that do not get there."""
    weights = np.where(np.isfinite(table.beam[-1, :, 0]), table.rays.weights, 0.0)
    return np.asarray(weights / (weights.sum() or 1.0))


def percent(share: float) -> str:
    """Part of a sampled beam in words, to two digits."""
    return f"about {float(f'{100 * share:.2g}'):g} %"


def _drilled(table: OpticalSurfaces, k: int, mirror: Surface, free: float, legs: list[tuple[int, int]]) -> Surface:
    """A mirror with a hole for all later legs of the beam, as far as its own beam leaves room for one."""
    hole = mirror.inner_semi_diameter
    if mirror.semi_diameter is None:
        return mirror
    most = free if free > 0 else _FULL_HOLE * mirror.semi_diameter
    for begin, end in legs:
        if end <= k:
            continue
        r = met_at(table.lens.rows[k], mirror, table.beam_and_rim[begin], table.beam_and_rim[end])
        widest = float(np.nanmax(r, initial=0.0)) * (1 + table.margin)
        if widest <= most or free > 0:
            hole = max(hole, min(widest, most))
    return mirror if hole <= mirror.inner_semi_diameter else replace(mirror, inner_semi_diameter=hole)


def _free_middle(table: OpticalSurfaces, k: int, mirror: Surface) -> float:
    """Radius within which a mirror that is used off its axis gets no light, mm; 0 if light falls around its vertex."""
    frame = mirror.to_world()
    own = (table.beam_and_rim[k + 1] - frame[:3, 3]) @ frame[:3, :2]
    own = own[np.isfinite(own[:, 0])]
    if not len(own):
        return 0.0
    azimuth = np.sort(np.arctan2(own[:, 1], own[:, 0]))
    widest_gap = np.diff(azimuth, append=azimuth[0] + 2 * np.pi).max()
    return float(np.hypot(*own.T).min()) * (1 - table.margin) if widest_gap > np.pi else 0.0


def _rim(aperture: ClearAperture, outer: bool) -> np.ndarray:
    """Points (n, 2) along the edge of an aperture in the frame of its row, mm."""
    t = np.linspace(0.0, 2 * np.pi, _RIM)
    if aperture.kind == "circle":
        points = (aperture.outer if outer else aperture.inner) * np.column_stack([np.cos(t), np.sin(t)])
    else:
        square = np.column_stack([np.cos(t), np.sin(t)])
        square /= np.abs(square).max(axis=1, keepdims=True)
        points = square * [aperture.half_width, aperture.half_height]
    return np.asarray(points + np.array([aperture.x, aperture.y]))
