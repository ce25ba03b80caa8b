"""Sag given on a grid, evaluated patch by patch in the kernel and on the host."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from mistray.physics.sags.grid import Grid, patch


@dataclass(frozen=True, eq=False)
class GridPatches:
    """
    Sag on a grid, uploaded to the device once for each floating-point precision.

    Attributes
    ----------
    grid : Grid
        Heights on the grid.
    """

    grid: Grid

    def evaluate(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Return the height, mm, and the slopes dz/dx and dz/dy at points x, y, mm; for NumPy or Dr.Jit arrays."""
        grid = self.grid
        if isinstance(x, np.ndarray | np.generic | float):
            return grid.evaluate(x, y)
        kind = dr.detached_t(type(x))
        ny, nx = grid.corners.shape[:2]
        u = (x - (grid.middle[0] - grid.half[0])) / grid.step[0]
        v = (y - (grid.middle[1] - grid.half[1])) / grid.step[1]
        whole, number = dr.int32_array_t(kind), dr.uint32_array_t(kind)
        i, j = (number(dr.clip(whole(dr.floor(dr.detach(w))), 0, n - 2)) for w, n in ((u, nx), (v, ny)))
        s, t = u - type(x)(kind(i)), v - type(x)(kind(j))
        buffer, first = self._buffer(kind), 4 * (j * nx + i)
        at = [
            [[type(x)(dr.gather(kind, buffer, first + (4 * (b * nx + a) + k))) for k in range(4)] for a in (0, 1)]
            for b in (0, 1)
        ]
        return patch(s, t, at, grid.step)

    def _buffer(self, kind: Any) -> Any:
        known = self.__dict__.setdefault("_buffers", {})
        if kind not in known:
            known[kind] = kind(self.grid.corners.ravel())
            dr.eval(known[kind])
        return known[kind]
