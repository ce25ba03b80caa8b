"""Numbers of surfaces in rows that are read, and added to by derivatives, four at a time: one costs as much alone.

A row belongs to a surface; rows of numbers whose derivatives are gathered are repeated for each batch of start rays.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.settings import BATCHES
from mistray.surfaces.gradient_columns import GEOMETRY
from mistray.surfaces.upload import upload

WIDTH = 4  # numbers that are read together


class NumberRows:
    """
    Some columns of `GEOMETRY`.

    Parameters
    ----------
    geometry : (surfaces, len(GEOMETRY)) float64
    columns : sequence of str
        Columns that are 0 at all surfaces are left out unless they are tracked.
    tracked : set of str
        Columns whose derivatives are gathered.

    Attributes
    ----------
    names : set of str
        Columns that have not been left out.
    """

    def __init__(self, geometry: np.ndarray, columns: Sequence[str], tracked: Collection[str] = ()) -> None:
        self._count, self._columns = len(geometry), tuple(columns)
        self._tracked = [name for name in columns if name in tracked]
        self._plain = [name for name in columns if name not in tracked and geometry[:, GEOMETRY.index(name)].any()]
        self.names = {*self._tracked, *self._plain}
        self._surfaces = dr.opaque(mi.UInt32, self._count)
        self._plain_values = upload(mi.Float64, _rows(geometry, self._plain))
        self._tracked_values = tracked_array(np.tile(_rows(geometry, self._tracked).ravel(), BATCHES))
        dr.eval(self._plain_values, self._tracked_values)

    def read(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> dict[str, Any]:
        """All columns by name at the surfaces s; 0 where they have been left out."""
        found: dict[str, Any] = dict.fromkeys(self._columns, mi.Float64(0))
        for names, values, row in (
            (self._plain, self._plain_values, s),
            (self._tracked, self._tracked_values, batch * self._surfaces + s),
        ):
            vectors = -(-len(names) // WIDTH)
            for k in range(vectors):
                four = dr.gather(mi.Vector4d, values, row * vectors + k, active)
                found |= dict(zip(names[WIDTH * k : WIDTH * (k + 1)], four, strict=False))
        return found

    def gradient(self) -> dict[str, np.ndarray]:
        """Derivatives that have been gathered, by column, each (BATCHES, surfaces) float64."""
        found = np.array(dr.grad(self._tracked_values)).reshape(BATCHES, self._count, -1)
        return {name: found[:, :, k] for k, name in enumerate(self._tracked)}


def tracked_array(values: np.ndarray) -> mi.Float64:
    """Numbers whose derivatives are gathered."""
    with dr.resume_grad():
        array = upload(mi.Float64, values)
        dr.enable_grad(array)
    return array


def _rows(geometry: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Columns by name in rows whose length is a multiple of `WIDTH`, one column at least; shape (surfaces, length)."""
    rows = np.zeros((len(geometry), max(1, -(-len(names) // WIDTH)) * WIDTH))
    for k, name in enumerate(names):
        rows[:, k] = geometry[:, GEOMETRY.index(name)]
    return rows
