"""Detection of walls that would block the beam of a folded system, where a real system has no barrel."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from mistray.prescription.model import Structure, Surface
from mistray.prescription.sequential.rays import distance
from mistray.prescription.sequential.table import Row

_END = 1e-9  # of a way or of a wall: what touches does not cross
_TOUCHING_MM = 1e-6  # rays that begin or end on a surface do not pass through it

Array = npt.NDArray[np.float64]


def shadowing_spaces(
    pieces: Iterable[Structure | Surface], segments: Iterable[tuple[Array, Array]], part: str = "barrel"
) -> set[int]:
    """
    Return the indices of the optical spaces with a wall that a ray crosses.

    Parameters
    ----------
    pieces : iterable of Structure or Surface
        Structures to test; pieces of other parts are skipped.
    segments : iterable of two (n, 3) float64
        Points at which rays leave an optical surface and meet the next, in the world, mm; NaN skips a ray.
    part : str
        Part that the walls belong to.

    Returns
    -------
    set of int
        Indices of the spaces, as in `Structure.space`.
    """
    legs = list(segments)
    walls = [piece for piece in pieces if isinstance(piece, Structure) and piece.part == part]
    return {wall.space for wall in walls if any(_crossed(wall, *leg) for leg in legs)}


def met_at(row: Row, surface: Surface, start: Array, end: Array) -> Array:
    """
    Return the distance from the axis, mm, at which rays pass through the clear part of a surface.

    Parameters
    ----------
    row : Row
        Row that gives the figure.
    surface : Surface
        Surface that gives the place and the clear area.
    start, end : (n, 3) float64
        Ends of each ray in the world, mm.

    Returns
    -------
    (n,) float64
        Distance from the axis of the surface, mm; NaN for rays that do not pass through.
    """
    frame = surface.to_world()
    a, b = ((point - frame[:3, 3]) @ frame[:3, :3] for point in (start, end))
    length = np.linalg.norm(b - a, axis=1)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        heading = (b - a) / length[:, None]
        s = distance(row, a, heading)
        x, y = (a + s[:, None] * heading)[:, :2].T
        r = np.hypot(x, y)
        if surface.outline is not None:
            within = surface.outline.contains(x, y)
        elif surface.half_width is not None and surface.half_height is not None:
            within = (np.abs(x) < surface.half_width) & (np.abs(y) < surface.half_height)
        else:
            within = (r < surface.outer_radius) & (r >= surface.inner_semi_diameter)
        result: Array = np.where((s > _TOUCHING_MM) & (s < length - _TOUCHING_MM) & within, r, np.nan)
    return result


@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def _crossed(wall: Structure, start: Array, end: Array) -> bool:
    """
    True if any segment between start and end points, (n, 3), mm, crosses the frustum of a wall.

    Touching at an end does not count.
    """
    frame = wall.to_world()
    a, b = ((point - frame[:3, 3]) @ frame[:3, :3] for point in (start, end))
    step = b - a
    if wall.z0 == wall.z1:
        t = (wall.z0 - a[:, 2]) / step[:, 2]
        share = (np.hypot(*(a + t[:, None] * step)[:, :2].T) - wall.r0) / (wall.r1 - wall.r0)
        return bool(np.any(_between(t) & _between(share)))
    slope = (wall.r1 - wall.r0) / (wall.z1 - wall.z0)
    # x² + y² = r(z)² with r linear along the ray: (d² - ρ²) t² + 2 (a·d - r ρ) t + a² - r² = 0
    radius, growth = wall.r0 + slope * (a[:, 2] - wall.z0), slope * step[:, 2]
    square = (step[:, :2] ** 2).sum(axis=1) - growth**2
    half = (a[:, :2] * step[:, :2]).sum(axis=1) - radius * growth
    rest = (a[:, :2] ** 2).sum(axis=1) - radius**2
    larger = -(half + np.copysign(np.sqrt(half * half - square * rest), half))
    for t in (larger / square, rest / larger):
        share = (a[:, 2] + t * step[:, 2] - wall.z0) / (wall.z1 - wall.z0)
        if np.any(_between(t) & _between(share) & (radius + t * growth > 0)):
            return True
    return False


def _between(share: Array) -> npt.NDArray[np.bool_]:
    """Return a mask of fractions along a segment that lie within it, at least `_END` from both ends."""
    return (share > _END) & (share < 1 - _END)
