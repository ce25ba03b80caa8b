"""Patches of a surface: pieces of known area in which rays that light it and rays that see it meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mistray.physics.sag import sag_derivative
from mistray.surfaces.pieces import Piece
from mistray.surfaces.surfaces import SurfaceTable

HITS_PER_PATCH = 8  # of the rarer of the two kinds of rays, on average at least
MOST_PATCHES = 256
NODES = 16  # of the quadrature over a patch of a curved surface, each way


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
        piece = table.pieces[self.surface]
        if piece.kind == "cone" or piece.outer:
            low, high = _limits(piece)
            along = q[:, 2] if piece.kind == "cone" and not piece.slope else q[:, 0] ** 2 + q[:, 1] ** 2
            u, v = (along - low) / (high - low), 0.5 + np.arctan2(q[:, 1], q[:, 0]) / (2 * np.pi)
        else:
            u, v = (0.5 + 0.5 * q[:, k] / piece.half_size[k] for k in (0, 1))
        i, j = (np.clip((x * n).astype(int), 0, n - 1) for x, n in ((u, self.first), (v, self.second)))
        return np.asarray(i * self.second + j)

    @property
    def areas(self) -> np.ndarray:
        """(count,) areas, mm²."""
        if self.surface >= len(self.table.pieces):
            return np.array([_scalar(self.table.shapes[self.surface].surface_area())])
        piece = self.table.pieces[self.surface]
        if piece.kind == "cone":
            r0 = piece.r0
            low, high = (r0 + piece.slope * z for z in piece.z_range)
            length = np.hypot(high - low, piece.z_range[1] - piece.z_range[0])
            return np.full(self.count, np.pi * (low + high) * length / self.count)
        if piece.outer:
            low, high = _limits(piece)
            r2 = low + (high - low) * _nodes(self.first)
            rings = np.pi * (high - low) * np.mean(_stretch(piece, r2), axis=1) / self.first
            return np.repeat(rings / self.second, self.second)
        (a, b), (n, m) = piece.half_size, (self.first, self.second)
        x, y = a * (2 * _nodes(n) - 1), b * (2 * _nodes(m) - 1)
        r2 = x[:, None, :, None] ** 2 + y[None, :, None, :] ** 2
        return np.asarray((4 * a * b / (n * m) * _stretch(piece, r2).mean(axis=(2, 3))).ravel())


def meet(table: SurfaceTable, surface: int, lit: np.ndarray, seen: np.ndarray) -> bool:
    """Whether points that light meets (m, 3) and points that the detector sees (n, 3) have a patch in common."""
    if not len(lit) or not len(seen):
        return False
    patches = Patches.of(table, surface, min(len(lit), len(seen)))
    return bool(np.intersect1d(patches.numbers(lit), patches.numbers(seen)).size)


def _limits(piece: Piece) -> tuple[float, float]:
    """Range of the coordinate in which the area of a cone or a flat disc is even: r², or z of a cylinder."""
    if piece.kind != "cone":
        return piece.inner**2, piece.outer**2
    if not piece.slope:
        return piece.z_range
    r0 = piece.r0
    low, high = ((r0 + piece.slope * z) ** 2 for z in piece.z_range)
    return float(low), float(high)


def _nodes(parts: int) -> np.ndarray:
    """(parts, NODES) midpoints of equal steps of 0 … 1, part by part."""
    return np.asarray((np.arange(parts * NODES) + 0.5) / (parts * NODES)).reshape(parts, NODES)


def _stretch(piece: Piece, r2: np.ndarray) -> np.ndarray:
    """Area of a surface over that of its projection along its axis."""
    if piece.kind == "plane":
        return np.ones_like(r2)
    slope = sag_derivative(r2, *piece.conic, piece.coefficients)
    return np.asarray(np.sqrt(1 + 4 * r2 * np.square(slope)))


def _scalar(value: object) -> float:
    return float(np.asarray(value).ravel()[0])
