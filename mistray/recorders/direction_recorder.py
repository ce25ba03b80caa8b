"""Recorder of backward traces: rays that leave the scene, by the direction that the light on their paths comes from."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.mis_weights import MisWeighting
from mistray.recorders.path_key import COUNT_MASK, NOT_DIFFRACTED
from mistray.recorders.path_sums import PathSums
from mistray.recorders.recorder import Departure, Memory, Recorder, Visit
from mistray.settings import BATCHES
from mistray.surfaces.upload import upload

# Classes of the light, in the order of their sums
CLASSES = ("direct", "straight_shot", "ghost", "single_scatter", "multiple_scatter", "edge_diffraction")
CLASS_COUNT = len(CLASSES)
DIRECT, STRAIGHT, GHOST, SINGLE, MULTIPLE, DIFFRACTED = range(CLASS_COUNT)
FAR_SIDE = 2.0  # more than any squared sine, so that the last cell includes 90°


def class_of_light(design: mi.Bool, reflections: mi.UInt32, scatters: mi.UInt32) -> mi.UInt32:
    """
    Return the class of light by its events, a number within `CLASSES`.

    Parameters
    ----------
    design : mi.Bool
        Whether its events are a sequence of the design.
    reflections, scatters : mi.UInt32
        Counted reflections, and scatter events (see `mistray.recorders.path_key.COUNT_MASK`).
    """
    stray = dr.select(reflections > 0, mi.UInt32(GHOST), mi.UInt32(STRAIGHT))
    unscattered = dr.select(design, mi.UInt32(DIRECT), stray)
    count = scatters & COUNT_MASK
    scattered = dr.select(count == 1, mi.UInt32(SINGLE), mi.UInt32(MULTIPLE))
    scattered = dr.select((scatters & NOT_DIFFRACTED) == 0, mi.UInt32(DIFFRACTED), scattered)
    return dr.select(count == 0, unscattered, scattered)


def class_of_departure(departure: Departure, design: DesignKeys) -> mi.UInt32:
    """Return the class of light of backward rays that leave the scene."""
    return class_of_light(design.hold(departure.key, True), departure.reflections, departure.scatters)


def class_of_arrival(visit: Visit, design: DesignKeys) -> mi.UInt32:
    """Return the class of light of forward rays that meet the detector."""
    state = visit.state
    return class_of_light(design.hold(state["key"], False), state["reflections"], state["scatters"])


class DirectionRecorder(Recorder):
    """
    Sums of the contributions of backward rays that leave the scene, by class of light and cell.

    Parameters
    ----------
    grid : DirectionGrid
    design : DesignKeys
        The sequences of the direct image.
    pixels : int
        Pixels of a map of the detector for every cell; 0: no maps.
    paths : PathSums, optional
    derivative : (CLASS_COUNT, n, m) float64, optional
        Derivative of a metric by the sum of the contributions of each class in each cell, for `gain`.
    mis : MisWeighting, optional
        MIS weights of backward rays, which compete with forward rays; without it, all weights are 1.
    """

    def __init__(
        self,
        grid: DirectionGrid,
        design: DesignKeys,
        pixels: int = 0,
        paths: PathSums | None = None,
        derivative: np.ndarray | None = None,
        mis: MisWeighting | None = None,
    ) -> None:
        self._mis = mis
        self._design = design
        self._derivative = None if derivative is None else upload(mi.Float64, np.asarray(derivative, dtype=np.float64))
        self.grid, self.pixels, self.paths = grid, pixels, paths
        self._angles, self._azimuths = grid.shape
        self.cells = self._angles * self._azimuths
        low, high = np.sin(np.radians(grid.edges_deg)).T ** 2
        # Upper borders are exclusive, but 90° belongs to the cell that ends there
        self._low = upload(mi.Float, low)
        self._high = upload(mi.Float, np.where(high >= 1, FAR_SIDE, high))
        self._azimuth = upload(mi.Float, grid.azimuths_deg)
        self._half = dr.opaque(mi.Float, grid.azimuth_cell_deg / 2)
        self._rows = [mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in column)) for column in grid.rotation.T]
        self.sums = dr.zeros(mi.Float64, CLASS_COUNT * self.cells * BATCHES)
        self.elsewhere = dr.zeros(mi.Float64, BATCHES)
        self.largest = dr.zeros(mi.UInt32, self.cells)  # bits of the largest contribution of a scattered ray
        self.maps = dr.zeros(mi.Float64, 2 * self.cells * pixels) if pixels else None
        dr.eval(self.sums, self.elsewhere, self.largest, self.maps)

    merges_aimed = True

    @property
    def code(self) -> Hashable:
        """See `Recorder.code`."""
        parts = (self.maps, self.paths, self._mis, self._derivative)
        return type(self).__name__, self._design.code, *(part is not None for part in parts)

    def cell(self, d: mi.Vector3f) -> tuple[mi.UInt32, mi.Bool]:
        """Return the cell of the light whose backward rays leave along d, and whether there is one."""
        # Field angle: light travels along -d. sin² orders the angles of the front half space
        x, y, z = (-dr.dot(d, row) for row in self._rows)
        sine2 = dr.fma(x, x, y * y)
        index = mi.UInt32(dr.binary_search(0, self._angles - 1, lambda k: dr.gather(mi.Float, self._high, k) <= sine2))
        inside = (z >= 0) & (sine2 >= dr.gather(mi.Float, self._low, index))
        inside &= sine2 < dr.gather(mi.Float, self._high, index)
        if self.grid.azimuth_cell_deg == 360:
            return index, inside
        # Azimuth: the cells need not be evenly spaced, so the nearest is searched for
        azimuth = dr.atan2(-x, y) * (180 / dr.pi)

        # The number of azimuths is opaque, so that it makes no new kernel
        def nearer(k: mi.UInt32, best: mi.UInt32, least: mi.Float) -> tuple[mi.UInt32, mi.UInt32, mi.Float]:
            apart = azimuth - dr.gather(mi.Float, self._azimuth, k)
            apart = dr.abs(apart - 360 * dr.round(apart * (1 / 360)))
            return k + 1, dr.select(apart < least, k, best), dr.minimum(apart, least)

        width, count = dr.width(d), dr.opaque(mi.UInt32, self._azimuths)
        _, best, least = dr.while_loop(
            (dr.zeros(mi.UInt32, width), dr.zeros(mi.UInt32, width), dr.full(mi.Float, 360, width)),
            lambda k, best, least: k < count,
            nearer,
            mode="symbolic",
            label="azimuth",
        )
        return index * self._azimuths + best, inside & (least <= self._half)

    def depart(self, departure: Departure, memory: Memory) -> None:
        """Add rays that leave the scene."""
        start, weight, active = departure.start, departure.weight, departure.active
        cell, inside = self.cell(departure.heading)
        # Connected rays stand for light that other rays carry as well
        own = active if departure.light_vertex is None else active & (departure.light_vertex == 0)
        dr.scatter_reduce(dr.ReduceOp.Add, self.elsewhere, mi.Float64(weight), start.batch, own & ~inside)
        weight, inside = self._own(departure, cell, inside)
        w = mi.Float64(weight)
        place = (class_of_departure(departure, self._design) * self.cells + cell) * BATCHES + start.batch
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, w, place, inside)
        scattered = inside & ((departure.scatters & COUNT_MASK) > 0)
        # The bits of positive floats are in the order of the floats
        dr.scatter_reduce(dr.ReduceOp.Max, self.largest, dr.reinterpret_array(mi.UInt32, weight), cell, scattered)
        if self.maps is not None:
            place = 2 * (cell * self.pixels + start.pixel)
            for k, value in enumerate((w, w * w)):
                dr.scatter_reduce(dr.ReduceOp.Add, self.maps, value, place + k, inside)
        if self.paths is not None:
            self.paths.record(departure.key, departure.length, departure.event, cell, weight, inside)

    def gain(self, departure: Departure) -> mi.Float64:
        """Return the gain of the metric from rays that leave; nothing is added to the sums."""
        cell, inside = self.cell(departure.heading)
        index = class_of_departure(departure, self._design) * self.cells + cell
        weight, inside = self._own(departure, cell, inside)
        gained = mi.Float64(weight) * dr.gather(mi.Float64, self._derivative, index, inside)
        return dr.select(inside, gained, 0)

    def _own(self, departure: Departure, cell: mi.UInt32, inside: mi.Bool) -> tuple[mi.Float, mi.Bool]:
        """Return the contribution of rays that leave within a cell, and whether there is any."""
        inside = inside & departure.active
        if self._mis is None:
            return departure.weight, inside
        share = self._mis.backward(departure, cell, inside).backward
        return departure.weight * share, inside & (share > 0)

    def read(self) -> dict[str, Any]:
        """
        Return the sums on the host.

        Returns
        -------
        dict
            ``cells`` (CLASS_COUNT, n, m, BATCHES), ``elsewhere`` (BATCHES,), ``largest`` (n, m), and ``maps`` (2, n, m,
            pixels) if there are any.
        """
        n, m = self.grid.shape
        found = {
            "cells": np.array(self.sums).reshape(CLASS_COUNT, n, m, BATCHES),
            "elsewhere": np.array(self.elsewhere),
            "largest": np.array(self.largest).view(np.float32).astype(np.float64).reshape(n, m),
        }
        if self.maps is not None:
            found["maps"] = np.moveaxis(np.array(self.maps).reshape(n, m, self.pixels, 2), 3, 0)
        return found
