"""
Surface parameters in rows of a device table; parameters and derivatives are read as vectors of four.

A gather of one value costs as much as one of four. A row belongs to a surface; rows of tracked parameters, whose
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
        Values of all surfaces, in the units of the columns.
    columns : sequence of str
        Names of the columns; those that are 0 at all surfaces are left out unless they are tracked.
    moving : set of str
        Columns whose derivatives are accumulated.
    real : type, optional
        Type of the values, ``mi.Float`` or, by default, ``mi.Float64``; derivatives are summed in float64.

    Attributes
    ----------
    moving : list of str
        Columns whose derivatives are accumulated.
    names : set of str
        Columns that have not been left out.
    """

    def __init__(
        self, geometry: np.ndarray, columns: Sequence[str], moving: Collection[str] = (), real: Any = None
    ) -> None:
        self._real = mi.Float64 if real is None else real
        self._count, self._columns = len(geometry), tuple(columns)
        self.moving = [name for name in columns if name in moving]
        others = [name for name in columns if name not in moving and geometry[:, GEOMETRY.index(name)].any()]
        self._names = [*self.moving, *others]
        self.names = set(self._names)
        self._surfaces = dr.opaque(mi.UInt32, self._count)
        self._values = upload(self._real, _rows(geometry, self._names))
        # One row for each batch, so that derivatives by batch give standard errors
        self._length = vectors_of(self.moving) * WIDTH
        self._derivatives = tracked(BATCHES * self._count * self._length) if self.moving else None

    def read(self, s: mi.UInt32, batch: mi.UInt32, active: mi.Bool) -> dict[str, Any]:
        """
        Return the geometry columns of surfaces s by name, each in its own unit; columns left out are 0.

        Derivatives of what is computed from them add to the row of each lane's `batch`.
        """
        # Zeros are literals: Dr.Jit drops the terms of columns that are left out
        found: dict[str, Any] = dict.fromkeys(self._columns, self._real(0))
        four = mi.Vector4f if self._real is mi.Float else mi.Vector4d
        vectors, moving = vectors_of(self._names), vectors_of(self.moving)
        for k in range(vectors):
            values = dr.gather(four, self._values, s * vectors + k, active)
            if k < moving and self._derivatives is not None:
                row = (batch * self._surfaces + s) * moving + k
                values = dr.replace_grad(values, four(dr.gather(mi.Vector4d, self._derivatives, row, active)))
            found |= dict(zip(self._names[WIDTH * k : WIDTH * (k + 1)], values, strict=False))
        return found

    def gradient(self) -> dict[str, np.ndarray]:
        """
        Return the accumulated derivatives with respect to tracked columns, by name, each (BATCHES, surfaces).

        The dictionary is empty if no column is tracked.
        """
        if self._derivatives is None:
            return {}
        found = np.array(dr.grad(self._derivatives)).reshape(BATCHES, self._count, -1)
        return {name: found[:, :, k] for k, name in enumerate(self.moving)}


def vectors_of(names: Sequence[str]) -> int:
    """Return the number of vectors of `WIDTH` values needed for one value per name."""
    return -(-len(names) // WIDTH)


def tracked(count: int) -> mi.Float64:
    """Return `count` zeros of float64 that accumulate derivatives on the device; they take no memory themselves."""
    with dr.resume_grad():
        zeros = dr.zeros(mi.Float64, count)
        dr.enable_grad(zeros)
    return zeros


def derived(value: Any, zeros: mi.Float64, index: mi.UInt32, active: mi.Bool) -> Any:
    """Return a value whose derivatives add to entry `index` of `zeros` from `tracked`; the value itself is kept."""
    return dr.replace_grad(value, type(value)(dr.gather(mi.Float64, zeros, index, active)))


def _rows(geometry: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """
    Return geometry columns by name as rows, padded with zeros to a multiple of `WIDTH` values.

    Returns
    -------
    (surfaces, length) float64
        At least one vector of `WIDTH` values for each surface.
    """
    rows = np.zeros((len(geometry), max(1, -(-len(names) // WIDTH)) * WIDTH))
    for k, name in enumerate(names):
        rows[:, k] = geometry[:, GEOMETRY.index(name)]
    return rows
