"""
Shares of whole families of paths, for derivatives by what moves paths.

The balance heuristic gives each path a share of its own, which changes along a path that moves. A share of all paths of
a family is a constant. Each direction then finds the derivative of its part by itself, however paths move with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import CLASS_COUNT, class_of_arrival, class_of_departure
from mistray.recorders.path_key import FAMILIES, family_of
from mistray.recorders.recorder import Departure, Visit
from mistray.recorders.weighing import PathShares
from mistray.surfaces.upload import upload

PRIOR = 4.0  # samples of a family that count as much as its class
UNKNOWN = 0.5  # share of a class that no sample is of


@dataclass(frozen=True, eq=False)
class FamilyVariances:
    """
    How well rays of either direction find the families of paths by themselves.

    Attributes
    ----------
    cells : int
        Number of cells.
    place : (k,) int
        Of what has been seen: (class · `FAMILIES` + family) · cells + cell.
    count, against, along : (k,) float64
        Number of samples, and variances of the sums of rays of each direction alone.
    """

    cells: int
    place: np.ndarray
    count: np.ndarray
    against: np.ndarray
    along: np.ndarray

    @classmethod
    def of(
        cls, cells: int, place: tuple[np.ndarray, np.ndarray, np.ndarray], weight: np.ndarray, along: np.ndarray
    ) -> FamilyVariances:
        """
        From samples of rays of both directions.

        With samples f/q of the density q of all rays, and the share s of rays with the light in it, these alone have
        the variance ∑ (f/q)²/s, those against it ∑ (f/q)²/(1 - s).

        Parameters
        ----------
        cells : int
        place : tuple of (s,) int
            Cell, class and family.
        weight, along : (s,) float64
            f/q and s, between 0 and 1.
        """
        cell, kind, family = place
        found, number = np.unique((kind * FAMILIES + family) * cells + cell, return_inverse=True)
        count = np.bincount(number, minlength=len(found)).astype(np.float64)
        parts = (np.bincount(number, weight**2 / part, len(found)) for part in (1 - along, along))
        return cls(cells, found, count, *parts)

    def shares(self) -> np.ndarray:
        """
        Shares of rays with the light at which the variance of both parts together is least.

        Each part counts by the inverse of its variance; what has few samples counts as its class.

        Returns
        -------
        (CLASS_COUNT, FAMILIES, cells) float32
        """
        kind, cell = self.place // (FAMILIES * self.cells), self.place % self.cells
        of_class = np.full((CLASS_COUNT, self.cells), UNKNOWN)
        sums = np.zeros((2, CLASS_COUNT, self.cells))
        for total, part in zip(sums, (self.against, self.along), strict=True):
            np.add.at(total, (kind, cell), part)
        np.divide(sums[0], sums.sum(axis=0), out=of_class, where=sums.sum(axis=0) > 0)
        found = np.repeat(of_class[:, None].astype(np.float32), FAMILIES, axis=1)
        own = self.against / (self.against + self.along)
        mixed = (self.count * own + PRIOR * of_class[kind, cell]) / (self.count + PRIOR)
        found.ravel()[self.place] = mixed
        return found


class FamilyShares:
    """
    Who counts how much of a path, by its family.

    Parameters
    ----------
    shares : (CLASS_COUNT, FAMILIES, c) float32
        Of rays with the light, see `FamilyVariances.shares`.
    design : DesignKeys
        The sequences of the direct image.
    """

    def __init__(self, shares: np.ndarray, design: DesignKeys) -> None:
        self._shares, self._cells = upload(mi.Float, shares.ravel()), dr.opaque(mi.UInt32, shares.shape[-1])
        self._design = design

    def against(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> PathShares:
        """See `mistray.recorders.weighing.Weighing`."""
        family = family_of(departure.event, departure.length, departure.start, active)
        return self._of(class_of_departure(departure, self._design), family, cell, active)

    def along(self, visit: Visit) -> PathShares:
        """See `mistray.recorders.weighing.Weighing`."""
        assert visit.start.cell is not None
        family = family_of(visit.event, visit.depth, visit.start, visit.detected)
        return self._of(class_of_arrival(visit, self._design), family, visit.start.cell, visit.detected)

    def _of(self, kind: mi.UInt32, family: mi.UInt32, cell: mi.UInt32, active: mi.Bool) -> PathShares:
        along = dr.gather(mi.Float, self._shares, (kind * FAMILIES + family) * self._cells + cell, active)
        return PathShares(along, 1 - along, mi.Float(0))
