"""Thickness of the bodies behind the surfaces of a scene, measured on the host."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from mistray.surfaces.host_points import stock_points
from mistray.surfaces.host_rays import first_hit, inside, normals

if TYPE_CHECKING:
    from mistray.surfaces.surfaces import SurfaceTable

PROFILE, AZIMUTHS, ACROSS = 17, 4, 6  # points of a surface at which its bodies are measured


class Bodies:
    """
    Thicknesses of the bodies on either side of the surfaces of a scene.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene; their optical properties are not read.
    """

    def __init__(self, table: SurfaceTable) -> None:
        self._table = table
        self._thickness: dict[int, np.ndarray] = {}

    @cached_property
    def size(self) -> float:
        """Diagonal of the scene's bounding box, mm, which no body is thicker than."""
        boxes = [shape.bbox() for shape in self._table.shapes]
        low = np.min([np.array(box.min, dtype=np.float64).ravel() for box in boxes], axis=0)
        high = np.max([np.array(box.max, dtype=np.float64).ravel() for box in boxes], axis=0)
        return float(np.linalg.norm(high - low))

    def thickness(self, surface: int) -> np.ndarray:
        """
        Return the thickness in front of and behind a surface, (2,), mm: the least distance along its normals.

        It is infinite on a side where the normals meet no surface. `surface` is an index in the table.
        """
        if surface not in self._thickness:
            points, normal = self._points(surface)
            result = np.full(2, np.inf)
            for side, d in enumerate((-normal, normal)):
                hit, end, _ = first_hit(self._table, points, d, np.full(len(points), surface))
                result[side] = np.linalg.norm(end - points, axis=1)[hit >= 0].min(initial=np.inf)
            self._thickness[surface] = result
        return self._thickness[surface]

    def _points(self, surface: int) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, 3), mm, on a surface away from its rims, and the unit normals from front to back."""
        table, shape = self._table, self._table.shapes[surface]
        if surface >= len(table.pieces):
            u = (np.stack(np.meshgrid(*2 * [np.arange(ACROSS)]), axis=-1).reshape(-1, 2) + 0.5) / ACROSS
            return stock_points(shape, *u.T)
        if not hasattr(shape, "profile"):
            u, v = (np.stack(np.meshgrid(*2 * [np.arange(ACROSS)]), axis=-1).reshape(-1, 2).T + 0.5) / ACROSS
            frame = shape.vertex_frame(shape.values, shape.matrix)
            points = table.pieces[surface].points(u, v) @ frame[:3, :3].T + frame[:3, 3]
            return points, normals(table, surface, points)
        r, z = shape.profile(PROFILE)[1::2].T
        phi = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
        local = np.stack([np.outer(np.sin(phi), r), np.outer(np.cos(phi), r), np.tile(z, (AZIMUTHS, 1))], axis=-1)
        points = local.reshape(-1, 3) @ shape.matrix[:3, :3].T + shape.matrix[:3, 3]
        points = points[inside(table, surface, points)]
        return points, normals(table, surface, points)
