"""What the kernel writes to: sums of flux, the film, recorded branches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.trace.ledger import BATCHES

# Rows of the tally: what is not tied to a surface
ESCAPED, THRESHOLD, ROULETTE, REFLECTIONS, EVENTS, MEDIUM, SEGMENTS, FIRST_MISS, STARTED = range(9)
# Scatter that a limit cuts, what was to be scattered less what the scattered rays carry, and the number, flux and
# squared flux of the hits of the detector by scattered rays
SCATTERS, SAMPLING, SCATTERED_HITS, SCATTERED_FLUX, SCATTERED_SQUARES = range(9, 14)
CONTROL = 14  # what `ray_control` keeps back
REASONS = 15
# Columns of the tally of a surface; the last two count its aimed rays and those that reach the detector undeflected
HITS, INCIDENT, ABSORBED_HERE, AIMED, LANDED = range(5)
SURFACE_SUMS = 5
HIT_SUMS = 3  # the first of them, which every hit adds to
NODE_FLOATS = 7  # of a node: point, direction of arrival, weight


class Tallies:
    """
    Float64 sums by batch: some for each surface, one for each medium and reason, and the film with its squares.

    `largest` is the largest flux of a scattered ray at the detector, as the bits of a float32.
    """

    def __init__(self, surfaces: int, media: int, pixels: int, maps: int = 0) -> None:
        self.count = surfaces
        self.surfaces = dr.zeros(mi.Float64, surfaces * SURFACE_SUMS * BATCHES)
        self.media = dr.zeros(mi.Float64, media * BATCHES)
        self.reasons = dr.zeros(mi.Float64, REASONS * BATCHES)
        self.film = dr.zeros(mi.Float64, pixels * max(maps, 1) * 2)
        self.largest = dr.zeros(mi.UInt32, 1)
        dr.eval(self.surfaces, self.media, self.reasons, self.film, self.largest)

    def add_reason(self, reason: int, batch: mi.UInt32, value: Any, active: mi.Bool) -> None:
        """Book flux (or a count) under a reason."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.reasons, mi.Float64(value), reason * BATCHES + batch, active)

    def add_surface(self, s: mi.UInt32, what: int, batch: mi.UInt32, value: Any, active: mi.Bool) -> None:
        """Book one of the sums of a surface."""
        index = (s * SURFACE_SUMS + what) * BATCHES + batch
        dr.scatter_reduce(dr.ReduceOp.Add, self.surfaces, mi.Float64(value), index, active)

    def hit_memory(self) -> Any:
        """Sums of a lane's hits by surface, in local memory: sums that lanes share cost a fifth of the time."""
        return dr.alloc_local(mi.Float64, self.count * HIT_SUMS, mi.Float64(0))

    @staticmethod
    def add_hit(memory: Any, s: mi.UInt32, incident: mi.Float, absorbed: mi.Float, active: mi.Bool) -> None:
        """Book a hit of a surface in a lane's own sums."""
        for what, value in (
            (HITS, mi.Float64(1)),
            (INCIDENT, mi.Float64(incident)),
            (ABSORBED_HERE, mi.Float64(absorbed)),
        ):
            place = s * HIT_SUMS + what
            memory.write(memory.read(place, active) + value, place, active)

    def collect_hits(self, memory: Any, batch: mi.UInt32) -> None:
        """Add the sums of all lanes to those of the surfaces."""

        def step(s: mi.UInt32, memory: Any) -> tuple[mi.UInt32, Any]:
            for what in range(HIT_SUMS):
                value = memory.read(s * HIT_SUMS + what)
                self.add_surface(s, what, batch, value, value != 0)
            return s + 1, memory

        count = dr.opaque(mi.UInt32, self.count)
        dr.while_loop(
            (dr.zeros(mi.UInt32, dr.width(batch)), memory),
            lambda s, memory: s < count,
            step,
            mode="symbolic",
            label="collect hits",
        )

    def add_scattered(self, batch: mi.UInt32, flux: mi.Float, active: mi.Bool) -> None:
        """Book a hit of the detector by a ray that has been scattered."""
        self.add_reason(SCATTERED_HITS, batch, 1.0, active)
        self.add_reason(SCATTERED_FLUX, batch, flux, active)
        self.add_reason(SCATTERED_SQUARES, batch, dr.square(mi.Float64(flux)), active)
        # The bits of positive floats are in the order of the floats
        bits = dr.reinterpret_array(mi.UInt32, flux)
        dr.scatter_reduce(dr.ReduceOp.Max, self.largest, bits, mi.UInt32(0), active)

    def add_medium(self, medium: mi.UInt32, batch: mi.UInt32, value: Any, active: mi.Bool) -> None:
        """Book flux that a medium absorbs."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.media, mi.Float64(value), medium * BATCHES + batch, active)


@dataclass
class Film:
    """
    Pixel grid of the detector.

    Attributes
    ----------
    width, height : int
    x0, y0, per_mm_x, per_mm_y : mi.Float
        Corner (mm) and pixels per mm, opaque.
    incident : bool
        Sum the flux that meets the detector instead of what it absorbs.
    map_of_slot : mi.UInt32 or None
        For maps of single paths: number of the map + 1 for each ledger slot, 0 for none.
    """

    width: int
    height: int
    x0: mi.Float
    y0: mi.Float
    per_mm_x: mi.Float
    per_mm_y: mi.Float
    incident: bool = False
    map_of_slot: mi.UInt32 | None = None

    def pixel(self, x: mi.Float, y: mi.Float) -> mi.UInt32:
        """Number of the pixel that holds a point of the detector, row 0 at the smallest y."""
        column = dr.clip(mi.Int32((x - self.x0) * self.per_mm_x), 0, self.width - 1)
        row = dr.clip(mi.Int32((y - self.y0) * self.per_mm_y), 0, self.height - 1)
        return mi.UInt32(row * self.width + column)


@dataclass
class Recorder:
    """
    Append buffer for whole branches: everything on the way to a leaf.

    Attributes
    ----------
    capacity : int
        Most branches that are kept.
    key : mi.UInt64
        Only paths with this key are recorded; 0 records every path that reaches the detector.
    """

    capacity: int
    max_events: int
    key: mi.UInt64

    def __post_init__(self) -> None:
        size = self.capacity * self.max_events
        self.count = dr.zeros(mi.UInt32, 1)
        self.lane = dr.zeros(mi.UInt32, self.capacity)
        self.length = dr.zeros(mi.UInt32, self.capacity)
        self.codes = dr.zeros(mi.UInt32, size)
        self.nodes = dr.zeros(mi.Float, size * NODE_FLOATS)
        dr.eval(self.count, self.lane, self.length, self.codes, self.nodes)


def read_node(memory: Any, k: mi.UInt32, active: mi.Bool) -> tuple[mi.Vector3f, mi.Vector3f, mi.Float]:
    """Point, direction of arrival and weight of node k."""
    v = [memory.read(k * NODE_FLOATS + j, active) for j in range(7)]
    return mi.Vector3f(*v[:3]), mi.Vector3f(*v[3:6]), v[6]


def record_branch(
    recorder: Recorder,
    nodes: Any,
    event: Callable[[mi.UInt32, mi.Bool], mi.UInt32],
    active: mi.Bool,
    p: mi.Vector3f,
    d: mi.Vector3f,
    w: mi.Float,
    depth: mi.UInt32,
    lane: mi.UInt32,
) -> None:
    """Write the current path, node by node, to the recorder."""
    slot = dr.scatter_inc(recorder.count, mi.UInt32(0), active)
    active = active & (slot < recorder.capacity)
    dr.scatter(recorder.lane, lane, slot, active)
    dr.scatter(recorder.length, depth + 1, slot, active)

    def step(k):  # type: ignore[no-untyped-def]
        going = active & (k <= depth)
        here = k == depth
        q, e, v = read_node(nodes, k, going & ~here)
        values = (*dr.select(here, p, q), *dr.select(here, d, e), dr.select(here, w, v))
        row = slot * recorder.max_events + k
        dr.scatter(recorder.codes, event(k, going), row, going)
        for j, value in enumerate(values):
            dr.scatter(recorder.nodes, value, row * NODE_FLOATS + j, going)
        return (k + 1,)

    dr.while_loop((dr.zeros(mi.UInt32, dr.width(depth)),), lambda k: active & (k <= depth), step, mode="symbolic")
