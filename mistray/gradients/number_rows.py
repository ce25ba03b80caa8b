"""
Numbers of surfaces in rows, which the device gathers, and scatters derivatives to, as vectors of four.

A gather of one number costs as much as one of four. A row belongs to a surface; rows of tracked numbers, whose
derivatives are accumulated, are repeated for each batch of start rays.
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
    Device table of some columns of `GEOMETRY`, a row for each surface; tracked columns accumulate derivatives.

    Parameters
    ----------
    geometry : (surfaces, len(GEOMETRY)) float64
        Numbers of all surfaces, in the units of the columns.
    columns : sequence of str
        Names of the columns; those that are 0 at all surfaces are left out unless they are tracked.
    tracked : set of str
        Columns whose derivatives are accumulated.

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
        # Tracked rows have a copy for each batch, so that derivatives by batch give standard errors
        self._plain_values = upload(mi.Float64, _rows(geometry, self._plain))
        self._tracked_values = tracked_array(np.tile(_rows(geometry, self._tracked).ravel(), BATCHES))
        dr.eval(self._plain_values, self._tracked_values)

    def read(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> dict[str, Any]:
        """Return the numbers of the surfaces s by column name, in the columns' units; 0 for columns left out."""
        # Zeros are literals: Dr.Jit drops the terms of columns that are left out
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
        """Return the accumulated derivatives with respect to tracked columns, by name, each (BATCHES, surfaces)."""
        found = np.array(dr.grad(self._tracked_values)).reshape(BATCHES, self._count, -1)
        return {name: found[:, :, k] for k, name in enumerate(self._tracked)}


def tracked_array(values: np.ndarray) -> mi.Float64:
    """Return numbers as a Dr.Jit array, float64, that accumulates derivatives with respect to them."""
    with dr.resume_grad():
        array = upload(mi.Float64, values)
        dr.enable_grad(array)
    return array


def _rows(geometry: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """
    Return columns by name as rows, padded with zeros to a multiple of `WIDTH`.

    Returns
    -------
    (surfaces, length) float64
        At least one vector of `WIDTH` numbers for each surface.
    """
    rows = np.zeros((len(geometry), max(1, -(-len(names) // WIDTH)) * WIDTH))
    for k, name in enumerate(names):
        rows[:, k] = geometry[:, GEOMETRY.index(name)]
    return rows
