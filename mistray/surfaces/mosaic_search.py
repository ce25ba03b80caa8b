"""Nearest hit of rays with many freeform surfaces of one sort, such as segments of a mirror or lenslets of an array.

A ray comes near few of them. Bounding spheres of all members are tested one after the other, at a few instructions
each. The code that searches a crossing exists once, in a loop over the members that the ray comes near. Parameters that
all members share are loaded once for all lanes; the others are gathered.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.crossings import FAR, AxisRay, turned
from mistray.surfaces.extrema import smaller
from mistray.surfaces.families.freeform import Freeform
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

FEWEST = 4  # fewest freeforms of one sort that form a mosaic
BITS = 32  # members of a group
SAME = 1e-9  # relative difference below which numbers count as equal
LENGTH_MM = 1e-6  # difference of outline lengths that count as equal; a hundredth of their rounding at 1 m
BOUNDS = ("size", "size2", "slope2", "self_hit", "half_x", "half_y")  # those of a larger member will do
ALIKE = 20.0  # ratio of bounds up to which the largest is used for all
SLACK = 1e-5  # margin for rounding, in units of a sphere's size and of its distance from the middle of the scene


def mosaics(pieces: Sequence[object], members: Sequence[int]) -> list[list[int]]:
    """
    Return groups of freeforms that share kernel code, for `MosaicSearch`, as lists of at most `BITS` surface indices.

    `members` are the indices of the surfaces that may be grouped. Sorts with fewer than `FEWEST` form no group.
    """
    sorts: dict[tuple[object, ...], list[int]] = {}
    for k in members:
        piece = pieces[k]
        if isinstance(piece, Freeform):
            sorts.setdefault(piece.sort, []).append(k)
    return [
        here[first : first + BITS]
        for here in sorts.values()
        if len(here) >= FEWEST
        for first in range(0, len(here), BITS)
    ]


class MosaicSearch:
    """
    Search for the nearest hit of rays with one group of freeforms of the same sort.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    members : sequence of int
        Indices of freeforms of one sort in `table.pieces`.
    """

    def __init__(self, table: SurfaceTable, members: Sequence[int]) -> None:
        pieces = [piece for k in members if isinstance(piece := table.pieces[k], Freeform)]
        first = pieces[0]
        self._first = first
        self._turned = any(piece.frame for piece in pieces)
        spheres, rows = [], []
        for piece in pieces:
            turn = table.frames[piece.frame]
            place = np.array([*table.axes[piece.axis][1:], piece.z])
            low, high = piece.z_range
            centre = turn @ (place + np.array([0.0, 0.0, 0.5 * (low + high)]))
            radius = float(np.hypot(piece.size, 0.5 * (high - low)))
            radius += SLACK * (radius + float(np.linalg.norm(centre)) + 1.0)
            spheres.append((*centre, radius * radius))
            turns = {f"turn_{k}": v for k, v in enumerate(turn.ravel())} if self._turned else {}
            rows.append({"axis_x": place[0], "axis_y": place[1], **turns, **_about_middle(piece)})
        self._spheres = [tuple(dr.opaque(mi.Float, v) for v in sphere) for sphere in spheres]
        common = {name: _common(name, np.array([float(row[name]) for row in rows])) for name in rows[0]}
        common = {name: value for name, value in common.items() if value is not None}
        self._common = {name: dr.opaque(mi.Float, value) for name, value in common.items()}
        self._own = tuple(name for name in rows[0] if name not in common)
        self._vectors = -(-len(self._own) // 4)
        values = np.zeros((len(rows), 4 * self._vectors))
        values[:, : len(self._own)] = [[float(row[name]) for name in self._own] for row in rows]
        self._rows = upload(mi.Float, values)
        self._indices = upload(mi.UInt32, np.array([piece.index for piece in pieces], dtype=np.uint32))

    def nearest(
        self, o: mi.Vector3f, d: mi.Vector3f, last: mi.UInt32, best: mi.Float, surface: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.Float, mi.UInt32]:
        """
        Return the nearest hits of rays after the group is searched: distances, mm, and surface indices.

        Parameters
        ----------
        o, d : mi.Vector3f
            Origins relative to `SurfaceTable.centre`, mm, and unit directions of the rays.
        last : mi.UInt32
            Index of the surface that each ray starts on.
        best, surface : mi.Float, mi.UInt32
            Distance of the nearest hit so far, mm, and the index of its surface.
        active : mi.Bool
            Lanes that have a ray.
        """
        near = dr.select(active, self._near(o, d, best), mi.UInt32(0))

        def step(near: mi.UInt32, best: mi.Float, surface: mi.UInt32) -> tuple[mi.UInt32, mi.Float, mi.UInt32]:
            member = dr.tzcnt(near)
            here = near != 0
            numbers = self._numbers(member, here)
            x, y = numbers.pop("axis_x"), numbers.pop("axis_y")
            u, v = o, d
            if self._turned:
                turn = [numbers.pop(f"turn_{k}") for k in range(9)]
                u, v = turned(turn, o), turned(turn, d)
            number = dr.gather(mi.UInt32, self._indices, member, here)
            t = self._first.crossing(AxisRay.of(u.x - x, u.y - y, u.z, v), numbers, last == number)
            nearer = here & (t < best)
            return near & (near - 1), dr.select(nearer, t, best), dr.select(nearer, number, surface)

        _, best, surface = dr.while_loop(
            (near, mi.Float(best), mi.UInt32(surface)),
            lambda near, best, surface: near != 0,
            step,
            labels=("near", "best", "surface"),
            mode="symbolic",
            label="mosaic",
        )
        return best, surface

    def _near(self, o: mi.Vector3f, d: mi.Vector3f, best: mi.Float) -> mi.UInt32:
        """Return a bit mask of the members whose bounding spheres the ray meets before the nearest hit so far."""
        found = mi.UInt32(0)
        end = smaller(best, FAR)
        for k, (x, y, z, radius2) in enumerate(self._spheres):
            to = mi.Vector3f(x, y, z) - o
            along = dr.clip(dr.dot(to, d), 0, end)
            off = to - along * d
            found |= dr.select(dr.squared_norm(off) <= radius2, mi.UInt32(1 << k), mi.UInt32(0))
        return found

    def _numbers(self, member: mi.UInt32, active: mi.Bool) -> dict[str, mi.Float]:
        vectors = [dr.gather(mi.Vector4f, self._rows, self._vectors * member + k, active) for k in range(self._vectors)]
        values = (vector[k] for vector in vectors for k in range(4))
        return {**self._common, **dict(zip(self._own, values, strict=False))}


def _about_middle(piece: Freeform) -> dict[str, float]:
    """
    Return the kernel parameters of a freeform by name, with the corners of its polygons about its middle, mm.

    Corners of a rotated polygon stay relative to the position of that polygon.
    """
    found = {name: float(value) for name, value in piece.kernel_values().items()}
    for k, figure in enumerate(piece.outline.figures, start=1):
        if figure.kind == "polygon" and not figure.angle_deg:
            x, y = found[f"clip_{k}_x"], found[f"clip_{k}_y"]
            found |= {f"clip_{k}_x": 0.0, f"clip_{k}_y": 0.0}
            for j in range(1, len(figure.sizes) // 2 + 1):
                found[f"clip_{k}_x{j}"] += x
                found[f"clip_{k}_y{j}"] += y
    return found


def _common(name: str, values: np.ndarray) -> float | None:
    """
    Return the value of a kernel parameter that all members share within rounding; None if they differ.

    Bounds within a factor `ALIKE` are shared as well, and the largest of them is returned. So are sizes of apertures
    (``clip_…``) that differ by at most `LENGTH_MM`.
    """
    most, least = float(values.max()), float(values.min())
    if name in BOUNDS and most <= ALIKE * least:
        return most
    allowed = SAME * max(abs(most), abs(least))
    if name.startswith("clip_"):
        allowed = max(allowed, LENGTH_MM)
    return float(values[0]) if most - least <= allowed else None
