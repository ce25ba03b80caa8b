"""Recorder of forward traces from many cells of directions at once: rays that meet the detector, by cell."""

from __future__ import annotations

from collections.abc import Hashable

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import CLASS_COUNT, class_of_arrival
from mistray.recorders.film import Film
from mistray.recorders.mis_weights import MisWeighting
from mistray.recorders.path_key import COUNT_MASK
from mistray.recorders.path_sums import PathSums
from mistray.recorders.recorder import Memory, Recorder, Visit
from mistray.recorders.start_rays import StartRays
from mistray.settings import BATCHES
from mistray.surfaces.upload import upload


class ArrivalRecorder(Recorder):
    """
    Sums of the contributions of rays that meet the detector, by class of light and cell.

    Parameters
    ----------
    cells : int
        Number of cells.
    design : DesignKeys
        The sequences of the direct image.
    mis : MisWeighting, optional
        MIS weights of forward rays, which compete with backward rays; without it, all weights are 1.
    paths : PathSums, optional
    film : Film, optional
        Pixel grid of a map of the detector for each cell; None: no maps.
    scattered_only : bool
        Leave out light that nothing has scattered.
    derivative : (CLASS_COUNT, cells) float64, optional
        Derivative of a metric by the sum of the contributions of each class in each cell, for `gain`.
    """

    merges_aimed, incident = True, True

    def __init__(
        self,
        cells: int,
        design: DesignKeys,
        mis: MisWeighting | None,
        paths: PathSums | None = None,
        film: Film | None = None,
        scattered_only: bool = False,
        derivative: np.ndarray | None = None,
    ) -> None:
        self._derivative = None if derivative is None else upload(mi.Float64, np.asarray(derivative, dtype=np.float64))
        self._cells, self._design, self._mis = cells, design, mis
        self.paths, self._film, self._scattered_only = paths, film, scattered_only
        self._pixels = pixels = 0 if film is None else film.width * film.height
        self._sums = dr.zeros(mi.Float64, CLASS_COUNT * cells * BATCHES)
        self._largest = dr.zeros(mi.UInt32, cells)  # bits of the largest contribution of a scattered ray
        self._maps = dr.zeros(mi.Float64, 2 * cells * pixels) if pixels else None
        self._segments = dr.zeros(mi.Float64, cells)
        dr.eval(self._sums, self._largest, self._maps, self._segments)

    @property
    def code(self) -> Hashable:
        """See `Recorder.code`."""
        parts = self._maps, self.paths, self._mis, self._derivative
        return type(self).__name__, self._design.code, self._scattered_only, *(part is not None for part in parts)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add rays that have met the detector."""
        state, cell, met = visit.state, visit.start.cell, visit.detected
        assert cell is not None
        if self._scattered_only:
            met &= (state["scatters"] & COUNT_MASK) != 0
        weight = self._contribution(visit)
        w = mi.Float64(weight)
        place = self._row(visit, cell) * BATCHES + visit.start.batch
        dr.scatter_reduce(dr.ReduceOp.Add, self._sums, w, place, met)
        # The bits of positive floats are in the order of the floats
        bits = dr.reinterpret_array(mi.UInt32, weight)
        dr.scatter_reduce(dr.ReduceOp.Max, self._largest, bits, cell, met & (state["scatters"] != 0))
        # Map of the cell: sum and sum of squares side by side in a pixel
        if self._maps is not None and self._film is not None:
            pixel = self._film.places(*visit.position)[0][0]
            place = 2 * (cell * self._pixels + pixel)
            for k, value in enumerate((w, w * w)):
                dr.scatter_reduce(dr.ReduceOp.Add, self._maps, value, place + k, met)
        if self.paths is not None:
            self.paths.record(visit.key, visit.depth + 1, visit.event, cell, weight, met)

    def gain(self, visit: Visit) -> mi.Float64:
        """Return the gain of the metric from rays that meet the detector; nothing is added to the sums."""
        cell, met = visit.start.cell, visit.detected
        assert cell is not None
        weight = mi.Float64(self._contribution(visit))
        return dr.select(met, weight * dr.gather(mi.Float64, self._derivative, self._row(visit, cell), met), 0)

    def _row(self, visit: Visit, cell: mi.UInt32) -> mi.UInt32:
        """Return the row of the sums of the class of light in a cell."""
        # The number of cells is opaque, so that it makes no new kernel
        return class_of_arrival(visit, self._design) * dr.opaque(mi.UInt32, self._cells) + cell

    def _contribution(self, visit: Visit) -> mi.Float:
        """Return the throughput times the MIS weight of forward rays."""
        return visit.weight if self._mis is None else visit.weight * self._mis.forward(visit).forward

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """Add up the segments."""
        dr.scatter_reduce(dr.ReduceOp.Add, self._segments, mi.Float64(segments), start.cell, active)

    def read(self) -> dict[str, np.ndarray]:
        """
        Return the sums on the host.

        Returns
        -------
        dict
            ``cells`` (CLASS_COUNT, cells, BATCHES), ``largest`` (cells,) and, if there are maps, ``maps`` (2, cells,
            pixels), in units of a start ray; ``segments`` (cells,), numbers of ray segments.
        """
        found = {
            "cells": np.array(self._sums).reshape(CLASS_COUNT, self._cells, BATCHES),
            "largest": np.array(self._largest).view(np.float32).astype(np.float64),
            "segments": np.array(self._segments),
        }
        if self._maps is not None:
            found["maps"] = np.moveaxis(np.array(self._maps).reshape(self._cells, self._pixels, 2), 2, 0)
        return found
