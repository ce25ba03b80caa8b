"""Sparse arrays, as they are sent between processes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Packed:
    """
    An array of float64, dense or without its zeros.

    Attributes
    ----------
    values : (n,) float64
    where : (n,) uint64 or None
        Indices of the values in the flat array, of which the zeros are left out; None: all values are there.
    """

    values: np.ndarray
    where: np.ndarray | None = None

    def add_to(self, total: np.ndarray) -> None:
        """Add the array to one in place, which must be contiguous."""
        flat = total.reshape(-1)
        if self.where is None:
            flat += self.values
        else:
            flat[self.where] += self.values


def pack(array: np.ndarray) -> Packed:
    """Return an array without its zeros if that is shorter."""
    flat = np.ascontiguousarray(array, dtype=np.float64).reshape(-1)
    # An index takes as many bytes as a value
    where = np.flatnonzero(flat)
    if 2 * len(where) >= len(flat):
        return Packed(flat)
    return Packed(flat[where], where.astype(np.uint64))
