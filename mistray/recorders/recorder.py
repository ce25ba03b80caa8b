"""
Interface of the recorders: objects that sum, list or differentiate the events that the ray tree reports.

The tree depends on no particular recorder. It calls the same few methods of each, in the order in which they are given,
while its kernel is traced. A method that a recorder does not override costs nothing. A recorder keeps results in arrays
of its own, which it adds to with `dr.scatter_reduce` and the like. Its per-lane state between two steps lies in
`memory`, a dictionary of loop variables and local arrays that all recorders share.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from inspect import isfunction
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import mitsuba as mi

from mistray.recorders.path_key import NO_EVENT, EventReader
from mistray.recorders.start_rays import StartRays

if TYPE_CHECKING:
    from mistray.kernel.interaction import Interaction
    from mistray.kernel.kernel_scene import KernelScene
    from mistray.kernel.scatter_shares import ScatterBudget

Memory = dict[str, Any]


@dataclass
class Visit:
    """
    Arrivals of rays at surfaces, each at the first visit of a node of the ray tree.

    Attributes
    ----------
    start : StartRays
        Start rays of the lanes.
    state : dict
        Variables of the loop, see `mistray.kernel.ray_tree`.
    interaction : Interaction
        Interaction at the surface: R, T and geometry.
    shares : ScatterBudget or None
        Scattering shares of the surfaces; None: no surface scatters.
    visited : mi.Bool
        Lanes that visit a node for the first time, those of connected rays left out.
    active : mi.Bool
        Lanes among `visited` whose hits contribute: all but rays that are lost in a material that is not here.
    detected : mi.Bool
        Lanes among `active` whose surface is a detector; only where it absorbs light within the limits of the trace,
        unless a recorder is `incident`. None in a backward trace.
    counted : mi.Bool
        Lanes among `detected` whose hits later recorders record; a recorder may remove some.
    weight, absorbed : mi.Float
        Throughput on arrival, and the flux that is absorbed within the limits of the trace, both in units of a start
        ray's flux.
    loss : mi.Float
        Fraction of the throughput that the surface absorbs, whatever the limits.
    position : tuple of mi.Float
        Point in the frame of the film, mm; meant for hits of a detector.
    code, key : mi.UInt32, mi.UInt64
        Event code of the absorption here, and 64-bit key of the path that ends with it.
    codes : dr.Local
        Earlier events of the path, by depth.
    nodes : tuple of dr.Local
        Earlier nodes of the path, see `mistray.kernel.pending_nodes`.
    scatters : bool
        Whether anything in the scene scatters.
    slot : mi.UInt32 or None
        Slot of the path in the ledger; None: no ledger has looked it up yet.
    pdf_ratio : mi.Float or None
        pdf_rev/pdf_own of the path: backward rays that find it for each of these forward rays, see
        `mistray.kernel.pdf_ratios`; None: there are no MIS weights.
    connection_ratio : mi.Float or None
        Connections that find the path, per ray and per light vertex, see
        `mistray.kernel.pdf_ratios.PdfRatios.connection_ratios`; None: there are no connections.
    window_place : mi.UInt32 or None
        Part and side of the surface that is hit, see `mistray.recorders.importance.window_row`; None: there are no
        weight windows.

    Examples
    --------
    >>> import drjit as dr
    >>> import mitsuba as mi
    >>> class Hits(mistray.recorders.Recorder):
    ...     def attach(self, scene):
    ...         self.ids, self.count = scene.table.ids, dr.zeros(mi.UInt32, scene.table.count)
    ...     def visit(self, visit, memory):
    ...         dr.scatter_reduce(dr.ReduceOp.Add, self.count, mi.UInt32(1), visit.surface, visit.active)
    >>> hits = Hits()
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[hits])
    >>> hits.count[hits.ids.index("L1_front")] == t.surfaces[0].hits
    True
    """

    start: StartRays
    state: dict[str, Any]
    interaction: Interaction
    shares: ScatterBudget | None
    visited: mi.Bool
    active: mi.Bool
    detected: mi.Bool
    counted: mi.Bool
    weight: mi.Float
    absorbed: mi.Float
    loss: mi.Float
    position: tuple[mi.Float, mi.Float]
    code: mi.UInt32
    key: mi.UInt64
    codes: Any
    nodes: Any
    scatters: bool
    slot: mi.UInt32 | None = None
    pdf_ratio: mi.Float | None = None
    connection_ratio: mi.Float | None = None
    window_place: mi.UInt32 | None = None

    @property
    def surface(self) -> mi.UInt32:
        """Index of the surface that each ray meets."""
        return self.state["s"]

    @property
    def depth(self) -> mi.UInt32:
        """Number of events on the path before the hit."""
        return self.state["depth"]

    def event(self, k: mi.UInt32, mask: mi.Bool) -> mi.UInt32:
        """Return the code of event k of the path, from 0, in lanes of `mask`; the last one is the absorption here."""
        # The absorption is not in local memory, where this entry is for the event that sends a child on
        before = k < self.depth
        return dr.select(before, self.codes.read(k, mask & before), self.code)

    def before(self, mask: mi.Bool) -> mi.UInt32:
        """Return the code of the event before the hit, or `NO_EVENT` if the start ray itself hits."""
        # Rays that go on from within a tree have a start depth above 0; earlier events are not in local memory
        there = self.depth > self.start.given("depth", dr.zeros(mi.UInt32, dr.width(mask)))
        return dr.select(there, self.codes.read(dr.select(there, self.depth - 1, 0), mask & there), mi.UInt32(NO_EVENT))

    @property
    def node(self) -> Sequence[mi.Float]:
        """Last node of each path: hit, mm from `SurfaceTable.centre`, direction of arrival, and throughput there."""
        return (*self.interaction.p, *self.state["d"], self.weight)


@dataclass
class Branch:
    """
    Child rays that nodes of the ray tree send on: reflected, transmitted or scattered.

    Attributes
    ----------
    start : StartRays
        Start rays of the lanes.
    depth : mi.UInt32
        Depth of the node.
    interaction : Interaction
        Interaction at the node: R, T and geometry.
    place : mi.UInt32
        Index of the surface; of a medium that scatters, its position after all surfaces.
    reflect : mi.Bool
        Whether the ray stays on the side of incidence.
    aimed : mi.Bool or None
        Lanes that scattered towards a target, whether the ray has any flux or not; None: nothing scatters.
    slope : mi.Float
        d ln(throughput) / d(R or T).
    active : mi.Bool
        Lanes that send a child on.

    Examples
    --------
    >>> import drjit as dr
    >>> import mitsuba as mi
    >>> class Reflected(mistray.recorders.Recorder):
    ...     def attach(self, scene):
    ...         self.ids, self.count = scene.table.ids, dr.zeros(mi.UInt32, scene.table.count)
    ...     def branch(self, branch, memory):
    ...         sent = branch.active & branch.reflect
    ...         dr.scatter_reduce(dr.ReduceOp.Add, self.count, mi.UInt32(1), branch.place, sent)
    >>> reflected = Reflected()
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[reflected])
    >>> reflected.count[reflected.ids.index("detector")]
    10000
    """

    start: StartRays
    depth: mi.UInt32
    interaction: Interaction
    place: mi.UInt32
    reflect: mi.Bool
    aimed: mi.Bool | None
    slope: mi.Float
    active: mi.Bool


@dataclass
class Departure:
    """
    Rays that leave the scene, with the events, key and pdf ratios of their paths.

    Attributes
    ----------
    start : StartRays
        Start rays of the lanes.
    heading : mi.Vector3f
        Unit direction.
    weight : mi.Float
        Throughput, in units of a start ray's flux.
    reflections, scatters : mi.UInt32
        Counted reflections, and scatter events, see `mistray.recorders.path_key.COUNT_MASK`.
    key, length : mi.UInt64, mi.UInt32
        Key of the path, and the number of its events.
    event : callable
        Function that returns event k of the path, see `EventReader`.
    active : mi.Bool
        Lanes whose rays leave.
    nodes : tuple of dr.Local
        Nodes before the last, see `mistray.kernel.pending_nodes`.
    node : sequence of mi.Float
        The last node, see `Visit.node`; of rays that come straight from their start, this start.
    pdf_ratio : mi.Float or None
        pdf_rev/pdf_own of the path: forward rays that find it for each of these backward rays, see
        `mistray.kernel.pdf_ratios`; None: there are no MIS weights.
    connection_ratio : mi.Float or None
        Connections that find the path, per ray and per light vertex, see
        `mistray.kernel.pdf_ratios.PdfRatios.connection_ratios`; None: there are no connections.
    light_vertex : mi.UInt32 or None
        Index plus one of the light vertex that a ray was connected to, see `mistray.kernel.scatter_shares.CONNECTED`; 0
        for other rays. None: no ray is connected.

    Examples
    --------
    >>> import drjit as dr
    >>> import mitsuba as mi
    >>> class Backwards(mistray.recorders.Recorder):
    ...     departs = True
    ...     def attach(self, scene):
    ...         self.sum = dr.zeros(mi.Float64, 1)
    ...     def depart(self, departure, memory):
    ...         out = departure.active & (departure.heading.z < 0)
    ...         dr.scatter_reduce(dr.ReduceOp.Add, self.sum, mi.Float64(departure.weight), mi.UInt32(0), out)
    ...     def collect(self, unit):
    ...         self.flux_W = unit * self.sum[0]
    >>> backwards = Backwards()
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[backwards])
    >>> print(f"{backwards.flux_W:.2f} W of {t.energy.escaped_W:.2f} W leave towards the source")
    58.32 W of 58.32 W leave towards the source
    """

    start: StartRays
    heading: mi.Vector3f
    weight: mi.Float
    reflections: mi.UInt32
    scatters: mi.UInt32
    key: mi.UInt64
    length: mi.UInt32
    event: EventReader
    active: mi.Bool
    nodes: Any
    node: Sequence[mi.Float]
    pdf_ratio: mi.Float | None = None
    connection_ratio: mi.Float | None = None
    light_vertex: mi.UInt32 | None = None

    @property
    def depth(self) -> mi.UInt32:
        """Number of events on each path before its last node."""
        return self.length - 1

    @property
    def after_event(self) -> mi.Bool:
        """Mask of the rays that leave after at least one event."""
        return self.active & (self.length > self.start.given("depth", 0))


@dataclass
class Segment:
    """
    Ray segments from the source, or from a node of the ray tree, to the next surface or out of the scene.

    Attributes
    ----------
    start : StartRays
        Start rays of the lanes.
    origin : mi.Vector3f
        Start of the segment in the device's frame, see `mistray.surfaces.surfaces.SurfaceTable.centre`; mm.
    heading : mi.Vector3f
        Unit direction.
    flux : mi.Float
        Throughput at the origin, in units of a start ray's flux.
    medium : mi.UInt32
        Position of the material in `Optics.media`; 0: unknown.
    length : mi.Float
        Length to the next surface, mm; without meaning where the ray leaves.
    leaves : mi.Bool
        Whether the ray leaves the scene.
    active : mi.Bool
        Lanes that travel a segment.

    Examples
    --------
    >>> import drjit as dr
    >>> import mitsuba as mi
    >>> class Escaped(mistray.recorders.Recorder):
    ...     def attach(self, scene):
    ...         self.sum = dr.zeros(mi.Float64, 1)
    ...     def travel(self, segment, memory):
    ...         leaves = segment.active & segment.leaves
    ...         dr.scatter_reduce(dr.ReduceOp.Add, self.sum, mi.Float64(segment.flux), mi.UInt32(0), leaves)
    ...     def collect(self, unit):
    ...         self.flux_W = unit * self.sum[0]
    >>> escaped = Escaped()
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[escaped])
    >>> print(f"{escaped.flux_W:.2f} W, {t.energy.escaped_W:.2f} W by the ledger")
    58.32 W, 58.32 W by the ledger
    """

    start: StartRays
    origin: mi.Vector3f
    heading: mi.Vector3f
    flux: mi.Float
    medium: mi.UInt32
    length: mi.Float
    leaves: mi.Bool
    active: mi.Bool


@dataclass
class Return:
    """
    Returns of lanes to earlier nodes of the ray tree, once whole subtrees are complete.

    Attributes
    ----------
    start : StartRays
        Start rays of the lanes.
    depth : mi.UInt32
        Depth of the deepest node.
    last : mi.UInt32
        Depth of the node to which the lane comes back; 0 where its tree is complete.
    closed : mi.UInt32
        Depth of the first node to which the lane does not come back.
    active : mi.Bool
        Lanes whose branch has ended: they come back to a node, or their tree is complete.

    Examples
    --------
    >>> import drjit as dr
    >>> import mitsuba as mi
    >>> class Deepest(mistray.recorders.Recorder):
    ...     def attach(self, scene):
    ...         self.depth = dr.zeros(mi.UInt32, 1)
    ...     def back(self, back, memory):
    ...         dr.scatter_reduce(dr.ReduceOp.Max, self.depth, back.depth, mi.UInt32(0), back.active)
    >>> deepest = Deepest()
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[deepest])
    >>> deepest.depth[0]
    12
    """

    start: StartRays
    depth: mi.UInt32
    last: mi.UInt32
    closed: mi.UInt32
    active: mi.Bool


class Recorder:
    """
    Base class of recorders, which records nothing; recorders override the methods that they need.

    Attributes
    ----------
    node_floats : int
        Number of floats that the recorder reads of each node of a path: the first of point (3), direction of arrival
        (3) and throughput.
    merges_aimed : bool
        Whether paths count as one that differ only in how a direction was sampled, at random or aimed.
    incident : bool
        Whether hits contribute whose light the detector does not absorb.
    departs : bool
        Whether light that leaves the scene in a forward trace is reported to the recorder, too.
    name : str
        Name in a result; "": the recorder has no entry there.
    kernel_by : tuple of str
        Names of the attributes that the kernel depends on.

    Examples
    --------
    >>> import drjit as dr
    >>> import mitsuba as mi
    >>> class Steep(mistray.recorders.Recorder):
    ...     def attach(self, scene):
    ...         self.sum = dr.zeros(mi.Float64, 1)
    ...     def visit(self, visit, memory):
    ...         steep = visit.active & (visit.interaction.cos_i < 0.5)
    ...         dr.scatter_reduce(dr.ReduceOp.Add, self.sum, mi.Float64(visit.weight), mi.UInt32(0), steep)
    ...     def collect(self, unit):
    ...         self.flux_W = unit * self.sum[0]
    >>> steep = Steep()
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[steep])
    >>> print(f"{steep.flux_W:.1f} W meet surfaces at more than 60°")
    2.7 W meet surfaces at more than 60°
    """

    name = ""
    kernel_by: ClassVar[tuple[str, ...]] = ()
    departs = False
    node_floats = 0
    merges_aimed = False
    incident = False

    @property
    def by_ray(self) -> bool:
        """True if a lane may trace one start ray only, because its memory belongs to that ray."""
        return type(self).begin is not Recorder.begin

    @property
    def code(self) -> Hashable:
        """Key that distinguishes the kernels of one scene by the recorders that they write to."""
        return type(self).__name__, *(_key_of(getattr(self, name)) for name in self.kernel_by)

    # ---- a trace of one source and wavelength, called on the host

    def attach(self, scene: KernelScene) -> None:
        """Prepare for a trace of one source and wavelength, and discard the results of an earlier trace."""

    def collect(self, unit: float) -> None:
        """Collect the results of a trace that has ended; `unit` is the flux of a start ray in W."""

    # ---- events of the rays, called while the kernel is traced: their arguments are symbolic

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """Put the recorder's per-lane state into the dictionary `memory`, before the first ray segments are traced."""

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Record rays that meet surfaces; called once per visit of a node, for all lanes."""

    def branch(self, branch: Branch, memory: Memory) -> None:
        """Record the child rays (reflected, transmitted or scattered) that nodes send on."""

    def travel(self, segment: Segment, memory: Memory) -> None:
        """Record ray segments from the source, or from a node, to the next surface or out of the scene."""

    def depart(self, departure: Departure, memory: Memory) -> None:
        """
        Record rays that leave the scene.

        All that leave in a backward trace are reported. In a forward trace only those that leave after a hit are, if
        any recorder has `departs`.
        """

    def back(self, back: Return, memory: Memory) -> None:
        """Record complete subtrees of the ray tree, when lanes return to an earlier node."""

    # ---- flux that no surface absorbs

    def lose(self, channel: int | mi.UInt32, flux: Any, active: mi.Bool, memory: Memory) -> None:
        """
        Record lost flux, in units of a start ray's, or a count, in a per-lane loss channel.

        These are the first `LANE_REASONS` channels of `mistray.recorders.tallies`.
        """

    def cut(self, channel: int | mi.UInt32, batch: mi.UInt32, flux: mi.Float, active: mi.Bool) -> None:
        """Record cut flux, in units of a start ray's flux, in one of the loss channels from `LANE_REASONS` on."""

    def take(self, medium: mi.UInt32, batch: mi.UInt32, flux: Any, active: mi.Bool) -> None:
        """Record the flux absorbed in a medium, in units of a start ray's flux."""

    # ---- complete trees

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """
        Record finished ray trees with their number of segments, one tree for each start ray.

        Trees of lanes in `cut_off` have reached the limit on segments.
        """

    def collect_lanes(self, start: StartRays, memory: Memory) -> None:
        """Collect the per-lane sums when all trees are finished; all rays of a lane belong to one batch."""


def _key_of(part: Any) -> Hashable:
    """
    Return a hashable key of a recorder's part.

    The key is the part itself if it is a number or tuple. Else it is its `code`, or whether the part is not None.
    """
    return part if isinstance(part, int | tuple) else getattr(part, "code", part is not None)


class Recorders(Recorder):
    """Several recorders as one, whose methods call those of each recorder in turn."""

    def __init__(self, recorders: Sequence[Recorder | None]) -> None:
        self._all = [recorder for recorder in recorders if recorder is not None]
        # The tree does what any of them needs
        self.node_floats = max((recorder.node_floats for recorder in self._all), default=0)
        self.merges_aimed = any(recorder.merges_aimed for recorder in self._all)
        self.incident = any(recorder.incident for recorder in self._all)
        self.departs = any(recorder.departs for recorder in self._all)

    @property
    def by_ray(self) -> bool:
        """True if any recorder needs a lane's memory for one start ray alone."""
        return any(recorder.by_ray for recorder in self._all)

    @property
    def code(self) -> Hashable:
        """Key that distinguishes the kernels of one scene by all of the recorders that they write to."""
        return tuple(recorder.code for recorder in self._all)


def _in_turn(name: str) -> Callable[..., None]:
    """Return a method for `Recorders` that calls the method `name` of each recorder in the given order."""

    # In order, since a recorder may change a visit for those after it
    def call(self: Recorders, *arguments: Any) -> None:
        for recorder in self._all:
            getattr(recorder, name)(*arguments)

    return call


for _name in [name for name, method in vars(Recorder).items() if isfunction(method)]:
    setattr(Recorders, _name, _in_turn(_name))
