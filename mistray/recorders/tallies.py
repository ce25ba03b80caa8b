"""Energy ledger: sums of flux by surface, by medium and by loss channel, in units of a start ray's flux."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.recorder import Branch, Memory, Recorder, Visit
from mistray.recorders.start_rays import StartRays
from mistray.settings import BATCHES, BRANCHES
from mistray.surfaces.extrema import larger
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable

# Loss channels: flux and counts that belong to no surface. Those that occur in any trace have sums in each lane
ESCAPED, THRESHOLD, ROULETTE, REFLECTIONS, EVENTS, MEDIUM, SEGMENTS, FIRST_MISS, STARTED = range(9)
# Scatter that a limit cuts, flux to be scattered less the flux of the scattered rays, and the number, flux and squared
# flux of the hits of the detector by scattered rays
SCATTERS, SAMPLING, SCATTERED_HITS, SCATTERED_FLUX, SCATTERED_SQUARES = range(9, 14)
TREE = 14  # flux left in trees that are larger than `max_segments`, and the flux that EVENTS cuts of them
LANE_REASONS = 15
EVENTS_OF_LANE = LANE_REASONS  # flux that EVENTS has cut in complete trees, in the memory of a lane
# Flux cut by `ray_control`, `max_generations`, `max_consecutive`, and by `cut_below` in the order of its branches
CONTROL, GENERATIONS, CONSECUTIVE, CUT_BRANCHES = range(LANE_REASONS, LANE_REASONS + 4)
CHANNEL_COUNT = CUT_BRANCHES + len(BRANCHES)
# Channels of flux that limits cut, by the names of `Energy.cut`
CUTS = {
    "flux_threshold": THRESHOLD,
    "roulette": ROULETTE,
    "max_reflections": REFLECTIONS,
    "max_scatters": SCATTERS,
    "scatter_sampling": SAMPLING,
    "max_generations": GENERATIONS,
    "max_events": EVENTS,
    "max_consecutive": CONSECUTIVE,
    "max_segments": TREE,
    "medium": MEDIUM,
    "ray_control": CONTROL,
    **{f"{branch}_below": CUT_BRANCHES + k for k, branch in enumerate(BRANCHES.values())},
}
# Columns of the tally of a surface; the last two count its aimed rays and those that reach the detector undeflected
HITS, INCIDENT, ABSORBED_HERE, AIMED, LANDED = range(5)
SURFACE_SUMS = 5
MOST_LANE_SUMS = 256  # most surfaces whose sums are kept by lane, 24 bytes for each surface and lane
HIT_SUMS = 3  # the first columns, to which every hit adds
ROOM_OF_MEDIA = 8  # media come by so many
SUMS = "sums"  # name of the per-lane sums in the memory


class Tallies(Recorder):
    """
    Recorder of the sums of the energy ledger by batch: for each surface, medium and loss channel, see `read`.

    Media scatter as well: counts of their aimed rays, and of those that land, follow the sums of the surfaces.

    `largest` is the largest flux of a scattered ray at the detector, as the bits of a float32.
    """

    by_ray = False  # all rays of a lane are of one batch

    def __init__(self, table: SurfaceTable) -> None:
        surfaces, self._media = table.count, len(table.optics.media)
        self.count = surfaces
        # Dr.Jit writes the size of a small array into the kernel: a few media more or less keep theirs
        media = -(-self._media // ROOM_OF_MEDIA) * ROOM_OF_MEDIA
        self._in_lanes = surfaces <= MOST_LANE_SUMS
        self.surfaces = dr.zeros(mi.Float64, (surfaces + media) * SURFACE_SUMS * BATCHES)
        self.media = dr.zeros(mi.Float64, media * BATCHES)
        self.channels = dr.zeros(mi.Float64, CHANNEL_COUNT * BATCHES)
        self.largest = dr.zeros(mi.UInt32, 1)
        dr.make_opaque(self.surfaces, self.media, self.channels, self.largest)

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """
        Allocate the sums of each lane in local memory; sums shared by all lanes would make a trace a fifth longer.

        These are the sums of the first `LANE_REASONS` channels, and the first `HIT_SUMS` of the `SURFACE_SUMS` of each
        surface; the latter only for up to `MOST_LANE_SUMS` surfaces.
        """
        sizes = (*(self.count,) * (HIT_SUMS if self._in_lanes else 0), LANE_REASONS + 1)
        memory[SUMS] = tuple(dr.alloc_local(mi.Float64, size, mi.Float64(0)) for size in sizes)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add hits, incident and absorbed flux to the sums of surfaces, and flux of scattered rays at the detector."""
        sums, batch, state = memory[SUMS], visit.start.batch, visit.state
        s, active = visit.surface, visit.active
        values = {HITS: 1.0, INCIDENT: visit.weight, ABSORBED_HERE: larger(visit.absorbed, 0)}
        for what, value in values.items():
            if self._in_lanes:
                sums[what].write(sums[what].read(s, active) + mi.Float64(value), s, active)
            else:
                self._add_surface(s, what, batch, value, active)
        if visit.scatters:
            # Hits of the detector by rays that have been scattered
            flux, scattered = visit.absorbed, visit.detected & (state["scatters"] != 0)
            values = {SCATTERED_HITS: 1.0, SCATTERED_FLUX: flux, SCATTERED_SQUARES: dr.square(mi.Float64(flux))}
            for channel, value in values.items():
                self.lose(channel, value, scattered, memory)
            # The bits of positive floats are in the order of the floats
            bits = dr.reinterpret_array(mi.UInt32, flux)
            dr.scatter_reduce(dr.ReduceOp.Max, self.largest, bits, mi.UInt32(0), scattered)
            landed = visit.detected & (state["aimed_from"] != NO_SURFACE)
            self._add_surface(state["aimed_from"], LANDED, batch, 1.0, landed)

    def branch(self, branch: Branch, memory: Memory) -> None:
        """Count the rays that each surface or medium scatters towards its importance targets."""
        if branch.aimed is not None:
            self._add_surface(branch.place, AIMED, branch.start.batch, 1.0, branch.aimed)

    def lose(self, channel: int | mi.UInt32, flux: Any, active: mi.Bool, memory: Memory) -> None:
        """Add lost flux, in units of a start ray's, or a count to a loss channel up to `EVENTS_OF_LANE`."""
        sums = memory[SUMS][-1]
        sums.write(sums.read(channel, active) + mi.Float64(flux), channel, active)

    def cut(self, channel: int | mi.UInt32, batch: mi.UInt32, flux: Any, active: mi.Bool) -> None:
        """Add flux, in units of a start ray's, to a loss channel in memory shared by all lanes."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.channels, mi.Float64(flux), channel * BATCHES + batch, active)

    def take(self, medium: mi.UInt32, batch: mi.UInt32, flux: Any, active: mi.Bool) -> None:
        """Add the flux that a medium absorbs, in units of a start ray's flux, to its sum."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.media, mi.Float64(flux), medium * BATCHES + batch, active)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """
        Add flux cut by `max_events` in finished ray trees to its loss channel, and count the trees' segments.

        The flux of trees over `max_segments` goes to the channel TREE instead.
        """
        # Whether a tree is over the limit is known at its end only
        own = memory[SUMS][-1]
        value = own.read(EVENTS, active)
        place = dr.select(cut_off, mi.UInt32(TREE), EVENTS_OF_LANE)
        self.lose(place, value, active, memory)
        own.write(mi.Float64(0), EVENTS, active)
        self.lose(SEGMENTS, segments, active, memory)

    def collect_lanes(self, start: StartRays, memory: Memory) -> None:
        """Add the sums of each lane to the sums of its batch."""
        sums, batch = memory[SUMS], start.batch
        sums[-1].write(sums[-1].read(EVENTS_OF_LANE), EVENTS)

        # Zeros are left out, which saves atomic additions: most lanes have met few of the surfaces
        def step(k: mi.UInt32, sums: tuple[Any, ...]) -> tuple[mi.UInt32, tuple[Any, ...]]:
            for what in range(len(sums) - 1):
                value = sums[what].read(k, k < self.count)
                self._add_surface(k, what, batch, value, value != 0)
            value = sums[-1].read(k, k < LANE_REASONS)
            self.cut(k, batch, value, value != 0)
            return k + 1, sums

        count = dr.opaque(mi.UInt32, max(self.count, LANE_REASONS) if self._in_lanes else LANE_REASONS)
        dr.while_loop(
            (dr.zeros(mi.UInt32, dr.width(batch)), sums),
            lambda k, sums: k < count,
            step,
            mode="symbolic",
            label="collect",
        )

    def read(self) -> dict[str, np.ndarray]:
        """
        Return the sums by surface, medium and loss channel on the host, in units of a start ray's flux.

        Returns
        -------
        dict
            ``surfaces`` (surfaces + media, SURFACE_SUMS, BATCHES), ``media`` (media, BATCHES), ``channels``
            (CHANNEL_COUNT, BATCHES).
        """
        return {
            "surfaces": np.array(self.surfaces).reshape(-1, SURFACE_SUMS, BATCHES)[: self.count + self._media],
            "media": np.array(self.media).reshape(-1, BATCHES)[: self._media],
            "channels": np.array(self.channels).reshape(CHANNEL_COUNT, BATCHES),
        }

    def _add_surface(self, s: mi.UInt32, what: int, batch: mi.UInt32, value: Any, active: mi.Bool) -> None:
        """Add a count, or flux in units of a start ray's, to column `what` of the sums of surface or medium `s`."""
        index = (s * SURFACE_SUMS + what) * BATCHES + batch
        dr.scatter_reduce(dr.ReduceOp.Add, self.surfaces, mi.Float64(value), index, active)
