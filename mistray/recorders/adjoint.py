"""
Adjoint pass: derivatives of a metric with respect to R and T of every surface, angle and side.

The throughput of a branch is the product of the R and T along it. To first order a metric M follows from its derivative
with respect to the flux Φ of every hit of the detector. With x the R or T of an event,

    ∂M/∂x = (1/x) Σ (∂M/∂Φ) Φ over the hits in the subtree of the event.

A second pass over the same start rays computes these sums. In depth-first order the sum over a subtree is the
difference of a running total between entering and leaving it. The total is `GAIN`; `Branch.slope` is 1/x, or
d ln(throughput)/dx where the surface scatters. A sum is added to the two rows of the coating's table between which R or
T was interpolated. So the result is the exact derivative of the traced metric with respect to the rows.
`mistray.gradients.coating_gradient` continues from the rows to layers.

Children that the primal pass did not follow (R or T exactly 0, or below the flux threshold) are left out. The subtree
sums are reverse-mode differentiation of a product over a tree; compare D. Vicini et al., "Path replay
backpropagation", ACM Trans. Graph. 40, 108 (2021).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from mistray.recorders.direction_recorder import SkyRecorder
from mistray.recorders.film import Film
from mistray.recorders.ledger import Ledger
from mistray.recorders.path_derivative import MOMENTS
from mistray.recorders.recorder import Branch, Departure, Memory, Recorder, Return, Visit
from mistray.recorders.start_rays import StartRays
from mistray.settings import BATCHES

GAIN, EVENTS = "gain", "events"  # names of the per-lane state in the memory
CHANNELS = 4  # R from the front, R from the back, T, R + T of an ideal coating beyond the critical angle


class Adjoint(Recorder):
    """
    Recorder of the adjoint pass: derivatives of one metric with respect to R and T, by sums over subtrees of ray trees.

    Parameters
    ----------
    rows : int
        Number of rows of the tables of R and T; 0: no derivatives by row, only the gain of the metric from each lane.
    film : Film
        Pixel grid of the detector.
    pixel : (maps · pixels,) mi.Float, optional
        Derivative of the metric with respect to the flux in each pixel of the film, for one or more groups of paths;
        None: the metric does not depend on the pixel.
    path : (capacity · MOMENTS,) mi.Float64, optional
        For each path of the ledger the coefficients of 1, x, y, x², y², x y (x and y in mm, in the detector's frame) of
        the derivative of the metric with respect to the flux of a hit at (x, y). None: the metric does not depend on
        the path.
    map_of_slot : (capacity,) mi.UInt32, optional
        Index of the map + 1 of each path of the ledger, 0 for none; None: all hits contribute to the first map.
    ledger : Ledger, optional
        Ledger that holds the paths; None: `path` and `map_of_slot` are not given.
    light : SkyRecorder, optional
        Recorder that gives the gain of rays that leave the scene, or of rays that meet the detector, in place of
        `pixel` and `path`; None: the gain follows from these.

    Attributes
    ----------
    gain : (n,) mi.Float64
        Gain of the metric from each lane of the latest trace: derivative × flux, summed over its hits or, with `light`,
        over its rays that leave. The flux is in units of a start ray's.
    sums : (BATCHES, rows, CHANNELS) mi.Float64
        Derivatives of the metric with respect to the rows of R and T, by batch of start rays. They are in the unit of
        the derivative times that of a start ray's flux.
    unknown : (1,) mi.Float64
        Flux of hits by paths that are not in the ledger, in units of a start ray's flux; its derivative is taken as 0.
    """

    kernel_by = ("by_ray", "pixel", "path", "map_of_slot", "ledger", "light")

    def __init__(
        self,
        rows: int,
        film: Film,
        pixel: mi.Float | None = None,
        path: mi.Float64 | None = None,
        map_of_slot: mi.UInt32 | None = None,
        ledger: Ledger | None = None,
        light: SkyRecorder | None = None,
    ) -> None:
        self.rows, self.pixel, self.path, self.map_of_slot = rows, pixel, path, map_of_slot
        self.ledger, self.light, self._film = ledger, light, film
        self.incident = self.merges_aimed = light is not None and light.incident
        self.stride = dr.opaque(mi.UInt32, rows * CHANNELS)
        self.sums = dr.zeros(mi.Float64, BATCHES * rows * CHANNELS)
        self.unknown = dr.zeros(mi.Float64, 1)
        dr.make_opaque(self.sums, self.unknown)

    @property
    def by_ray(self) -> bool:
        """True if each lane handles one start ray only, as when there are no rows and `gain` is that of one ray."""
        return not self.rows

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """
        Set each lane's gain, the running sum of its contributions to the metric, to 0.

        If there are rows, allocate arrays by depth for cell, fraction, slope and gain.
        """
        memory[GAIN] = dr.zeros(mi.Float64, dr.width(start.lane))
        if self.rows:
            types = (mi.UInt32, mi.Float, mi.Float, mi.Float64)
            memory[EVENTS] = tuple(dr.alloc_local(dtype, max_events) for dtype in types)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """
        Add the contribution of each detector hit to the gain of its lane, and the detector's part to the derivatives.

        The contribution is the absorbed flux times the derivative of the metric with respect to it. Flux on paths that
        are not in the ledger is added to `unknown`. With `light` for the detector the contribution is
        `SkyRecorder.gain`, of incident flux, and R and T of the detector itself have no derivatives.
        """
        if self.light is not None and self.light.incident:
            memory[GAIN] = memory[GAIN] + self.light.gain(visit)
            return
        # The primal pass has filled the ledger; it is only read here
        if self.ledger is not None:
            slot, found = self.ledger.known(visit.key, visit.counted)
            unknown = visit.counted & ~found
            dr.scatter_reduce(dr.ReduceOp.Add, self.unknown, mi.Float64(visit.absorbed), mi.UInt32(0), unknown)
            visit.slot, visit.counted = slot, found
        # Gain: derivative × flux
        counted = visit.counted
        derivative = self._derivative(visit)
        gained = derivative * mi.Float64(visit.absorbed)
        memory[GAIN] = dr.select(counted, memory[GAIN] + gained, memory[GAIN])
        if self.rows:
            self._detected(visit, mi.Float(derivative) * visit.weight)

    def branch(self, branch: Branch, memory: Memory) -> None:
        """Store table cell, slope and gain so far of an R or T event, before its child is followed; only with rows."""
        if not self.rows:
            return
        it, depth, active = branch.interaction, branch.depth, branch.active
        cells, fractions, slopes, gains = memory[EVENTS]
        cells.write(it.place.row * CHANNELS + it.channel(branch.reflect), depth, active)
        fractions.write(it.place.fraction, depth, active)
        slopes.write(branch.slope, depth, active)
        gains.write(memory[GAIN], depth, active)

    def depart(self, departure: Departure, memory: Memory) -> None:
        """
        Add the contribution of each escaping ray to the metric to the gain of its lane.

        Only `light` for rays that leave the scene gives such a contribution, see `SkyRecorder.gain`. Otherwise nothing
        is added.
        """
        if self.light is not None and not self.light.incident:
            memory[GAIN] = memory[GAIN] + self.light.gain(departure)

    def back(self, back: Return, memory: Memory) -> None:
        """
        Add the derivatives with respect to R or T of events whose subtrees are complete: slope times subtree's gain.

        Without rows nothing is added.
        """
        if not self.rows:
            return
        cells, fractions, slopes, gains = memory[EVENTS]
        gain, last, active = memory[GAIN], back.last, back.active

        def step(k):  # type: ignore[no-untyped-def]
            k = k - 1
            going = active & (k + 1 > last)
            subtree = gain - gains.read(k, going)
            derivative = mi.Float(subtree) * slopes.read(k, going)
            found = going & (subtree != 0)
            self._add(cells.read(k, going), fractions.read(k, going), back.start.batch, derivative, found)
            return (k,)

        dr.while_loop((dr.select(active, back.depth, 0),), lambda k: active & (k > last), step, mode="symbolic")

    def collect_lanes(self, start: StartRays, memory: Memory) -> None:
        """Store the final gain of each lane, the metric's sum over its trees, in `gain`."""
        self.gain = memory[GAIN]

    def _derivative(self, visit: Visit) -> mi.Float64:
        """
        Return the derivative of the metric with respect to the flux of each detector hit.

        It is the sum of the parts by pixel and by path, as far as they are given, in their unit.
        """
        (x, y), slot, active, film = visit.position, visit.slot, visit.counted, self._film
        total = dr.zeros(mi.Float64, dr.width(x))
        if self.pixel is not None:
            here, first = active, mi.UInt32(0)
            if self.map_of_slot is not None:
                number = dr.gather(mi.UInt32, self.map_of_slot, slot, active)
                here = active & (number > 0)
                first = (number - 1) * (film.width * film.height)
            for pixel, share in film.places(x, y):
                value = dr.gather(mi.Float, self.pixel, first + pixel, here)
                total += mi.Float64(value if share is None else value * share)
        if self.path is not None:
            assert slot is not None
            # In double precision: for a small spot far from the axis the terms nearly cancel
            far_x, far_y = mi.Float64(x), mi.Float64(y)
            terms = (1, far_x, far_y, far_x * far_x, far_y * far_y, far_x * far_y)
            for k, term in enumerate(terms):
                total += term * dr.gather(mi.Float64, self.path, slot * MOMENTS + k, active)
        return total

    def _detected(self, visit: Visit, weighted: mi.Float) -> None:
        """
        Add derivatives with respect to R and T of the detector's own surface to the sums of their table cells.

        `weighted` is the derivative of the metric with respect to absorbed flux, times the incident flux.
        """
        # It absorbs the flux that it does not reflect, transmit or scatter
        it, shares = visit.interaction, visit.shares
        for reflect in (True, False):
            # In total reflection nothing is transmitted, and what an ideal coating would transmit is reflected
            active = visit.counted & (weighted != 0) & mi.Bool(reflect | ~it.tir)
            cell = it.place.row * CHANNELS + it.channel(mi.Bool(reflect))
            not_absorbed = weighted
            if shares is not None:
                share = shares.reflection if reflect else shares.transmission
                not_absorbed = weighted * (share.kept + share.slope)
            self._add(cell, it.place.fraction, visit.start.batch, -not_absorbed, active)

    def _add(self, cell: mi.UInt32, fraction: mi.Float, batch: mi.UInt32, value: mi.Float, active: mi.Bool) -> None:
        index = batch * self.stride + cell
        low, high = mi.Float64(value * (1 - fraction)), mi.Float64(value * fraction)
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, low, index, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, high, index + CHANNELS, active & (fraction > 0))
