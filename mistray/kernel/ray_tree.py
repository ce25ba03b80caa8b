"""The kernel: every lane walks the whole ray tree of its start ray, depth first, and then that of another one.

A lane holds one node at a time: a point on a surface, reached along a direction with a weight (its flux in units of
the start ray's). At each visit it sends one of the node's children on (see `mistray.kernel.branching`) and, if others
have flux, marks its depth as pending; when a branch ends the lane returns to the deepest pending node and sends on the
next. The nodes of the current path lie in local memory, indexed by depth, so the path is always at hand and nothing can
overflow below `max_events`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.errors import MistrayError
from mistray.kernel.branch_limits import NO_RUN, BranchLimits
from mistray.kernel.branching import REFLECT, TRANSMIT, Branching, Children, Choice, Node
from mistray.kernel.event_codes import after_scatter, event_code, is_diffraction
from mistray.kernel.interaction import interact
from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.next_hit import film_coordinates, next_hit
from mistray.kernel.odds import Odds
from mistray.kernel.pending_nodes import LEVELS, OPTIONAL, PendingNodes, at_once, in_step, node_word, wait_level
from mistray.kernel.scatter_shares import Rivalry
from mistray.kernel.start_supply import StartSupply
from mistray.recorders.path_key import ABSORBED, COUNT_MASK, EVENT_BITS, FIRST_KEY, extend_key
from mistray.recorders.recorder import Branch, Departure, Memory, Recorder, Recorders, Return, Segment, Visit
from mistray.recorders.start_rays import StartRays
from mistray.recorders.start_samples import worth_row
from mistray.recorders.tallies import ESCAPED, FIRST_MISS, MEDIUM, STARTED
from mistray.settings import Settings
from mistray.surfaces.optics import DETECTOR, NO_LOSS
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surface_rows import LaneRows

State = dict[str, Any]
MEMORY = ("memory", "recorders")  # variables of the loop that belong to lanes, not to rays


def trace_tree(scene: KernelScene, start: StartRays, settings: Settings, recorders: Sequence[Recorder | None]) -> None:
    """
    Trace the trees of a set of start rays.

    Parameters
    ----------
    scene : KernelScene
        Says whether rays follow the light from a source to the detector, or go backward from the detector to the sky.
    start : StartRays
        One lane each.
    settings : Settings
    recorders : sequence of Recorder or None
        Take the results, in this order; None is left out.
    """
    # What a user differentiates by, such as the vertices of a mesh, does not make a trace differentiable
    with dr.suspend_grad():
        _trace_tree(scene, start, settings, Recorders(recorders))


def _trace_tree(scene: KernelScene, start: StartRays, settings: Settings, together: Recorders) -> None:
    """The same for recorders that are put together."""
    tree = _Tree(scene, start, settings, together)
    state = tree.first_segment()
    if tree.scatters and StartSupply.pays(scene, settings) and not together.by_ray:
        tree.end(state, ~state["active"])
        known = {name: value for name, value in state.items() if name not in MEMORY}
        dr.eval(known)
        supply = StartSupply(start, known)
        if not supply.any:
            return
        tree = _Tree(scene, start, settings, together, supply)
        state = tree.idle()
    tree.walk(state)


@dataclass
class _Sent:
    """Rays that nodes send on: where from, along which direction, with which flux, and how they were found."""

    origin: mi.Vector3f
    heading: mi.Vector3f
    flux: mi.Float
    reflect: mi.Bool
    aim: mi.Bool
    slope: mi.Float  # d ln(flux) / d(R or T)
    medium_in: mi.UInt32
    place: mi.UInt32  # number of the surface, or of the medium that scatters
    away: mi.Float  # of the node behind the origin, see the state
    shared: mi.Float  # see the state
    rivalry: Rivalry
    active: mi.Bool  # whether there is one
    joint: mi.UInt32 | None = None  # see the state


class _Tree:
    """The steps of a visit, with what is the same for all of them."""

    def __init__(
        self,
        scene: KernelScene,
        start: StartRays,
        settings: Settings,
        recorders: Recorders,
        supply: StartSupply | None = None,
    ) -> None:
        if any(settings.cut_below_W):
            raise MistrayError("cut_below_W is in watts of a source, and this trace starts from none; use cut_below")
        table = scene.table
        self.scene, self.start, self.settings, self.recorders, self.supply = scene, start, settings, recorders, supply
        self.n = dr.width(start.o)
        if supply is not None:
            self.n = supply.lanes
            self.start = start = supply.start(self.full())
        self.has_stock, self.bulk = table.stock_scene is not None, table.optics.scatters
        self.scatters = scene.scatters(settings)
        self.odds = Odds(scene, settings) if scene.opposite is not None else None
        self.runs = settings.limits_consecutive
        self.by_way = scene.backward or recorders.by_way  # how a direction was found is not asked
        self.limits = BranchLimits(settings, self.cut, start.batch)
        self.connects = self.odds is not None and self.odds.connects
        self.books = mi.Bool(True)  # lanes whose rays are no connections, which stand for light that others stand for
        self.branching = Branching(scene, settings, self.limits, self.lose, start.batch)
        self.needed = self._needed()
        self.nodes = PendingNodes(settings.max_events, self.needed)
        self.rows: LaneRows | None = None
        self.first_depth = start.given("depth", self.full())

    def lose(self, channel: int | mi.UInt32, flux: Any, active: mi.Bool, memory: Memory) -> None:
        """See `mistray.recorders.recorder.Recorder.lose`."""
        self.recorders.lose(channel, flux, active & self.books, memory)

    def cut(self, channel: int | mi.UInt32, batch: mi.UInt32, flux: mi.Float, active: mi.Bool) -> None:
        """See `mistray.recorders.recorder.Recorder.cut`."""
        self.recorders.cut(channel, batch, flux, active & self.books)

    # A Local array takes an index of traced size 1 as uniform over the lanes: every index must start at full width
    def full(self, value: int = 0) -> mi.UInt32:
        """A number of each lane."""
        return dr.full(mi.UInt32, value, self.n)

    def first_segment(self) -> State:
        """From the source to the first surface: the variables of the loop."""
        start, table, n, full = self.start, self.scene.table, self.n, self.full
        o, d, bulk = start.o, start.d, self.bulk
        memory: Memory = {}
        codes = dr.alloc_local(mi.UInt32, self.settings.max_events)
        self.recorders.begin(start, self.settings.max_events, memory)
        left_behind, medium = start.given("left", full(NO_SURFACE)), start.given("medium", full())
        key = start.given("key", dr.full(mi.UInt64, FIRST_KEY, n))
        reflections, scatters = start.given("reflections", full()), start.given("scatters", full())
        under_way = start.w > 0
        if start.at is not None:
            under_way &= start.at == NO_SURFACE
        t, s, normal = next_hit(table, self.scene.intersector, o, d, left_behind, under_way, normal=start.normal)
        if start.at is not None:
            t, s = dr.select(under_way, t, 0), dr.select(under_way, s, start.at)
        hit = s != NO_SURFACE
        missed = ~hit & (start.w > 0)
        passed = missed if start.scale is None else ~hit  # aimed rays may have no flux
        run = start.given("run", full(NO_RUN))
        hit = self.limits.arrive(run, s, start.w, hit)
        lose = self.recorders.lose
        lose(ESCAPED, start.w, missed, memory)
        lose(FIRST_MISS, 1.0, passed, memory)
        lose(STARTED, 1.0, mi.Bool(True), memory)
        self.recorders.travel(Segment(start, o, d, start.w, medium, t, missed, under_way), memory)
        if self.scene.backward:
            depth = self.first_depth
            gone = Departure(start, d, start.w, reflections, scatters, key, depth, lambda k, _: k, missed)
            self.recorders.depart(gone, memory)
        w, clouded = self._attenuate(start.w, medium, t, hit)
        unpolarized = dr.zeros(mi.Vector3f, n if self.settings.stokes else 1)
        stokes = start.given("stokes", unpolarized) if self.settings.stokes else unpolarized
        return {
            "active": hit,  # the lane has a node to visit
            "child": full(TRANSMIT),  # number of the child that this visit is for; the first visit looks for one
            "p": dr.fma(t, d, o),  # the node
            "d": mi.Vector3f(d),  # direction in which it was reached
            "w": mi.Float(w),  # weight with which it was reached
            "stokes": mi.Vector3f(stokes),  # polarisation with which it was reached
            "s": dr.select(hit, s, 0),  # its surface
            "normal": normal,  # there, if the surface is stock
            "medium": mi.UInt32(medium),  # material of the segment that led to it; 0 is not known
            "depth": mi.UInt32(self.first_depth),  # events before it
            "reflections": mi.UInt32(reflections),  # counted reflections before it
            "key": mi.UInt64(key),  # of the events before it
            "run": mi.UInt32(run),  # hits of one surface in a row before it
            "pending": full(),  # depth + 1 of the deepest node before it that has a child still to come; 0: none
            "segments": full(1),
            "scatters": mi.UInt32(scatters),  # scatter events before it, see COUNT_MASK
            # Surface that sent the ray to a target, unless it was reflected since
            "aimed_from": mi.UInt32(start.given("aimed_from", full(NO_SURFACE))),
            # Weight when it left the source or was scattered last, see `Branching.birth`
            "birth": mi.Float(start.given("birth", start.w)),
            "scatter_factor": dr.full(mi.Float, 1, n),  # of its scattered rays, see `ScatterFactors`
            "medium_factor": dr.full(mi.Float, 1, n),  # of those that its medium scatters, where it is another one
            # See `mistray.kernel.odds`
            **Odds.first(n if self.odds is not None else 1, n if self.connects else 1),
            # Of a ray that is connected to light, see `mistray.kernel.scatter_shares.JOINED`; 0 of others
            "joint": dr.zeros(mi.UInt32, n if self.connects else 1),
            "length": mi.Float(t) if bulk else dr.zeros(mi.Float, 1),  # of the segment that led to it, mm
            # Of the node behind p, where its medium has scattered, mm
            "away": dr.zeros(mi.Float, n if bulk else 1),
            # Flux that the medium scattered in all where it sent this ray among others; 0 of other rays
            "shared": dr.zeros(mi.Float, n if bulk else 1),
            # Flux that its medium scattered on the way
            "clouded": mi.Float(clouded) if bulk else dr.zeros(mi.Float, 1),
            "trunk": full(),  # deepest node of the current path before its first reflection
            "wait": full(),  # level at which the lane waits, see `mistray.kernel.pending_nodes`; 0: it is under way
            "rng": mi.PCG32(start.rng),
            "memory": (self.nodes.memory, codes),
            "recorders": memory,
        }

    def idle(self) -> State:
        """The variables of the loop of lanes that have no ray yet."""
        assert self.supply is not None
        memory: Memory = {}
        self.recorders.begin(self.start, self.settings.max_events, memory)
        ray, all_of_them = self.full(), dr.full(mi.Bool, True, self.n)
        state = {name: self.supply.known(name, ray) for name in self.supply.names}
        codes = dr.alloc_local(mi.UInt32, self.settings.max_events)
        lanes = {"active": all_of_them, "idle": all_of_them, "ray": ray}
        return {**state, **lanes, "memory": (self.nodes.memory, codes), "recorders": memory}

    def walk(self, state: State) -> None:
        """Visit all nodes of all trees."""
        if LaneRows.pay(self.scene.table):
            self.rows = LaneRows(self.scene.table, self.n)
        state, constant = self.varying(state)

        def visit(state: State) -> State:
            kept = constant
            if self.supply is not None:
                state = self._renewed(state)
                kept = {name: self.supply.known(name, state["ray"]) for name in constant}
            following = self.visit({**state, **kept})
            return {name: value for name, value in following.items() if name not in constant}

        walk_on = at_once if self.scatters else in_step
        state = walk_on(state, visit, partial(self.nodes.resume, child=REFLECT))
        if self.supply is None:
            self.end(state, mi.Bool(True))
        else:
            self.recorders.collect_lanes(self.supply.start(state["ray"]), state["recorders"])

    def varying(self, state: State) -> tuple[State, State]:
        """The variables that this scene needs, and the others with the values that they keep."""
        always = ("child", "medium")  # though not all scenes keep them with their nodes
        constant = {name: state[name] for name in OPTIONAL if name not in self.needed and name not in always}
        return {name: value for name, value in state.items() if name not in constant}, constant

    def _needed(self) -> set[str]:
        """Names of the variables of a node, beside those of every scene, that this one needs."""
        needed = set()
        if self.runs:
            needed |= {"run"}
        if self.settings.stokes:
            needed |= {"stokes"}
        if self.has_stock:
            needed |= {"normal"}
        if self.bulk:
            needed |= {"length", "clouded"}
        if self.odds is not None:
            needed |= {"odds", "chance"}
        if self.connects:
            needed |= {"near", "link", "joint"}
        if self.scatters:
            needed |= {"child", "medium", "scatters", "aimed_from", "birth", "scatter_factor"}
            if self.bulk:
                needed |= {"away", "shared"}
                if self.scene.table.optics.one_child:
                    needed |= {"medium_factor"}
        return needed

    def visit(self, state: State) -> State:
        """One visit of a node by every lane: arrive, report, choose a child, send it on, or go back."""
        path, codes = state["memory"]
        memory = dict(state["recorders"])
        if self.supply is not None:
            self.start = self.supply.start(state["ray"])
            self.first_depth = self.start.given("depth", self.full())
        trunk = dr.select(state["reflections"] == 0, state["depth"], state["trunk"])
        node = self._arrive(state, path, codes, memory)
        children = self.branching.children(node, memory)
        choice = self.branching.choose(node, children, memory)
        sent = self._send(node, children, choice)
        path, code = self._keep(node, children, choice, sent, path, codes, memory)
        following = self._follow(node, children, choice, sent, path, codes, code, memory)
        following |= self._go_back(node, choice, following.pop("hit"), trunk, memory)
        following = {**state, **following, "rng": node.rng}
        if self.supply is not None:
            done = state["active"] & ~following["active"]
            self._complete(following["segments"], done, memory)
            following |= {"active": state["active"], "idle": done}
        return {**following, "memory": (path, codes), "recorders": memory}

    def _renewed(self, state: State) -> State:
        """The variables of the loop after idle lanes have taken new rays; those that get none are finished."""
        assert self.supply is not None
        ray, found = self.supply.next(state["idle"])
        fresh = {name: self.supply.known(name, ray, found) for name in self.supply.names if name in state}
        fresh |= {"ray": ray, "active": mi.Bool(True)}
        renewed = {name: dr.select(found, value, state[name]) for name, value in fresh.items()}
        return {**state, **renewed, "active": state["active"] & (found | ~state["idle"])}

    def _complete(self, segments: mi.UInt32, done: mi.Bool, memory: Memory) -> None:
        self.recorders.end(self.start, segments, segments >= self.branching.max_segments, done, memory)

    def end(self, state: State, done: mi.Bool) -> None:
        """Trees are complete, and the lanes have no others."""
        self._complete(state["segments"], done, state["recorders"])
        self.recorders.collect_lanes(self.start, state["recorders"])

    def _attenuate(
        self, flux: mi.Float, medium: mi.UInt32, length: mi.Float, hit: mi.Bool
    ) -> tuple[mi.Float, mi.Float]:
        """What is left at the end of segments, and what their media scatter; what they absorb is reported."""
        optics = self.scene.table.optics
        if not optics.absorbs:
            return flux, mi.Float(0)
        left, clouded, taken = optics.attenuate(flux, medium, length, hit)
        self.recorders.take(medium, self.start.batch, taken, hit & (taken > 0) & self.books)
        return left, clouded

    def _arrive(self, state: State, path: Any, codes: Any, memory: Memory) -> Node:
        """What the light meets, and at a first visit what the surface takes of it, which is reported."""
        active, d, w, s = (state[k] for k in ("active", "d", "w", "s"))
        table, scattering = self.scene.table, self.scene.scattering
        first = active & (state["child"] == TRANSMIT)
        if self.connects:
            self.books = state["joint"] == 0
        visited = first & self.books
        again = active & ~first
        stokes = state["stokes"] if self.settings.stokes else None
        reached = dr.fma(state["away"], d, state["p"]) if self.bulk and self.scatters else state["p"]
        it = interact(table, reached, d, s, state["normal"] if self.has_stock else None, stokes, active, self.rows)
        strayed = first & (state["medium"] != 0) & (it.medium_in != 0) & (it.medium_in != state["medium"])
        self.lose(MEDIUM, w, strayed, memory)
        first &= ~strayed
        R, T = it.R, it.T
        given = None
        if scattering.any:
            given = scattering.give(s, it, first | again)
            R, T = R * given.reflection.kept, T * given.transmission.kept
        loss = 1 - R - T if given is None else given.absorbed
        at_rim = mi.Bool(False)
        if table.wall_rims.some:
            at_rim = table.wall_rims.at_rim(s, it.local, first)
            loss = dr.select(at_rim, 1, loss)
        absorbed = dr.select(dr.abs(loss) < NO_LOSS, 0, w * loss)
        counted = first & self.books
        absorbed, counts = self.limits.absorb(absorbed, counted)
        detected = mi.Bool(False) if self.scene.backward else counted & ((it.word & DETECTOR) != 0) & counts
        if not self.recorders.incident:
            detected &= absorbed > 0
        code = (s << EVENT_BITS) | ABSORBED
        hits = Visit(
            *(self.start, state, it, given, visited, counted, detected, detected, w, absorbed),
            *(film_coordinates(table, it, s), code, extend_key(state["key"], code), codes, path, self.scatters),
            odds=None if self.odds is None or self.scene.backward else self.odds.at_end(state),
            link=None if self.odds is None or self.scene.backward else self.odds.link_at_end(state),
        )
        self.recorders.visit(hits, memory)
        row = None
        if self.scene.windows is not None:
            row = worth_row(s, hits.before(active), state["scatters"] & COUNT_MASK)
        return Node(state, it, given, R, T, first & ~at_rim, again, state["rng"], row, self.start.scale)

    def _send(self, node: Node, children: Children, choice: Choice) -> _Sent:
        """The chosen child's origin, direction and flux."""
        state, it, given, rng = node.state, node.interaction, node.shares, node.rng
        w, d, s, p = state["w"], state["d"], state["s"], it.p
        table, scattering = self.scene.table, self.scene.scattering
        scatter, cloud, flux = choice.scatter, choice.cloud, choice.flux
        reflect = choice.number == REFLECT
        heading = dr.select(reflect, it.reflected, it.transmitted)
        origin = p
        aim, slope, rivalry = mi.Bool(False), dr.rcp(dr.select(reflect, it.R, it.T)), Rivalry()
        if self.scatters and given is not None:
            opposite = None if self.scene.opposite is None else self.scene.opposite.scattering
            connects = self.scene.connections is not None
            heading, share, scatter_slope, back_side, aim, rng, rivalry = scattering.scatter(
                table, s, given, choice.draw, it, d, heading, rng, scatter, opposite, connects
            )
            reflect = dr.select(scatter, back_side, reflect)
            slope = dr.select(scatter, scatter_slope, slope)
            flux = dr.select(scatter, w * share * choice.factor, flux)
        # Behind an opaque surface is no medium: the light stays in the one that led to it
        medium_in = dr.select(it.medium_in == 0, state["medium"], it.medium_in)
        away, shared = mi.Float(0), mi.Float(0)
        bulk_aim = children.bulk_aim
        if bulk_aim is not None and scattering.bulk is not None:
            cloud_ray = choice.draw_cloud(rng)
            away, along, share = scattering.bulk.scatter(
                medium_in, p, d, state["length"], bulk_aim, cloud_ray, rng, cloud
            )
            away = dr.select(cloud, away, 0)
            origin, heading = dr.fma(-away, d, p), dr.select(cloud, along, heading)
            slope = dr.select(cloud, 0, slope)
            shared = dr.select(cloud & (bulk_aim.rays > 0), flux, 0)
            flux = dr.select(cloud, flux * share, flux)
            aim |= cloud & cloud_ray.aim
        node.rng = rng
        place = dr.select(cloud, table.count + medium_in, s) if self.bulk else s
        return _Sent(origin, heading, flux, reflect, aim, slope, medium_in, place, away, shared, rivalry, node.visit)

    def _keep(
        self, node: Node, children: Children, choice: Choice, sent: _Sent, path: Any, codes: Any, memory: Memory
    ) -> tuple[Any, mi.UInt32]:
        """Keep the node, for its later visits and as part of the path, and report the branch; its nodes and code."""
        state, it, visit = node.state, node.interaction, node.visit
        depth, scatter, cloud = state["depth"], choice.scatter, choice.cloud
        joint = dr.select(scatter, sent.rivalry.joint, state["joint"]) if self.connects else state["joint"]
        sent.joint, self.books = joint, joint == 0 if self.connects else self.books
        if self.scatters:
            self.lose(children.remainder, -sent.flux, (scatter | cloud) & (sent.flux > 0), memory)
        sent.flux = self.limits.end(sent.flux, scatter, cloud, sent.reflect, visit)
        sent.active = go = visit & (sent.flux > 0)
        word = node_word(state["s"], state["reflections"])
        kept = {**state, "p": sent.origin, "away": sent.away, "word": word}
        kept |= {"child": choice.later, "scatter_factor": choice.kept.surface, "medium_factor": choice.kept.medium}
        path = self.nodes.keep(path, kept, depth, choice.pending, choice.pending | go, self.recorders.node_floats)
        how = (scatter, cloud, mi.Bool(False) if self.by_way else sent.aim) if self.scatters else None
        code = event_code(sent.place, it, sent.reflect, how)
        codes.write(code, depth, go)
        aimed = sent.aim if self.scatters else None
        branched = go & self.books
        self.recorders.branch(
            Branch(self.start, depth, it, sent.place, sent.reflect, aimed, sent.slope, branched), memory
        )
        return path, code

    def _follow(
        self,
        node: Node,
        children: Children,
        choice: Choice,
        sent: _Sent,
        path: Any,
        codes: Any,
        code: mi.UInt32,
        memory: Memory,
    ) -> State:
        """Follow rays to the next surface, or out of the scene; the variables of the loop for those that go on."""
        state, it, bulk, scatters = node.state, node.interaction, self.bulk, self.scatters
        table, depth, s, key = self.scene.table, state["depth"], state["s"], extend_key(state["key"], code)
        scatter, cloud, reflect, go = choice.scatter, choice.cloud, sent.reflect, sent.active
        medium = dr.select(reflect | cloud, sent.medium_in, it.medium_out)
        last = dr.select(cloud, NO_SURFACE, s) if bulk else s
        left_behind = state["normal"] if self.has_stock else None
        t, s2, normal = next_hit(table, self.scene.intersector, sent.origin, sent.heading, last, go, normal=left_behind)
        hit = go & (s2 != NO_SURFACE)
        leaving = go & ~hit
        self.lose(ESCAPED, sent.flux, leaving, memory)
        own = go & self.books
        self.recorders.travel(
            Segment(self.start, sent.origin, sent.heading, sent.flux, medium, t, leaving, own), memory
        )
        run = self.limits.run_after(state["run"], s, cloud)
        hit = self.limits.arrive(run, s2, sent.flux, hit)
        bounced, thins = reflect & children.counted & ~scatter, self.branching.thins(it, children)
        scattered, after = scatter | cloud, state["scatters"]
        if scatters:
            diffracted = is_diffraction(table.optics, it, scatter, reflect)
            after = dr.select(scattered, after_scatter(after, sent.aim, children.transmits | cloud, diffracted), after)
        following: State = {}
        if self.odds is not None:
            share, wall = dr.select(reflect, node.R, node.T), ~children.transmits
            following |= self.odds.after(state, share, wall, bounced & thins, scatter, cloud, sent.rivalry.odds)
            if self.connects:
                through = medium if self.scene.backward else sent.medium_in
                following |= self.odds.linked(state, it, sent.heading, through, sent.rivalry.against, scatter, cloud, t)
                following["joint"] = sent.joint
        if self.scene.backward or self.recorders.departs:
            reflections = state["reflections"] + dr.select(bounced, mi.UInt32(1), 0)
            last = (*sent.origin, *state["d"], state["w"])
            counts = (reflections, after, key, depth + 1, codes.read, leaving)
            gone = Departure(
                self.start,
                sent.heading,
                sent.flux,
                *counts,
                path,
                last,
                None if self.odds is None else self.odds.at_end(following),
                None if self.odds is None else self.odds.link_at_end(following),
                sent.joint if self.connects else None,
            )
            self.recorders.depart(gone, memory)
        flux, clouded = self._attenuate(sent.flux, medium, t, hit)
        if scatters:
            aimed_from = dr.select(bounced, NO_SURFACE, state["aimed_from"])
            following |= {
                "scatters": after,
                "aimed_from": dr.select(scattered, dr.select(sent.aim, sent.place, NO_SURFACE), aimed_from),
                "birth": dr.select(scattered, sent.flux, self.branching.birth(state, bounced & thins)),
                "scatter_factor": dr.full(mi.Float, 1, self.n),
            }
            if "medium_factor" in self.needed:
                following["medium_factor"] = dr.full(mi.Float, 1, self.n)
            if bulk:
                shared = dr.select(scattered, sent.shared, state["shared"])
                following |= {"length": t, "clouded": clouded, "away": mi.Float(0), "shared": shared}
        elif bulk:  # nothing is followed: a first visit reports what the medium scatters
            following["clouded"] = clouded
        if it.polarized:
            following["stokes"] = dr.select(scattered, 0, it.polarized.after(reflect, sent.heading))
        return following | {
            "hit": hit,
            "child": self.full(TRANSMIT),
            "p": dr.fma(t, sent.heading, sent.origin),
            "d": sent.heading,
            "w": flux,
            "s": dr.select(hit, s2, 0),
            "normal": normal if self.has_stock else state["normal"],
            "medium": medium,
            "reflections": dr.select(bounced, state["reflections"] + 1, state["reflections"]),
            "key": key,
            "run": run,
            "segments": dr.select(go, state["segments"] + 1, state["segments"]),
        }

    def _go_back(self, node: Node, choice: Choice, hit: mi.Bool, trunk: mi.UInt32, memory: Memory) -> State:
        """Let lanes whose branch has ended go back to their deepest pending node; the variables that this changes."""
        state = node.state
        depth = state["depth"]
        pending = dr.select(choice.pending, depth + 1, state["pending"])
        ended = state["active"] & ~hit
        back = ended & (pending != 0)
        k = dr.select(back, pending - 1, 0)
        closed = dr.select(back, k + 1, self.first_depth)
        self.recorders.back(Return(self.start, depth, k, closed, ended), memory)
        return {
            "active": hit | back,
            "wait": wait_level(k, trunk, back, 1 if self.scatters else LEVELS),
            "trunk": trunk,
            "depth": dr.select(back, k, depth + 1),
            "pending": pending,
        }
