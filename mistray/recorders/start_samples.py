"""Recorder of light that arrives, ray by ray: where it started with the light, and what it brings."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, fields, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import DirectionRecorder, class_of_arrival, class_of_departure
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.path_key import (
    COUNT_MASK,
    EVENT_BITS,
    EVENT_MASK,
    NO_EVENT,
    RANDOM_TRANSMITTED,
    family_of,
    mixed_word,
)
from mistray.recorders.recorder import Departure, Memory, Recorder, Visit
from mistray.recorders.start_rays import StartRays
from mistray.recorders.weighing import StartWeighing
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.upload import upload

SAMPLES = 1 << 20  # that are kept; more are counted only
WAYS = 256  # to a surface that are told apart; more share their numbers


def worth_row(surface: mi.UInt32, before: mi.UInt32, scatters: mi.UInt32) -> mi.UInt32:
    """
    Row of a surface in tables of (surfaces · `WAYS`,) numbers.

    The way there is the event before, or `NO_EVENT`, and the number of scatter events: light that comes to either face
    of a stop is told apart, and so is a reflection from light that goes through.
    """
    return surface * WAYS + mixed_word(before + scatters * 0x9E3779B1) % WAYS


@dataclass(frozen=True, eq=False)
class Samples:
    """
    Light that arrives.

    Attributes
    ----------
    lane, cell, kind, family : (s,) int
        Start ray, cell of directions, class of light and family of paths, see `mistray.recorders.path_key.family_of`.
    points : (s, 4) float64
        Starts with the light in the unit cube of the cell, see `mistray.sampling.plane_wave.wave_rays`.
    weight : (s,) float64
        What counts of each, in units of a start ray.
    along, connected : (s,) float64
        Shares of its path, see `mistray.recorders.weighing.PathShares`.
    density : (s,) float64
        Of start rays with the light at the point.
    segments : (c,) float64
        Ray segments by the cell of their start rays; all in one number where rays go to all cells.
    worth : (4, n, WAYS) float64, optional
        By surface and way there, see `worth_row`: weight that arrives, its squares, what follows from it, and the
        squares of that; of a trace against the light.
    """

    lane: np.ndarray
    cell: np.ndarray
    kind: np.ndarray
    family: np.ndarray
    points: np.ndarray
    weight: np.ndarray
    along: np.ndarray
    connected: np.ndarray
    density: np.ndarray
    segments: np.ndarray
    worth: np.ndarray | None = None

    def times(self, unit: np.ndarray) -> Samples:
        """Those of weights in other units, by cell."""
        return replace(self, weight=self.weight * unit[self.cell])

    @classmethod
    def together(cls, parts: Sequence[Samples], lanes: int) -> Samples:
        """Those of several passes of so many start rays, in units of one of them all."""
        if len(parts) == 1:
            return parts[0]
        columns = {f.name: [getattr(one, f.name) for one in parts] for f in fields(cls)}
        columns["lane"] = [lane + k * lanes for k, lane in enumerate(columns["lane"])]
        sums = {name: sum(columns.pop(name)[1:], start=getattr(parts[0], name)) for name in ("segments", "worth")}
        return cls(**{name: np.concatenate(values) for name, values in columns.items()}, **sums)


class _StartSamples(Recorder):
    """What both directions have in common."""

    by_way = True

    def __init__(self, cells: int, design: DesignKeys, weighing: StartWeighing, capacity: int = SAMPLES) -> None:
        self._design, self._weighing, self._capacity = design, weighing, capacity
        self._count = dr.zeros(mi.UInt32, 1)
        self._words = [dr.empty(mi.UInt32, capacity) for _ in range(4)]
        self._floats = [dr.empty(mi.Float, capacity) for _ in range(8)]
        self._segments = dr.zeros(mi.Float64, cells)
        dr.eval(self._count, self._words, self._floats, self._segments)

    @property
    def code(self) -> Hashable:
        """See `Recorder.code`."""
        return type(self).__name__, self._design.code

    def _keep(self, words: tuple[mi.UInt32, ...], floats: tuple[mi.Float, ...], active: mi.Bool) -> None:
        place = dr.scatter_inc(self._count, mi.UInt32(0), active)
        active &= place < self._capacity
        for array, value in zip((*self._words, *self._floats), (*words, *floats), strict=True):
            dr.scatter(array, value, place, active)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """Count segments."""
        cell = mi.UInt32(0) if start.cell is None else start.cell
        dr.scatter_reduce(dr.ReduceOp.Add, self._segments, mi.Float64(segments), cell, active)

    def read(self) -> Samples:
        """The samples on the host; of more than there is room for, those that came first stand for all."""
        total = int(self._count[0])
        count = min(total, self._capacity)
        there = dr.arange(mi.UInt32, count)  # the rest has not been written
        words, floats = (
            [np.array(dr.gather(type(array), array, there)) for array in arrays]
            for arrays in (self._words, self._floats)
        )
        # Lanes come in any order; what follows from the samples shall be the same each time. Pairs of words sort fast
        x, y, u, _, brought, *_ = (values.view(np.uint32) for values in floats)
        pairs = (y, u), (brought, x), words[:2]  # the last one matters most
        order = np.lexsort([high.astype(np.uint64) << 32 | low for high, low in pairs])
        lane, cell, kind, family = (values[order].astype(np.int64) for values in words)
        *points, weight, along, connected, density = (values[order].astype(np.float64) for values in floats)
        places, segments = np.stack(points, axis=1), np.array(self._segments)
        weight *= total / max(count, 1)
        return Samples(lane, cell, kind, family, places, weight, along, connected, density, segments)


class DepartureSamples(_StartSamples):
    """
    Of a trace against the light: rays that leave the scene.

    Parameters
    ----------
    grid : DirectionGrid
    design : DesignKeys
    weighing : StartWeighing
    surfaces : int
    values : (c,) float64
        Of light of each cell, in what follows from the weight at a surface.
    capacity : int
        Samples that are kept; more are counted only.
    """

    def __init__(
        self,
        grid: DirectionGrid,
        design: DesignKeys,
        weighing: StartWeighing,
        surfaces: int,
        values: np.ndarray,
        capacity: int = SAMPLES,
    ) -> None:
        super().__init__(1, design, weighing, capacity)
        self._cells = DirectionRecorder(grid, design)
        self._values, self._surfaces = upload(mi.Float64, values), surfaces
        self._worth = [dr.zeros(mi.Float64, surfaces * WAYS) for _ in range(4)]
        dr.eval(self._worth)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add up what arrives where it may be scattered."""
        if visit.shares is None:
            return
        active = visit.active & (visit.shares.scattered > 0)
        row = worth_row(visit.surface, visit.before(active), visit.state["scatters"] & COUNT_MASK)
        weight = mi.Float64(visit.weight)
        dr.scatter_reduce(dr.ReduceOp.Add, self._worth[0], weight, row, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self._worth[1], weight * weight, row, active)

    def _add_worth(self, departure: Departure, worth: mi.Float64, active: mi.Bool) -> None:
        """Add up what follows from the weights at the scatter events of paths, but for those at points of light."""
        last = dr.full(mi.UInt32, NO_SURFACE, dr.width(active))
        if departure.joint is not None:
            last = dr.select(departure.joint != 0, (departure.scatters & COUNT_MASK) - 1, last)

        def on(
            k: mi.UInt32, before: mi.UInt32, order: mi.UInt32, going: mi.Bool
        ) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Bool]:
            code = departure.event(k, going)
            scattered = going & ((code & EVENT_MASK) >= RANDOM_TRANSMITTED)
            surface = code >> EVENT_BITS
            row = worth_row(surface, before, order)
            here = scattered & (order != last) & (surface < self._surfaces)
            dr.scatter_reduce(dr.ReduceOp.Add, self._worth[2], worth, row, here)
            dr.scatter_reduce(dr.ReduceOp.Add, self._worth[3], worth * worth, row, here)
            return k + 1, code, order + dr.select(scattered, mi.UInt32(1), 0), going & (k + 1 < departure.length)

        width = dr.width(active)
        going = active & (departure.length > 0) & (worth > 0)
        dr.while_loop(
            (dr.zeros(mi.UInt32, width), dr.full(mi.UInt32, NO_EVENT, width), dr.zeros(mi.UInt32, width), going),
            lambda k, before, order, going: going,
            on,
            mode="symbolic",
            label="worth",
        )

    def depart(self, departure: Departure, memory: Memory) -> None:
        """Keep rays that leave within a cell."""
        cell, inside = self._cells.cell(departure.heading)
        inside &= departure.active
        family = family_of(departure.event, departure.length, departure.start, inside)
        words = departure.start.lane, cell, class_of_departure(departure, self._design), family
        weight = departure.weight
        point = self._weighing.start_of(departure, cell, inside)
        shares = self._weighing.against(departure, cell, inside)
        density = self._weighing.density(cell, point, inside)
        floats = (*point, weight * shares.against, shares.along, shares.connected, density)
        self._keep(words, floats, inside & (shares.against > 0))
        value = dr.gather(mi.Float64, self._values, cell, inside)
        self._add_worth(departure, mi.Float64(weight * shares.against) * value, inside)

    def read(self) -> Samples:
        """See `_StartSamples.read`."""
        worth = np.array([np.array(one) for one in self._worth]).reshape(4, self._surfaces, WAYS)
        return replace(super().read(), worth=worth)


class ArrivalSamples(_StartSamples):
    """
    Of a trace with the light: rays that meet the detector.

    Parameters
    ----------
    cells, design, weighing
        See `mistray.recorders.arrivals.ArrivalRecorder`.
    scattered_only : bool
        Leave out light that nothing has scattered.
    """

    incident = True

    def __init__(self, cells: int, design: DesignKeys, weighing: StartWeighing, scattered_only: bool = False) -> None:
        super().__init__(cells, design, weighing)
        self._scattered_only = scattered_only

    @property
    def code(self) -> Hashable:
        """See `Recorder.code`."""
        return super().code, self._scattered_only

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Keep rays that have met the detector."""
        start, met = visit.start, visit.detected
        assert start.cell is not None
        assert start.place is not None
        assert start.scale is not None
        if self._scattered_only:
            met &= (visit.state["scatters"] & COUNT_MASK) != 0
        family = family_of(visit.event, visit.depth, start, met)
        words = start.lane, start.cell, class_of_arrival(visit, self._design), family
        shares = self._weighing.along(visit)
        density = dr.rcp(start.scale)
        floats = (*start.place, visit.weight * shares.along, shares.along, shares.connected, density)
        self._keep(words, floats, met)
