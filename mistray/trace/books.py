"""What the kernel writes to: sums of flux, the film, recorded branches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.trace.ledger import BATCHES, Ledger
from mistray.trace.settings import BRANCHES

# Rows of the tally: what is not tied to a surface. Those of any trace have sums in each lane
ESCAPED, THRESHOLD, ROULETTE, REFLECTIONS, EVENTS, MEDIUM, SEGMENTS, FIRST_MISS, STARTED = range(9)
# Scatter that a limit cuts, what was to be scattered less what the scattered rays carry, and the number, flux and
# squared flux of the hits of the detector by scattered rays
SCATTERS, SAMPLING, SCATTERED_HITS, SCATTERED_FLUX, SCATTERED_SQUARES = range(9, 14)
TREE = 14  # what is left of trees that are larger than `max_segments`, and what EVENTS cuts of them
LANE_REASONS = 15
# What `ray_control` keeps back, `max_generations`, `max_consecutive`, and `cut_below` in the order of its branches
CONTROL, GENERATIONS, CONSECUTIVE, CUT_BRANCHES = range(LANE_REASONS, LANE_REASONS + 4)
REASONS = CUT_BRANCHES + len(BRANCHES)
# Columns of the tally of a surface; the last two count its aimed rays and those that reach the detector undeflected
HITS, INCIDENT, ABSORBED_HERE, AIMED, LANDED = range(5)
SURFACE_SUMS = 5
MOST_LANE_SUMS = 256  # surfaces whose sums are kept by lane, 24 bytes for each surface and lane
HIT_SUMS = 3  # the first of them, which every hit adds to
FILM_BYTES, LEAST_GROUPS = 1 << 24, 8  # of the images of the detector of a run, by groups of batches
NODE_FLOATS = 7  # of a node: point, direction of arrival, weight
POINT_FLOATS = 3  # of them the point


class Tallies:
    """
    Float64 sums by batch: some for each surface, one for each medium and reason, and images of the detector.

    Media scatter as well: their aimed rays and those that land stand behind the sums of the surfaces.

    `largest` is the largest flux of a scattered ray at the detector, as the bits of a float32.
    """

    def __init__(self, surfaces: int, media: int, pixels: int) -> None:
        self.count = surfaces
        self._in_lanes = surfaces <= MOST_LANE_SUMS
        self.surfaces = dr.zeros(mi.Float64, (surfaces + media) * SURFACE_SUMS * BATCHES)
        self.media = dr.zeros(mi.Float64, media * BATCHES)
        self.reasons = dr.zeros(mi.Float64, REASONS * BATCHES)
        self.film = dr.zeros(mi.Float64, pixels)
        self.largest = dr.zeros(mi.UInt32, 1)
        dr.eval(self.surfaces, self.media, self.reasons, self.film, self.largest)

    def add_surface(self, s: mi.UInt32, what: int, batch: mi.UInt32, value: Any, active: mi.Bool) -> None:
        """Book one of the sums of a surface."""
        index = (s * SURFACE_SUMS + what) * BATCHES + batch
        dr.scatter_reduce(dr.ReduceOp.Add, self.surfaces, mi.Float64(value), index, active)

    def lane_sums(self) -> tuple[Any, ...]:
        """
        Sums of a lane of its own, in local memory: sums that lanes share would cost a fifth of the time.

        Returns
        -------
        tuple of dr.Local
            The first `HIT_SUMS` of `SURFACE_SUMS` of each surface unless there are too many of them, and last those of
            the first `LANE_REASONS`.
        """
        sizes = (*(self.count,) * (HIT_SUMS if self._in_lanes else 0), LANE_REASONS)
        return tuple(dr.alloc_local(mi.Float64, size, mi.Float64(0)) for size in sizes)

    @staticmethod
    def add_reason(sums: tuple[Any, ...], reason: int, value: Any, active: mi.Bool) -> None:
        """Book flux (or a count) under one of the first `LANE_REASONS`."""
        sums[-1].write(sums[-1].read(reason, active) + mi.Float64(value), reason, active)

    def add_cut(self, reason: int | mi.UInt32, batch: mi.UInt32, value: mi.Float, active: mi.Bool) -> None:
        """Book flux under one of the other reasons, which most traces have no light for."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.reasons, mi.Float64(value), reason * BATCHES + batch, active)

    @staticmethod
    def move_reason(sums: tuple[Any, ...], reason: int, to: int, active: mi.Bool) -> None:
        """Book what is booked under a reason under another one."""
        value = sums[-1].read(reason, active)
        sums[-1].write(sums[-1].read(to, active) + value, to, active)
        sums[-1].write(mi.Float64(0), reason, active)

    def add_hit(
        self,
        sums: tuple[Any, ...],
        s: mi.UInt32,
        batch: mi.UInt32,
        incident: mi.Float,
        absorbed: mi.Float,
        active: mi.Bool,
    ) -> None:
        """Book a hit of a surface."""
        values = {HITS: 1.0, INCIDENT: incident, ABSORBED_HERE: absorbed}
        for what, value in values.items():
            if self._in_lanes:
                sums[what].write(sums[what].read(s, active) + mi.Float64(value), s, active)
            else:
                self.add_surface(s, what, batch, value, active)

    def collect(self, sums: tuple[Any, ...], batch: mi.UInt32) -> None:
        """Add the sums of all lanes."""

        def step(k: mi.UInt32, sums: tuple[Any, ...]) -> tuple[mi.UInt32, tuple[Any, ...]]:
            for what in range(len(sums) - 1):
                value = sums[what].read(k, k < self.count)
                self.add_surface(k, what, batch, value, value != 0)
            value = sums[-1].read(k, k < LANE_REASONS)
            dr.scatter_reduce(dr.ReduceOp.Add, self.reasons, value, k * BATCHES + batch, value != 0)
            return k + 1, sums

        count = dr.opaque(mi.UInt32, max(self.count, LANE_REASONS) if self._in_lanes else LANE_REASONS)
        dr.while_loop(
            (dr.zeros(mi.UInt32, dr.width(batch)), sums),
            lambda k, sums: k < count,
            step,
            mode="symbolic",
            label="collect",
        )

    def add_to_film(self, pixel: mi.UInt32, flux: mi.Float64, active: mi.Bool) -> None:
        """Add flux to a pixel of one of the images."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.film, flux, pixel, active)

    def add_scattered(self, sums: tuple[Any, ...], flux: mi.Float, active: mi.Bool) -> None:
        """Book a hit of the detector by a ray that has been scattered."""
        self.add_reason(sums, SCATTERED_HITS, 1.0, active)
        self.add_reason(sums, SCATTERED_FLUX, flux, active)
        self.add_reason(sums, SCATTERED_SQUARES, dr.square(mi.Float64(flux)), active)
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
    tent : bool
        Spread a hit over the four nearest pixels, in proportion to how near their centres are; else it counts in the
        pixel that holds it.
    groups : int
        Of batches, a power of two; the film has an image for each of them, whose spread is the error of their sum.
    image_of_slot : mi.UInt32 or None
        For maps of single paths: the `image_word` of the map of each ledger slot, 0 for none.
    """

    width: int
    height: int
    x0: mi.Float
    y0: mi.Float
    per_mm_x: mi.Float
    per_mm_y: mi.Float
    groups: int
    incident: bool = False
    image_of_slot: mi.UInt32 | None = None
    tent: bool = False

    def image(self, batch: mi.UInt32, slot: mi.UInt32 | None, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """First pixel of the image where a hit counts, and whether it does."""
        group = batch >> dr.opaque(mi.UInt32, (BATCHES // self.groups).bit_length() - 1)
        if self.image_of_slot is not None:
            word = dr.gather(mi.UInt32, self.image_of_slot, slot, active)
            active &= word > 0
            group = (word >> 1) - 1 + dr.select((word & 1) > 0, group, 0)
        return group * (self.width * self.height), active

    def places(self, x: mi.Float, y: mi.Float) -> list[tuple[mi.UInt32, mi.Float | None]]:
        """
        Where a hit at a point of the detector counts.

        Returns
        -------
        list of (mi.UInt32, mi.Float or None)
            Numbers of pixels, row 0 at the smallest y, and the shares of the flux that they get; None: all of it.
        """
        along_x, along_y = (x - self.x0) * self.per_mm_x, (y - self.y0) * self.per_mm_y
        if not self.tent:
            return [(self._number(mi.Int32(along_x), mi.Int32(along_y)), None)]
        low_x, low_y = dr.floor(along_x - 0.5), dr.floor(along_y - 0.5)
        part_x, part_y = along_x - 0.5 - low_x, along_y - 0.5 - low_y
        column, row = mi.Int32(low_x), mi.Int32(low_y)
        return [
            (self._number(column + i, row + j), (part_x if i else 1 - part_x) * (part_y if j else 1 - part_y))
            for j in (0, 1)
            for i in (0, 1)
        ]

    def _number(self, column: mi.Int32, row: mi.Int32) -> mi.UInt32:
        """Number of a pixel, or of the nearest one beyond the border."""
        column, row = dr.clip(column, 0, self.width - 1), dr.clip(row, 0, self.height - 1)
        return mi.UInt32(row * self.width + column)


def image_word(first: int, by_group: bool) -> int:
    """The map of a path: number of its first image, and whether it has one for each group of batches or one in all."""
    return 2 * (first + 1) + by_group


def groups_of(pixels: int) -> int:
    """Groups of batches that have an image of so many pixels each: fewer where the images would be large."""
    most = FILM_BYTES // (8 * pixels)
    return int(np.clip(1 << max(most, 1).bit_length() - 1, LEAST_GROUPS, BATCHES))


def spreads(film: mi.Film) -> bool:
    """
    Whether the hits on a detector are spread over the pixels around them, see `Film`.

    Parameters
    ----------
    film : mi.Film
        Of the detector; spread where its reconstruction filter is a ``tent``.

    Raises
    ------
    MistrayError
        For a tent that is not two pixels wide.
    """
    kernel = film.rfilter()
    if kernel.class_name() != "TentFilter":
        return False
    if kernel.radius() != 1:
        raise MistrayError(
            f"the film's rfilter 'tent' has a radius of {kernel.radius():g} pixels; leave out its radius, which is 1"
        )
    return True


@dataclass
class PathChoice:
    """
    Some of the paths of a ledger.

    Attributes
    ----------
    ledger : Ledger
        That knows the paths.
    chosen : (capacity,) mi.UInt32
        1 for the slots of the chosen paths, 0 for the others.
    """

    ledger: Ledger
    chosen: mi.UInt32

    def holds(self, key: mi.UInt64, active: mi.Bool) -> mi.Bool:
        """Whether the path of this key is one of them."""
        slot, known = self.ledger.known(key, active)
        return known & (dr.gather(mi.UInt32, self.chosen, slot, known) != 0)


@dataclass
class Recorder:
    """
    Append buffer for whole branches: everything on the way to a leaf.

    Attributes
    ----------
    capacity : int
        Most branches that are kept.
    max_events : int
        Longest branch that is kept whole.
    points_only : bool
        Keep the points of the nodes only.
    choice : PathChoice or None
        Only branches of these paths are recorded; None: of every path that reaches the detector. Against the light
        every ray is recorded that leaves the scene and counts, see `Sky.gain`.
    count : (1,) mi.UInt32
        Branches that there were.
    lane, length : (capacity,) mi.UInt32
        Start ray and number of events of each.
    codes : (capacity, max_events) mi.UInt32
        Events, surface << EVENT_BITS | what.
    nodes : (capacity, max_events, node_floats) mi.Float
        Points (mm), and unless `points_only` directions of arrival and weights.
    weight : (capacity,) mi.Float64
        Flux that meets the detector in units of the start ray's; against the light what the metric gains.
    heading : (capacity, 3) mi.Float
        Directions of rays that leave the scene.
    place : (capacity, 2) mi.Float
        x and y of the hits in the detector's frame, mm.
    path : (capacity,) mi.UInt64
        Keys of the events, see `mistray.trace.ledger.extend_key`.
    peak : (1,) mi.UInt32
        The largest flux that one ray brought to the detector, recorded or not, as the bits of a float32.
    """

    capacity: int
    max_events: int
    points_only: bool = False
    choice: PathChoice | None = None

    def __post_init__(self) -> None:
        size = self.capacity * self.max_events
        self.node_floats = POINT_FLOATS if self.points_only else NODE_FLOATS
        self.count = dr.zeros(mi.UInt32, 1)
        self.lane = dr.zeros(mi.UInt32, self.capacity)
        self.length = dr.zeros(mi.UInt32, self.capacity)
        self.codes = dr.zeros(mi.UInt32, size)
        self.nodes = dr.zeros(mi.Float, size * self.node_floats)
        self.weight = dr.zeros(mi.Float64, self.capacity)
        self.heading = dr.zeros(mi.Float, 3 * self.capacity)
        self.place = dr.zeros(mi.Float, 2 * self.capacity)
        self.path = dr.zeros(mi.UInt64, self.capacity)
        self.peak = dr.zeros(mi.UInt32, 1)
        dr.eval(self.count, self.lane, self.length, self.codes, self.nodes, self.weight, self.heading, self.place)
        dr.eval(self.path, self.peak)

    def wants(self, key: mi.UInt64, w: mi.Float, detected: mi.Bool) -> mi.Bool:
        """Whether to record a hit of the detector by a path of this key; its flux w counts for the peak."""
        # The bits of positive floats are in the order of the floats
        bits = dr.reinterpret_array(mi.UInt32, w)
        dr.scatter_reduce(dr.ReduceOp.Max, self.peak, bits, mi.UInt32(0), detected)
        return detected if self.choice is None else self.choice.holds(key, detected)

    def clear(self) -> None:
        """Forget all branches."""
        self.count = dr.zeros(mi.UInt32, 1)
        dr.eval(self.count)


def as_many(capacity: int, max_events: int) -> int:
    """Branches that take the memory of so many of 64 events."""
    return max(1, capacity * 64 // max(max_events, 64))


def record_branch(
    recorder: Recorder,
    nodes: Any,
    event: Callable[[mi.UInt32, mi.Bool], mi.UInt32],
    active: mi.Bool,
    last: Sequence[mi.Float],
    depth: mi.UInt32,
    lane: mi.UInt32,
    key: mi.UInt64,
    weight: mi.Float64,
    heading: mi.Vector3f | None = None,
    place: tuple[mi.Float, mi.Float] | None = None,
) -> tuple[mi.UInt32, mi.Bool]:
    """
    Write the current path, node by node, to the recorder.

    Parameters
    ----------
    recorder : Recorder
    nodes : sequence of dr.Local
        What the nodes before the last consist of.
    event : callable
        `event(k, mask)` gives event k.
    active : mi.Bool
    last : sequence of mi.Float
        What a node consists of, for the last one.
    depth, lane : mi.UInt32
        Number of the last node, number of the start ray.
    key : mi.UInt64
        Of the path, the last event included.
    weight : mi.Float64
    heading : mi.Vector3f, optional
    place : tuple of mi.Float, optional
        See `Recorder`.

    Returns
    -------
    slot : mi.UInt32
        Where it was written.
    kept : mi.Bool
        Whether there was room for it.
    """
    slot = dr.scatter_inc(recorder.count, mi.UInt32(0), active)
    active = active & (slot < recorder.capacity)
    dr.scatter(recorder.lane, lane, slot, active)
    dr.scatter(recorder.length, depth + 1, slot, active)
    dr.scatter(recorder.path, key, slot, active)
    dr.scatter(recorder.weight, weight, slot, active)
    if heading is not None:
        for j, component in enumerate(heading):
            dr.scatter(recorder.heading, component, 3 * slot + j, active)
    if place is not None:
        for j, component in enumerate(place):
            dr.scatter(recorder.place, component, 2 * slot + j, active)

    def step(k):  # type: ignore[no-untyped-def]
        going = active & (k <= depth)
        here = k == depth
        row = slot * recorder.max_events + k
        dr.scatter(recorder.codes, event(k, going), row, going)
        for j in range(recorder.node_floats):
            value = dr.select(here, last[j], nodes[j].read(k, going & ~here))
            dr.scatter(recorder.nodes, value, row * recorder.node_floats + j, going)
        return (k + 1,)

    dr.while_loop((dr.zeros(mi.UInt32, dr.width(depth)),), lambda k: active & (k <= depth), step, mode="symbolic")
    return slot, active
