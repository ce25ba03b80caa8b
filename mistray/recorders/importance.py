"""
Importance of scatter events: contributions of paths by surface, approach and place.

Weight windows follow from it, see `mistray.kernel.kernel_scene.WeightWindows`. Rows are the same for both directions,
so that a path which a backward ray has found also tells forward rays where they matter.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.events import EVENT_BITS, FIRST_SCATTERED, kind_of, place_of, stays
from mistray.recorders.path_key import COUNT_MASK, NO_EVENT
from mistray.recorders.recorder import Departure, Memory, Visit
from mistray.recorders.sampler import mixed_word

WAYS = 1024  # approaches and places at a surface that are told apart by hashing; more of them share rows
PLACES = "places of scatter events"  # entry of the memory of lanes
BACK = 1  # bit of a place: the light comes from the back


def window_row(surface: mi.UInt32, place: mi.UInt32, before: mi.UInt32, scatters: mi.UInt32) -> mi.UInt32:
    """
    Return the row of a hit in importance tables of (surfaces · `WAYS`,) entries.

    Parameters
    ----------
    surface : mi.UInt32
        Index of the surface.
    place : mi.UInt32
        Part of the surface that is hit, and the side that the light comes from, as bit `BACK`.
    before : mi.UInt32
        Code of the event before, of which only the surface counts, or `NO_EVENT`.
    scatters : mi.UInt32
        Number of scatter events before.
    """
    word = place + (before >> EVENT_BITS) * 0x9E3779B1 + scatters * 0x7FEB352D
    return surface * WAYS + mixed_word(word) % WAYS


class ImportanceSums:
    """
    Sums by `window_row` of the throughput that arrives at scattering surfaces, and of contributions of paths by them.

    Parameters
    ----------
    surfaces : int
        Number of surfaces.
    """

    def __init__(self, surfaces: int) -> None:
        self._surfaces = surfaces
        # Sums of `read`, each with its squares
        self._sums = [dr.zeros(mi.Float64, surfaces * WAYS) for _ in range(6)]
        self._placed = False
        dr.make_opaque(self._sums)

    def begin(self, max_events: int, memory: Memory) -> None:
        """Allocate memory for the place of each event on the path of a lane."""
        # Nothing has a place before the first visit; where media scatter, there are no weight windows, nor places
        self._placed = False
        memory[PLACES] = dr.alloc_local(mi.UInt32, max_events)

    def _add(self, first: int, value: mi.Float64, row: mi.UInt32, active: mi.Bool) -> None:
        for k, one in enumerate((value, value * value)):
            dr.scatter_reduce(dr.ReduceOp.Add, self._sums[first + k], one, row, active)

    def arrive(self, visit: Visit, weight: mi.Float64, memory: Memory) -> None:
        """
        Add the weight of rays that arrive at scattering surfaces, and keep the places of all hits in `memory`.

        `weight` is the throughput in units of a start ray's flux; forward rays have it times the value of their cell.
        """
        if visit.shares is None or visit.window_place is None:
            return
        self._placed = True
        memory[PLACES].write(visit.window_place, visit.depth, visit.visited)
        active = visit.active & (visit.shares.scattered > 0)
        before, scatters = visit.before(active), visit.state["scatters"] & COUNT_MASK
        self._add(0, weight, window_row(visit.surface, visit.window_place, before, scatters), active)

    def contribute(
        self,
        end: Visit | Departure,
        length: mi.UInt32,
        value: mi.Float64,
        forward: mi.Float,
        active: mi.Bool,
        memory: Memory,
    ) -> None:
        """
        Add the contribution of complete paths to the rows of their scatter events.

        Parameters
        ----------
        end : Visit or Departure
            End of the paths, at the detector or out of the scene.
        length : mi.UInt32
            Number of their events before the end.
        value : mi.Float64
            Contribution of these rays: MIS-weighted throughput times the value of its cell.
        forward : mi.Float
            MIS weight of forward rays on the same paths.
        active : mi.Bool
            Lanes that contribute.
        memory : dict
            Memory of the lanes, with the places of the events.
        """
        if not self._placed:
            return
        places, width = memory[PLACES], dr.width(active)
        # The last scatter event of a connected ray, at its light vertex, has no place
        connected, backward = mi.Bool(False), isinstance(end, Departure)
        total = (end.scatters if isinstance(end, Departure) else end.state["scatters"]) & COUNT_MASK
        if isinstance(end, Departure) and end.light_vertex is not None:
            connected = end.light_vertex != 0

        def on(k: mi.UInt32, before: mi.UInt32, order: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
            going = active & (k < length)
            code = end.event(k, going)
            surface = place_of(code)
            scattered = going & (kind_of(code) >= FIRST_SCATTERED)
            # Media scatter too, but have no rows
            here = scattered & ~(connected & (order + 1 == total)) & (surface < self._surfaces)
            place = places.read(k, here)
            row = window_row(surface, place, before, order)
            self._add(2, value, row, here)
            if backward:
                # Forward rays come from the event behind, and from the other side if the light is transmitted
                behind = going & (k + 1 < length)
                after = dr.select(behind, end.event(k + 1, behind), mi.UInt32(NO_EVENT))
                other_side = place ^ dr.select(stays(code), mi.UInt32(0), BACK)
                row = window_row(surface, other_side, after, total - 1 - order)
            self._add(4, value * forward, row, here)
            return k + 1, code, order + dr.select(scattered, mi.UInt32(1), 0)

        dr.while_loop(
            (dr.zeros(mi.UInt32, width), dr.full(mi.UInt32, NO_EVENT, width), dr.zeros(mi.UInt32, width)),
            lambda k, *_: active & (k < length),
            on,
            mode="symbolic",
            label="importance",
        )

    def read(self) -> np.ndarray:
        """
        Return the sums on the host.

        Returns
        -------
        (3, 2, n, WAYS) float64
            Sums of three quantities and of their squares, by surface (n) and way. First, the weight that arrives, see
            `arrive`. Second, the contribution that follows from it. Third, the contribution times the MIS weight of
            forward rays, in the rows of forward rays. The third sums of both directions add up to the contribution of
            forward rays, estimated from the paths of both.
        """
        found: Any = [np.array(one) for one in self._sums]
        return np.array(found).reshape(3, 2, self._surfaces, WAYS)
