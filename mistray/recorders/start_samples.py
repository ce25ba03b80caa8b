"""
Samples of the light that reaches the detector: its contribution, and the start point of a forward ray on its path.

Start maps are learned from these samples, and weight windows from the importance that is summed beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.events import EVENT_BITS, EVENT_MASK, RANDOM_TRANSMITTED
from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import REDUCE, DirectionRecorder, MisWeighting, class_of_light
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.path_key import COUNT_MASK, NO_EVENT, mixed_word, path_class_of
from mistray.recorders.recorder import Departure, Memory, Recorder, Visit
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.upload import upload

SAMPLES = 1 << 20  # most samples that are kept; more are counted only
WAYS = 256  # approaches to a surface that are told apart by hashing; more of them share rows


def window_row(surface: mi.UInt32, before: mi.UInt32, scatters: mi.UInt32) -> mi.UInt32:
    """
    Return the row of a surface and approach in importance tables of (surfaces · `WAYS`,) entries, by hashing.

    The approach is the event before, or `NO_EVENT`, and the number of scatter events before the hit. So the two faces
    of a stop are distinguished, and reflection from transmission.
    """
    return surface * WAYS + mixed_word(before + scatters * 0x9E3779B1) % WAYS


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
        Throughput times MIS weight of each sample, in units of a start ray.
    forward, connected : (s,) float64
        MIS weights of its path, see `mistray.recorders.direction_recorder.MisWeights`.
    density : (s,) float64
        Density of forward start rays at the point, relative to its mean.
    ends : (s, 4) float64
        Start points of backward rays in the unit cube of the detector, see
        `mistray.sampling.detector_start.DetectorStart.place`.
    start_weight : (s,) float64
        Weight with which a backward ray would start there, the inverse of its density.
    segments : (c,) float64
        Number of ray segments by the cell of their start rays; in a backward trace one number for all cells.
    importance : (4, n, WAYS) float64, optional
        Sums by surface and approach, see `window_row`: throughput that arrives, its squares, the contribution that
        follows from it, and the squares of that. Weight windows follow from them. None: of a forward trace.
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
    importance: np.ndarray | None = None

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
    """Base class of recorders that append samples of forward or backward rays to a buffer on the device."""

    merges_aimed = True

    kernel_by: ClassVar[tuple[str, ...]] = ("_design",)

    def __init__(self, cells: int, design: DesignKeys, mis: MisWeighting, capacity: int = SAMPLES) -> None:
        self._design, self._mis, self._capacity = design, mis, capacity
        self._count = dr.zeros(mi.UInt32, 1)
        self._words = [dr.empty(mi.UInt32, capacity) for _ in range(4)]
        self._floats = [dr.empty(mi.Float, capacity) for _ in range(13)]
        self._segments = dr.zeros(mi.Float64, cells)
        dr.eval(self._count, self._words, self._floats, self._segments)

    def _keep(self, words: tuple[mi.UInt32, ...], floats: tuple[mi.Float | None, ...], active: mi.Bool) -> None:
        place = dr.scatter_inc(self._count, mi.UInt32(0), active)
        active &= place < self._capacity
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
            *(lane, cell, kind, path_class, places, weight, forward, connected, density, ends, numbers[12], segments)
        )


class DepartureSamples(_StartSamples):
    """
    Recorder of samples of backward rays that leave the scene, and of the importance of surfaces.

    Parameters
    ----------
    grid : DirectionGrid
        Cells of directions.
    design : DesignKeys
        Sequences of the direct image.
    mis : MisWeighting
        MIS weights of the paths.
    surfaces : int
        Number of surfaces.
    values : (c,) float64
        Value of a unit of contribution in each cell, for the importance of surfaces.
    capacity : int
        Most samples that are kept; more are counted only.
    """

    def __init__(
        self,
        grid: DirectionGrid,
        design: DesignKeys,
        mis: MisWeighting,
        surfaces: int,
        values: np.ndarray,
        capacity: int = SAMPLES,
    ) -> None:
        super().__init__(1, design, mis, capacity)
        self._cells = DirectionRecorder(grid, design)
        self._values, self._surfaces = upload(mi.Float64, values), surfaces
        self._importance = [dr.zeros(mi.Float64, surfaces * WAYS) for _ in range(4)]
        dr.eval(self._importance)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add each ray's throughput at a scattering surface, and its square, to sums by surface and approach."""
        if visit.shares is None:
            return
        active = visit.active & (visit.shares.scattered > 0)
        row = window_row(visit.surface, visit.before(active), visit.state["scatters"] & COUNT_MASK)
        weight = mi.Float64(visit.weight)
        dr.scatter_reduce(dr.ReduceOp.Add, self._importance[0], weight, row, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self._importance[1], weight * weight, row, active)

    def _add_importance(self, departure: Departure, importance: mi.Float64, active: mi.Bool) -> None:
        """Add each path's MIS-weighted throughput to the importance of its scatter events, except at light vertices."""
        # The last scatter event of a connected ray is at its light vertex
        last = dr.full(mi.UInt32, NO_SURFACE, dr.width(active))
        if departure.light_vertex is not None:
            last = dr.select(departure.light_vertex != 0, (departure.scatters & COUNT_MASK) - 1, last)

        # Walk the events from the start: `order` is the number of scatter events so far, as at the visits
        def on(
            k: mi.UInt32, before: mi.UInt32, order: mi.UInt32, going: mi.Bool
        ) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Bool]:
            code = departure.event(k, going)
            scattered = going & ((code & EVENT_MASK) >= RANDOM_TRANSMITTED)
            # Media scatter too, but have no rows
            surface = code >> EVENT_BITS
            row = window_row(surface, before, order)
            here = scattered & (order != last) & (surface < self._surfaces)
            dr.scatter_reduce(dr.ReduceOp.Add, self._importance[2], importance, row, here)
            dr.scatter_reduce(dr.ReduceOp.Add, self._importance[3], importance * importance, row, here)
            return k + 1, code, order + dr.select(scattered, mi.UInt32(1), 0), going & (k + 1 < departure.length)

        width = dr.width(active)
        going = active & (departure.length > 0) & (importance > 0)
        dr.while_loop(
            (dr.zeros(mi.UInt32, width), dr.full(mi.UInt32, NO_EVENT, width), dr.zeros(mi.UInt32, width), going),
            lambda k, before, order, going: going,
            on,
            mode="symbolic",
            label="importance",
        )

    def depart(self, departure: Departure, memory: Memory) -> None:
        """Keep samples of rays that leave within a cell, and add their throughput to the importance of surfaces."""
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
        value = dr.gather(mi.Float64, self._values, cell, inside)
        self._add_importance(departure, mi.Float64(weight * mis.backward) * value, inside)

    def read(self) -> Samples:
        """Return the samples on the host, with the sums of importance by surface and approach."""
        importance = np.array([np.array(one) for one in self._importance]).reshape(4, self._surfaces, WAYS)
        return replace(super().read(), importance=importance)


class ArrivalSamples(_StartSamples):
    """
    Recorder of samples of forward rays that meet the detector.

    Parameters
    ----------
    cells, design, mis
        See `mistray.recorders.direction_recorder.ArrivalRecorder`.
    scattered_only : bool
        Whether light that nothing has scattered is left out.
    """

    incident = True

    kernel_by = ("_design", "_scattered_only")

    def __init__(self, cells: int, design: DesignKeys, mis: MisWeighting, scattered_only: bool = False) -> None:
        super().__init__(cells, design, mis)
        self._scattered_only = scattered_only

    def visit(self, visit: Visit, memory: Memory) -> None:
        """
        Keep samples of rays that meet the detector: start point, MIS-weighted throughput and start density.

        With `scattered_only`, rays that nothing has scattered are left out.
        """
        start, met = visit.start, visit.detected
        assert start.cell is not None
        assert start.place is not None
        if self._scattered_only:
            met &= (visit.state["scatters"] & COUNT_MASK) != 0
        path_class = path_class_of(visit.event, visit.depth, start, met)
        words = start.lane, start.cell, class_of_light(visit, self._design), path_class
        mis = self._mis.forward(visit)
        assert mis.end is not None
        floats = (*start.place, visit.weight * mis.forward, mis.forward, mis.connected, mis.density, *mis.end)
        self._keep(words, floats, met)
