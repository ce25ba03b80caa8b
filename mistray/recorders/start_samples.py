"""
Samples of the light that reaches the detector: its contribution, and the start point of a forward ray on its path.

Start maps are learned from these samples, and weight windows from the importance that is summed beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import DirectionRecorder, MisWeighting, class_of_light
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.importance import ImportanceSums
from mistray.recorders.path_key import COUNT_MASK, path_class_of
from mistray.recorders.path_sums import REDUCE
from mistray.recorders.recorder import Departure, Memory, Recorder, Visit
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.upload import upload

SAMPLES = 1 << 20  # most samples that are kept; more are counted only


@dataclass(frozen=True, eq=False)
class Samples:
    """
    Samples of light that reaches the detector, one for each contributing ray of a forward or backward trace.

    Attributes
    ----------
    lane, cell, kind, path_class : (s,) int
        Indices of the start ray, the cell of directions, the class of light and the path class, see
        `mistray.recorders.path_key.path_class_of`.
    points : (s, 4) float64
        Start points of forward rays in the unit cube of the cell, see `mistray.sampling.plane_wave.wave_rays`.
    weight : (s,) float64
        Throughput times MIS weight of each sample, in units of a start ray's flux.
    forward, connected : (s,) float64
        MIS weights of forward rays and of connections on its path, see
        `mistray.recorders.direction_recorder.MisWeights`.
    density : (s,) float64
        Density of forward start rays at the point, relative to its mean.
    ends : (s, 4) float64
        Start points of backward rays in the unit cube of the detector, see
        `mistray.sampling.detector_start.DetectorStart.place`.
    start_weight : (s,) float64
        Weight with which a backward ray would start there, the inverse of its density.
    segments : (c,) float64
        Number of ray segments by the cell of their start rays; in a backward trace one number for all cells.
    importance : (3, 2, n, WAYS) float64
        Sums by row, see `mistray.recorders.importance.ImportanceSums.read`.
    """

    lane: np.ndarray
    cell: np.ndarray
    kind: np.ndarray
    path_class: np.ndarray
    points: np.ndarray
    weight: np.ndarray
    forward: np.ndarray
    connected: np.ndarray
    density: np.ndarray
    ends: np.ndarray
    start_weight: np.ndarray
    segments: np.ndarray
    importance: np.ndarray

    def times(self, unit: np.ndarray) -> Samples:
        """Return the samples with each weight multiplied by the factor of its cell of directions, `unit` (c,)."""
        return replace(self, weight=self.weight * unit[self.cell])

    @classmethod
    def together(cls, parts: Sequence[Samples], lanes: int) -> Samples:
        """Return the samples of several passes as one, of `lanes` start rays each; all weights have the same unit."""
        if len(parts) == 1:
            return parts[0]
        columns = {f.name: [getattr(one, f.name) for one in parts] for f in fields(cls)}
        # Start rays are numbered through over the passes
        columns["lane"] = [lane + k * lanes for k, lane in enumerate(columns["lane"])]
        sums = {name: sum(columns.pop(name)[1:], start=getattr(parts[0], name)) for name in ("segments", "importance")}
        return cls(**{name: np.concatenate(values) for name, values in columns.items()}, **sums)


class _StartSamples(Recorder):
    """
    Base class of recorders that append samples of forward or backward rays to a buffer on the device.

    Parameters
    ----------
    cells : int
        Number of sums of ray segments: one for each start cell, or 1.
    design, mis
        Sequences of the direct image, and MIS weights, as for `SkyRecorder`.
    surfaces : int
        Number of surfaces.
    values : (c,) float64
        Value of a unit of contribution in each cell of directions, for the importance.
    capacity : int
        Largest number of samples that are kept.
    """

    merges_aimed = True

    kernel_by: ClassVar[tuple[str, ...]] = ("_design",)

    def __init__(
        self,
        cells: int,
        design: DesignKeys,
        mis: MisWeighting,
        surfaces: int,
        values: np.ndarray,
        capacity: int = SAMPLES,
    ) -> None:
        self._design, self._mis, self._capacity = design, mis, capacity
        self._importance, self._values = ImportanceSums(surfaces), upload(mi.Float64, values)
        self._count = dr.zeros(mi.UInt32, 1)
        self._words = [dr.empty(mi.UInt32, capacity) for _ in range(4)]
        self._floats = [dr.empty(mi.Float, capacity) for _ in range(13)]
        self._segments = dr.zeros(mi.Float64, cells)
        dr.make_opaque(self._count, self._words, self._floats, self._segments)

    @property
    def by_ray(self) -> bool:
        """False: a lane may trace several start rays, since each writes its places before it reads them."""
        return False

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """Allocate memory for the places of the events on the path of a lane."""
        self._importance.begin(max_events, memory)

    def _keep(self, words: tuple[mi.UInt32, ...], floats: tuple[mi.Float | None, ...], active: mi.Bool) -> None:
        place = dr.scatter_inc(self._count, mi.UInt32(0), active)
        # Not in place: the caller's mask also counts rays beyond the capacity
        active = active & (place < self._capacity)
        for array, value in zip((*self._words, *self._floats), (*words, *floats), strict=True):
            dr.scatter(array, value, place, active)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """Add the number of ray segments of each complete tree to the start cell of its ray, or to one sum."""
        cell = mi.UInt32(0) if start.cell is None else start.cell
        dr.scatter_reduce(dr.ReduceOp.Add, self._segments, mi.Float64(segments), cell, active, REDUCE)

    def read(self) -> Samples:
        """Return the samples on the host; if there were more than fit, the weights of those kept are scaled up."""
        total = int(self._count[0])
        count = min(total, self._capacity)
        there = dr.arange(mi.UInt32, count)  # the rest of the buffer has not been written
        words, floats = (
            [np.array(dr.gather(type(array), array, there)) for array in arrays]
            for arrays in (self._words, self._floats)
        )
        # Lanes append in any order; sorting makes all later steps reproducible. Pairs of words sort fast
        x, y, u, _, brought, *_ = (values.view(np.uint32) for values in floats)
        pairs = (y, u), (brought, x), words[:2]  # the last one matters most
        order = np.lexsort([high.astype(np.uint64) << 32 | low for high, low in pairs])
        lane, cell, kind, path_class = (values[order].astype(np.int64) for values in words)
        numbers = [values[order].astype(np.float64) for values in floats]
        places, ends = np.stack(numbers[:4], axis=1), np.stack(numbers[8:12], axis=1)
        weight, forward, connected, density = numbers[4:8]
        weight *= total / max(count, 1)
        segments = np.array(self._segments)
        return Samples(
            *(lane, cell, kind, path_class, places, weight, forward, connected, density, ends, numbers[12], segments),
            importance=self._importance.read(),
        )


class DepartureSamples(_StartSamples):
    """
    Recorder of samples of backward rays that leave the scene, and of the importance of surfaces.

    Parameters
    ----------
    grid : DirectionGrid
        Cells of directions.
    design, mis, surfaces, values, capacity
        See `_StartSamples`.
    """

    def __init__(self, grid: DirectionGrid, *arguments: Any, **options: Any) -> None:
        super().__init__(1, *arguments, **options)
        self._cells = DirectionRecorder(grid, self._design)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add each ray's throughput at a scattering surface to the importance sums."""
        self._importance.arrive(visit, mi.Float64(visit.weight), memory)

    def depart(self, departure: Departure, memory: Memory) -> None:
        """Keep samples of rays that leave within a cell, and add their contribution to the importance sums."""
        cell, inside = self._cells.cell(departure.heading)
        inside &= departure.active
        path_class = path_class_of(departure.event, departure.length, departure.start, inside)
        words = departure.start.lane, cell, class_of_light(departure, self._design), path_class
        # Contribution: throughput times the MIS weight of backward rays
        weight = departure.weight
        mis = self._mis.backward(departure, cell, inside)
        assert mis.place is not None
        assert mis.end is not None
        floats = (*mis.place, weight * mis.backward, mis.forward, mis.connected, mis.density, *mis.end)
        self._keep(words, floats, inside & (mis.backward > 0))
        value = mi.Float64(weight * mis.backward) * dr.gather(mi.Float64, self._values, cell, inside)
        contributes = inside & (value > 0)
        self._importance.contribute(departure, departure.length, value, mis.forward, contributes, memory)


class ArrivalSamples(_StartSamples):
    """
    Recorder of samples of forward rays that meet the detector.

    Parameters
    ----------
    cells : int
        Number of cells of directions.
    design, mis, surfaces, values, capacity
        See `_StartSamples`.
    scattered_only : bool
        Whether only samples of scattered light are kept.
    """

    incident = True

    kernel_by = ("_design", "_scattered_only")

    def __init__(self, *arguments: Any, scattered_only: bool = False, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._scattered_only = scattered_only

    def visit(self, visit: Visit, memory: Memory) -> None:
        """
        Keep samples of rays that meet the detector: start point, MIS-weighted throughput and start density.

        With `scattered_only`, rays that nothing has scattered are left out.
        """
        start, met = visit.start, visit.detected
        assert start.cell is not None
        assert start.place is not None
        value = dr.gather(mi.Float64, self._values, start.cell, visit.active)
        self._importance.arrive(visit, value * visit.weight, memory)
        if self._scattered_only:
            met = met & ((visit.state["scatters"] & COUNT_MASK) != 0)
        path_class = path_class_of(visit.event, visit.depth, start, met)
        words = start.lane, start.cell, class_of_light(visit, self._design), path_class
        mis = self._mis.forward(visit)
        assert mis.end is not None
        floats = (*start.place, visit.weight * mis.forward, mis.forward, mis.connected, mis.density, *mis.end)
        self._keep(words, floats, met)
        value *= mi.Float64(visit.weight * mis.forward)
        contributes = met & (value > 0)
        self._importance.contribute(visit, visit.depth, value, mis.forward, contributes, memory)
