"""
MIS weights that are constant over path classes, for derivatives with respect to parameters that move paths.

The weight of the balance heuristic differs from path to path, and changes as a path moves. A weight that all paths of a
class have in common is a constant. Each direction then estimates the derivative of its part by itself, however the
paths move.

The sum of two independent estimates with the weights w and 1 - w has the least variance at w = V_1/(V_0 + V_1). Each is
then weighted by its inverse variance. Here w and V_0 belong to forward rays (`forward`), and V_1 to backward rays
(`backward`).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import CLASS_COUNT, MisWeights, class_of_light
from mistray.recorders.path_key import PATH_CLASSES, path_class_of
from mistray.recorders.recorder import Departure, Visit
from mistray.surfaces.upload import upload

PRIOR = 4.0  # weight of the class of light in the estimate for a path class, in samples
UNKNOWN = 0.5  # MIS weight in a class of light without samples


@dataclass(frozen=True, eq=False)
class PathClassVariances:
    """
    Variances of the light of each path class and cell, from forward rays alone and from backward rays alone.

    They are sums of squared contributions to PST_normal, dimensionless.

    Attributes
    ----------
    cells : int
        Number of cells.
    place : (k,) int
        Row of each path class with samples: (class of light · `PATH_CLASSES` + path class) · cells + cell.
    count, backward, forward : (k,) float64
        Number of samples, and variances of the sums of backward and of forward rays alone.
    """

    cells: int
    place: np.ndarray
    count: np.ndarray
    backward: np.ndarray
    forward: np.ndarray

    @classmethod
    def of(
        cls, cells: int, place: tuple[np.ndarray, np.ndarray, np.ndarray], weight: np.ndarray, forward: np.ndarray
    ) -> PathClassVariances:
        """
        Return the variances estimated from samples of rays of both directions.

        Samples are f/q with the density q of all rays, to which forward rays contribute the fraction s. Forward rays
        alone then have the variance ∑ (f/q)²/s, and backward rays alone ∑ (f/q)²/(1 - s).

        Parameters
        ----------
        cells : int
            Number of cells.
        place : tuple of (s,) int
            Indices of the cell, the class of light and the path class.
        weight, forward : (s,) float64
            f/q; and s, above 0 and below 1.
        """
        cell, kind, path_class = place
        found, number = np.unique((kind * PATH_CLASSES + path_class) * cells + cell, return_inverse=True)
        count = np.bincount(number, minlength=len(found)).astype(np.float64)
        parts = (np.bincount(number, weight**2 / part, len(found)) for part in (1 - forward, forward))
        return cls(cells, found, count, *parts)

    def mis_weights(self) -> np.ndarray:
        """
        Return the MIS weights of forward rays, by class and cell, that minimise the variance of the sum of both parts.

        Each part is weighted by its inverse variance. The fewer samples a path class has, the closer its weight is to
        that of its class of light; without samples of this, the weight is `UNKNOWN`.

        Returns
        -------
        (CLASS_COUNT, PATH_CLASSES, cells) float32
            MIS weights of forward rays, 0 … 1.
        """
        # Weight of each class of light, also for path classes without samples
        kind, cell = self.place // (PATH_CLASSES * self.cells), self.place % self.cells
        of_class = np.full((CLASS_COUNT, self.cells), UNKNOWN)
        sums = np.zeros((2, CLASS_COUNT, self.cells))
        for total, part in zip(sums, (self.backward, self.forward), strict=True):
            np.add.at(total, (kind, cell), part)
        np.divide(sums[0], sums.sum(axis=0), out=of_class, where=sums.sum(axis=0) > 0)
        found = np.repeat(of_class[:, None].astype(np.float32), PATH_CLASSES, axis=1)
        # Own weight of path classes with samples, with `PRIOR` samples of the class of light
        own = self.backward / (self.backward + self.forward)
        mixed = (self.count * own + PRIOR * of_class[kind, cell]) / (self.count + PRIOR)
        found.ravel()[self.place] = mixed
        return found


class PathClassWeights:
    """
    MIS weights that are the same for all paths of a path class and cell.

    Parameters
    ----------
    weights : (CLASS_COUNT, PATH_CLASSES, c) float32
        MIS weights of forward rays, see `PathClassVariances.mis_weights`.
    design : DesignKeys
        Design sequences, which form the direct image.
    """

    def __init__(self, weights: np.ndarray, design: DesignKeys) -> None:
        self._weights, self._cells = upload(mi.Float, weights.ravel()), dr.opaque(mi.UInt32, weights.shape[-1])
        self._design = design

    def backward(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> MisWeights:
        """Return the MIS weights, 0 … 1, of backward rays that leave within a cell, by the class of their path."""
        path_class = path_class_of(departure.event, departure.length, departure.start, active)
        return self._of(class_of_light(departure, self._design), path_class, cell, active)

    def forward(self, visit: Visit) -> MisWeights:
        """Return the MIS weights, 0 … 1, of forward rays that meet the detector, by the class of their path."""
        assert visit.start.cell is not None
        path_class = path_class_of(visit.event, visit.depth, visit.start, visit.detected)
        return self._of(class_of_light(visit, self._design), path_class, visit.start.cell, visit.detected)

    def _of(self, kind: mi.UInt32, path_class: mi.UInt32, cell: mi.UInt32, active: mi.Bool) -> MisWeights:
        # No connections: they would be a third part
        forward = dr.gather(mi.Float, self._weights, (kind * PATH_CLASSES + path_class) * self._cells + cell, active)
        return MisWeights(forward, 1 - forward, mi.Float(0))
