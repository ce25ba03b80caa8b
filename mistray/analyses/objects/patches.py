"""Patches of a surface, pieces of known area, to match rays that light it with rays that see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mistray.surfaces.surfaces import SurfaceTable

HITS_PER_PATCH = 8  # of the rarer of the two kinds of rays, on average at least
MOST_PATCHES = 256


@dataclass(frozen=True, eq=False)
class Patches:
    """
    Division of a surface into patches along two coordinates: radius (or z, or x) and azimuth (or y).

    Attributes
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    surface : int
        Index of the surface in the table.
    first, second : int
        Number of parts along each coordinate.
    """

    table: SurfaceTable
    surface: int
    first: int
    second: int

    @classmethod
    def of(cls, table: SurfaceTable, surface: int, hits: int) -> Patches:
        """
        Return the division of a surface into at most 256 patches with at least 8 of `hits` each on average.

        A Mitsuba shape is one patch, and so is a surface with fewer hits.
        """
        count = 1 if surface >= len(table.pieces) else int(np.clip(hits // HITS_PER_PATCH, 1, MOST_PATCHES))
        first = max(1, int(np.sqrt(count)))
        return cls(table, surface, first, count // first)

    @property
    def count(self) -> int:
        """Number of patches."""
        return self.first * self.second

    def numbers(self, points: np.ndarray) -> np.ndarray:
        """Return the index of the patch that holds each point (m, 3), mm, of the surface; (m,) int."""
        if self.count == 1:
            return np.zeros(len(points), dtype=int)
        table, rotation = self.table, self.table.rotations[self.surface]
        q = np.einsum("ij,jk->ik", points - table.vertices[self.surface], rotation)  # not BLAS: its threads cost more
        u, v = table.pieces[self.surface].unit_square(q)
        i, j = (np.clip((x * n).astype(int), 0, n - 1) for x, n in ((u, self.first), (v, self.second)))
        return np.asarray(i * self.second + j)

    @property
    def areas(self) -> np.ndarray:
        """Area of each patch, (count,), mm²."""
        if self.surface >= len(self.table.pieces):
            return np.array([_scalar(self.table.shapes[self.surface].surface_area())])
        return self.table.pieces[self.surface].areas(self.first, self.second).ravel()


def meet(table: SurfaceTable, surface: int, lit: np.ndarray, seen: np.ndarray) -> bool:
    """True if some patch of a surface has both lit points (m, 3) and seen points (n, 3), mm."""
    if not len(lit) or not len(seen):
        return False
    patches = Patches.of(table, surface, min(len(lit), len(seen)))
    return bool(np.intersect1d(patches.numbers(lit), patches.numbers(seen)).size)


def _scalar(value: object) -> float:
    return float(np.asarray(value).ravel()[0])
