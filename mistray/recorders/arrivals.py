"""Recorder of forward traces from many cells of directions at once: rays that meet the detector, by cell."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import SINGLE, SkyContribution, SkyRecorder, class_of_arrival
from mistray.recorders.film import Film
from mistray.recorders.mis_weights import MisWeighting
from mistray.recorders.path_sums import PathSums
from mistray.recorders.recorder import Memory, Visit
from mistray.recorders.start_rays import StartRays


class ArrivalRecorder(SkyRecorder):
    """
    Recorder of forward rays that meet the detector: MIS-weighted throughput by class of light and start cell.

    Parameters
    ----------
    shape, design, mis, paths, derivative
        See `SkyRecorder`.
    film : Film, optional
        Pixel grid of a map of the detector for each cell; None: no maps.
    scattered_only : bool
        Leave out light that nothing has scattered.
    """

    incident = True

    kernel_by = (*SkyRecorder.kernel_by, "_scattered_only")

    def __init__(
        self,
        shape: tuple[int, int],
        design: DesignKeys,
        mis: MisWeighting | None,
        paths: PathSums | None = None,
        film: Film | None = None,
        scattered_only: bool = False,
        derivative: np.ndarray | None = None,
    ) -> None:
        super().__init__(shape, design, mis, paths, 0 if film is None else film.width * film.height, derivative)
        self._film, self._scattered_only = film, scattered_only
        self._segments = dr.zeros(mi.Float64, shape[0] * shape[1])
        dr.eval(self._segments)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add the contributions of rays that meet the detector to the sums of their classes and start cells."""
        pixel = None if self._film is None else self._film.places(*visit.position)[0][0]
        self.add(visit, self.contribution(visit), pixel)

    def contribution(self, end: Visit) -> SkyContribution:
        """Return the class of light, start cell and MIS-weighted throughput of rays that meet the detector."""
        cell, met, kind = end.start.cell, end.detected, class_of_arrival(end, self._design)
        assert cell is not None
        if self._scattered_only:
            met = met & (kind >= SINGLE)
        weight = end.weight if self._mis is None else end.weight * self._mis.forward(end).forward
        return SkyContribution(kind, cell, weight, met)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """Add the numbers of ray segments of complete trees to the start cells of their rays."""
        dr.scatter_reduce(dr.ReduceOp.Add, self._segments, mi.Float64(segments), start.cell, active)

    def read(self) -> dict[str, Any]:
        """Return sums by class and start cell, in units of a start ray's flux, and numbers of ``segments``, (n, m)."""
        return super().read() | {"segments": np.array(self._segments).reshape(self._shape)}
