"""
The kernel: every lane walks the whole ray tree of its start ray, depth first, and then that of another one.

A lane holds one node at a time: a point on a surface, reached along a direction with a throughput β, its flux in units
of the start ray's. At each visit it sends one of the node's children on (see `mistray.kernel.branching`) and marks its
depth as pending if others have flux. When a branch ends the lane returns to the deepest pending node and sends on the
next child. The nodes of the path lie in local memory by depth, so that nothing can overflow below `max_events`. A start
ray has no node yet: its first visit only sends it on, so that the code of a visit is all there is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.events import ABSORBED, event_of
from mistray.kernel.branch_limits import NO_RUN, BranchLimits
from mistray.kernel.branching import REFLECT, START, TRANSMIT, Branching, Children, Choice, Node, Sent
from mistray.kernel.interaction import event_code, interact, is_diffraction
from mistray.kernel.kernel_scene import KernelScene, film_coordinates, next_hit
from mistray.kernel.pdf_ratios import PdfRatios, State
from mistray.kernel.pending_nodes import (
    LEVELS,
    OPTIONAL,
    PendingNodes,
    needed_variables,
    recorded_once,
    walk_in_lockstep,
)
from mistray.kernel.scatter_shares import ScatterHit, ScatterPdfs
from mistray.kernel.start_supply import StartSupply
from mistray.recorders.importance import window_row
from mistray.recorders.path_key import COUNT_MASK, FIRST_KEY, after_scatter, extend_key
from mistray.recorders.recorder import Branch, Departure, Memory, Recorder, Recorders, Return, Segment, Visit
from mistray.recorders.start_rays import StartRays
from mistray.recorders.tallies import FIRST_MISS, MEDIUM, STARTED
from mistray.settings import Settings
from mistray.surfaces.optics import DETECTOR, NO_LOSS
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surface_rows import LaneRows


def trace_tree(scene: KernelScene, start: StartRays, settings: Settings, recorders: Sequence[Recorder | None]) -> None:
    """
    Trace the ray trees of a set of start rays, and pass the results to recorders.

    Parameters
    ----------
    scene : KernelScene
        Scene to trace, forward or backward, see `KernelScene`.
    start : StartRays
        Start rays, one per lane.
    settings : Settings
        Settings of the trace, after `Settings.with_unit`.
    recorders : sequence of Recorder or None
        Recorders that take the results, in this order; entries that are None are left out.
    """
    # What a user differentiates by, such as the vertices of a mesh, does not make a trace differentiable
    with dr.suspend_grad():
        together = Recorders(recorders)
        pays = scene.scatters(settings) and StartSupply.pays(scene, settings) and not together.by_ray
        supply = StartSupply(start) if pays else None
        _Tree(scene, start.with_new_literals(), settings, together, supply).walk()


class _Tree:
    """
    Trace of ray trees: its scene, start rays, settings, recorders, and the steps of a visit to a node.

    In the steps `path` and `codes` are the nodes and the event codes of each lane's path by depth, see `visit`, and
    `memory` holds the arrays of the recorders.
    """

    def __init__(
        self,
        scene: KernelScene,
        start: StartRays,
        settings: Settings,
        recorders: Recorders,
        supply: StartSupply | None = None,
    ) -> None:
        table = scene.table
        self.scene, self.start, self.settings, self.recorders, self.supply = scene, start, settings, recorders, supply
        self.n = dr.width(start.o)
        if supply is not None:
            self.n = supply.lanes
            self.start = start = supply.start(self.full())
        self.has_mitsuba_shapes, self.bulk = table.mitsuba_scene is not None, table.optics.scatters
        self.scatters = scene.scatters(settings)
        self.pdf_ratios = PdfRatios(scene, settings) if scene.competing is not None else None
        self.merges_aimed = scene.backward or recorders.merges_aimed  # how a direction was found is not part of a path
        self.limits = BranchLimits(settings, recorders.cut, start.batch)
        self.connects = self.pdf_ratios is not None and self.pdf_ratios.connects
        self.branching = Branching(scene, settings, self.limits, recorders.lose, start.batch)
        self.needed = needed_variables(scene, settings)
        self.nodes = PendingNodes(settings.max_events, self.needed)
        self.rows: LaneRows | None = None

    # A Local array takes an index of traced size 1 as uniform over the lanes: every index must start at full width
    def full(self, value: int = 0) -> mi.UInt32:
        """Return a device array with one entry per lane, all equal to an integer."""
        return dr.full(mi.UInt32, value, self.n)

    # ---- the state of the loop

    def at_start(self, start: StartRays) -> State:
        """Return the loop variables of start rays, before their first segment; those of lanes are left out."""
        n, full, stokes = self.n, self.full, self.settings.stokes
        unpolarized = dr.zeros(mi.Vector3f, n if stokes else 1)
        return {
            "child": full(START),  # number of the child that this visit is for; the first visit looks for one
            "p": mi.Vector3f(start.o),  # point of the node, mm
            "d": mi.Vector3f(start.d),  # unit direction in which it was reached
            "w": mi.Float(start.w),  # throughput β with which it was reached
            # Polarisation with which it was reached: Q, U, V over I
            "stokes": mi.Vector3f(start.given("stokes", unpolarized)) if stokes else unpolarized,
            "s": full(),  # number of its surface
            # Normal there, if the surface is one of Mitsuba's own shapes
            "normal": start.given("normal", dr.zeros(mi.Vector3f, n if self.has_mitsuba_shapes else 1)),
            "medium": mi.UInt32(start.given("medium", full())),  # of the segment that led to it; 0: unknown
            "depth": mi.UInt32(start.given("depth", full())),  # events before it
            "reflections": mi.UInt32(start.given("reflections", full())),  # counted reflections before it
            "key": mi.UInt64(start.given("key", dr.full(mi.UInt64, FIRST_KEY, n))),  # key of the events before it
            "run": mi.UInt32(start.given("run", full(NO_RUN))),  # hits of one surface in a row before it
            "pending": full(),  # depth + 1 of the deepest node before it that has a child still to come; 0: none
            "segments": full(),  # ray segments of the tree so far
            "scatters": mi.UInt32(start.given("scatters", full())),  # scatter events before it, see COUNT_MASK
            # Surface that sent the ray to a target, unless it was reflected since
            "aimed_from": mi.UInt32(start.given("aimed_from", full(NO_SURFACE))),
            # Throughput at the source or after the last scatter event, see `Branching.reference`
            "reference": mi.Float(start.given("reference", start.w)),
            "split": full(1),  # factor of its weight window on the number of its scattered rays
            "survival": dr.full(mi.Float, 1, n),  # probability of its weight window that it scatters
            # Density ratios for MIS weights
            **PdfRatios.first(n if self.pdf_ratios is not None else 1, n if self.connects else 1),
            # Number of the light vertex plus one that a ray is connected to, see `CONNECTED`; 0 of others
            "light_vertex": dr.zeros(mi.UInt32, n if self.connects else 1),
            "length": dr.zeros(mi.Float, n if self.bulk else 1),  # length of the segment that led to it, mm
            # Distance of the node behind p, where its medium has scattered, mm
            "away": dr.zeros(mi.Float, n if self.bulk else 1),
            # Flux of all rays that the medium scattered where it sent this one; 0 of other rays
            "shared": dr.zeros(mi.Float, n if self.bulk else 1),
            "in_scattered": dr.zeros(mi.Float, n if self.bulk else 1),  # flux scattered on the way
            "direct_depth": full(),  # deepest node of the current path before its first reflection
            "resume_level": full(),  # level at which the lane waits, see `pending_nodes`; 0: it is under way
            "seed": mi.UInt32(start.seed),  # of the random numbers of the node
        }

    # ---- the loop

    def walk(self) -> None:
        """Follow the ray trees of all start rays to their ends, and collect the recorders' results."""
        if LaneRows.pay(self.scene.table):
            self.rows = LaneRows(self.scene.table, self.n)
        supply, active = self.supply, dr.full(mi.Bool, True, self.n)
        state = self.at_start(self.start)
        # Variables that keep their values in this scene are none of the loop. These change in all, kept or not
        changing = self.needed | {"child", "medium"}
        constant = {name for name in OPTIONAL if name not in changing}
        fixed = {name: state[name] for name in constant}
        state = {name: value for name, value in state.items() if name not in constant}

        # The lanes: whether they have a node to visit, nodes and events of the current path by depth, recorders
        memory: Memory = {}
        self.recorders.begin(self.start, self.settings.max_events, memory)
        codes = dr.alloc_local(mi.UInt32, self.settings.max_events)
        state |= {"active": active, "memory": (self.nodes.memory, codes), "recorders": memory}
        if supply is not None:  # they wait for their first start ray
            state |= {"idle": active, "ray": self.full()}

        def visit(state: State) -> State:
            start, values = self.start, fixed
            if supply is not None:
                state = supply.renew(state, self.at_start)
                start = supply.start(state["ray"])
                renewed = self.at_start(start)
                values = {name: renewed[name] for name in constant}
            following = self.visit(start, {**state, **values})
            return {name: value for name, value in following.items() if name not in constant}

        resume = partial(self.nodes.resume, child=REFLECT)
        if self.scatters:  # until no lane has a node left; none waits
            state = recorded_once(state, lambda state: state["active"], lambda state: visit(resume(state)), "ray tree")
        else:
            state = walk_in_lockstep(state, visit, resume)
        if supply is None:
            self._complete(self.start, state, mi.Bool(True), state["recorders"])
        start = self.start if supply is None else supply.start(state["ray"])
        self.recorders.collect_lanes(start, state["recorders"])

    def visit(self, start: StartRays, state: State) -> State:
        """Visit one node per lane, and return the variables of the loop at the next node."""
        path, codes = state["memory"]
        memory = dict(state["recorders"])

        # Interact: Snell's law, R and T, scattering shares. A first visit records the hit and what is absorbed
        node = self._interact(start, state, path, codes, memory)

        # Choose the child that this visit sends on, by limits, thresholds and roulette
        children = self.branching.children(node, memory)
        choice = self.branching.choose(node, children, memory)

        # Scatter, or refract or reflect: origin, direction and throughput of the child
        sent = self._send(node, children, choice, memory)

        # Store the node for its later visits and as part of the path, and record the branch
        path, code = self._store(node, choice, sent, path, codes, memory)

        # Start: a start ray has no node, and sets off as it is
        sent = self._with_start_rays(node, sent)

        # Intersect and attenuate: the child's next surface, or its way out of the scene
        following, hit = self._follow(node, children, choice, sent, path, codes, code, memory)

        # Return to the deepest pending node where the branch has ended
        following |= self._go_back(node, choice, hit, following["depth"], memory)
        following = {**state, **following}
        if self.supply is not None:
            done = state["active"] & ~following["active"]
            self._complete(start, following, done, memory)
            following |= {"active": state["active"], "idle": done}
        return {**following, "memory": (path, codes), "recorders": memory}

    def _complete(self, start: StartRays, state: State, done: mi.Bool, memory: Memory) -> None:
        """Record the complete ray trees of the lanes in `done`, and the start rays that have met nothing."""
        self.recorders.lose(STARTED, 1.0, done, memory)
        # Aimed start rays may have no flux: these count, too
        met_nothing = done & (state["child"] == START)
        if start.scale is None:
            met_nothing &= start.w > 0
        self.recorders.lose(FIRST_MISS, 1.0, met_nothing, memory)
        self.recorders.end(start, state["segments"], state["segments"] >= self.branching.max_segments, done, memory)

    # ---- the steps of a visit

    def _attenuate(
        self,
        start: StartRays,
        flux: mi.Float,
        medium: mi.UInt32,
        length: mi.Float,
        hit: mi.Bool,
        contributes: mi.Bool,
    ) -> tuple[mi.Float, mi.Float]:
        """Return the throughput left after `length` mm in a medium, and that scattered; record the rest as absorbed."""
        optics = self.scene.table.optics
        if not optics.absorbs:
            return flux, mi.Float(0)
        transmitted, in_scattered, absorbed = optics.attenuate(flux, medium, length, hit)
        self.recorders.take(medium, start.batch, absorbed, hit & (absorbed > 0) & contributes)
        return transmitted, in_scattered

    def _interact(self, start: StartRays, state: State, path: Any, codes: Any, memory: Memory) -> Node:
        """Return the nodes of this visit; a first visit also records the hit and the absorbed throughput."""
        active, d, w, s = (state[k] for k in ("active", "d", "w", "s"))
        table, scattering = self.scene.table, self.scene.scattering
        starts = active & (state["child"] == START)
        first = active & (state["child"] == TRANSMIT)
        again = active & ~first & ~starts
        contributes = state["light_vertex"] == 0 if self.connects else mi.Bool(True)
        visited = first & contributes

        # Intersection, moved onto the surface, and Snell's law, R and T there
        stokes = state["stokes"] if self.settings.stokes else None
        normal = state["normal"] if self.has_mitsuba_shapes else None
        reached = dr.fma(state["away"], d, state["p"]) if self.bulk and self.scatters else state["p"]
        it = interact(table, reached, d, s, normal, stokes, first | again, self.rows)

        # A ray whose material is not the one that the surface has on this side is lost
        strayed = first & (state["medium"] != 0) & (it.medium_in != 0) & (it.medium_in != state["medium"])
        self.recorders.lose(MEDIUM, w, strayed & contributes, memory)
        first &= ~strayed

        # Energy balance: R + T + scatter + absorption = 1
        R, T, budget = it.R, it.T, None
        if scattering.any:
            budget = scattering.budget(s, it, first | again)
            R, T = R * budget.reflection.kept, T * budget.transmission.kept
        loss = 1 - R - T if budget is None else budget.absorbed
        at_rim = mi.Bool(False)
        if table.wall_rims.some:
            at_rim = table.wall_rims.at_rim(s, it.local, first)
            loss = dr.select(at_rim, 1, loss)
        loss, counted = dr.select(dr.abs(loss) < NO_LOSS, 0, loss), first & contributes
        absorbed, counts = self.limits.absorb(w * loss, counted, start.given("scale", mi.Float(1)))

        # Record the hit, with MIS weights if it is on the detector of a forward trace
        detected = mi.Bool(False) if self.scene.backward else counted & ((it.word & DETECTOR) != 0) & counts
        if not self.recorders.incident:
            detected &= absorbed > 0
        code = event_of(s, ABSORBED)
        ratios = None if self.scene.backward else self.pdf_ratios
        hits = Visit(
            start=start,
            state=state,
            interaction=it,
            shares=budget,
            visited=visited,
            active=counted,
            detected=detected,
            counted=detected,
            weight=w,
            absorbed=absorbed,
            loss=loss,
            position=film_coordinates(table, it, s),
            code=code,
            key=extend_key(state["key"], code),
            codes=codes,
            nodes=path,
            scatters=self.scatters,
            pdf_ratio=None if ratios is None else ratios.at_end(state),
            connection_ratio=None if ratios is None else ratios.connection_ratio_at_end(state),
        )
        # Weight window, found once: rounding may put a later visit into the place beside
        split, survival = state["split"], state["survival"]
        if (windows := self.scene.windows) is not None:
            hits.window_place = windows.place(it)
            row = window_row(s, hits.window_place, hits.before(first), state["scatters"] & COUNT_MASK)
            split, survival = windows.read(row, windows.value(start, w, first), (split, survival), first)
        self.recorders.visit(hits, memory)
        return Node(
            start=start,
            state=state,
            interaction=it,
            budget=budget,
            R=R,
            T=T,
            first=first & ~at_rim,
            again=again,
            starts=starts,
            contributes=contributes,
            sampler=start.sampler(state["seed"]),
            split=split,
            survival=survival,
        )

    def _send(self, node: Node, children: Children, choice: Choice, memory: Memory) -> Sent:
        """Return the chosen child ray of each node; its flux is 0 where no child goes on, for example at a limit."""
        state, it, budget = node.state, node.interaction, node.budget
        w, d, s, p = state["w"], state["d"], state["s"], it.p
        table, scattering = self.scene.table, self.scene.scattering
        scatter, by_medium, flux = choice.scatter, choice.by_medium, choice.flux

        # Specular: refracted or reflected
        reflect = node.visit & (choice.number == REFLECT)
        heading, origin = dr.select(reflect, it.reflected, it.transmitted), p
        aim, slope, pdfs = mi.Bool(False), dr.rcp(dr.select(reflect, it.R, it.T)), ScatterPdfs()

        # Scattered by the surface: a direction by its techniques, its MIS weight and densities
        if self.scatters and budget is not None:
            competing = None if self.scene.competing is None else self.scene.competing.scattering
            hit, connects = ScatterHit(table, s, it, d), self.scene.vertices is not None
            heading, share, scatter_slope, back_side, aim, pdfs = scattering.scatter(
                hit, budget, choice.draw, heading, choice.sampler, scatter, competing, connects
            )
            reflect = dr.select(scatter, back_side, reflect)
            slope = dr.select(scatter, scatter_slope, slope)
            flux = dr.select(scatter, w * share * choice.factor, flux)

        # Scattered by the medium: a point on the segment, and a direction from there.
        # Behind an opaque surface is no medium: the light stays in the one that led to it
        medium_in = dr.select(it.medium_in == 0, state["medium"], it.medium_in)
        away, shared, bulk_aim = mi.Float(0), mi.Float(0), children.bulk_aim
        if bulk_aim is not None and scattering.bulk is not None:
            medium_ray = choice.draw_in_medium()
            away, along, share = scattering.bulk.scatter(
                medium_in, p, d, state["length"], bulk_aim, medium_ray, choice.sampler, by_medium
            )
            away = dr.select(by_medium, away, 0)
            origin, heading = dr.fma(-away, d, p), dr.select(by_medium, along, heading)
            slope = dr.select(by_medium, 0, slope)
            shared = dr.select(by_medium & (bulk_aim.rays > 0), flux, 0)
            flux = dr.select(by_medium, flux * share, flux)
            aim |= by_medium & medium_ray.aim

        # The flux of scattered rays leaves the remainder, and limits may end the branch
        vertex, contributes = state["light_vertex"], node.contributes
        if self.connects:
            vertex = dr.select(scatter, pdfs.light_vertex, vertex)
            contributes = vertex == 0
        if self.scatters:
            scattered = (scatter | by_medium) & (flux > 0) & contributes
            self.recorders.lose(children.remainder, -flux, scattered, memory)
        scale = node.start.given("scale", mi.Float(1))
        flux = self.limits.end(flux, scatter, by_medium, reflect, node.visit, contributes, scale)
        return Sent(
            origin=origin,
            heading=heading,
            flux=flux,
            reflect=reflect,
            aim=aim,
            slope=slope,
            medium_in=medium_in,
            place=dr.select(by_medium, table.count + medium_in, s) if self.bulk else s,
            away=away,
            shared=shared,
            pdfs=pdfs,
            light_vertex=vertex,
            contributes=contributes,
            active=node.visit & (flux > 0),
        )

    @staticmethod
    def _with_start_rays(node: Node, sent: Sent) -> Sent:
        """Return the rays that set off in this visit: the child rays of nodes, and start rays that have flux."""
        state, starts = node.state, node.starts
        return replace(
            sent,
            origin=dr.select(starts, state["p"], sent.origin),
            heading=dr.select(starts, state["d"], sent.heading),
            flux=dr.select(starts, state["w"], sent.flux),
            medium_in=dr.select(starts, state["medium"], sent.medium_in),
            active=sent.active | (starts & (state["w"] > 0)),
        )

    def _store(
        self, node: Node, choice: Choice, sent: Sent, path: Any, codes: Any, memory: Memory
    ) -> tuple[Any, mi.UInt32]:
        """Store nodes by depth and report their child rays to recorders; return the stored nodes and event codes."""
        state, it = node.state, node.interaction
        depth, go = state["depth"], sent.active
        stored = {**state, "p": sent.origin, "away": sent.away, "child": choice.later}
        stored |= {"split": node.split, "survival": node.survival}
        path = self.nodes.keep(path, stored, depth, choice.pending, choice.pending | go, self.recorders.node_floats)
        aim = mi.Bool(False) if self.merges_aimed else sent.aim
        code = event_code(
            sent.place, it, sent.reflect, (choice.scatter, choice.by_medium, aim) if self.scatters else None
        )
        codes.write(code, depth, go)
        self.recorders.branch(
            Branch(
                start=node.start,
                depth=depth,
                interaction=it,
                place=sent.place,
                reflect=sent.reflect,
                aimed=sent.aim if self.scatters else None,
                slope=sent.slope,
                active=go & sent.contributes,
            ),
            memory,
        )
        return path, code

    def _follow(
        self,
        node: Node,
        children: Children,
        choice: Choice,
        sent: Sent,
        path: Any,
        codes: Any,
        code: mi.UInt32,
        memory: Memory,
    ) -> tuple[State, mi.Bool]:
        """Return the loop variables at the next surface of the child rays, and a mask of the lanes that reach one."""
        start, state, it, bulk, scatters = node.start, node.state, node.interaction, self.bulk, self.scatters
        table, depth, s, starts = self.scene.table, state["depth"], state["s"], node.starts
        scatter, by_medium, reflect, go = choice.scatter, choice.by_medium, sent.reflect, sent.active

        # No event has happened to a start ray: what events change stays as it is
        def after_event(name: str, value: Any) -> Any:
            return dr.select(starts, state[name], value)

        key, events = after_event("key", extend_key(state["key"], code)), after_event("depth", depth + 1)

        # Intersect; start rays that begin at a node are there
        medium = dr.select(reflect | by_medium | starts, sent.medium_in, it.medium_out)
        leaves_surface = dr.select(starts, start.given("left", NO_SURFACE), s)
        leaves_surface = dr.select(by_medium, NO_SURFACE, leaves_surface) if bulk else leaves_surface
        before, intersector = state["normal"] if self.has_mitsuba_shapes else None, self.scene.intersector
        travels = go if start.at is None else go & ~(starts & (start.at != NO_SURFACE))
        t, s2, normal = next_hit(table, intersector, sent.origin, sent.heading, leaves_surface, travels, normal=before)
        if start.at is not None:
            there = go & ~travels
            t, s2 = dr.select(there, 0, t), dr.select(there, start.at, s2)
        hit = go & (s2 != NO_SURFACE)
        gone = go & ~hit

        # Record the segment
        channel, leaving = self.scene.way_out(medium, gone)
        self.recorders.lose(channel, sent.flux, gone & sent.contributes, memory)
        recorded = travels & sent.contributes
        self.recorders.travel(Segment(start, sent.origin, sent.heading, sent.flux, medium, t, gone, recorded), memory)
        run = after_event("run", self.limits.run_after(state["run"], s, by_medium))
        hit = self.limits.arrive(run, s2, sent.flux, hit, sent.contributes)

        # Counts of the path: reflections and scatter events
        bounced, by_roulette = reflect & children.counted & ~scatter, self.branching.plays_roulette(it, children)
        scattered, scatter_word = scatter | by_medium, state["scatters"]
        if scatters:
            diffracted = is_diffraction(table.optics, it, scatter, reflect)
            optical = children.transmits | by_medium
            scatter_word = dr.select(
                scattered, after_scatter(scatter_word, sent.aim, optical, diffracted), scatter_word
            )

        # Density ratios of the path, for MIS weights
        following: State = {}
        if self.pdf_ratios is not None:
            share, wall = dr.select(reflect, node.R, node.T), ~children.transmits
            following |= self.pdf_ratios.after(
                state, share, wall, bounced & by_roulette, scatter, by_medium, sent.pdfs.pdf_ratio
            )
            if self.connects:
                through = medium if self.scene.backward else sent.medium_in
                following |= self.pdf_ratios.connection_ratios(
                    state, it, sent.heading, through, sent.pdfs.pdf_rev, scatter, by_medium, t
                )
                following["light_vertex"] = sent.light_vertex
            following = {name: after_event(name, value) for name, value in following.items()}

        # Record what leaves the scene
        if self.scene.backward or self.recorders.departs:
            ratios = self.pdf_ratios
            departure = Departure(
                start=start,
                heading=sent.heading,
                weight=sent.flux,
                reflections=state["reflections"] + dr.select(bounced, mi.UInt32(1), 0),
                scatters=scatter_word,
                key=key,
                length=events,
                event=codes.read,
                active=leaving,
                nodes=path,
                node=(*sent.origin, *state["d"], state["w"]),
                pdf_ratio=None if ratios is None else ratios.at_end(following),
                connection_ratio=None if ratios is None else ratios.connection_ratio_at_end(following),
                light_vertex=sent.light_vertex if self.connects else None,
            )
            self.recorders.depart(departure, memory)

        # Attenuate
        flux, in_scattered = self._attenuate(start, sent.flux, medium, t, hit, sent.contributes)
        if scatters:
            aimed_from = dr.select(bounced, NO_SURFACE, state["aimed_from"])
            reference = self.branching.reference(state, bounced & by_roulette)
            following |= {
                "scatters": scatter_word,
                "aimed_from": dr.select(scattered, dr.select(sent.aim, sent.place, NO_SURFACE), aimed_from),
                "reference": dr.select(scattered, sent.flux, reference),
            }
            if bulk:
                shared = dr.select(scattered, sent.shared, state["shared"])
                following |= {"length": t, "in_scattered": in_scattered, "away": mi.Float(0), "shared": shared}
        elif bulk:  # nothing is followed: a first visit records what the medium scatters
            following["in_scattered"] = in_scattered
        if "seed" in self.needed:
            following["seed"] = after_event("seed", choice.sampler.seed)
        if it.polarized:
            polarized = dr.select(scattered, 0, it.polarized.after(reflect, sent.heading))
            following["stokes"] = after_event("stokes", polarized)
        following |= {
            # A start ray that meets nothing has no node; all others look for their first child there
            "child": dr.select(starts & ~hit, mi.UInt32(START), TRANSMIT),
            "p": dr.fma(t, sent.heading, sent.origin),
            "d": sent.heading,
            "w": flux,
            "s": dr.select(hit, s2, 0),
            "normal": normal if self.has_mitsuba_shapes else state["normal"],
            "medium": medium,
            "reflections": dr.select(bounced, state["reflections"] + 1, state["reflections"]),
            "key": key,
            "depth": events,
            "run": run,
            "segments": dr.select(go, state["segments"] + 1, state["segments"]),
        }
        return following, hit

    def _go_back(self, node: Node, choice: Choice, hit: mi.Bool, events: mi.UInt32, memory: Memory) -> State:
        """Return the loop variables that change where a branch has ended and its lane goes back to a pending node."""
        state, depth = node.state, node.state["depth"]
        direct_depth = dr.select(state["reflections"] == 0, depth, state["direct_depth"])
        pending = dr.select(choice.pending, depth + 1, state["pending"])
        ended = state["active"] & ~hit
        back = ended & (pending != 0)
        k = dr.select(back, pending - 1, 0)
        closed = dr.select(back, k + 1, node.start.given("depth", self.full()))
        self.recorders.back(Return(node.start, depth, k, closed, ended & ~node.starts), memory)
        # Lanes that are back wait at level 1, or on the direct path at level 2; where light is scattered none waits
        level = mi.UInt32(1) if self.scatters else dr.select(k <= direct_depth, mi.UInt32(LEVELS), 1)
        return {
            "active": hit | back,
            "resume_level": dr.select(back, level, 0),
            "direct_depth": direct_depth,
            "depth": dr.select(back, k, events),
            "pending": pending,
        }
