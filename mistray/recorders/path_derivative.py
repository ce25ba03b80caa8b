"""Derivatives of a metric with respect to the flux of detector hits, as functions of the hit's path and position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MOMENTS = 6  # coefficients of a path: 1, x, y, x², y², x y


@dataclass(frozen=True)
class HitDerivative:
    """
    Derivative of a metric with respect to the flux of a detector hit, as a function of the hit's path and position.

    Attributes
    ----------
    pixel : (maps, height, width) float64 or None
        Derivative with respect to the flux in each pixel, in the metric's unit per W, for one or more groups of paths;
        None: no part of the metric depends on the pixel.
    map_of_path : (paths,) int or None
        Index of the map that a path contributes to, -1: none; None: all hits contribute to map 0.
    path : (paths, MOMENTS) float64 or None
        For each path, in the order of `Trace.paths`, the coefficients of 1, x, y, x², y², x y (x and y in mm, in the
        detector's frame). Their sum is the derivative with respect to the flux of a hit at (x, y), in the metric's unit
        per W. None: no part of the metric depends on the path.
    """

    pixel: np.ndarray | None = None
    path: np.ndarray | None = None
    map_of_path: np.ndarray | None = None


@dataclass(frozen=True)
class PathDerivative:
    """
    Derivatives of a metric with respect to the flux of hits, in units of a start ray's, for each path of one run.

    Attributes
    ----------
    keys : (p,) uint64
        Keys of the paths, ascending.
    slots : (p,) int
        Slots of the paths in the ledger.
    coefficients : (p, MOMENTS) float64
        Coefficients as in `HitDerivative.path`, of the derivative with respect to the flux in units of a start ray's.
    maps : (p,) int
        Index of the map of each path, see `HitDerivative.map_of_path`.
    """

    keys: np.ndarray
    slots: np.ndarray
    coefficients: np.ndarray
    maps: np.ndarray

    @classmethod
    def of_paths(
        cls, keys: np.ndarray, slots: np.ndarray, coefficients: np.ndarray, maps: np.ndarray
    ) -> PathDerivative:
        """Create the metric's derivatives of one run from its paths in any order; they are sorted by key."""
        order = np.argsort(keys)
        return cls(keys[order], slots[order], coefficients[order], maps[order])

    def of(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the coefficients, (n, MOMENTS), and map indices, (n,), that give the derivative for path keys, (n,).

        For unknown keys the coefficients are 0 and the map index is -1.
        """
        found, maps = np.zeros((len(keys), MOMENTS)), np.full(len(keys), -1)
        if len(self.keys):
            # Keys above the largest one would be found behind the end
            place = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
            same = self.keys[place] == keys
            found[same], maps[same] = self.coefficients[place[same]], self.maps[place[same]]
        return found, maps
