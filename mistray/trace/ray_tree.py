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

from mistray.trace.adjoint import Adjoint
from mistray.trace.books import (
    ABSORBED_HERE,
    ESCAPED,
    EVENTS,
    FIRST_MISS,
    HITS,
    INCIDENT,
    MEDIUM,
    NODE_FLOATS,
    REFLECTIONS,
    ROULETTE,
    SEGMENTS,
    STARTED,
    THRESHOLD,
    Film,
    Recorder,
    Tallies,
    read_node,
    record_branch,
)
from mistray.trace.interaction import counts_as_reflection, interact
from mistray.trace.intersect import Intersector
from mistray.trace.ledger import (
    ABSORBED,
    EVENT_BITS,
    FIRST_KEY,
    REFLECTED,
    TOTAL,
    TRANSMITTED,
    Ledger,
    extend_key,
)
from mistray.trace.optics import DETECTOR, NO_LOSS
from mistray.trace.settings import Settings
from mistray.trace.surfaces import NO_SURFACE, SurfaceTable

GRAZING = 0.01  # smallest cosine that counts when a ray leaves a stock surface behind


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


def walk(
    table: SurfaceTable,
    intersector: Intersector,
    start: StartRays,
    settings: Settings,
    film: Film,
    tallies: Tallies | None = None,
    ledger: Ledger | None = None,
    recorder: Recorder | None = None,
    box: mi.Vector4f | None = None,
    adjoint: Adjoint | None = None,
) -> None:
    """
    Trace the trees of a set of start rays; results are added to the tallies, the film, the ledger and the recorder.

    Parameters
    ----------
    start : StartRays
        One lane each, all of weight 1.
    film : Film
        Pixels of the detector.
    tallies : Tallies, optional
        Where the flux goes.
    ledger : Ledger, optional
        Sums by path. In an adjoint walk it is only asked for the slots of the paths.
    recorder : Recorder, optional
        Whole branches.
    box : mi.Vector4f, optional
        Only detector hits with x0 ≤ x ≤ x1, y0 ≤ y ≤ y1 (mm) enter the ledger.
    adjoint : Adjoint, optional
        Gathers derivatives; nothing else is written then.
    """
    o, d, batch, lane, rng = start.o, start.d, start.batch, start.lane, mi.PCG32(start.rng)
    n = dr.width(o)
    max_events = settings.max_events
    has_stock = table.stock_scene is not None
    absorbs = table.optics.absorbs
    threshold = dr.opaque(mi.Float, settings.flux_threshold)
    max_reflections = dr.opaque(mi.UInt32, settings.max_reflections)
    keep_nodes = recorder is not None
    split, roulette = settings.splitting == "split", settings.below_threshold == "roulette"

    def add_reason(reason: int, value: Any, active: mi.Bool) -> None:
        if tallies is not None:
            tallies.add_reason(reason, batch, value, active)

    # A Local array takes an index of traced size 1 as uniform over the lanes: every index must start at full width
    def full(value: int = 0) -> mi.UInt32:
        return dr.full(mi.UInt32, value, n)

    nodes = dr.alloc_local(mi.Float, max_events * NODE_FLOATS)
    codes = dr.alloc_local(mi.UInt32, max_events)
    words = dr.alloc_local(mi.UInt32, max_events)
    keys = dr.alloc_local(mi.UInt64, max_events)
    normals = dr.alloc_local(mi.Float, max_events * 3 if has_stock else 1)
    polarizations = dr.alloc_local(mi.Float, max_events * 3 if settings.stokes else 1)
    events = adjoint.memory(max_events) if adjoint is not None else ()

    # First segment: from the source to the first surface
    t, s, normal = _next_hit(table, intersector, o, d, full(NO_SURFACE), mi.Bool(True))
    hit = s != NO_SURFACE
    add_reason(ESCAPED, 1.0, ~hit)
    add_reason(FIRST_MISS, 1.0, ~hit)
    add_reason(STARTED, 1.0, mi.Bool(True))

    state = {
        "active": hit,  # the lane has a node to visit
        "again": dr.full(mi.Bool, False, n),  # it is a second visit, for the reflected child
        "p": dr.fma(t, d, o),  # the node
        "d": mi.Vector3f(d),  # direction in which it was reached
        "w": dr.full(mi.Float, 1, n),  # weight with which it was reached
        "stokes": dr.zeros(mi.Vector3f, n if settings.stokes else 1),  # polarisation with which it was reached
        "s": dr.select(hit, s, 0),  # its surface
        "normal": normal,  # there, if the surface is stock
        "medium": full(0),  # material of the segment that led to it; 0 is not known
        "depth": full(0),  # events before it
        "reflections": full(0),  # counted reflections before it
        "key": dr.full(mi.UInt64, FIRST_KEY, n),  # of the events before it
        "pending": dr.zeros(mi.UInt64, n),  # bit k: the reflected child of the node at depth k is still to come
        "segments": full(1),
        "total": dr.zeros(mi.Float64, n if adjoint is not None else 1),  # derivative × flux of the hits so far
        "rng": rng,
        "memory": (nodes, codes, words, keys, normals, polarizations, *events),
    }

    def body(state: dict[str, Any]) -> dict[str, Any]:
        active, again, d, w, s, depth = (state[k] for k in ("active", "again", "d", "w", "s", "depth"))
        nodes, codes, words, keys, normals, polarizations, *events = state["memory"]
        rng, total = state["rng"], state["total"]
        first = active & ~again
        stokes = state["stokes"] if settings.stokes else None
        it = interact(table, state["p"], d, s, state["normal"] if has_stock else None, stokes, active)
        p = it.p

        # ---- books of a first visit
        strayed = first & (state["medium"] != 0) & (it.medium_in != 0) & (it.medium_in != state["medium"])
        add_reason(MEDIUM, w, strayed)
        first &= ~strayed
        R, T = it.R, it.T
        loss = 1 - R - T
        absorbed = dr.select(dr.abs(loss) < NO_LOSS, 0, w * loss)
        if tallies is not None:
            tallies.add_surface(s, HITS, batch, 1.0, first)
            tallies.add_surface(s, INCIDENT, batch, w, first)
            tallies.add_surface(s, ABSORBED_HERE, batch, absorbed, first & (absorbed > 0))

        detected = first & ((it.word & DETECTOR) != 0) & (absorbed > 0)
        x, y = _film_coordinates(table, it)
        pixel = film.pixel(x, y)
        key = extend_key(state["key"], (s << EVENT_BITS) | ABSORBED)

        def event(k: mi.UInt32, mask: mi.Bool) -> mi.UInt32:
            return dr.select(k < depth, codes.read(k, mask & (k < depth)), (s << EVENT_BITS) | ABSORBED)

        slot, booked = None, detected
        if ledger is not None:
            if box is not None:
                booked = detected & (x >= box.x) & (x <= box.y) & (y >= box.z) & (y <= box.w)
            slot, booked, new = ledger.find(key, booked)
            if adjoint is None:
                ledger.record(slot, batch, w, absorbed, x, y, stokes, booked)
                ledger.write_events(slot, depth + 1, event, new)
        if recorder is not None:
            wanted = detected & ((recorder.key == 0) | (recorder.key == key))
            record_branch(recorder, nodes, event, wanted, p, d, w, depth, lane)
        if adjoint is not None:
            derivative = adjoint.derivative(pixel, slot, booked)
            total = dr.select(booked, total + mi.Float64(derivative) * mi.Float64(absorbed), total)
            adjoint.detected(it, batch, derivative * w, booked)
        if tallies is not None:
            on_film = detected
            if film.map_of_slot is not None:
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
        add_reason(EVENTS, w_t + w_r, first & ~room & (T + R > 0))
        add_reason(REFLECTIONS, w_r, first & room & ~may_reflect & (R > 0))
        w_t = dr.select(room, w_t, 0)
        w_r = dr.select(room & may_reflect, w_r, 0)

        if split:
            if not roulette:
                cut_t, cut_r = w_t < threshold, w_r < threshold
                cut = dr.select(cut_t, w_t, 0) + dr.select(cut_r, w_r, 0)
                add_reason(THRESHOLD, cut, first & (cut > 0))
                w_t, w_r = dr.select(cut_t, 0, w_t), dr.select(cut_r, 0, w_r)
            reflect = again | (w_t == 0)
            push = first & ~reflect & (w_r > 0)
            child = dr.select(reflect, w_r, w_t)
        else:
            both = w_t + w_r
            reflect = rng.next_float32() * both >= w_t
            push = mi.Bool(False)
            child = both
            if not roulette:
                add_reason(THRESHOLD, both, first & (both < threshold) & (both > 0))
                child = dr.select(both < threshold, 0, both)
        if roulette:
            small = visit & (child > 0) & (child < threshold)
            survives = rng.next_float32() * threshold < child
            rolled = dr.select(small, dr.select(survives, threshold, 0), child)
            add_reason(ROULETTE, child - rolled, small)
            child = rolled

        go = visit & (child > 0)
        # ---- keep the node: for its second visit, and as part of the path
        kept = (push | go) if keep_nodes else push
        for j, value in enumerate((p.x, p.y, p.z, d.x, d.y, d.z, w)):
            nodes.write(value, depth * NODE_FLOATS + j, kept)
        for memory, name, used in ((normals, "normal", has_stock), (polarizations, "stokes", settings.stokes)):
            if used:
                for j in range(3):
                    memory.write(state[name][j], depth * 3 + j, push)
        keys.write(state["key"], depth, push)
        words.write(s | (reflections << 16), depth, push)
        bit = mi.UInt64(1) << mi.UInt64(depth)
        pending = dr.select(push, state["pending"] | bit, state["pending"])
        code = (s << EVENT_BITS) | dr.select(
            reflect, dr.select(it.tir, mi.UInt32(TOTAL), mi.UInt32(REFLECTED)), mi.UInt32(TRANSMITTED)
        )
        codes.write(code, depth, go)
        if adjoint is not None:
            adjoint.enter(tuple(events), depth, it, reflect, total, go)

        # ---- the child's segment
        heading = dr.select(reflect, it.reflected, it.transmitted)
        # Behind an opaque surface is no medium: the light stays in the one that led to it
        medium_in = dr.select(it.medium_in == 0, state["medium"], it.medium_in)
        medium = dr.select(reflect, medium_in, it.medium_out)
        t, s2, normal2 = _next_hit(table, intersector, p, heading, s, go, normal=state["normal"] if has_stock else None)
        hit = go & (s2 != NO_SURFACE)
        add_reason(ESCAPED, child, go & ~hit)
        if absorbs:
            coefficient = dr.gather(mi.Float, table.optics.absorption, medium, hit)
            left = child * dr.exp(-coefficient * dr.select(hit, t, 0))
            if tallies is not None:
                tallies.add_medium(medium, batch, child - left, hit & (coefficient > 0))
            child = left
        segments = dr.select(go, state["segments"] + 1, state["segments"])

        # ---- or back to the deepest pending node
        ended = active & ~hit
        back = ended & (pending != 0)
        k = dr.select(back, 63 - mi.UInt32(dr.lzcnt(pending)), 0)
        if adjoint is not None:
            adjoint.leave(tuple(events), batch, depth, k, total, ended)
        bp, bd, bw = read_node(nodes, k, back)
        word, bkey = words.read(k, back), keys.read(k, back)
        pending = dr.select(back, pending & ~(mi.UInt64(1) << mi.UInt64(k)), pending)

        def again_or(memory: Any, vector: mi.Vector3f) -> mi.Vector3f:
            return dr.select(back, mi.Vector3f(*(memory.read(k * 3 + j, back) for j in range(3))), vector)

        return {
            "active": hit | back,
            "again": back,
            "p": dr.select(back, bp, dr.fma(t, heading, p)),
            "d": dr.select(back, bd, heading),
            "w": dr.select(back, bw, child),
            "stokes": again_or(polarizations, it.polarized.after(reflect, heading))
            if it.polarized
            else state["stokes"],
            "s": dr.select(back, word & 0xFFFF, dr.select(hit, s2, 0)),
            "normal": again_or(normals, normal2) if has_stock else state["normal"],
            "medium": dr.select(back, 0, medium),
            "depth": dr.select(back, k, depth + 1),
            "reflections": dr.select(back, word >> 16, dr.select(reflect & counted, reflections + 1, reflections)),
            "key": dr.select(back, bkey, extend_key(state["key"], code)),
            "pending": pending,
            "segments": segments,
            "total": total,
            "rng": rng,
            "memory": (nodes, codes, words, keys, normals, polarizations, *events),
        }

    (end,) = dr.while_loop(
        (state,), lambda state: state["active"], lambda state: (body(state),), mode="symbolic", label="ray tree"
    )
    add_reason(SEGMENTS, end["segments"], mi.Bool(True))


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
