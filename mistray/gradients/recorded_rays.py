"""Rays that are traced again in portions that fit into a recorder, and their records as input of path replay."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.recorders.branch_recorder import BranchRecorder, Node
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.upload import upload

ROOM = 0.7  # fraction of the capacity that the next portion should fill
GROWTH = 4  # of the number of rays from one portion to the next, at most

Trace = Callable[[StartRays, BranchRecorder], object]


class Portions:
    """
    Division of start rays into portions, sized so that the recorder has room for the records of each.

    Parameters
    ----------
    recorder : BranchRecorder
        Recorder that the portions must fit into.
    lanes : int
        Number of start rays of the first portion.
    too_many : str
        Message if a single start ray records more than there is room for, with {count} and {capacity}.
    """

    def __init__(self, recorder: BranchRecorder, lanes: int, too_many: str) -> None:
        self._recorder, self._lanes, self._too_many = recorder, max(1, lanes), too_many

    @classmethod
    def filling(cls, recorder: BranchRecorder, records: float, too_many: str) -> Portions:
        """Return portions that just fill the recorder, given the expected `records` per start ray; see the class."""
        return cls(recorder, int(ROOM * recorder.capacity / max(records, 1.0)), too_many)

    def of(
        self, start: StartRays, trace: Trace, most: Callable[[], int] | None = None
    ) -> Iterator[tuple[StartRays, int]]:
        """
        Yield portions of start rays, once traced, with the number of their records.

        The recorder holds these records until the next portion.

        Parameters
        ----------
        start : StartRays
            Start rays to divide.
        trace : callable
            Traces a portion of the start rays with the recorder, its second argument.
        most : callable, optional
            Returns an upper limit of the number of rays of the next portion; None: there is no such limit.

        Raises
        ------
        MistrayError
            If a single start ray has more records than the recorder has room for.
        """
        done, count, capacity = 0, dr.width(start.lane), self._recorder.capacity
        while done < count:
            here = min(self._lanes, count - done, *([most()] if most else []))
            part = start if here == count else start.take(dr.arange(mi.UInt32, here) + dr.opaque(mi.UInt32, done))
            self._recorder.clear()
            trace(part, self._recorder)
            recorded = int(self._recorder.count[0])
            # Overflow: nothing of the portion is used, and fewer rays are traced again
            self._lanes = max(1, min(GROWTH * self._lanes, int(here * ROOM * capacity / max(recorded, 1))))
            if recorded <= capacity:
                done += here
                yield part, recorded
            elif here == 1:
                raise MistrayError(self._too_many.format(count=recorded, capacity=capacity))


@dataclass
class RecordedRays:
    """
    Recorded rays of a portion, one lane each, with access to their events.

    Attributes
    ----------
    recorder : BranchRecorder
        Recorder that holds the events.
    row : mi.UInt32
        Row of each ray in the recorder.
    start : StartRays
        Start rays of the recorded portion.
    lane : mi.UInt32
        Index of each ray's start ray in `start`.
    o, d : mi.Vector3d
        Origins, mm, relative to the centre of the scene, and unit directions, along the axes of the world.
    batch, length : mi.UInt32
        Index of the start ray's batch, and number of events.
    longest : int
        Number of events of the longest ray.
    """

    recorder: BranchRecorder
    row: mi.UInt32
    start: StartRays
    lane: mi.UInt32
    o: mi.Vector3d
    d: mi.Vector3d
    batch: mi.UInt32
    length: mi.UInt32
    longest: int

    @classmethod
    def of(cls, recorder: BranchRecorder, start: StartRays, rows: np.ndarray) -> RecordedRays:
        """Return the recorded rays in given rows of a recorder, one lane per row; `start` is the traced portion."""
        row = upload(mi.UInt32, rows)
        lane = dr.gather(mi.UInt32, recorder.lane, row) - dr.opaque(mi.UInt32, int(start.lane[0]))
        length = dr.gather(mi.UInt32, recorder.length, row)
        o, d = (mi.Vector3d(dr.gather(mi.Vector3f, v, lane)) for v in (start.o, start.d))
        d = dr.normalize(d)
        batch = dr.gather(mi.UInt32, start.batch, lane)
        dr.eval(row, length, o, d, batch)
        return cls(recorder, row, start, lane, o, d, batch, length, max(1, int(dr.max(length)[0])))

    @property
    def weight(self) -> mi.Float64:
        """Recorded weights of the rays: flux at the end in units of the start ray's, or contribution to the metric."""
        return dr.gather(mi.Float64, self.recorder.weight, self.row)

    @property
    def place(self) -> list[mi.Float64]:
        """Recorded places x, y of the hits on the detector, mm, in its own frame."""
        return [mi.Float64(dr.gather(mi.Float, self.recorder.place, 2 * self.row + k)) for k in range(2)]

    @property
    def heading(self) -> mi.Vector3f:
        """Unit directions, in the world, in which the rays leave the scene."""
        return mi.Vector3f(*(dr.gather(mi.Float, self.recorder.heading, 3 * self.row + k) for k in range(3)))

    def node(self, k: mi.UInt32, active: mi.Bool) -> Node:
        """Return event `k` of each recorded ray, counted from 0 at the start, where `active`."""
        return self.recorder.node(self.row, k, active)
