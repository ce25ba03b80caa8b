"""Walls that would stand in the beam of a folded system: a barrel there is none in the real one."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from mistray.prescription.model import Structure, Surface
from mistray.prescription.sequential import Row
from mistray.prescription.sequential_rays import distance

_SAMPLES = 257


Array = npt.NDArray[np.float64]


def shadowing_spaces(
    pieces: Iterable[Structure | Surface], segments: Iterable[tuple[Array, Array]], part: str = "barrel"
) -> set[int]:
    """
    Numbers of the spaces whose walls rays cross.

    Parameters
    ----------
    pieces : iterable of Structure or Surface
        Those of other parts are passed over.
    segments : iterable of two (n, 3) float64
        Where rays leave an optical surface and where they meet the next, in the world, mm; NaN for rays to pass over.
    part : str
        Of the walls.

    Returns
    -------
    set of int
    """
    t = np.linspace(0.0, 1.0, _SAMPLES)[:, None, None]
    lines = [a + t * (b - a) for a, b in segments]
    walls = [piece for piece in pieces if isinstance(piece, Structure) and piece.part == part]
    return {wall.space for wall in walls if any(_crossed(wall, line) for line in lines)}


def met_at(row: Row, surface: Surface, start: Array, end: Array) -> Array:
    """
    Where rays pass through the clear part of a surface.

    Parameters
    ----------
    row : Row
        With its figure.
    surface : Surface
        With its place and clear radii.
    start, end : (n, 3) float64
        In the world, mm.

    Returns
    -------
    (n,) float64
        Distance from its axis, mm; NaN for rays that do not.
    """
    frame = surface.to_world()
    a, b = ((point - frame[:3, 3]) @ frame[:3, :3] for point in (start, end))
    length = np.linalg.norm(b - a, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        heading = (b - a) / length[:, None]
        s = distance(row, a, heading)
        r = np.hypot(*(a + s[:, None] * heading)[:, :2].T)
        within = (r < surface.outer_radius) & (r >= surface.inner_semi_diameter)
        result: Array = np.where((s > 0) & (s < length) & within, r, np.nan)
    return result


def _crossed(wall: Structure, line: Array) -> bool:
    """Whether points (samples, n, 3) along rays change sides of a frustum between its ends."""
    frame = wall.to_world()
    local = (line - frame[:3, 3]) @ frame[:3, :3]
    r, z = np.hypot(local[..., 0], local[..., 1]), local[..., 2]
    if wall.z0 == wall.z1:
        side = np.sign(z - wall.z0)
        beside = (r > min(wall.r0, wall.r1)) & (r < max(wall.r0, wall.r1))
    else:
        share = (z - wall.z0) / (wall.z1 - wall.z0)
        side = np.sign(r - wall.r0 - share * (wall.r1 - wall.r0))
        beside = (share > 0) & (share < 1)
    with np.errstate(invalid="ignore"):
        changed = (side[1:] * side[:-1] < 0) & beside[1:] & beside[:-1]
    return bool(np.any(changed))
