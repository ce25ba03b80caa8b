"""
Shares of whole families of paths, for derivatives by what moves paths.

The balance heuristic gives each path a share of its own, which changes along a path that moves. A share of all paths of
a family is a constant. Each direction then finds the derivative of its part by itself, however paths move with it.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.direction_recorder import CLASS_COUNT, class_of_arrival, class_of_departure
from mistray.recorders.path_key import FAMILIES, family_of
from mistray.recorders.recorder import Departure, Visit
from mistray.recorders.weighing import PathShares
from mistray.surfaces.upload import upload

PRIOR = 4.0  # samples of a family that count as much as its class
UNKNOWN = 0.5  # share of a class that no sample is of


def family_shares(
    place: tuple[np.ndarray, np.ndarray, np.ndarray], weight: np.ndarray, along: np.ndarray, cells: int
) -> np.ndarray:
    """
    Shares at which the variance of both parts together is least.

    With samples of the density of all rays, each of f/q and of a share s of rays with the light, these alone have the
    variance ∑ (f/q)²/s, those against it ∑ (f/q)²/(1 - s). Each part counts by the inverse of its own.

    Parameters
    ----------
    place : tuple of (s,) int
        Cell, class and family of the samples.
    weight, along : (s,) float64
    cells : int

    Returns
    -------
    (CLASS_COUNT · FAMILIES, cells) float64
        Of rays with the light.
    """
    cell, kind, family = place
    along = np.clip(along, 1e-9, 1 - 1e-9)

    def sums(row: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Number of samples in each row and cell, and their best share."""
        index, size = row * cells + cell, rows * cells
        against, with_it = (np.bincount(index, weight**2 / part, size) for part in (1 - along, along))
        count = np.bincount(index, minlength=size).reshape(rows, cells)
        total = against + with_it
        share = np.divide(against, total, out=np.full(size, UNKNOWN), where=total > 0)
        return count, share.reshape(rows, cells)

    of_class = np.repeat(sums(kind, CLASS_COUNT)[1], FAMILIES, axis=0)
    count, own = sums(kind * FAMILIES + family, CLASS_COUNT * FAMILIES)
    return np.asarray((count * own + PRIOR * of_class) / (count + PRIOR))


class FamilyShares:
    """
    Who counts how much of a path, by its family.

    Parameters
    ----------
    shares : (CLASS_COUNT · FAMILIES, c) float64
        Of rays with the light.
    has_optics : bool
        Whether light must pass a lens or a mirror to be part of the direct image.
    """

    def __init__(self, shares: np.ndarray, has_optics: bool) -> None:
        self._shares, self._cells = upload(mi.Float, shares.ravel()), dr.opaque(mi.UInt32, shares.shape[1])
        self._has_optics = has_optics

    def against(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> PathShares:
        """See `mistray.recorders.weighing.Weighing`."""
        family = family_of(departure.event, departure.length, departure.start, active)
        return self._of(class_of_departure(departure, self._has_optics), family, cell, active)

    def along(self, visit: Visit) -> PathShares:
        """See `mistray.recorders.weighing.Weighing`."""
        assert visit.start.cell is not None
        family = family_of(visit.event, visit.depth, visit.start, visit.detected)
        return self._of(class_of_arrival(visit, self._has_optics), family, visit.start.cell, visit.detected)

    def _of(self, kind: mi.UInt32, family: mi.UInt32, cell: mi.UInt32, active: mi.Bool) -> PathShares:
        along = dr.gather(mi.Float, self._shares, (kind * FAMILIES + family) * self._cells + cell, active)
        return PathShares(along, 1 - along, mi.Float(0))
