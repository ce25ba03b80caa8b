"""Patches of a surface: pieces of known area in which rays that light it and rays that see it meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mistray.surfaces.surfaces import SurfaceTable

HITS_PER_PATCH = 8  # of the rarer of the two kinds of rays, on average at least
MOST_PATCHES = 256


@dataclass(frozen=True, eq=False)
class Patches:
    """
    A surface divided along two coordinates: radius (or z, or x) and azimuth (or y).

    Attributes
    ----------
    table : SurfaceTable
    surface : int
    first, second : int
        Number of parts along the coordinates.
    """

    table: SurfaceTable
    surface: int
    first: int
    second: int

    @classmethod
    def of(cls, table: SurfaceTable, surface: int, hits: int) -> Patches:
        """So many patches that each gets some of the hits; a stock shape is one patch."""
        count = 1 if surface >= len(table.pieces) else int(np.clip(hits // HITS_PER_PATCH, 1, MOST_PATCHES))
        first = max(1, int(np.sqrt(count)))
        return cls(table, surface, first, count // first)

    @property
    def count(self) -> int:
        """Number of patches."""
        return self.first * self.second

    def numbers(self, points: np.ndarray) -> np.ndarray:
        """Patches that hold points (m, 3) of the surface, mm."""
        if self.count == 1:
            return np.zeros(len(points), dtype=int)
        table, rotation = self.table, self.table.rotations[self.surface]
        q = np.einsum("ij,jk->ik", points - table.vertices[self.surface], rotation)  # not BLAS: its threads cost more
        u, v = table.pieces[self.surface].unit_square(q)
        i, j = (np.clip((x * n).astype(int), 0, n - 1) for x, n in ((u, self.first), (v, self.second)))
        return np.asarray(i * self.second + j)

    @property
    def areas(self) -> np.ndarray:
        """(count,) areas, mm²."""
        if self.surface >= len(self.table.pieces):
            return np.array([_scalar(self.table.shapes[self.surface].surface_area())])
        return self.table.pieces[self.surface].areas(self.first, self.second).ravel()


def meet(table: SurfaceTable, surface: int, lit: np.ndarray, seen: np.ndarray) -> bool:
    """Whether points that light meets (m, 3) and points that the detector sees (n, 3) have a patch in common."""
    if not len(lit) or not len(seen):
        return False
    patches = Patches.of(table, surface, min(len(lit), len(seen)))
    return bool(np.intersect1d(patches.numbers(lit), patches.numbers(seen)).size)


def _scalar(value: object) -> float:
    return float(np.asarray(value).ravel()[0])
