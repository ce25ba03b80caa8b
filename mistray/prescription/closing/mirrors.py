"""Mirrors of a sequential lens made non-sequential: off-axis segments, holes, and beams that mirrors block."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mistray.percent import percent_text
from mistray.physics.geometry.outline import Outline, circle
from mistray.prescription.closing.shadows import met_at

if TYPE_CHECKING:
    from mistray.prescription.closing.surfaces import OpticalSurfaces
    from mistray.prescription.model import Surface

_FULL_HOLE = 0.9  # of a mirror's radius: a greater hole would leave no mirror
_ALL = 0.995  # share of the beam above which no light is left


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # huge numbers reach nothing
def cut_holes(table: OpticalSurfaces) -> None:
    """
    Cut holes in mirrors where a later part of the beam passes, and note the light that mirrors block.

    Parameters
    ----------
    table : OpticalSurfaces
        Optical surfaces; mirrors are replaced, rays that a mirror stops become `blocked`, and notes are added.
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
            table.exchange(mirror, drilled)
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
    """
    Return the fraction of the light at the image that each ray of `OpticalSurfaces.beam` carries, (n,).

    It is 0 for rays that do not reach the image.
    """
    weights = np.where(np.isfinite(table.beam[-1, :, 0]), table.rays.weights, 0.0)
    return np.asarray(weights / (weights.sum() or 1.0))


def percent(share: float) -> str:
    """Return a fraction of the beam in words, such as "about 12 %"."""
    return f"about {percent_text(share)}"


def _drilled(table: OpticalSurfaces, k: int, mirror: Surface, free: float, legs: list[tuple[int, int]]) -> Surface:
    """
    Return the mirror of row `k` with a hole for later parts of the beam; the hole leaves all that its own beam needs.

    `free` is the radius of `_free_middle`, mm. `legs` are the `segments` of the beam that neither begin nor end at the
    mirror. A mirror that needs no hole, or is not round, is returned as it is.
    """
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
    """Return the radius, mm, about the vertex of mirror `k` that its own beam leaves unlit; 0 if it is not off-axis."""
    own = footprint(table, k, mirror.to_world())
    return float(np.hypot(*own.T).min()) * (1 - table.margin) if beside_vertex(own) else 0.0


def footprint(table: OpticalSurfaces, k: int, frame: np.ndarray) -> np.ndarray:
    """Return the points, (n, 2), mm, at which the beam meets row `k`: x and y in `frame`, (4, 4), of its surface."""
    own = (table.beam_and_rim[k + 1] - frame[:3, 3]) @ frame[:3, :2]
    return np.asarray(own[np.isfinite(own[:, 0])])


def beside_vertex(points: np.ndarray) -> bool:
    """True if all points of a footprint, (n, 2), lie on one side of the vertex, so that the beam misses it."""
    azimuth = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    return bool(len(points) and np.diff(azimuth, append=azimuth[0] + 2 * np.pi).max() > np.pi)


def piece_beside_vertex(points: np.ndarray, margin: float) -> Outline:
    """Return a disc about the middle of points (n, 2), mm, wider than they need by `margin` times the radius."""
    x, y = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.hypot(*(points - (x, y)).T).max()) * (1 + margin)
    return circle(radius, x=float(x), y=float(y))
