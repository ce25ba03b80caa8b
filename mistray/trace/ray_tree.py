"""The kernel: every lane walks the whole ray tree of its start ray, depth first.

A lane holds one node at a time: a point on a surface, reached along a direction with a weight (its flux in units of
the start ray's). A node has several children, in this order: the transmitted one, the reflected one, and the scattered
ones. At each visit it sends on one of them and, if others are worth it, marks its depth as pending; when a branch ends
the lane returns to the deepest pending node and sends on the next. The nodes of the current path lie in local memory,
indexed by depth, so the path is always at hand and nothing can overflow below `max_events`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.errors import MistrayError
from mistray.trace.adjoint import Adjoint
from mistray.trace.arrivals import Arrival, ArrivalBook
from mistray.trace.books import (
    AIMED,
    ESCAPED,
    EVENTS,
    FIRST_MISS,
    LANDED,
    MEDIUM,
    POINT_FLOATS,
    REFLECTIONS,
    ROULETTE,
    SAMPLING,
    SCATTERS,
    SEGMENTS,
    STARTED,
    THRESHOLD,
    TREE,
    Film,
    Recorder,
    Tallies,
    record_branch,
)
from mistray.trace.branch_limits import NO_RUN, BranchLimits
from mistray.trace.event_codes import after_scatter, event_code, is_diffraction, scatters_done
from mistray.trace.extrema import larger
from mistray.trace.interaction import counts_as_reflection, interact, is_aside
from mistray.trace.intersect import Intersector
from mistray.trace.ledger import ABSORBED, COUNT_MASK, EVENT_BITS, FIRST_KEY, Ledger, extend_key
from mistray.trace.next_hit import film_coordinates, next_hit
from mistray.trace.optics import DETECTOR, NO_LOSS, ONE_CHILD, OPAQUE
from mistray.trace.pending_nodes import LEVELS, PendingNodes, at_once, in_step, node_word, wait_level
from mistray.trace.pieces import NO_SURFACE
from mistray.trace.rims import RimBook
from mistray.trace.scatter_shares import ScatteredRay
from mistray.trace.scattering import Scattering
from mistray.trace.settings import Settings
from mistray.trace.sky import Sky
from mistray.trace.start_rays import StartRays
from mistray.trace.surface_rows import LaneRows
from mistray.trace.surfaces import SurfaceTable

# Children of a node in the order in which they are sent on; scattered ones follow
TRANSMIT, REFLECT, SCATTER = range(3)
# Share of `scatter_threshold` that holds at walls against the light: in the dark little is all there is
WORTH_IN_THE_DARK = 1e-3
SUMS_OF_LANE = 2  # place of the sums by surface among the local arrays


def walk(
    table: SurfaceTable,
    scattering: Scattering,
    intersector: Intersector,
    start: StartRays,
    settings: Settings,
    film: Film,
    tallies: Tallies | None = None,
    ledger: Ledger | None = None,
    recorder: Recorder | None = None,
    box: mi.Vector4f | None = None,
    adjoint: Adjoint | None = None,
    sky: Sky | None = None,
    rims: RimBook | None = None,
    arrivals: ArrivalBook | None = None,
) -> mi.Float64 | None:
    """
    Trace the trees of a set of start rays; results are added to the tallies, the film, the ledger and the recorder.

    Rays either follow the light from a source to the detector, or go against it from the detector to the sky.

    Parameters
    ----------
    start : StartRays
        One lane each.
    film : Film
        Pixels of the detector.
    tallies : Tallies, optional
        Where the flux goes.
    ledger : Ledger, optional
        Sums by path. In an adjoint walk it is only asked for the slots of the paths that it knows.
    recorder : Recorder, optional
        Whole branches; of rays that leave those that count, by `Sky.gain`, and no sums of the sky are written then.
    box : mi.Vector4f, optional
        Only detector hits with x0 ≤ x ≤ x1, y0 ≤ y ≤ y1 (mm) enter the ledger and the recorder.
    adjoint : Adjoint, optional
        Gathers derivatives; nothing else is written then.
    sky : Sky, optional
        Takes the rays that leave the scene, which go against the light then; the detector is a surface like others,
        and what a surface absorbs of a ray is what it emits towards the detector. `scattering` must be for such rays.
        In an adjoint walk its `Sky.gain` is asked instead.
    arrivals : ArrivalBook, optional
        Takes the rays that meet the detector, by way and by the cell of directions that they come from.
    rims : RimBook, optional
        Takes the hits close to rims, in an adjoint walk of a scene whose media do not scatter.

    Returns
    -------
    mi.Float64 or None
        In an adjoint walk what the metric gains from each lane: derivative × flux, summed over its hits.
    """
    o, d, batch, lane, rng = start.o, start.d, start.batch, start.lane, mi.PCG32(start.rng)
    n, max_events = dr.width(o), settings.max_events
    has_stock, bulk = table.stock_scene is not None, table.optics.scatters
    scatters = (scattering.any or bulk) and settings.max_scatters > 0
    threshold, scatter_threshold = (
        dr.opaque(mi.Float, limit) for limit in (settings.flux_threshold, settings.scatter_threshold)
    )
    scatter_limits = [dr.opaque(mi.UInt32, limit) for limit in settings.scatter_limits]
    max_reflections, scatter_rays, max_segments = (dr.opaque(mi.UInt32, limit) for limit in settings.tree_limits)
    if any(settings.cut_below_W):
        raise MistrayError("cut_below_W is in watts of a source, and this trace starts from none; use cut_below")
    limits, runs = BranchLimits(settings, tallies, batch), settings.limits_consecutive
    recorded_floats = recorder.node_floats if recorder is not None else POINT_FLOATS if rims is not None else 0
    split, roulette = settings.splitting == "split", settings.below_threshold == "roulette"

    def booker(sums: tuple[Any, ...]) -> Callable[[int | mi.UInt32, Any, mi.Bool], None]:
        return partial(tallies.add_reason, sums) if tallies is not None else lambda *_: None

    def attenuate(flux: mi.Float, medium: mi.UInt32, length: mi.Float, hit: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """What is left at the end of segments, and what their media scatter; what they absorb is booked."""
        if not table.optics.absorbs:
            return flux, mi.Float(0)
        left, clouded, taken = table.optics.attenuate(flux, medium, length, hit)
        if tallies is not None:
            tallies.add_medium(medium, batch, taken, hit & (taken > 0))
        return left, clouded

    # A Local array takes an index of traced size 1 as uniform over the lanes: every index must start at full width
    def full(value: int = 0) -> mi.UInt32:
        return dr.full(mi.UInt32, value, n)

    nodes = PendingNodes(max_events, has_stock, settings.stokes, scatters, bulk, runs)
    codes = dr.alloc_local(mi.UInt32, max_events)
    rows = LaneRows(table, n) if LaneRows.pay(table) else None
    sums = tallies.lane_sums() if tallies is not None else ()
    add_reason = booker(sums)
    events = adjoint.memory(max_events) if adjoint is not None else ()
    rim_events = rims.memory(max_events) if rims is not None else ()

    # First segment: from the source to the first surface
    left_behind, start_medium = start.given("left", full(NO_SURFACE)), start.given("medium", full())
    first_depth, first_key = start.given("depth", full()), start.given("key", dr.full(mi.UInt64, FIRST_KEY, n))
    first_reflections, first_scatters = start.given("reflections", full()), start.given("scatters", full())
    first_aside = start.given("aside", dr.full(mi.Bool, False, n))
    under_way = start.w > 0
    if start.at is not None:
        under_way &= start.at == NO_SURFACE
    t, s, normal = next_hit(table, intersector, o, d, left_behind, under_way, normal=start.normal)
    if start.at is not None:
        t, s = dr.select(under_way, t, 0), dr.select(under_way, s, start.at)
    hit = s != NO_SURFACE
    missed = ~hit & (start.w > 0)
    first_run = start.given("run", full(NO_RUN))
    hit = limits.arrive(first_run, s, start.w, hit)
    add_reason(ESCAPED, start.w, missed)
    add_reason(FIRST_MISS, 1.0, missed)
    add_reason(STARTED, 1.0, mi.Bool(True))
    total = dr.zeros(mi.Float64, n if adjoint is not None else 1)  # derivative × flux of the hits so far
    if sky is not None:
        if adjoint is not None:
            total = sky.gain(d, start.w, first_reflections, first_scatters, first_aside, first_depth, missed)
        elif recorder is None:
            sky.record(
                *(d, start.w, first_reflections, first_scatters, first_aside),
                *(batch, start, first_key, first_depth, lambda k, _: k, missed),
            )
    start_w, start_clouded = attenuate(start.w, start_medium, t, hit)

    state = {
        "active": hit,  # the lane has a node to visit
        "child": full(TRANSMIT),  # number of the child that this visit is for; the first visit looks for one
        "p": dr.fma(t, d, o),  # the node
        "d": mi.Vector3f(d),  # direction in which it was reached
        "w": mi.Float(start_w),  # weight with which it was reached
        "stokes": dr.zeros(mi.Vector3f, n if settings.stokes else 1),  # polarisation with which it was reached
        "s": dr.select(hit, s, 0),  # its surface
        "normal": normal,  # there, if the surface is stock
        "medium": mi.UInt32(start_medium),  # material of the segment that led to it; 0 is not known
        "depth": mi.UInt32(first_depth),  # events before it
        "reflections": mi.UInt32(first_reflections),  # counted reflections before it
        "key": mi.UInt64(first_key),  # of the events before it
        "aside": mi.Bool(first_aside),  # an event before it is none of a direct image, see `is_aside`
        "run": mi.UInt32(first_run),  # hits of one surface in a row before it
        "pending": full(),  # depth + 1 of the deepest node before it that has a child still to come; 0: none
        "segments": full(1),
        "total": total,
        "scatters": mi.UInt32(first_scatters),  # scatter events before it, see COUNT_MASK
        # Surface that sent the ray to a target, unless it was reflected since
        "aimed_from": mi.UInt32(start.given("aimed_from", full(NO_SURFACE))),
        "birth": mi.Float(start.given("birth", start.w)),  # weight with which it left the source or was scattered last
        "boost": dr.full(mi.Float, 1, n),  # factor of its scattered rays; 0: none, negative: see ONE_CHILD
        "length": mi.Float(t) if bulk else dr.zeros(mi.Float, 1),  # of the segment that led to it, mm
        # Of the node behind p, where its medium has scattered, mm
        "away": dr.zeros(mi.Float, n if bulk else 1),
        # Flux that the medium scattered in all where it sent this ray among others; 0 of other rays
        "shared": dr.zeros(mi.Float, n if bulk else 1),
        # Flux that its medium scattered on the way
        "clouded": mi.Float(start_clouded) if bulk else dr.zeros(mi.Float, 1),
        "trunk": full(),  # deepest node of the current path before its first reflection
        "wait": full(),  # level at which the lane waits, see `mistray.trace.pending_nodes`; 0: it is under way
        "rng": rng,
        "memory": (nodes.memory, codes, sums),
        "events": events,
        "rim_events": rim_events,
    }

    needed = {
        "run": runs,
        "stokes": settings.stokes,
        "normal": has_stock,
        "total": adjoint is not None,
        "length": bulk,
        "away": bulk and scatters,
        "shared": bulk and scatters,
        "clouded": bulk,
    }
    needed |= dict.fromkeys(("scatters", "aimed_from", "birth", "boost"), scatters)
    constant = {name: state.pop(name) for name, is_needed in needed.items() if not is_needed}

    def body(state: dict[str, Any]) -> dict[str, Any]:
        state = {**state, **constant}
        active, d, w, s, depth = (state[k] for k in ("active", "d", "w", "s", "depth"))
        trunk = dr.select(state["reflections"] == 0, depth, state["trunk"])
        path, codes, sums = state["memory"]
        add_reason = booker(sums)
        events, rim_events = state["events"], state["rim_events"]
        rng, total = state["rng"], state["total"]
        first = active & (state["child"] == TRANSMIT)
        visited = mi.Bool(first)
        again = active & ~first
        stokes = state["stokes"] if settings.stokes else None
        reached = dr.fma(state["away"], d, state["p"]) if bulk and scatters else state["p"]
        it = interact(table, reached, d, s, state["normal"] if has_stock else None, stokes, active, rows)
        p = it.p

        # ---- books of a first visit
        strayed = first & (state["medium"] != 0) & (it.medium_in != 0) & (it.medium_in != state["medium"])
        add_reason(MEDIUM, w, strayed)
        first &= ~strayed
        R, T = it.R, it.T
        given = None
        if scattering.any:
            given = scattering.give(s, it, first | again)
            R, T = R * given.reflection.kept, T * given.transmission.kept
        loss = 1 - R - T if given is None else given.absorbed
        absorbed = dr.select(dr.abs(loss) < NO_LOSS, 0, w * loss)
        absorbed, counts = limits.absorb(absorbed, first)
        if tallies is not None:
            tallies.add_hit(sums, s, batch, w, larger(absorbed, 0), first)

        detected = first & ((it.word & DETECTOR) != 0) & counts if sky is None else mi.Bool(False)
        if not film.incident:
            detected &= absorbed > 0
        x, y = film_coordinates(table, it)
        key = extend_key(state["key"], (s << EVENT_BITS) | ABSORBED)

        def event(k: mi.UInt32, mask: mi.Bool) -> mi.UInt32:
            return dr.select(k < depth, codes.read(k, mask & (k < depth)), (s << EVENT_BITS) | ABSORBED)

        slot, booked = None, detected
        if box is not None:
            booked = detected & (x >= box.x) & (x <= box.y) & (y >= box.z) & (y <= box.w)
        if recorder is not None:
            wanted, last_node = recorder.wants(key, w, detected) & booked, (*p, *d, w)
            record_branch(recorder, path, event, wanted, last_node, depth, lane, key, mi.Float64(w), place=(x, y))
        if rims is not None:
            rims.visit(rim_events, path, event, it, state, batch, lane, visited, first)
        if ledger is not None:
            if adjoint is not None:
                slot, booked = adjoint.known(ledger, key, absorbed, booked)
            else:
                slot, booked, new = ledger.find(key, booked)
                ledger.record(slot, batch, w, absorbed, x, y, stokes, booked)
                ledger.write_events(slot, depth + 1, event, new)
        if arrivals is not None:
            pixel = film.places(x, y)[0][0]
            arrivals.record(Arrival(key, depth + 1, event, start.cell, batch, w, state["scatters"], pixel, detected))
        if adjoint is not None:
            derivative = adjoint.derivative(film, x, y, slot, booked)
            gained = derivative * mi.Float64(w if film.incident else absorbed)
            total = dr.select(booked, total + gained, total)
            if adjoint.rows and not film.incident:
                adjoint.detected(it, given, batch, mi.Float(derivative) * w, booked)
        if tallies is not None:
            if scatters:
                tallies.add_scattered(sums, absorbed, detected & (state["scatters"] != 0))
                landed = detected & (state["aimed_from"] != NO_SURFACE)
                tallies.add_surface(state["aimed_from"], LANDED, batch, 1.0, landed)
            image, on_film = film.image(batch, slot, booked)
            for pixel, share in film.places(x, y):
                flux = mi.Float64(w if film.incident else absorbed)
                if share is not None:
                    flux *= mi.Float64(share)
                tallies.add_to_film(image + pixel, flux, on_film)

        # ---- children
        visit = first | again
        counted = counts_as_reflection(it)
        reflections = state["reflections"]
        room = (depth + 1 < max_events) & (again | (state["segments"] < max_segments))  # pending nodes are emptied
        may_reflect = ~counted | (reflections < max_reflections)
        w_t, w_r = w * T, w * R
        w_s = w * given.scattered if given is not None else mi.Float(0)
        w_b = dr.select(visit, state["clouded"], 0) if bulk else mi.Float(0)
        add_reason(EVENTS, w_t + w_r + w_s + w_b, first & ~room & (w_t + w_r + w_s + w_b > 0))
        add_reason(REFLECTIONS, w_r, first & room & ~may_reflect & (R > 0))
        w_t = dr.select(room, w_t, 0)
        w_r = dr.select(room & may_reflect, w_r, 0)
        generations = reflections + (state["scatters"] & COUNT_MASK)
        w_t, w_r, w_s, w_b = limits.follow(it, generations, (w_t, w_r, w_s, w_b), first & room)
        transmits = (it.word & OPAQUE) == 0
        random_rays = aimed_rays = mi.UInt32(0)
        may_scatter = may_cloud = mi.Bool(False)
        bulk_aim = scattering.bulk.aim(s, it, visit) if scatters and scattering.bulk is not None else None
        clouded_rays = mi.UInt32(0)
        if scatters:
            done = scatters_done(state["scatters"])
            may_scatter = room & (done[0] < scatter_limits[0])
            at_random, at_optics = done[1] < scatter_limits[1], done[2] < scatter_limits[2]
            random_clouds = dr.select(at_random, mi.UInt32(1), 0)
            if bulk_aim is not None:
                clouded_rays = random_clouds + bulk_aim.rays
            may_cloud = may_scatter & at_optics & (clouded_rays > 0)
            wanted_rays = scatter_rays
            if given is not None:
                wanted_rays = dr.select(given.random_rays > 0, given.random_rays, scatter_rays)
            random_rays = dr.select(at_random, wanted_rays, 0)
            remainder = dr.select(at_random, mi.UInt32(SAMPLING), mi.UInt32(SCATTERS))  # aimed rays leave light out
            aimed_rays = given.aimed_t + given.aimed_r if given is not None else mi.UInt32(0)
            may_scatter &= (~transmits | at_optics) & (random_rays + aimed_rays > 0)
        stopped = dr.select(may_scatter, 0, w_s) + dr.select(may_cloud, 0, w_b)
        add_reason(SCATTERS, stopped, first & room & (stopped > 0))
        w_s, w_b = dr.select(may_scatter, w_s, 0), dr.select(may_cloud, w_b, 0)

        # A ray that has not been scattered keeps to the flux threshold; one that has plays roulette below its own
        fresh = (state["scatters"] & COUNT_MASK) == 0 if scatters else mi.Bool(True)
        own = state["birth"] * scatter_threshold
        limit = dr.select(fresh, threshold if roulette else 0, own)
        boost = state["boost"]
        # One for all children: none knows of another
        lot = rng.next_float32() if roulette or scatters or sky is not None else mi.Float(0)
        if scatters and split:
            # A weak node scatters with a probability in proportion to the light that reaches it
            worth = own
            if sky is not None:
                worth = dr.select(transmits, own, own * WORTH_IN_THE_DARK)
            if bulk:
                # Of all rays of a segment one scatters again on average: trees in a medium would grow without end
                worth = dr.maximum(worth, state["shared"])
            chance = dr.minimum((w + state["clouded"] if bulk else w) / worth, 1)
            if sky is not None:
                chance = chance * dr.gather(mi.Float, sky.thrift.scatter, s, first)
            boost = dr.select(first, dr.select(1 - lot <= chance, dr.rcp(chance), 0), boost)
        if split and table.optics.one_child:
            # Of transmission, reflection and scatter one takes the flux of all. A negative boost: the surface does not
            # scatter, what its medium has scattered is sent on all the same
            w_all = w_t + w_r + w_s
            chosen = rng.next_float32() * w_all
            only = first & ((it.word & ONE_CHILD) != 0)
            to_t, to_r = chosen < w_t, (chosen >= w_t) & ((chosen < w_t + w_r) | (w_s == 0))
            boost = dr.select(only, dr.select(to_t | to_r, -boost, boost * w_all / w_s), boost)
            w_t = dr.select(only, dr.select(to_t, w_all, 0), w_t)
            w_r = dr.select(only, dr.select(to_r, w_all, 0), w_r)
            w_s = dr.select(only, dr.select(to_t | to_r, 0, w_all), w_s)
        if scatters and split:
            add_reason(remainder, w_s + w_b, first & (w_s + w_b > 0))
        if split:
            if not roulette:
                cut_t, cut_r = fresh & (w_t < threshold), fresh & (w_r < threshold)
                cut = dr.select(cut_t, w_t, 0) + dr.select(cut_r, w_r, 0)
                add_reason(THRESHOLD, cut, first & (cut > 0))
                w_t, w_r = dr.select(cut_t, 0, w_t), dr.select(cut_r, 0, w_r)
            if sky is not None:
                thinned = fresh & transmits & counted & ((it.word & ONE_CHILD) == 0)
                followed = again | (lot < sky.thrift.reflection)
                kept_r = dr.select(thinned, dr.select(followed, w_r / sky.thrift.reflection, 0), w_r)
                add_reason(ROULETTE, w_r - kept_r, first & thinned)
                w_r = kept_r
            if roulette or scatters:
                # A later visit is for a child that has survived
                left_t, left_r = (
                    dr.select((v > 0) & (v < limit), dr.select(lot * limit < v, limit, 0), v) for v in (w_t, w_r)
                )
                left_r = dr.select(again & (w_r > 0), dr.maximum(w_r, limit), left_r)
                add_reason(ROULETTE, w_t + w_r - left_t - left_r, first & (dr.minimum(w_t, w_r) < limit))
                w_t, w_r = left_t, left_r
            scattered_rays = dr.select((boost > 0) & (w_s > 0), random_rays + aimed_rays, 0)
            end = SCATTER + scattered_rays + dr.select((boost != 0) & (w_b > 0), clouded_rays, 0)
            after_t = dr.select(w_r > 0, mi.UInt32(REFLECT), mi.UInt32(SCATTER))
            number = dr.select(first, dr.select(w_t > 0, mi.UInt32(TRANSMIT), after_t), state["child"])
            later = dr.select(number == TRANSMIT, after_t, dr.maximum(number + 1, SCATTER))
            push = visit & ((later == REFLECT) | (later < end))
            child = dr.select(number == TRANSMIT, w_t, dr.select(number == REFLECT, w_r, 0))
            scatter = visit & (number >= SCATTER) & (number < SCATTER + scattered_rays)
            cloud = visit & (number >= SCATTER + scattered_rays) & (number < end)
            child = dr.select(cloud, w_b * dr.abs(boost), child)
        else:
            both = w_t + w_r + w_s + w_b
            chosen = rng.next_float32() * both
            later = number = dr.select(
                chosen < w_t,
                mi.UInt32(TRANSMIT),
                dr.select((chosen < w_t + w_r) | (w_s + w_b == 0), mi.UInt32(REFLECT), mi.UInt32(SCATTER)),
            )
            push = mi.Bool(False)
            child = both
            if roulette or scatters:
                small = (both > 0) & (both < limit)
                child = dr.select(small, dr.select(lot * limit < both, limit, 0), both)
                add_reason(ROULETTE, both - child, visit & small)
            if not roulette:
                cut = fresh & (both < threshold)
                add_reason(THRESHOLD, both, first & cut & (both > 0))
                child = dr.select(cut, 0, child)
            scatter = visit & (number == SCATTER) & (child > 0)
            cloud = scatter & (chosen >= w_t + w_r + w_s) & (w_b > 0)
            scatter &= ~cloud & (w_s > 0)
            child = dr.select((number == SCATTER) & ~scatter & ~cloud, 0, child)
            if scatters:
                add_reason(remainder, child, scatter | cloud)
        reflect = number == REFLECT
        heading = dr.select(reflect, it.reflected, it.transmitted)
        origin = p
        aim, slope = mi.Bool(False), dr.rcp(dr.select(reflect, it.R, it.T))
        if scatters and given is not None:
            if split:
                factor = boost

                def choose(rng: mi.PCG32) -> ScatteredRay:
                    return given.ray(number - SCATTER, random_rays, rng)
            else:
                factor = child / both

                def choose(rng: mi.PCG32) -> ScatteredRay:
                    return given.one_ray(w_s / both, random_rays, rng)

            heading, share, scatter_slope, back_side, aim, rng = scattering.scatter(
                table, s, given, choose, it, d, heading, rng, scatter
            )
            reflect = dr.select(scatter, back_side, reflect)
            slope = dr.select(scatter, scatter_slope, slope)
            child = dr.select(scatter, w * share * factor, child)
        # Behind an opaque surface is no medium: the light stays in the one that led to it
        medium_in = dr.select(it.medium_in == 0, state["medium"], it.medium_in)
        away, shared = mi.Float(0), mi.Float(0)
        if scatters and scattering.bulk is not None and bulk_aim is not None:
            if split:
                aim_cloud = number >= SCATTER + scattered_rays + random_clouds
                random_parts, aimed_parts = mi.Float(random_clouds), mi.Float(bulk_aim.rays)
            else:
                aim_cloud, random_parts, aimed_parts = scattering.bulk.one_ray(bulk_aim, random_clouds, rng)
            away, along, share = scattering.bulk.scatter(
                medium_in, p, d, state["length"], bulk_aim, aim_cloud, random_parts, aimed_parts, rng, cloud
            )
            away = dr.select(cloud, away, 0)
            origin, heading = dr.fma(-away, d, p), dr.select(cloud, along, heading)
            slope = dr.select(cloud, 0, slope)
            shared = dr.select(cloud & (bulk_aim.rays > 0), child, 0)
            child = dr.select(cloud, child * share, child)
            aim |= cloud & aim_cloud
        place = dr.select(cloud, table.count + medium_in, s) if bulk else s
        if scatters:
            add_reason(remainder, -child, (scatter | cloud) & (child > 0))
            if tallies is not None:
                tallies.add_surface(place, AIMED, batch, 1.0, aim)

        child = limits.end(child, scatter, cloud, reflect, visit)
        go = visit & (child > 0)
        # ---- keep the node: for its second visit, and as part of the path
        word = node_word(s, reflections, state["aside"] if sky is not None else None)
        node = {**state, "p": origin, "away": away, "word": word, "child": later, "boost": boost}
        path = nodes.keep(path, node, depth, push, push | go, recorded_floats)
        pending = dr.select(push, depth + 1, state["pending"])
        by_way = sky is not None or arrivals is not None  # they do not ask how a direction was found
        how = (scatter, cloud, mi.Bool(False) if by_way else aim) if scatters else None
        code = event_code(place, it, reflect, how)
        codes.write(code, depth, go)
        if adjoint is not None and adjoint.rows:
            adjoint.enter(events, depth, it, reflect, slope, total, go)

        # ---- the child's segment
        medium = dr.select(reflect | cloud, medium_in, it.medium_out)
        last = dr.select(cloud, NO_SURFACE, s) if bulk else s
        left_behind = state["normal"] if has_stock else None
        t, s2, normal2 = next_hit(table, intersector, origin, heading, last, go, normal=left_behind)
        hit = go & (s2 != NO_SURFACE)
        leaving = go & ~hit
        add_reason(ESCAPED, child, leaving)
        run = limits.run_after(state["run"], s, cloud)
        hit = limits.arrive(run, s2, child, hit)
        bounced = reflect & counted & ~scatter
        aside, after = state["aside"], state["scatters"]
        if scatters:
            scattered, optical = scatter | cloud, transmits | cloud
            diffracted = is_diffraction(table.optics, it, scatter, reflect)
            after = dr.select(scattered, after_scatter(after, aim, optical, diffracted), after)
        if sky is not None:
            bounces = reflections + dr.select(bounced, mi.UInt32(1), 0)
            aside = aside | is_aside(it, reflect)
            path_key = extend_key(state["key"], code)
            if adjoint is not None or recorder is not None:
                gained = sky.gain(heading, child, bounces, after, aside, depth + 1, leaving)
                if adjoint is not None:
                    total = total + gained
                if recorder is not None:
                    last_node, counts = (*origin, *d, w), leaving & (gained != 0)
                    record_branch(recorder, path, codes.read, counts, last_node, depth, lane, path_key, gained, heading)
            else:
                sky.record(
                    heading, child, bounces, after, aside, batch, start, path_key, depth + 1, codes.read, leaving
                )
        child, clouded = attenuate(child, medium, t, hit)
        segments = dr.select(go, state["segments"] + 1, state["segments"])

        # ---- or back to the deepest pending node
        ended = active & ~hit
        back = ended & (pending != 0)
        k = dr.select(back, pending - 1, 0)
        if adjoint is not None and adjoint.rows:
            adjoint.leave(events, batch, depth, k, total, ended)
        if rims is not None:
            rims.close(rim_events, depth, dr.select(back, k + 1, first_depth), total, ended)
        following = {}
        if scatters:
            aimed_from = dr.select(bounced, NO_SURFACE, state["aimed_from"])
            aimed_from = dr.select(scattered, dr.select(aim, place, NO_SURFACE), aimed_from)
            birth = dr.select(scattered, child, state["birth"])
            following = {
                "scatters": after,
                "aimed_from": aimed_from,
                "birth": birth,
                "boost": dr.full(mi.Float, 1, n),
            }
            if bulk:
                shared = dr.select(scattered, shared, state["shared"])
                following |= {"length": t, "clouded": clouded, "away": mi.Float(0), "shared": shared}
        elif bulk:  # nothing is followed: a first visit books what the medium scatters
            following = {"clouded": clouded}
        following |= {
            "active": hit | back,
            "wait": wait_level(k, trunk, back, 1 if scatters else LEVELS),
            "trunk": trunk,
            "child": full(TRANSMIT),
            "p": dr.fma(t, heading, origin),
            "d": heading,
            "w": child,
            "stokes": dr.select(scatter | cloud, 0, it.polarized.after(reflect, heading))
            if it.polarized
            else state["stokes"],
            "s": dr.select(hit, s2, 0),
            "normal": normal2 if has_stock else state["normal"],
            "medium": medium,
            "depth": dr.select(back, k, depth + 1),
            "reflections": dr.select(bounced, reflections + 1, reflections),
            "aside": aside,
            "key": extend_key(state["key"], code),
            "run": run,
            "pending": pending,
            "segments": segments,
            "total": total,
            "rng": rng,
            "memory": (path, codes, sums),
            "events": events,
            "rim_events": rim_events,
        }
        return {name: value for name, value in {**state, **following}.items() if name not in constant}

    walk_on = at_once if scatters else in_step
    end = walk_on(state, body, partial(nodes.resume, child=REFLECT))
    if tallies is not None:
        sums = end["memory"][SUMS_OF_LANE]
        tallies.move_reason(sums, EVENTS, TREE, end["segments"] >= max_segments)
        tallies.add_reason(sums, SEGMENTS, end["segments"], mi.Bool(True))
        tallies.collect(sums, batch)
    return end["total"] if adjoint is not None else None
