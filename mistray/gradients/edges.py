"""
Boundary terms of rims: rays that hit a surface close to a rim, compared with rays that go past it.

Let Δ ≥ 0 be the distance of a hit from a rim: outer radius less ρ, ρ less inner radius, z less z_low and so on, in
the frame of the surface. If the rim moves outwards by dΔ relative to the rays, those that have just missed it hit the
surface. The metric then changes by the flux of rays per unit of Δ at the rim, times the difference of the contributions
of a ray that hits and one that goes past. The flux density is estimated from the rays with Δ < ε, weighted with the
one-sided linear boundary kernel (J. Fan and I. Gijbels, Local Polynomial Modelling and Its Applications, 1996, section
3.2)

    k(Δ) = (4 - 6 Δ/ε)/ε,   ∫ k dΔ = 1,   ∫ k Δ dΔ = 0   over 0 … ε,

so that the error goes with ε² where the density is smooth; `mistray.gradients.edge_widths` chooses ε. With c = k ·
(contribution of the hit - contribution past the rim) held fixed, the derivative of Σ c Δ with respect to any parameter
is that of the metric: Δ depends on the rim, on the surface and on all earlier hits of the path.

A rim is the end of an analytic surface: clear radii, the sides of a rectangle, the ends of a cone or tube. A ray past
the rim starts just outside it, in the direction of the ray that hit. Where another surface touches the rim, the edge is
the line in which both meet (see `mistray.gradients.edge_contacts`). A convex edge is described by the rays on either
surface; if both end there, each contributes half. The same goes for a concave edge, but there the rim itself does not
determine the edge. Δ follows from the distance D = F/|∇F| of the hit from the other surface, which `EdgeEvents.joined`
names: Δ = -D s/(n · u). Here n is the direction of the gradient, u the direction in which the rim ends the surface, and
s the component of u along the coordinate of Δ. The coefficient of D replaces that of Δ.

Silhouettes of curved surfaces and the onset of total reflection are treated the same way, with a distance and a
kernel of their own: see `mistray.gradients.grazing`.

Lines in which surfaces cross away from their rims are not covered, nor are rims of meshes and other Mitsuba shapes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.events import place_of
from mistray.gradients.edge_contacts import PAST, EdgeContacts
from mistray.gradients.edge_widths import rim_zones
from mistray.gradients.grazing import SILHOUETTE, Grazing, grazing_kernel
from mistray.gradients.recorded_rays import Portions
from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.launches import launches_of
from mistray.kernel.ray_tree import trace_tree
from mistray.recorders.adjoint import GAIN, Adjoint
from mistray.recorders.branch_recorder import NODE_FLOATS, BranchRecorder, as_many
from mistray.recorders.path_key import mixed_events
from mistray.recorders.recorder import Memory, Recorder, Return, Visit
from mistray.recorders.sampler import tree_seeds
from mistray.recorders.start_rays import StartRays
from mistray.settings import Settings
from mistray.surfaces.gradient_columns import HALF_HEIGHT, HALF_WIDTH, HIGH, INNER, LOW, OUTER, RIM_COLUMNS
from mistray.surfaces.surface import ENDS, NO_SURFACE, RECTANGLE, ROUND
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

CAPACITY = 1 << 17  # hits of a portion
FIRST_LANES = 1 << 12
TOO_MANY = (
    "a single start ray hits {count} times close to a rim, more than {capacity}; narrow the edge zones or lower "
    "max_reflections or max_scatters"
)
CLEAR = 1.25  # lift over a silhouette, in units of that which clears a sphere
STREAM = 0x3C6EF372  # separates the random numbers of rays past rims from all others
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


class RimRecorder(Recorder):
    """
    Recorder of hits close to rims and of their contributions to a metric, before an `Adjoint` in a trace.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    width : float
        Width of the zones, in units of the rim's radius or half side.
    capacity : int
        Largest number of hits that are kept.
    max_events : int
        Number of events of the longest path.
    limits : mapping, optional
        Upper limits of the widths of some zones, mm, see `rim_zones`.

    Attributes
    ----------
    zones : dict
        Widths of the zones, mm, from `rim_zones`.
    paths : BranchRecorder
        Paths up to and including the hit; `weight` is the throughput on arrival.
    columns : dict
        Values of each hit, (capacity,) each: ``rim``, a place in `RIM_COLUMNS` or a jump of
        `mistray.gradients.grazing`; ``delta``, the distance from the rim or silhouette, mm, or the dimensionless one
        from the critical angle; ``scale``, see `mistray.gradients.grazing.Grazing.find`; ``copies``, the factor 1/p of
        a hit whose zone was chosen with probability p: 1, or 2 for each choice between two zones; ``gain``, the
        contribution to the metric, in its unit, of the hit and all events after it.
    axis : (3 · capacity,) mi.Float
        Unit normal at each hit in the world, on the side of transmission: x, y and z in turn.
    before : dict
        Fields of `StartRays` → (capacity,) state of the ray before the hit.
    """

    node_floats = NODE_FLOATS - 1

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
        self.paths = BranchRecorder(capacity, max_events)
        self.grazing = Grazing(table, width)
        kinds_of = {"rim": mi.UInt32, "delta": mi.Float, "scale": mi.Float, "copies": mi.Float, "gain": mi.Float64}
        self.columns = {name: dr.zeros(kind, capacity) for name, kind in kinds_of.items()}
        self.axis = dr.zeros(mi.Float, 3 * capacity)
        self.before = {name: dr.zeros(getattr(mi, kind), capacity) for name, kind in STATE.items()}
        dr.eval(self.columns, self.axis, self.before)

    def begin(self, start: StartRays, max_events: int, memory: Memory) -> None:
        """Allocate arrays by depth in each lane: slot of each recorded hit, and the metric's running sum before it."""
        memory[RIMS] = dr.alloc_local(mi.UInt32, max_events), dr.alloc_local(mi.Float64, max_events)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Record hits within the zone of a rim, silhouette or critical angle, with their paths."""
        it, state, valid = visit.interaction, visit.state, visit.active
        slots, before = memory[RIMS]
        depth = state["depth"]
        # Nearest rim or jump
        rim, delta, near, both = self._nearest(state["s"], it.local, valid)
        kind, distance, scale, near_jump = self.grazing.find(state["s"], it, state["d"], valid)
        # A hit is recorded once: between a rim and a jump a random bit chooses
        mixed = near & near_jump
        jumps = near_jump & (~near | ((_random_bits(it.local) & 1) != 0))
        rim, delta = dr.select(jumps, kind, rim), dr.select(jumps, distance, delta)
        copies = dr.select(mixed, mi.Float(2), 1) * dr.select(both & ~jumps, mi.Float(2), 1)
        near |= near_jump

        def write(near: mi.Bool) -> mi.UInt32:
            weight = mi.Float64(state["w"])
            slot, kept = self.paths.write(visit, near, weight)
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
        """
        Return the rim whose zone each hit lies in, the distance from it, mm, and masks of hits in a zone, in two zones.

        `q` are the hits in the frames of their surfaces `s`, mm. In two zones a random bit chooses the rim.
        """
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
        # Between two zones a random bit chooses
        first = near_first & (~both | ((_random_bits(q) & 2) != 0))
        rim = 2 * kind + dr.select(first ^ (kind == ENDS), mi.UInt32(0), 1)
        return rim, dr.select(first, to_first, to_second), near_first | near_second, both

    def back(self, back: Return, memory: Memory) -> None:
        """Store, for recorded hits whose subtrees are complete, what the subtree contributes to the metric."""
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


@dataclass
class EdgeEvents:
    """
    Hits close to rims, with the coefficients c of their distance Δ in the derivative of a metric.

    Attributes
    ----------
    paths : BranchRecorder
        Paths up to and including the hits; points only.
    row : (n,) mi.UInt32
        Rows of the hits in `paths`.
    rim : (n,) mi.UInt32
        Rim, as a place in `RIM_COLUMNS`, or a jump of `mistray.gradients.grazing`.
    joined : (n,) mi.UInt32
        Surface that meets the rim in a concave edge; `NO_SURFACE` for all others.
    scale : (n,) mi.Float
        Radius of curvature at a silhouette, mm, or n_i/n_t at the critical angle; unset at rims.
    c : list of (n,) mi.Float64
        Coefficients of Δ for each width, in the metric's unit per mm, or per 1 at the critical angle. Where there is a
        `joined` surface, they are those of the distance F/|∇F| from it.
    """

    paths: BranchRecorder
    row: mi.UInt32
    rim: mi.UInt32
    joined: mi.UInt32
    scale: mi.Float
    c: list[mi.Float64]


class Edges:
    """
    Estimator of the boundary terms of a metric's derivative at rims, for forward or backward rays.

    Parameters
    ----------
    scene : KernelScene
        Scene at the wavelength.
    settings : Settings
        Settings of the trace.
    widths : sequence of float
        Widths of the zones along the rims, in units of their radius or half side, the widest first. If the widest zones
        of a surface are narrowed so that they do not overlap, all others are smaller in proportion.
    limits : mapping, optional
        Widths of narrower zones of some rims, mm, see `mistray.gradients.full.full_rims`.
    """

    def __init__(
        self,
        scene: KernelScene,
        settings: Settings,
        widths: Sequence[float],
        limits: Mapping[tuple[int, int], float] | None = None,
    ) -> None:
        table, width = scene.table, widths[0]
        self._relative_widths = [w / width for w in widths]
        self._scene, self._table, self._settings = scene, table, settings
        capacity = as_many(CAPACITY, settings.max_events)
        self._near = RimRecorder(table, width, capacity, settings.max_events, limits)
        self._portions = Portions(self._near.paths, FIRST_LANES, TOO_MANY)
        self._launches = launches_of(table, settings, Edges, scene.backward, scene.competing is not None)
        rims = len(RIM_COLUMNS)
        sizes = np.zeros((table.count, rims, 2))
        for (surface, rim), zone in self._near.zones.items():
            sizes[surface, rim] = table.pieces[surface].rim_sizes[rim], zone
        self._sizes, self._contacts = upload(mi.Float, sizes), EdgeContacts(table)

    def events(self, start: StartRays, adjoint: Adjoint) -> Iterator[tuple[StartRays, EdgeEvents]]:
        """
        Yield the hits close to rims in the ray trees of start rays, in portions of a bounded size.

        Parameters
        ----------
        start : StartRays
            Start rays to trace.
        adjoint : Adjoint
            Adjoint of the metric, without derivatives with respect to rows of coating tables.

        Yields
        ------
        start : StartRays
            Rays of the portion.
        events : EdgeEvents
            Hits of the portion, valid until the next one.

        Raises
        ------
        MistrayError
            If a single start ray has more hits than can be kept.
        """

        def record(part: StartRays, _: BranchRecorder) -> None:
            self._launches.time(dr.width(part.lane), lambda: self._gains(part, adjoint, self._near))

        for part, hits in self._portions.of(start, record, lambda: self._launches.lanes):
            found = self._compare(hits, adjoint) if hits else None
            if found is not None:
                yield part, found

    def _gains(self, start: StartRays, adjoint: Adjoint, rims: RimRecorder | None = None) -> mi.Float64:
        """
        Return each start ray's contribution to the metric, summed over its tree, in the metric's unit.

        If `rims` is given, it records the hits close to rims on the way.
        """
        trace_tree(self._scene, start, self._settings, [rims, adjoint])
        dr.eval(adjoint.gain)
        dr.sync_thread()
        return adjoint.gain

    def _compare(self, hits: int, adjoint: Adjoint) -> EdgeEvents | None:
        """
        Trace rays that just miss the rims, to compare them with the recorded hits, `hits` in number.

        Return the hits that change the metric, with their coefficients in the derivative; None if there is no such hit.
        """
        near, row = self._near, dr.arange(mi.UInt32, hits)
        rim, delta, scale, copies, found_gain = (dr.gather(type(v), v, row) for v in near.columns.values())
        # Contribution of the hit less that past the rim
        start, place, factor, joined = self._past(row, (rim, delta, scale), adjoint.light is not None)
        gain = found_gain - self._gains(start, adjoint)
        gain *= factor * mi.Float64(copies)
        # Hits that contribute; all that is gathered is in memory, or each array would be computed again
        dr.eval(gain)
        counts = dr.compress(gain != 0)
        if not dr.width(counts):
            return None
        arrays = (row, rim, delta, scale, gain, place, joined)
        row, rim, delta, scale, gain, place, joined = (dr.gather(type(v), v, counts) for v in arrays)
        # Width of the zone; of jumps in the square of a cosine, see `mistray.gradients.grazing`
        zone = dr.gather(mi.Float, self._sizes, 2 * place + 1)
        jumps, grazes = rim >= SILHOUETTE, rim == SILHOUETTE
        zone = dr.select(jumps, near.grazing.zone * dr.select(grazes, 0.5 * scale, 1), zone)

        def density(width: mi.Float) -> mi.Float64:
            distance, width = mi.Float64(delta), mi.Float64(width)
            return dr.select(jumps, grazing_kernel(distance, width), kernel(distance, width))

        # c = k · gain for each width
        c = [gain * density(relative * zone) for relative in self._relative_widths]
        dr.eval(row, rim, joined, scale, c)
        return EdgeEvents(near.paths, row, rim, joined, scale, c)

    def _past(
        self, row: mi.UInt32, jump: tuple[mi.UInt32, mi.Float, mi.Float], classed: bool
    ) -> tuple[StartRays, mi.UInt32, mi.Float64, mi.UInt32]:
        """
        Return start data of rays that just miss the rims; `jump` holds rim or kind of jump, distance and scale.

        `row` are the rows of the recorded hits, and `classed` says whether the metric asks for the path classes of
        rays. With the start come the rim's place in tables of (surfaces, rims), the factor of the coefficient, see
        `mistray.gradients.edge_contacts.Corner`, and `EdgeEvents.joined`.
        """
        near, jumps = self._near, jump[0] >= SILHOUETTE
        rim = dr.select(jumps, 0, jump[0])
        # Last event of the recorded path: surface, point, direction of arrival, throughput
        length = dr.gather(mi.UInt32, near.paths.length, row)
        whole = dr.full(mi.Bool, True, dr.width(row))
        hit = near.paths.node(row, length - 1, whole)
        p, d, s = hit.p, hit.d, place_of(hit.code)
        w = mi.Float(dr.gather(mi.Float64, near.paths.weight, row))
        before = {name: dr.gather(type(v), v, row) for name, v in near.before.items()}
        # Start beside the edge, in the direction of the ray that hit
        corner, o = self._contacts.past(s, rim, p, d, before["depth"] == 0, ~jumps)
        key = before["key"]
        # The order of the rows varies from run to run: the seed of each ray comes from its path and its hit
        bits = dr.reinterpret_array(mi.UInt32, p.x) ^ (dr.reinterpret_array(mi.UInt32, p.y) * 0x85EBCA6B)
        lane = dr.gather(mi.UInt32, near.paths.lane, row)
        own = mi.UInt32(key) ^ mi.UInt32(key >> 32) ^ bits
        seed = tree_seeds(self._settings.seed ^ STREAM, own)
        # Assemble the start rays; jumps have a start of their own
        left = dr.select(corner.left == NO_SURFACE, s, corner.left)
        o, d, left, at = self._jump(row, jump, p, s, (o, d, left, corner.at))
        # Part of the events before the hit in the number of the path class
        path_class, none = None, dr.zeros(mi.UInt32, dr.width(row))
        if classed:
            path_class = mixed_events(partial(near.paths.event_code, row), none, length - 1, none, whole)
        start = StartRays(lane=lane, seed=seed, o=o, d=d, w=w, left=left, at=at, path_class=path_class, **before)
        place = s * len(RIM_COLUMNS) + rim
        factor, joined = dr.select(jumps, 1, corner.factor), dr.select(jumps, NO_SURFACE, corner.joined)
        dr.eval(vars(start), place, factor, joined)
        return start, place, factor, joined

    def _jump(
        self,
        row: mi.UInt32,
        jump: tuple[mi.UInt32, mi.Float, mi.Float],
        p: mi.Vector3f,
        s: mi.UInt32,
        others: tuple[Any, ...],
    ) -> Any:
        """
        Return start data of rays past a jump: origin (mm), direction, surface that is left, surface that is met.

        Lanes without a jump keep those in `others`. `p` are the recorded hits, mm, and `s` their surfaces; `row` and
        `jump` are those of `_past`.
        """
        (kind, delta, scale), (o, d, left, at) = jump, others
        grazes, critical = kind == SILHOUETTE, kind > SILHOUETTE
        jumps = grazes | critical
        axis = mi.Vector3f(*(dr.gather(mi.Float, self._near.axis, 3 * row + j, jumps) for j in range(3)))
        # Past a silhouette: slightly above the surface where the ray is nearest to it, even if it is more curved there
        depth = scale * (dr.rsqrt(1 - 2 * delta / scale) - 1)
        o = dr.select(grazes, p - (CLEAR * depth + PAST * scale) * axis, dr.select(critical, p, o))
        # Beyond the critical angle: in the same plane of incidence, at the same place
        sine = dr.sqrt(1 + PAST) / scale
        aside = dr.normalize(d - dr.dot(d, axis) * axis)
        beyond = dr.sqrt(dr.maximum(1 - dr.square(sine), 0)) * axis + sine * aside
        d = dr.select(critical, beyond, d)
        return o, d, dr.select(jumps, NO_SURFACE, left), dr.select(critical, s, dr.select(grazes, NO_SURFACE, at))


def _random_bits(q: mi.Vector3f) -> mi.UInt32:
    """Return two random bits for each point q, mm, by a hash: the last bits of coordinates off the axis may be 0."""
    x, y = (dr.reinterpret_array(mi.UInt32, coordinate) for coordinate in (q.x, q.y))
    return (x * 0x9E3779B1 ^ y * 0x85EBCA6B) >> 30


def kernel(delta: Any, width: Any) -> Any:
    """Return the one-sided linear boundary kernel k, 1/mm, at a distance Δ from the rim; 0 beyond its width ε."""
    return dr.select(delta < width, (4 - 6 * delta / width) / width, 0)
