"""Overlaps and absorbing rims of walls, so that rounding lets no light through the seams between surfaces.

Positions on the device are rounded. At a seam a ray may miss both surfaces by a rounding, meet the farther one first,
or start from a point on the wrong side of the other. This happens to one ray in ten million. Behind a deep baffle that
light would outshine all light that takes the right way. Therefore walls that bound no body overlap with their
neighbours by two roundings, so that a ray meets one of them. And a wall absorbs rays that meet it within some roundings
of its rim, unless another wall continues it there.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.families.cone import Cone
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.gradient_columns import HIGH, INNER, LOW, OUTER
from mistray.surfaces.surface import TracedSurface
from mistray.surfaces.upload import upload

ROUNDINGS = 2  # overlap of walls with their neighbours, in roundings of positions
TILES = 1  # overlap of other surfaces, if they are many, in roundings of positions
MOST_OVERLAP = 8e-6  # greatest overlap, in units of the size of a surface
RIM_ROUNDINGS = 4  # width of the zone at a rim that absorbs, in roundings of positions
MOST_RIM = 1e-5  # greatest width of that zone, in units of the size of a wall
MOST_OF_WIDTH = 1e-4  # greatest width of that zone, in units of the distance between the wall's rims
PLACES = 6  # decimals in mm to which rims that coincide agree
SMOOTH = 1e-8  # 1 - |cosine| of the angle below which a wall continues another


def let_overlap(
    pieces: Sequence[TracedSurface], vertices: np.ndarray, between_media: Sequence[bool], many: Sequence[int]
) -> float:
    """
    Set the overlaps of surfaces with their neighbours, and return the rounding error of positions, mm.

    Parameters
    ----------
    pieces : sequence of TracedSurface
        Surfaces whose `overlap` is set.
    vertices : (n, 3) float64
        Positions of the surfaces' vertices on the device, mm.
    between_media : sequence of bool
        Whether each surface has different media on its sides. Such surfaces do not overlap: light beside a body is not
        in it.
    many : sequence of int
        Indices of the surfaces in a tree, such as the tiles of a mirror, which nothing else holds together.
    """
    if not pieces:
        return 0.0
    largest = max(piece.size + float(np.ptp(piece.z_range)) for piece in pieces)
    rounding = float(np.spacing(np.float32(np.abs(vertices).max() + largest)))
    tiles = set(many)
    for number, (piece, bounds) in enumerate(zip(pieces, between_media, strict=True)):
        roundings = 0 if bounds else ROUNDINGS if piece.wall else TILES if number in tiles else 0
        piece.overlap = min(roundings * rounding, MOST_OVERLAP * piece.size)
    return rounding


class WallRims:
    """
    Rims of the walls of a scene; walls absorb light near them so that none leaks through seams.

    Parameters
    ----------
    pieces : sequence of TracedSurface
        All analytic surfaces of the scene.
    count : int
        Number of all surfaces of the scene.
    rounding : float
        Rounding error of positions, mm.

    Attributes
    ----------
    some : bool
        Whether any wall has a rim.
    """

    def __init__(self, pieces: Sequence[TracedSurface], count: int, rounding: float) -> None:
        # Weights of z and r² in the coordinate across the rims, and its limits; light beyond them is absorbed
        rows = np.tile([0.0, 0.0, -np.inf, np.inf], (count, 1))
        walls = [piece for piece in pieces if piece.wall and isinstance(piece, Cone | SagSurface)]
        smooth = _smooth_rims(walls)
        for piece in walls:
            near = min(RIM_ROUNDINGS * rounding, MOST_RIM * piece.size, MOST_OF_WIDTH * float(np.ptp(piece.reach)))
            if isinstance(piece, Cone):
                weights, bounds = (1.0, 0.0), (piece.z_range[0] + near, piece.z_range[1] - near)
            else:
                weights, bounds = (0.0, 1.0), ((piece.inner + near) ** 2, (piece.outer - near) ** 2)
            rims = set(piece.rim_sizes).difference(smooth[piece.index])
            low = bounds[0] if rims & {LOW, INNER} else -np.inf
            high = bounds[1] if rims & {HIGH, OUTER} else np.inf
            rows[piece.index] = *weights, low, high
        self.some = bool(np.isfinite(rows[:, 2:]).any())
        self._rows = upload(mi.Float, rows)

    def at_rim(self, s: mi.UInt32, q: mi.Vector3f, active: mi.Bool) -> mi.Bool:
        """Return a mask of points q, mm, in frames of the walls s, that lie within a few rounding errors of a rim."""
        along, across, low, high = dr.gather(mi.Vector4f, self._rows, s, active)
        place = dr.fma(along, q.z, across * dr.fma(q.x, q.x, q.y * q.y))
        return active & ((place < low) | (place > high))


def _smooth_rims(walls: Sequence[TracedSurface]) -> dict[int, set[int]]:
    """Return, for each wall by surface index, the set of its rims where another wall continues it smoothly."""
    found: dict[int, set[int]] = {piece.index: set() for piece in walls}
    meeting: dict[tuple[int, float, float], list[tuple[int, int, np.ndarray]]] = {}
    for piece in walls:
        for rim in piece.rim_sizes:
            point = piece.rim_point(rim)
            place = piece.axis, round(float(point[0]), PLACES), round(float(piece.z + point[1]), PLACES)
            others = meeting.setdefault(place, [])
            tangent = piece.tangent(point)
            for other, other_rim, direction in others:
                if other != piece.index and abs(float(tangent @ direction)) > 1 - SMOOTH:
                    found[piece.index].add(rim)
                    found[other].add(other_rim)
            others.append((piece.index, rim, tangent))
    return found
