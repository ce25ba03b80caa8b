"""Recorders of whole rays, event by event from the source to the detector, to other surfaces or out of the scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.direction_recorder import SkyRecorder
from mistray.recorders.flux_maps.surface_maps import SurfaceMaps
from mistray.recorders.ledger import Ledger
from mistray.recorders.recorder import Departure, Memory, Recorder, Visit
from mistray.surfaces.upload import upload

NODE_FLOATS = 8  # floats of a node: point, direction of arrival, throughput, and the bits of the event code
WIDTH = 4  # floats that are written and read together: one store instead of four
VECTORS = NODE_FLOATS // WIDTH


@dataclass
class PathChoice:
    """
    Selection of some paths of a ledger, so that only rays on these paths are recorded.

    Attributes
    ----------
    ledger : Ledger
        Ledger that holds the paths.
    chosen : (capacity,) mi.UInt32
        1 for the slots of the chosen paths, 0 for all others.
    """

    ledger: Ledger
    chosen: mi.UInt32

    def holds(self, key: mi.UInt64, active: mi.Bool) -> mi.Bool:
        """Return a mask of lanes whose path, identified by its 64-bit key, is among the chosen paths."""
        slot, known = self.ledger.known(key, active)
        return known & (dr.gather(mi.UInt32, self.chosen, slot, known) != 0)


@dataclass
class Node:
    """
    One recorded event of each ray: point and direction of arrival, along the axes of the world, and event code.

    Attributes
    ----------
    p : mi.Vector3f
        Points relative to `SurfaceTable.centre`, mm.
    d : mi.Vector3f
        Unit directions of arrival.
    code : mi.UInt32
        Surface and kind of event, see `mistray.events`.
    """

    p: mi.Vector3f
    d: mi.Vector3f
    code: mi.UInt32


@dataclass
class BranchRecorder(Recorder):
    """
    Append buffer for whole branches: all nodes on the path to a leaf of the ray tree.

    Attributes
    ----------
    capacity : int
        Largest number of branches that are kept.
    max_events : int
        Largest number of events of a branch that is kept whole.
    choice : PathChoice or None
        Paths whose branches are recorded; None: all paths that reach the detector. A backward trace records every ray
        that leaves the scene and contributes.
    light : SkyRecorder or None
        Recorder whose gain selects and weights the rays that are recorded: rays that leave the scene, or that meet the
        detector, absorbed or not. None: rays that the detector absorbs are recorded.
    count : (1,) mi.UInt32
        Number of branches, including those beyond the capacity.
    lane, length : (capacity,) mi.UInt32
        Index of the start ray, and number of events, of each branch.
    nodes : (capacity, max_events, NODE_FLOATS) mi.Float
        Points relative to `SurfaceTable.centre` (mm), directions of arrival, throughputs, and the bits of the event
        codes, see `codes`.
    weight : (capacity,) mi.Float64
        Flux that meets the detector, in units of the start ray's; with `light` the gain, in the metric's unit.
    heading : (capacity, 3) mi.Float
        Unit directions of rays that leave the scene; without meaning for others.
    place : (capacity, 2) mi.Float
        Position x, y of hits in the detector's frame, mm; without meaning for rays that leave the scene.
    path : (capacity,) mi.UInt64
        Keys of the events, see `mistray.recorders.path_key.extend_key`.
    peak : (1,) mi.UInt32
        Largest flux of one ray at the detector, recorded or not, in units of the start ray's, as bits of a float32.
    """

    capacity: int
    max_events: int
    choice: PathChoice | None = None
    light: SkyRecorder | None = field(default=None, init=False)

    kernel_by: ClassVar[tuple[str, ...]] = ("choice", "light")
    node_floats = NODE_FLOATS - 1  # the tree keeps the codes apart

    def __post_init__(self) -> None:
        size = self.capacity * self.max_events
        self._stride = dr.opaque(mi.UInt32, self.max_events)
        self.count = dr.zeros(mi.UInt32, 1)
        self.lane = dr.zeros(mi.UInt32, self.capacity)
        self.length = dr.zeros(mi.UInt32, self.capacity)
        # Not cleared: the system would do so page by page, 0.5 s for 2^18 branches
        self.nodes = dr.empty(mi.Float, size * NODE_FLOATS)
        self.weight = dr.zeros(mi.Float64, self.capacity)
        self.heading = dr.zeros(mi.Float, 3 * self.capacity)
        self.place = dr.zeros(mi.Float, 2 * self.capacity)
        self.path = dr.zeros(mi.UInt64, self.capacity)
        self.peak = dr.zeros(mi.UInt32, 1)
        dr.make_opaque(self.count, self.lane, self.length, self.nodes, self.weight, self.heading, self.place)
        dr.make_opaque(self.path, self.peak)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """
        Record rays that the detector absorbs, on the chosen paths, and update the largest flux of a ray there.

        With `light` for the detector, rays whose gain is 0 are left out.
        """
        # The bits of positive floats are in the order of the floats
        bits = dr.reinterpret_array(mi.UInt32, visit.weight)
        dr.scatter_reduce(dr.ReduceOp.Max, self.peak, bits, mi.UInt32(0), visit.detected)
        # A ray without gain says nothing of the metric, and takes no room
        chosen = visit.detected if self.choice is None else self.choice.holds(visit.key, visit.detected)
        weight = mi.Float64(visit.weight)
        if self.light is not None and self.light.incident:
            weight = self.light.gain(visit)
            chosen = chosen & (weight != 0)
        self.write(visit, chosen & visit.counted, weight, place=visit.position)

    def depart(self, departure: Departure, memory: Memory) -> None:
        """
        Record rays that leave the scene after an event, with a gain (contribution to the metric) other than 0.

        This is done only with `light` for rays that leave the scene.
        """
        if self.light is not None and not self.light.incident:
            gained = self.light.gain(departure)
            self.write(departure, departure.after_event & (gained != 0), gained, departure.heading)

    def write(
        self,
        end: Visit | Departure,
        active: mi.Bool,
        weight: mi.Float64,
        heading: mi.Vector3f | None = None,
        place: tuple[mi.Float, mi.Float] | None = None,
    ) -> tuple[mi.UInt32, mi.Bool]:
        """
        Append branches to the buffer, node by node, as far as there is room.

        Parameters
        ----------
        end : Visit or Departure
            Rays that meet surfaces, or that leave after at least one event; the last node is theirs.
        active : mi.Bool
            Lanes whose branches are appended.
        weight : mi.Float64
            Flux or gain of each branch, see `BranchRecorder`.
        heading, place : optional
            Direction of departure, or position on the detector, mm, see `BranchRecorder`.

        Returns
        -------
        slot : mi.UInt32
            Slot of each branch.
        kept : mi.Bool
            True for active lanes whose branch found room; only their slots are valid.
        """
        # Claim a slot
        depth, last = end.depth, end.node
        assert last is not None
        slot = dr.scatter_inc(self.count, mi.UInt32(0), active)
        active = active & (slot < self.capacity)
        # Columns of the branch
        columns = (self.lane, end.start.lane), (self.length, depth + 1), (self.path, end.key), (self.weight, weight)
        for column, value in columns:
            dr.scatter(column, value, slot, active)
        for array, vector, size in ((self.heading, heading, 3), (self.place, place, 2)):
            for j, component in enumerate(vector if vector is not None else ()):
                dr.scatter(array, component, size * slot + j, active)

        # Nodes: the last one is not in local memory yet
        def step(k):  # type: ignore[no-untyped-def]
            going = active & (k <= depth)
            here = k == depth
            row = (slot * self.max_events + k) * VECTORS
            node = [dr.select(here, last[j], end.nodes[j].read(k, going & ~here)) for j in range(self.node_floats)]
            node.append(dr.reinterpret_array(mi.Float, end.event(k, going)))
            for j in range(0, NODE_FLOATS, WIDTH):
                dr.scatter(self.nodes, mi.Vector4f(*node[j : j + WIDTH]), row + j // WIDTH, going)
            return (k + 1,)

        dr.while_loop((dr.zeros(mi.UInt32, dr.width(depth)),), lambda k: active & (k <= depth), step, mode="symbolic")
        return slot, active

    def clear(self) -> None:
        """Discard all recorded branches, so that the buffer is empty."""
        self.count = dr.zeros(mi.UInt32, 1)
        dr.make_opaque(self.count)

    @property
    def kept(self) -> int:
        """Number of branches in the buffer, at most `capacity`."""
        return min(int(self.count[0]), self.capacity)

    def events(self, slots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the event codes of some recorded branches, and the number of events of each.

        Parameters
        ----------
        slots : (n,) int
            Slots of the branches in the buffer.

        Returns
        -------
        codes : (n, k) uint32
            Event lists, padded with 0 to the longest of them.
        lengths : (n,) int64
            Number of events of each.
        """
        lengths = self.length.numpy()[slots].astype(np.int64)
        codes = self.codes[slots, : int(lengths.max(initial=1))]
        return np.where(np.arange(codes.shape[1]) < lengths[:, None], codes, 0), lengths

    def node(self, slot: mi.UInt32, k: mi.UInt32, active: mi.Bool) -> Node:
        """Return event `k` of the recorded branches in the given slots, for active lanes; see `Node`."""
        row = (slot * self._stride + k) * VECTORS
        first, second = (dr.gather(mi.Vector4f, self.nodes, row + j, active) for j in range(VECTORS))
        code = dr.reinterpret_array(mi.UInt32, second.w)
        return Node(mi.Vector3f(first.x, first.y, first.z), mi.Vector3f(first.w, second.x, second.y), code)

    def event_code(self, slot: mi.UInt32, k: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return the code of event `k` of the recorded branches in the given slots, see `mistray.events`."""
        last = (slot * self._stride + k) * NODE_FLOATS + NODE_FLOATS - 1
        return dr.reinterpret_array(mi.UInt32, dr.gather(mi.Float, self.nodes, last, active))

    @property
    def codes(self) -> np.ndarray:
        """Event codes of all slots, (capacity, max_events) uint32: surface << EVENT_BITS | kind of event."""
        return np.asarray(self.nodes.numpy().view(np.uint32).reshape(self.capacity, -1, NODE_FLOATS)[..., -1])

    def nodes_of(self, slots: np.ndarray, longest: int) -> np.ndarray:
        """
        Return the first `longest` nodes of the branches in some slots; 0 beyond a branch's end.

        Returns
        -------
        (n, longest, NODE_FLOATS - 1) float64
            Point (3) relative to `SurfaceTable.centre`, mm, unit direction of arrival (3) and throughput at each node.
        """
        nodes = self.nodes.numpy().reshape(self.capacity, -1, NODE_FLOATS)[slots, :longest, :-1]
        inside = np.arange(longest) < self.length.numpy()[slots, None]
        return np.where(inside[:, :, None], nodes, 0).astype(np.float64)


@dataclass
class ElsewhereRecorder(BranchRecorder):
    """
    Recorder of rays up to each hit of chosen surfaces, or until they leave the scene.

    Attributes
    ----------
    surfaces : (s,) bool
        Surfaces whose hits are recorded, whether they absorb light or not.
    departs : bool
        Whether rays that leave the scene are recorded instead; rays that miss all surfaces have no event and are left
        out.
    """

    surfaces: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    departs: bool = False

    kernel_by = ("departs",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._chosen = upload(mi.UInt32, self.surfaces.astype(np.uint32))

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Record the rays that meet the chosen surfaces, with all events up to the hit; nothing if `departs` is set."""
        if not self.departs:
            here = visit.active & (dr.gather(mi.UInt32, self._chosen, visit.surface, visit.active) != 0)
            self.write(visit, here, mi.Float64(visit.weight))

    def depart(self, departure: Departure, memory: Memory) -> None:
        """Record rays that leave the scene after at least one event, if `departs` is set."""
        if self.departs:
            self.write(departure, departure.after_event, mi.Float64(departure.weight), departure.heading)


@dataclass
class CellRecorder(ElsewhereRecorder):
    """
    Recorder of rays up to each hit of mapped surfaces, with the map cell of the hit.

    Attributes
    ----------
    maps : SurfaceMaps
        Maps, already attached to the scene, whose surfaces are recorded.
    cell, batch : (capacity,) mi.UInt32
        Index of the cell in which the incident flux of a hit is summed, and batch of its start ray.
    absorbed : (capacity,) mi.Float64
        Flux that the surface absorbs, in units of the start ray's.
    """

    maps: SurfaceMaps = field(kw_only=True)

    kernel_by = ("maps",)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Columns beside those of the branches
        self.cell = dr.zeros(mi.UInt32, self.capacity)
        self.batch = dr.zeros(mi.UInt32, self.capacity)
        self.absorbed = dr.zeros(mi.Float64, self.capacity)
        dr.make_opaque(self.cell, self.batch, self.absorbed)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Record rays that meet mapped surfaces, with map cell, batch and absorbed flux (of a start ray's flux)."""
        # The cell is that of the incident flux; what is absorbed has its own
        cell, here = self.maps.cell(visit)
        slot, kept = self.write(visit, here, mi.Float64(visit.weight))
        dr.scatter(self.cell, cell, slot, kept)
        dr.scatter(self.batch, visit.start.batch, slot, kept)
        dr.scatter(self.absorbed, mi.Float64(dr.maximum(visit.absorbed, 0)), slot, kept)


def as_many(capacity: int, max_events: int) -> int:
    """
    Return the number of branches of `max_events` events that fit into the memory of `capacity` branches of 64 events.

    The number is at least 1 and at most `capacity`.
    """
    return max(1, capacity * 64 // max(max_events, 64))
