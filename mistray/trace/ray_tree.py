"""The kernel: every lane walks the whole ray tree of its start ray, depth first.

A lane holds one node at a time: a point on a surface, reached along a direction with a weight (its flux in units of
the start ray's). At its first visit a node sends on its transmitted child and, if the reflected child is worth it,
marks its depth as pending; when a branch ends the lane returns to the deepest pending node and sends on the reflected
child. The nodes of the current path lie in local memory, indexed by depth, so the path is always at hand and nothing
can overflow below `max_events`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.trace.interaction import counts_as_reflection, interact
from mistray.trace.intersect import Intersector
from mistray.trace.ledger import (
    ABSORBED,
    BATCHES,
    EVENT_BITS,
    FIRST_KEY,
    REFLECTED,
    TOTAL,
    TRANSMITTED,
    Ledger,
    extend_key,
)
from mistray.trace.settings import Settings
from mistray.trace.surfaces import DETECTOR, NO_LOSS, NO_SURFACE, SurfaceTable

# Rows of the tally: what is not tied to a surface
ESCAPED, THRESHOLD, ROULETTE, REFLECTIONS, EVENTS, MEDIUM, SEGMENTS, FIRST_MISS, STARTED = range(9)
REASONS = 9
HITS, INCIDENT, ABSORBED_HERE = range(3)
NODE_FLOATS = 8
GRAZING = 0.01  # smallest cosine that counts when a ray leaves a stock surface behind


class Tallies:
    """Float64 sums by batch: three for each surface, one for each reason, and the film with its squares."""

    def __init__(self, surfaces: int, pixels: int, maps: int = 0) -> None:
        self.surfaces = dr.zeros(mi.Float64, surfaces * 3 * BATCHES)
        self.reasons = dr.zeros(mi.Float64, REASONS * BATCHES)
        self.film = dr.zeros(mi.Float64, pixels * max(maps, 1) * 2)
        dr.eval(self.surfaces, self.reasons, self.film)

    def add_reason(self, reason: int, batch: mi.UInt32, value: Any, active: mi.Bool) -> None:
        """Book flux (or a count) under a reason."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.reasons, mi.Float64(value), reason * BATCHES + batch, active)

    def add_surface(self, s: mi.UInt32, what: int, batch: mi.UInt32, value: Any, active: mi.Bool) -> None:
        """Book hits, incident or absorbed flux at a surface."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.surfaces, mi.Float64(value), (s * 3 + what) * BATCHES + batch, active)


@dataclass
class Film:
    """
    Pixel grid of the detector.

    Attributes
    ----------
    width, height : int
    x0, y0, per_mm_x, per_mm_y : mi.Float
        Corner (mm) and pixels per mm, opaque.
    map_of_slot : mi.UInt32 or None
        For maps of single paths: number of the map + 1 for each ledger slot, 0 for none.
    """

    width: int
    height: int
    x0: mi.Float
    y0: mi.Float
    per_mm_x: mi.Float
    per_mm_y: mi.Float
    map_of_slot: mi.UInt32 | None = None

    def pixel(self, x: mi.Float, y: mi.Float) -> mi.UInt32:
        """Number of the pixel that holds a point of the detector, row 0 at the smallest y."""
        column = dr.clip(mi.Int32((x - self.x0) * self.per_mm_x), 0, self.width - 1)
        row = dr.clip(mi.Int32((y - self.y0) * self.per_mm_y), 0, self.height - 1)
        return mi.UInt32(row * self.width + column)


@dataclass
class StartRays:
    """
    Rays as they leave a source.

    Attributes
    ----------
    lane : mi.UInt32
        Numbers of the start rays within the trace.
    batch : mi.UInt32
        Batch of each ray, for standard errors.
    rng : mi.PCG32
        One generator a lane.
    o, d : mi.Vector3f
        Origins (mm) and unit directions.
    """

    lane: mi.UInt32
    batch: mi.UInt32
    rng: mi.PCG32
    o: mi.Vector3f
    d: mi.Vector3f

    def take(self, index: mi.UInt32) -> StartRays:
        """Some of the rays."""
        rng = mi.PCG32()
        rng.state, rng.inc = (dr.gather(mi.UInt64, v, index) for v in (self.rng.state, self.rng.inc))
        lane, batch = (dr.gather(mi.UInt32, v, index) for v in (self.lane, self.batch))
        o, d = (dr.gather(mi.Vector3f, v, index) for v in (self.o, self.d))
        dr.eval(lane, batch, rng, o, d)
        return StartRays(lane, batch, rng, o, d)


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


def _read(memory: Any, k: mi.UInt32, active: mi.Bool) -> tuple[mi.Vector3f, mi.Vector3f, mi.Float]:
    v = [memory.read(k * NODE_FLOATS + j, active) for j in range(7)]
    return mi.Vector3f(*v[:3]), mi.Vector3f(*v[3:6]), v[6]


def walk(
    table: SurfaceTable,
    intersector: Intersector,
    start: StartRays,
    settings: Settings,
    tallies: Tallies,
    film: Film,
    ledger: Ledger | None,
    recorder: Recorder | None = None,
    box: mi.Vector4f | None = None,
) -> None:
    """
    Trace the trees of a set of start rays; results are added to the tallies, the film, the ledger and the recorder.

    Parameters
    ----------
    start : StartRays
        One lane each, all of weight 1.
    box : mi.Vector4f, optional
        Only detector hits with x0 ≤ x ≤ x1, y0 ≤ y ≤ y1 (mm) enter the ledger.
    """
    o, d, batch, lane, rng = start.o, start.d, start.batch, start.lane, mi.PCG32(start.rng)
    n = dr.width(o)
    max_events = settings.max_events
    has_stock = table.stock_scene is not None
    threshold = dr.opaque(mi.Float, settings.flux_threshold)
    max_reflections = dr.opaque(mi.UInt32, settings.max_reflections)
    keep_nodes = recorder is not None
    split, roulette = settings.splitting == "split", settings.below_threshold == "roulette"

    # A Local array takes an index of traced size 1 as uniform over the lanes: every index must start at full width
    def full(value: int = 0) -> mi.UInt32:
        return dr.full(mi.UInt32, value, n)

    nodes = dr.alloc_local(mi.Float, max_events * NODE_FLOATS)
    codes = dr.alloc_local(mi.UInt32, max_events)
    words = dr.alloc_local(mi.UInt32, max_events)
    keys = dr.alloc_local(mi.UInt64, max_events)
    normals = dr.alloc_local(mi.Float, max_events * 3 if has_stock else 1)

    # First segment: from the source to the first surface
    t, s, normal = _next_hit(table, intersector, o, d, full(NO_SURFACE), mi.Bool(True))
    hit = s != NO_SURFACE
    tallies.add_reason(ESCAPED, batch, 1.0, ~hit)
    tallies.add_reason(FIRST_MISS, batch, 1.0, ~hit)
    tallies.add_reason(STARTED, batch, 1.0, mi.Bool(True))

    state = {
        "active": hit,  # the lane has a node to visit
        "again": dr.full(mi.Bool, False, n),  # it is a second visit, for the reflected child
        "p": dr.fma(t, d, o),  # the node
        "d": mi.Vector3f(d),  # direction in which it was reached
        "w": dr.full(mi.Float, 1, n),  # weight with which it was reached
        "s": dr.select(hit, s, 0),  # its surface
        "normal": normal,  # there, if the surface is stock
        "medium": full(0),  # material of the segment that led to it; 0 is not known
        "depth": full(0),  # events before it
        "reflections": full(0),  # counted reflections before it
        "key": dr.full(mi.UInt64, FIRST_KEY, n),  # of the events before it
        "pending": dr.zeros(mi.UInt64, n),  # bit k: the reflected child of the node at depth k is still to come
        "segments": full(1),
        "rng": rng,
        "memory": (nodes, codes, words, keys, normals),
    }

    def body(state: dict[str, Any]) -> dict[str, Any]:
        active, again, d, w, s, depth = (state[k] for k in ("active", "again", "d", "w", "s", "depth"))
        nodes, codes, words, keys, normals = state["memory"]
        rng = state["rng"]
        first = active & ~again
        it = interact(table, state["p"], d, s, state["normal"] if has_stock else None, active)
        p = it.p

        # ---- books of a first visit
        strayed = first & (state["medium"] != 0) & (it.medium_in != 0) & (it.medium_in != state["medium"])
        tallies.add_reason(MEDIUM, batch, w, strayed)
        first &= ~strayed
        R, T = it.R, it.T
        loss = 1 - R - T
        absorbed = dr.select(dr.abs(loss) < NO_LOSS, 0, w * loss)
        tallies.add_surface(s, HITS, batch, 1.0, first)
        tallies.add_surface(s, INCIDENT, batch, w, first)
        tallies.add_surface(s, ABSORBED_HERE, batch, absorbed, first & (absorbed > 0))

        detected = first & ((it.word & DETECTOR) != 0) & (absorbed > 0)
        x, y = _film_coordinates(table, it)
        key = extend_key(state["key"], (s << EVENT_BITS) | ABSORBED)

        def event(k: mi.UInt32, mask: mi.Bool) -> mi.UInt32:
            return dr.select(k < depth, codes.read(k, mask & (k < depth)), (s << EVENT_BITS) | ABSORBED)

        if ledger is not None:
            booked = detected
            if box is not None:
                booked = detected & (x >= box.x) & (x <= box.y) & (y >= box.z) & (y <= box.w)
            slot, booked, new = ledger.find(key, booked)
            ledger.record(slot, batch, w, absorbed, x, y, booked)
            ledger.write_events(slot, depth + 1, event, new)
        if recorder is not None:
            _record(
                recorder, nodes, event, detected & ((recorder.key == 0) | (recorder.key == key)), p, d, w, depth, lane
            )
        pixel = film.pixel(x, y)
        on_film = detected
        if film.map_of_slot is not None:
            assert ledger is not None
            number = dr.gather(mi.UInt32, film.map_of_slot, slot, booked)
            on_film = booked & (number > 0)
            pixel += (number - 1) * (film.width * film.height)
        flux = mi.Float64(absorbed)
        dr.scatter_reduce(dr.ReduceOp.Add, tallies.film, flux, 2 * pixel, on_film)
        dr.scatter_reduce(dr.ReduceOp.Add, tallies.film, flux * flux, 2 * pixel + 1, on_film)

        # ---- children
        visit = first | (active & again)
        counted = counts_as_reflection(it)
        reflections = state["reflections"]
        room = depth + 1 < max_events
        may_reflect = ~counted | (reflections < max_reflections)
        w_t, w_r = w * T, w * R
        tallies.add_reason(EVENTS, batch, w_t + w_r, first & ~room & (T + R > 0))
        tallies.add_reason(REFLECTIONS, batch, w_r, first & room & ~may_reflect & (R > 0))
        w_t = dr.select(room, w_t, 0)
        w_r = dr.select(room & may_reflect, w_r, 0)

        if split:
            if not roulette:
                cut_t, cut_r = w_t < threshold, w_r < threshold
                cut = dr.select(cut_t, w_t, 0) + dr.select(cut_r, w_r, 0)
                tallies.add_reason(THRESHOLD, batch, cut, first & (cut > 0))
                w_t, w_r = dr.select(cut_t, 0, w_t), dr.select(cut_r, 0, w_r)
            reflect = again | (w_t == 0)
            push = first & ~reflect & (w_r > 0)
            child = dr.select(reflect, w_r, w_t)
        else:
            total = w_t + w_r
            reflect = rng.next_float32() * total >= w_t
            push = mi.Bool(False)
            child = total
            if not roulette:
                tallies.add_reason(THRESHOLD, batch, total, first & (total < threshold) & (total > 0))
                child = dr.select(total < threshold, 0, total)
        if roulette:
            small = visit & (child > 0) & (child < threshold)
            survives = rng.next_float32() * threshold < child
            rolled = dr.select(small, dr.select(survives, threshold, 0), child)
            tallies.add_reason(ROULETTE, batch, child - rolled, small)
            child = rolled

        go = visit & (child > 0)
        # ---- keep the node: for its second visit, and as part of the path
        kept = (push | go) if keep_nodes else push
        for j, value in enumerate((p.x, p.y, p.z, d.x, d.y, d.z, w)):
            nodes.write(value, depth * NODE_FLOATS + j, kept)
        if has_stock:
            for j in range(3):
                normals.write(state["normal"][j], depth * 3 + j, push)
        keys.write(state["key"], depth, push)
        words.write(s | (reflections << 16), depth, push)
        bit = mi.UInt64(1) << mi.UInt64(depth)
        pending = dr.select(push, state["pending"] | bit, state["pending"])
        code = (s << EVENT_BITS) | dr.select(
            reflect, dr.select(it.tir, mi.UInt32(TOTAL), mi.UInt32(REFLECTED)), mi.UInt32(TRANSMITTED)
        )
        codes.write(code, depth, go)

        # ---- the child's segment
        heading = dr.select(reflect, it.reflected, it.transmitted)
        t, s2, normal2 = _next_hit(table, intersector, p, heading, s, go, normal=state["normal"] if has_stock else None)
        hit = go & (s2 != NO_SURFACE)
        tallies.add_reason(ESCAPED, batch, child, go & ~hit)
        segments = dr.select(go, state["segments"] + 1, state["segments"])

        # ---- or back to the deepest pending node
        back = active & ~hit & (pending != 0)
        k = dr.select(back, 63 - mi.UInt32(dr.lzcnt(pending)), 0)
        bp, bd, bw = _read(nodes, k, back)
        word, bkey = words.read(k, back), keys.read(k, back)
        pending = dr.select(back, pending & ~(mi.UInt64(1) << mi.UInt64(k)), pending)
        new_normal = state["normal"]
        if has_stock:
            new_normal = dr.select(back, mi.Vector3f(*(normals.read(k * 3 + j, back) for j in range(3))), normal2)
        return {
            "active": hit | back,
            "again": back,
            "p": dr.select(back, bp, dr.fma(t, heading, p)),
            "d": dr.select(back, bd, heading),
            "w": dr.select(back, bw, child),
            "s": dr.select(back, word & 0xFFFF, dr.select(hit, s2, 0)),
            "normal": new_normal,
            "medium": dr.select(back, 0, dr.select(reflect, it.medium_in, it.medium_out)),
            "depth": dr.select(back, k, depth + 1),
            "reflections": dr.select(back, word >> 16, dr.select(reflect & counted, reflections + 1, reflections)),
            "key": dr.select(back, bkey, extend_key(state["key"], code)),
            "pending": pending,
            "segments": segments,
            "rng": rng,
            "memory": (nodes, codes, words, keys, normals),
        }

    (end,) = dr.while_loop(
        (state,), lambda state: state["active"], lambda state: (body(state),), mode="symbolic", label="ray tree"
    )
    tallies.add_reason(SEGMENTS, batch, end["segments"], mi.Bool(True))


def _next_hit(
    table: SurfaceTable,
    intersector: Intersector,
    o: mi.Vector3f,
    d: mi.Vector3f,
    last: mi.UInt32,
    active: mi.Bool,
    normal: mi.Vector3f | None = None,
) -> tuple[mi.Float, mi.UInt32, mi.Vector3f]:
    """Nearest hit of analytic and stock surfaces: distance, surface, and the normal if it is stock."""
    t, s = intersector.nearest(o, d, last, active)
    if table.stock_scene is None:
        return t, s, mi.Vector3f(0)
    skip = mi.Float(0)
    if normal is not None:  # leave a stock surface behind by a few roundings, along the ray so that it stays the same
        slant = dr.maximum(dr.abs(dr.dot(normal, d)), GRAZING)
        skip = dr.select(last >= len(table.pieces), table.stock_epsilon / slant, 0)
    ray = mi.Ray3f(mi.Point3f(dr.fma(skip, d, o)), d)
    ray.maxt = dr.select(dr.isfinite(t), t - skip, dr.largest(mi.Float))
    hit = table.stock_scene.ray_intersect_preliminary(ray, coherent=False, active=active)
    nearer = active & hit.is_valid() & (hit.t + skip < t)
    si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, nearer)
    number = dr.gather(mi.UInt32, table.stock_lookup, dr.reinterpret_array(mi.UInt32, si.shape), nearer)
    return dr.select(nearer, si.t + skip, t), dr.select(nearer, number, s), mi.Vector3f(si.n)


def _film_coordinates(table: SurfaceTable, it: Any) -> tuple[mi.Float, mi.Float]:
    """Position on the detector in its own frame, mm."""
    if table.detector < len(table.pieces):
        return it.local.x, it.local.y
    centre, right, up = table.detector_axes
    return dr.dot(it.p - centre, right), dr.dot(it.p - centre, up)


def _record(
    recorder: Recorder,
    nodes: Any,
    event: Any,
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
        q, e, v = _read(nodes, k, going & ~here)
        values = (*dr.select(here, p, q), *dr.select(here, d, e), dr.select(here, w, v))
        row = slot * recorder.max_events + k
        dr.scatter(recorder.codes, event(k, going), row, going)
        for j, value in enumerate(values):
            dr.scatter(recorder.nodes, value, row * NODE_FLOATS + j, going)
        return (k + 1,)

    dr.while_loop((dr.zeros(mi.UInt32, dr.width(depth)),), lambda k: active & (k <= depth), step, mode="symbolic")
