"""
Recorder of rays that hit a surface close to one of its rims, with their paths and their contributions to the metric.

A rim is the end of an analytic surface: clear radii, the sides of a rectangle, the ends of a cone or tube. Rays within
a narrow zone along it sample the light that a move of the rim would let pass or catch; `mistray.gradients.edges` forms
the derivative from them.
"""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.gradients.grazing import Grazing
from mistray.recorders.adjoint import GAIN
from mistray.recorders.branch_recorder import POINT_FLOATS, BranchRecorder
from mistray.recorders.recorder import Memory, Recorder, Return, Visit
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.gradient_columns import HALF_HEIGHT, HALF_WIDTH, HIGH, INNER, LOW, OUTER
from mistray.surfaces.surface import ENDS, RECTANGLE, ROUND
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

NO_EVENT = 0xFFFFFFFF
RIMS = "rims"  # key of the local arrays in the memory
FAR = 1e30  # mm, where there is no rim
SIDES = OUTER, INNER, HALF_WIDTH, HALF_HEIGHT, HIGH, LOW  # the first and the second rim of each coordinate
# State of a ray before a hit, by the fields of `StartRays`
STATE = {
    "batch": "UInt32",
    "medium": "UInt32",
    "depth": "UInt32",
    "reflections": "UInt32",
    "scatters": "UInt32",
    "key": "UInt64",
    "reference": "Float",
    "aimed_from": "UInt32",
    "run": "UInt32",
    "scale": "Float",
    "cell": "UInt32",
}


def rim_zones(
    table: SurfaceTable, width: float, limits: Mapping[tuple[int, int], float] | None = None
) -> dict[tuple[int, int], float]:
    """
    Return the widths of the boundary zones along all rims, mm, by surface and place in `RIM_COLUMNS`.

    Parameters
    ----------
    table : SurfaceTable
    width : float
        Width in units of the rim's radius or half side.
    limits : mapping, optional
        Upper limits of the widths of some zones, mm.
    """
    limits = limits or {}
    return {
        (piece.index, rim): min(zone, limits.get((piece.index, rim), np.inf))
        for piece in table.pieces
        for rim, zone in piece.zone_widths(width).items()
    }


class RimRecorder(Recorder):
    """
    Recorder of hits close to rims and of their contributions to a metric, before an `Adjoint` in a trace.

    Parameters
    ----------
    table : SurfaceTable
    width : float
        Width of the zones, in units of the rim's radius or half side.
    capacity : int
        Largest number of hits that are kept.
    max_events : int
        Number of events of the longest path.
    limits : mapping, optional
        See `rim_zones`.

    Attributes
    ----------
    zones : dict
        Result of `rim_zones`.
    paths : BranchRecorder
        Paths up to and including the hit; `weight` is the throughput on arrival, `heading` the direction of arrival.
    columns : dict
        Numbers of each hit, (capacity,) each: ``rim``, a place in `RIM_COLUMNS` or a jump of
        `mistray.gradients.grazing`; ``delta``, the distance from the rim, mm, or from the jump; ``scale``, see
        `mistray.gradients.grazing.Grazing.find`; ``copies``, the factor 1/p of a hit whose zone was chosen with
        probability p: 1, or 2 for each choice between two zones; ``gain``, the contribution to the metric of the hit
        and all events after it.
    axis : (capacity, 3) mi.Float
        Normal at the hit, on the side of transmission.
    before : dict
        Fields of `StartRays` → (capacity,) state of the ray before the hit.
    """

    node_floats = POINT_FLOATS

    def __init__(
        self,
        table: SurfaceTable,
        width: float,
        capacity: int,
        max_events: int,
        limits: Mapping[tuple[int, int], float] | None = None,
    ) -> None:
        self.zones = rim_zones(table, width, limits)
        bounds = np.tile([FAR, -FAR, 0.0, 0.0], (table.count, 1))
        kinds = np.zeros(table.count, dtype=np.uint32)
        for piece in table.pieces:
            i, kinds[piece.index] = piece.index, piece.rim_coordinate
            low, high = piece.reach
            if piece.rim_coordinate == RECTANGLE:
                high, low = piece.rim_sizes[HALF_WIDTH], -piece.rim_sizes[HALF_HEIGHT]
            for rim in piece.rim_sizes:
                column = SIDES.index(rim) % 2
                bounds[i, column], bounds[i, 2 + column] = (high, low)[column], self.zones[i, rim]
        self._families = table.families
        self._bounds, self._kinds = upload(mi.Float, bounds), upload(mi.UInt32, kinds)
        self.paths = BranchRecorder(capacity, max_events, points_only=True)
        self.grazing = Grazing(table, width)
        kinds_of = {"rim": mi.UInt32, "delta": mi.Float, "scale": mi.Float, "copies": mi.Float, "gain": mi.Float64}
        self.columns = {name: dr.zeros(kind, capacity) for name, kind in kinds_of.items()}
        self.axis = dr.zeros(mi.Float, 3 * capacity)
        self.before = {name: dr.zeros(getattr(mi, kind), capacity) for name, kind in STATE.items()}
        dr.eval(self.columns, self.axis, self.before)

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """Allocate each lane's arrays by depth: slot of the hit, and contribution to the metric before it."""
        memory[RIMS] = dr.alloc_local(mi.UInt32, max_events), dr.alloc_local(mi.Float64, max_events)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Record the hits that lie in the zone of a rim, silhouette or critical angle, with their paths."""
        it, state, valid = visit.interaction, visit.state, visit.active
        slots, before = memory[RIMS]
        depth = state["depth"]
        # Nearest rim or jump
        rim, delta, near, both = self._nearest(state["s"], it.local, valid)
        kind, distance, scale, near_jump = self.grazing.find(state["s"], it, state["d"], valid)
        # A hit is recorded once: between a rim and a jump a low-order bit of a coordinate chooses
        mixed = near & near_jump
        jumps = near_jump & (~near | ((dr.reinterpret_array(mi.UInt32, it.local.y) & 1) != 0))
        rim, delta = dr.select(jumps, kind, rim), dr.select(jumps, distance, delta)
        copies = dr.select(mixed, mi.Float(2), 1) * dr.select(both & ~jumps, mi.Float(2), 1)
        near |= near_jump

        def write(near: mi.Bool) -> mi.UInt32:
            weight = mi.Float64(state["w"])
            slot, kept = self.paths.write(visit, near, weight, heading=state["d"])
            for name, value in {"rim": rim, "delta": delta, "copies": copies, "scale": scale}.items():
                dr.scatter(self.columns[name], value, slot, kept)
            for j, component in enumerate(it.axis):
                dr.scatter(self.axis, component, 3 * slot + j, kept)
            start = visit.start
            of_start = {
                "batch": start.batch,
                "scale": start.given("scale", mi.Float(1)),
                "cell": start.given("cell", mi.UInt32(0)),
            }
            for name, values in self.before.items():
                dr.scatter(values, of_start[name] if name in of_start else state[name], slot, kept)
            return dr.select(kept, slot, NO_EVENT)

        # Few hits are close to a rim: the others skip the writes
        slot = dr.if_stmt(
            (near,), near, write, lambda near: mi.UInt32(NO_EVENT), arg_labels=("near",), mode="symbolic", label="rim"
        )
        slots.write(slot, depth, visit.visited)
        before.write(memory[GAIN], depth, near)

    def _nearest(self, s: mi.UInt32, q: mi.Vector3f, active: mi.Bool) -> tuple[mi.UInt32, mi.Float, mi.Bool, mi.Bool]:
        """Return the rim, the distance from it (mm), whether its zone holds the hit, and whether two zones do."""
        bounds = dr.gather(mi.Vector4f, self._bounds, s, active)
        kind = dr.gather(mi.UInt32, self._kinds, s, active)
        rho = dr.sqrt(dr.fma(q.x, q.x, q.y * q.y))
        along = dr.select(kind == ROUND, rho, dr.select(kind == ENDS, q.z, dr.abs(q.x)))
        across = dr.select(kind == RECTANGLE, -dr.abs(q.y), along)
        for here, family in self._families.members(s, active):
            place = family.coordinate(*q, self._families.numbers(family, s, here))
            along, across = dr.select(here, place, along), dr.select(here, place, across)
        to_first, to_second = dr.maximum(bounds.x - along, 0), dr.maximum(across - bounds.y, 0)
        near_first, near_second = active & (to_first < bounds.z), active & (to_second < bounds.w)
        both = near_first & near_second
        # Between two zones the last bit of a coordinate chooses
        odd = (dr.reinterpret_array(mi.UInt32, q.x) & 1) != 0
        first = near_first & (~both | odd)
        rim = 2 * kind + dr.select(first ^ (kind == ENDS), mi.UInt32(0), 1)
        return rim, dr.select(first, to_first, to_second), near_first | near_second, both

    def back(self, back: Return, memory: Memory) -> None:
        """Record the contributions to the metric of hits whose subtrees are complete."""
        (slots, before), gain, active = memory[RIMS], memory[GAIN], back.active

        def step(k):  # type: ignore[no-untyped-def]
            going = active & (k <= back.depth)
            slot = slots.read(k, going)
            here = going & (slot != NO_EVENT)
            dr.scatter(self.columns["gain"], gain - before.read(k, here), slot, here)
            return (k + 1,)

        dr.while_loop(
            (mi.UInt32(back.closed),), lambda k: active & (k <= back.depth), step, mode="symbolic", label="close rims"
        )
