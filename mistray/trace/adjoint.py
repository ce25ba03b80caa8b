"""The kernel run in reverse: derivatives of a metric by R and T of every surface, angle and side.

The weight of a branch is the product of the R and T along it, and a metric is known to first order by its derivative
by the flux of every hit of the detector. So a second walk with the same start rays, at each event, needs the sum of
derivative × flux over the subtree that the event leads to; divided by the event's own R or T it is the derivative by
that number. In depth-first order the sum over a subtree is the difference of a running total between entering and
leaving it. It is added to the two rows of the coating's table between which R or T was interpolated, so that what comes
out is the exact derivative of the traced metric by the rows. `mistray.trace.coating_gradient` goes on from the rows to
layers.

What it leaves out: children that the primal did not follow (R or T exactly 0, or below the flux threshold).
Source: the subtree sums are reverse-mode differentiation of a product over a tree; compare D. Vicini et al., "Path
replay backpropagation", ACM Trans. Graph. 40, 108 (2021).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.trace.books import Film
from mistray.trace.interaction import Interaction
from mistray.trace.ledger import BATCHES, Ledger
from mistray.trace.raw_gradient import MOMENTS
from mistray.trace.scatter_shares import Given

CHANNELS = 4  # R from the front, R from the back, T, R + T of an ideal coating beyond the critical angle


class Adjoint:
    """
    Sums of the derivatives of one metric.

    Parameters
    ----------
    rows : int
        Rows of the tables of R and T; 0: no derivatives by rows, only the total of each lane, see `walk`.
    pixel : (maps · pixels,) mi.Float, optional
        Derivative of the metric by the flux in each pixel of the film, for one or more groups of paths.
    path : (capacity · MOMENTS,) mi.Float64, optional
        For each path of the ledger the coefficients of 1, x, y, x², y², x y (mm, in the detector's frame) of the
        derivative of the metric by the flux of a hit at (x, y).
    map_of_slot : (capacity,) mi.UInt32, optional
        Number of the map + 1 of each path of the ledger, 0 for none; None: all hits count in the first map.

    Attributes
    ----------
    sums : (BATCHES, rows, CHANNELS) mi.Float64
        Derivatives of the metric by the rows, by batch of start rays; in units of a start ray's flux.
    unknown : (1,) mi.Float64
        Flux of hits by paths that the ledger does not know, whose derivative is taken to be 0.
    """

    def __init__(
        self,
        rows: int,
        pixel: mi.Float | None = None,
        path: mi.Float64 | None = None,
        map_of_slot: mi.UInt32 | None = None,
    ) -> None:
        self.rows, self.pixel, self.path, self.map_of_slot = rows, pixel, path, map_of_slot
        self.stride = dr.opaque(mi.UInt32, rows * CHANNELS)
        self.sums = dr.zeros(mi.Float64, BATCHES * rows * CHANNELS)
        self.unknown = dr.zeros(mi.Float64, 1)
        dr.eval(self.sums, self.unknown)

    def known(self, ledger: Ledger, key: mi.UInt64, flux: mi.Float, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """Slots of the paths of hits, and which of them the ledger knows."""
        slot, found = ledger.known(key, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.unknown, mi.Float64(flux), mi.UInt32(0), active & ~found)
        return slot, found

    def memory(self, max_events: int) -> tuple[Any, ...]:
        """Local arrays by depth: cell of the table, fraction, slope, running total when the event was entered."""
        if not self.rows:
            return ()
        return (
            dr.alloc_local(mi.UInt32, max_events),
            dr.alloc_local(mi.Float, max_events),
            dr.alloc_local(mi.Float, max_events),
            dr.alloc_local(mi.Float64, max_events),
        )

    def derivative(self, film: Film, x: mi.Float, y: mi.Float, slot: mi.UInt32 | None, active: mi.Bool) -> mi.Float64:
        """Derivative of the metric by the flux of a hit at (x, y), mm."""
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
            # Of a small spot far from the axis the terms nearly cancel
            far_x, far_y = mi.Float64(x), mi.Float64(y)
            terms = (1, far_x, far_y, far_x * far_x, far_y * far_y, far_x * far_y)
            for k, term in enumerate(terms):
                total += term * dr.gather(mi.Float64, self.path, slot * MOMENTS + k, active)
        return total

    def enter(
        self,
        memory: tuple[Any, ...],
        depth: mi.UInt32,
        it: Interaction,
        reflect: mi.Bool,
        slope: mi.Float,
        total: Any,
        active: mi.Bool,
    ) -> None:
        """Note the event at this depth, before its child is followed; `slope` is d ln(child's weight) / d(R or T)."""
        cells, fractions, slopes, totals = memory
        cells.write(it.place.row * CHANNELS + it.channel(reflect), depth, active)
        fractions.write(it.place.fraction, depth, active)
        slopes.write(slope, depth, active)
        totals.write(total, depth, active)

    def detected(
        self, it: Interaction, given: Given | None, batch: mi.UInt32, weighted: mi.Float, active: mi.Bool
    ) -> None:
        """A hit of the detector, which absorbs the rest; `weighted` is the derivative times the incident flux."""
        active = active & (weighted != 0)
        for reflect in (True, False):
            cell = it.place.row * CHANNELS + it.channel(mi.Bool(reflect))
            taken = weighted
            if given is not None:
                shares = given.reflection if reflect else given.transmission
                taken = weighted * (shares.kept + shares.slope)
            self._add(cell, it.place.fraction, batch, -taken, active)

    def leave(
        self,
        memory: tuple[Any, ...],
        batch: mi.UInt32,
        depth: mi.UInt32,
        last: mi.UInt32,
        total: mi.Float64,
        active: mi.Bool,
    ) -> None:
        """Close the events at the depths last … depth - 1, whose subtrees are complete."""
        cells, fractions, slopes, totals = memory

        def step(k):  # type: ignore[no-untyped-def]
            k = k - 1
            going = active & (k + 1 > last)
            subtree = total - totals.read(k, going)
            share = mi.Float(subtree) * slopes.read(k, going)
            self._add(cells.read(k, going), fractions.read(k, going), batch, share, going & (subtree != 0))
            return (k,)

        dr.while_loop((dr.select(active, depth, 0),), lambda k: active & (k > last), step, mode="symbolic")

    def _add(self, cell: mi.UInt32, fraction: mi.Float, batch: mi.UInt32, value: mi.Float, active: mi.Bool) -> None:
        index = batch * self.stride + cell
        low, high = mi.Float64(value * (1 - fraction)), mi.Float64(value * fraction)
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, low, index, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, high, index + CHANNELS, active & (fraction > 0))
