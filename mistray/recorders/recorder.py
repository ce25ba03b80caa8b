"""What the ray tree reports to: a recorder sums, lists or differentiates what happens to the rays.

The tree knows no recorder. It calls the same few methods of each, in the order in which they are given, while its
kernel is traced; a method that a recorder does not override costs nothing. A recorder keeps results in arrays of its
own, which it adds to with `dr.scatter_reduce` and the like. What it must remember of a lane from one step to the next
stands in `memory`, a dictionary of loop variables and local arrays that all recorders share.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from mistray.recorders.path_key import NO_EVENT
from mistray.recorders.start_rays import StartRays

if TYPE_CHECKING:
    from mistray.kernel.interaction import Interaction
    from mistray.kernel.kernel_scene import KernelScene
    from mistray.kernel.scatter_shares import ScatterBudget

Memory = dict[str, Any]
EventReader = Callable[[mi.UInt32, mi.Bool], mi.UInt32]
"""``read(k, mask)`` gives event k of a path, surface << EVENT_BITS | what."""


@dataclass
class Visit:
    """
    Rays that meet surfaces for the first time.

    Attributes
    ----------
    start : StartRays
        That the lanes come from.
    state : dict
        Variables of the loop, see `mistray.kernel.ray_tree`.
    interaction : Interaction
    shares : ScatterBudget or None
        What the surfaces scatter.
    visited : mi.Bool
        Lanes that visit a node for the first time.
    active : mi.Bool
        Those of them whose hits count.
    detected : mi.Bool
        Those of them that a detector takes.
    counted : mi.Bool
        Those of them that later recorders count; a recorder may take lanes out.
    weight, absorbed : mi.Float
        Flux that arrives and that is absorbed, in units of a start ray.
    position : tuple of mi.Float
        In the detector's frame, mm.
    code, key : mi.UInt32, mi.UInt64
        Of the absorption here, and of the path that ends with it.
    codes : dr.Local
        Events before, by depth.
    nodes : tuple of dr.Local
        Nodes before, see `mistray.kernel.pending_nodes`.
    scatters : bool
        Whether anything in the scene scatters.
    slot : mi.UInt32 or None
        Of the path in the ledger, once a ledger has found it.
    odds : mi.Float or None
        Rays against the light for one of these that arrive, see `mistray.kernel.odds`; None: they are not weighed.
    link : mi.Float or None
        How many connections find their paths, see `mistray.kernel.odds.Odds.linked`; None: there are none.
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
    position: tuple[mi.Float, mi.Float]
    code: mi.UInt32
    key: mi.UInt64
    codes: Any
    nodes: Any
    scatters: bool
    slot: mi.UInt32 | None = None
    odds: mi.Float | None = None
    link: mi.Float | None = None

    @property
    def surface(self) -> mi.UInt32:
        """Number of the surface."""
        return self.state["s"]

    @property
    def depth(self) -> mi.UInt32:
        """Events before."""
        return self.state["depth"]

    def event(self, k: mi.UInt32, mask: mi.Bool) -> mi.UInt32:
        """See `EventReader`; the last event is the absorption here."""
        before = k < self.depth
        return dr.select(before, self.codes.read(k, mask & before), self.code)

    def before(self, mask: mi.Bool) -> mi.UInt32:
        """The event before the hit, `NO_EVENT` straight after the start of a ray, which may be within a tree."""
        there = self.depth > self.start.given("depth", dr.zeros(mi.UInt32, dr.width(mask)))
        return dr.select(there, self.codes.read(dr.select(there, self.depth - 1, 0), mask & there), mi.UInt32(NO_EVENT))

    @property
    def node(self) -> Sequence[mi.Float]:
        """Point, direction of arrival and weight."""
        return (*self.interaction.p, *self.state["d"], self.weight)


@dataclass
class Branch:
    """
    Rays that a node sends on.

    Attributes
    ----------
    start : StartRays
    depth : mi.UInt32
        Of the node.
    interaction : Interaction
    place : mi.UInt32
        Number of the surface, or of the medium that scatters.
    reflect : mi.Bool
        Whether the ray goes back to where the light came from.
    aimed : mi.Bool or None
        Lanes that scattered towards a target, whether the ray has any weight or not; None: nothing scatters.
    slope : mi.Float
        d ln(its weight) / d(R or T).
    active : mi.Bool
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
    Rays that leave the scene.

    Attributes
    ----------
    start : StartRays
    heading : mi.Vector3f
        Unit direction.
    weight : mi.Float
        In units of a start ray.
    reflections, scatters : mi.UInt32
        Counted reflections, and scatter events, see `mistray.recorders.ledger.COUNT_MASK`.
    key, length : mi.UInt64, mi.UInt32
        Of the path, and the number of its events.
    event : callable
        See `EventReader`.
    active : mi.Bool
    nodes : tuple of dr.Local, optional
        Nodes before the last.
    node : sequence of mi.Float, optional
        The last one: point, direction of arrival and weight; None: the rays come straight from their start.
    odds : mi.Float or None
        Rays with the light for one of these that leave, see `mistray.kernel.odds`; None: they are not weighed.
    link : mi.Float or None
        How many connections find their paths, see `mistray.kernel.odds.Odds.linked`; None: there are none.
    joint : mi.UInt32 or None
        What rays remember that were connected to light, see `mistray.kernel.scatter_shares.JOINED`; 0 of others.
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
    nodes: Any = None
    node: Sequence[mi.Float] | None = None
    odds: mi.Float | None = None
    link: mi.Float | None = None
    joint: mi.UInt32 | None = None


@dataclass
class Segment:
    """
    Rays on their way from one point to the next.

    Attributes
    ----------
    start : StartRays
    origin : mi.Vector3f
        Of the device, see `mistray.surfaces.surfaces.SurfaceTable.centre`; mm.
    heading : mi.Vector3f
        Unit direction.
    flux : mi.Float
        At the origin, in units of a start ray.
    medium : mi.UInt32
        Number of the material; 0 is not known.
    length : mi.Float
        To the next surface, mm; without meaning where it leaves.
    leaves : mi.Bool
        Whether it leaves the scene.
    active : mi.Bool
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
    Branches that have ended, with all that followed from them.

    Attributes
    ----------
    start : StartRays
    depth : mi.UInt32
        Of the deepest node.
    last : mi.UInt32
        Of the node to which the lane comes back; 0 where its tree is complete.
    closed : mi.UInt32
        Of the first node to which it does not come back.
    active : mi.Bool
    """

    start: StartRays
    depth: mi.UInt32
    last: mi.UInt32
    closed: mi.UInt32
    active: mi.Bool


class Recorder:
    """
    Does nothing; recorders override what they need.

    Attributes
    ----------
    node_floats : int
        How many numbers of the nodes of a path it reads: 0, POINT_FLOATS or NODE_FLOATS.
    by_way : bool
        Whether paths that differ only in how a direction was found are one to it: at random or aimed.
    incident : bool
        Whether hits of the detector count that it does not absorb.
    departs : bool
        Whether it is told of light that leaves the scene of a trace with the light, too.
    name : str
        What a result calls it; empty: nothing.
    """

    name = ""
    departs = False
    node_floats = 0
    by_way = False
    incident = False

    @property
    def by_ray(self) -> bool:
        """Whether the memory of a lane is of one start ray: then no lane takes a second one."""
        return type(self).begin is not Recorder.begin

    @property
    def code(self) -> Hashable:
        """What tells the kernels of the same scene apart that write to it."""
        return type(self).__name__

    def attach(self, scene: KernelScene) -> None:
        """A trace of one source and wavelength begins, or begins again: what it has brought so far does not count."""

    def collect(self, unit: float) -> None:
        """It has ended; the flux of a start ray is so many W."""

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """Put what is remembered of a lane into the memory, before the first segment."""

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Rays have met surfaces."""

    def branch(self, branch: Branch, memory: Memory) -> None:
        """Rays are sent on from a node."""

    def travel(self, segment: Segment, memory: Memory) -> None:
        """Rays go from the source, or from a node, to the next surface or out of the scene."""

    def depart(self, departure: Departure, memory: Memory) -> None:
        """Rays of a backward trace leave the scene, and those of other traces after a hit if the recorder `departs`."""

    def back(self, back: Return, memory: Memory) -> None:
        """Branches have ended."""

    def lose(self, channel: int | mi.UInt32, flux: Any, active: mi.Bool, memory: Memory) -> None:
        """Flux (or a count) goes to one of the first `LANE_REASONS` of `mistray.recorders.tallies`."""

    def cut(self, channel: int | mi.UInt32, batch: mi.UInt32, flux: mi.Float, active: mi.Bool) -> None:
        """Flux goes to one of the other channels, which most traces have no light for."""

    def take(self, medium: mi.UInt32, batch: mi.UInt32, flux: Any, active: mi.Bool) -> None:
        """A medium absorbs flux."""

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """Trees are complete, of so many segments; those of the lanes `cut_off` were larger than they may be."""

    def collect_lanes(self, start: StartRays, memory: Memory) -> None:
        """All trees of the lanes are complete. The rays of a lane were of one batch."""


class Recorders(Recorder):
    """Several recorders, told one after the other."""

    def __init__(self, recorders: Sequence[Recorder | None]) -> None:
        self._all = [recorder for recorder in recorders if recorder is not None]
        self.node_floats = max((recorder.node_floats for recorder in self._all), default=0)
        self.by_way = any(recorder.by_way for recorder in self._all)
        self.incident = any(recorder.incident for recorder in self._all)
        self.departs = any(recorder.departs for recorder in self._all)

    @property
    def by_ray(self) -> bool:
        """See `Recorder.by_ray`."""
        return any(recorder.by_ray for recorder in self._all)

    @property
    def code(self) -> Hashable:
        """See `Recorder.code`."""
        return tuple(recorder.code for recorder in self._all)

    def attach(self, scene: KernelScene) -> None:
        """See `Recorder.attach`."""
        for recorder in self._all:
            recorder.attach(scene)

    def collect(self, unit: float) -> None:
        """See `Recorder.collect`."""
        for recorder in self._all:
            recorder.collect(unit)

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """See `Recorder.begin`."""
        for recorder in self._all:
            recorder.begin(start, max_events, memory)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """See `Recorder.visit`."""
        for recorder in self._all:
            recorder.visit(visit, memory)

    def branch(self, branch: Branch, memory: Memory) -> None:
        """See `Recorder.branch`."""
        for recorder in self._all:
            recorder.branch(branch, memory)

    def travel(self, segment: Segment, memory: Memory) -> None:
        """See `Recorder.travel`."""
        for recorder in self._all:
            recorder.travel(segment, memory)

    def depart(self, departure: Departure, memory: Memory) -> None:
        """See `Recorder.depart`."""
        for recorder in self._all:
            recorder.depart(departure, memory)

    def back(self, back: Return, memory: Memory) -> None:
        """See `Recorder.back`."""
        for recorder in self._all:
            recorder.back(back, memory)

    def lose(self, channel: int | mi.UInt32, flux: Any, active: mi.Bool, memory: Memory) -> None:
        """See `Recorder.lose`."""
        for recorder in self._all:
            recorder.lose(channel, flux, active, memory)

    def cut(self, channel: int | mi.UInt32, batch: mi.UInt32, flux: mi.Float, active: mi.Bool) -> None:
        """See `Recorder.cut`."""
        for recorder in self._all:
            recorder.cut(channel, batch, flux, active)

    def take(self, medium: mi.UInt32, batch: mi.UInt32, flux: Any, active: mi.Bool) -> None:
        """See `Recorder.take`."""
        for recorder in self._all:
            recorder.take(medium, batch, flux, active)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """See `Recorder.end`."""
        for recorder in self._all:
            recorder.end(start, segments, cut_off, active, memory)

    def collect_lanes(self, start: StartRays, memory: Memory) -> None:
        """See `Recorder.collect_lanes`."""
        for recorder in self._all:
            recorder.collect_lanes(start, memory)
