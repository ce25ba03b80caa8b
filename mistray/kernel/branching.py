"""
Branching: the children of a node of the ray tree, and the child ray that each visit sends on.

A node has several children, in this order: the transmitted one, the reflected one, and the scattered ones. With
``splitting="split"`` each visit sends on the next child that has enough flux; with "one" a single child takes it all,
drawn at random in proportion to the flux of each.

Throughput β of a ray is its flux in units of the start ray's. Russian roulette (M. Pharr et al., Physically based
rendering, 4th edition, section 2.2.4) lets a child of throughput β < β_min survive with the probability q = β/β_min and
gives it β/q = β_min.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.kernel.branch_limits import BranchLimits
from mistray.kernel.bulk_scattering import BulkAim, MediumRay
from mistray.kernel.interaction import Interaction, counts_as_reflection
from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.scatter_shares import CONNECTED, Connection, ScatterBudget, ScatteredRay, ScatterPdfs
from mistray.recorders.path_key import COUNT_MASK, scatters_done
from mistray.recorders.recorder import Memory
from mistray.recorders.sampler import BRANCH, EVENT, Sampler
from mistray.recorders.start_rays import StartRays
from mistray.recorders.tallies import EVENTS, REFLECTIONS, ROULETTE, SAMPLING, SCATTERS, THRESHOLD
from mistray.settings import Settings
from mistray.surfaces.optics import ONE_CHILD, OPAQUE

Loss = Callable[[int | mi.UInt32, Any, mi.Bool, Memory], None]

TRANSMIT, REFLECT, SCATTER = range(3)  # numbers of children; scattered ones follow
START = 0xFFFFFFFF  # stands for the child of a start ray, which has met no surface
# Share of `scatter_threshold` that holds at walls of a backward trace: in the dark little is all there is
DARK_THRESHOLD_SHARE = 1e-3


@dataclass
class Node:
    """
    State of the ray tree nodes that a visit processes, one node per lane.

    Attributes
    ----------
    start : StartRays
        Start rays, one per lane.
    state : dict
        Variables of the loop, see `mistray.kernel.ray_tree`.
    interaction : Interaction
        Interaction at the hits.
    budget : ScatterBudget or None
        Scattered and absorbed fractions of the flux; None: no surface scatters.
    R, T : mi.Float
        Fractions of the incident flux in the specular reflected and transmitted rays, without scatter.
    first, again : mi.Bool
        Lanes on their first visit to the node, and lanes that have come back to it.
    starts : mi.Bool
        Lanes without a node, whose start ray sets off.
    contributes : mi.Bool
        Lanes whose flux enters the energy ledger; not those of connected rays, whose light other rays carry as well.
    sampler : Sampler
        Random numbers of each node.
    split : mi.UInt32
        Factor of the weight window on the number of rays that the surface scatters at random, see `WeightWindows`.
    survival : mi.Float
        Probability of the weight window that a node scatters.
    """

    start: StartRays
    state: dict[str, Any]
    interaction: Interaction
    budget: ScatterBudget | None
    R: mi.Float
    T: mi.Float
    first: mi.Bool
    again: mi.Bool
    starts: mi.Bool
    contributes: mi.Bool
    sampler: Sampler
    split: mi.UInt32
    survival: mi.Float

    @property
    def visit(self) -> mi.Bool:
        """Mask of lanes that visit a node, for the first time or again, and may send on a child ray."""
        return self.first | self.again


@dataclass
class Children:
    """
    Child rays of nodes: throughput of each kind of event, and numbers of scattered rays.

    Attributes
    ----------
    transmitted, reflected, scattered, in_scattered : mi.Float
        Throughput of each event, summed over its rays; `in_scattered` is scattered by the medium before the node.
    counted : mi.Bool
        Whether a reflection counts towards `max_reflections`.
    transmits : mi.Bool
        Whether the surface is not opaque.
    random_rays, aimed_rays, connected_rays : mi.UInt32
        Numbers of rays that the surface scatters at random, towards targets and to light vertices.
    random_medium_rays, medium_rays : mi.UInt32
        Number of rays that the medium scatters at random, and number of all rays that it scatters.
    bulk_aim : BulkAim or None
        Importance targets of light that the medium scatters; None: no medium scatters, or the settings allow none.
    remainder : mi.UInt32 or int
        Channel of the energy ledger for scattered flux that no ray carries.
    """

    transmitted: mi.Float
    reflected: mi.Float
    scattered: mi.Float
    in_scattered: mi.Float
    counted: mi.Bool
    transmits: mi.Bool
    random_rays: mi.UInt32
    aimed_rays: mi.UInt32
    connected_rays: mi.UInt32
    random_medium_rays: mi.UInt32
    medium_rays: mi.UInt32
    bulk_aim: BulkAim | None
    remainder: mi.UInt32 | int


@dataclass
class Choice:
    """
    Child ray that a visit to a node sends on, and the state for later visits.

    Attributes
    ----------
    number : mi.UInt32
        Index of the child: 0 transmitted, 1 reflected, from 2 on scattered.
    later : mi.UInt32
        Index of the next child; with ``splitting="one"`` that of this child.
    pending : mi.Bool
        Whether there is a next child, for which the lane comes back.
    flux : mi.Float
        Throughput of the child; 0: none is sent on.
    scatter, by_medium : mi.Bool
        Whether the surface scatters it, and whether the medium before it does.
    factor : mi.Float
        Factor on the throughput of a ray that the surface scatters.
    sampler : Sampler
        Random numbers of the child.
    draw, draw_in_medium : callable
        ``draw()`` returns the ray of the surface, ``draw_in_medium()`` that of the medium.
    """

    number: mi.UInt32
    later: mi.UInt32
    pending: mi.Bool
    flux: mi.Float
    scatter: mi.Bool
    by_medium: mi.Bool
    factor: mi.Float
    sampler: Sampler
    draw: Callable[[], ScatteredRay]
    draw_in_medium: Callable[[], MediumRay]


@dataclass(frozen=True)
class Sent:
    """Child rays that nodes send on, one per lane: origin (mm), direction, throughput, and pdfs for MIS weights."""

    origin: mi.Vector3f  # mm
    heading: mi.Vector3f  # unit direction
    flux: mi.Float  # throughput
    reflect: mi.Bool  # whether the ray stays on the side of incidence
    aim: mi.Bool  # whether it was scattered towards a target
    slope: mi.Float  # d ln(flux) / d(R or T)
    medium_in: mi.UInt32  # material on the side of incidence
    place: mi.UInt32  # index of the surface; of a medium that scatters, its position after all surfaces
    away: mi.Float  # of the node behind the origin, see the state; mm
    shared: mi.Float  # see the state
    pdfs: ScatterPdfs  # for MIS weights
    light_vertex: mi.UInt32  # see the state
    contributes: mi.Bool  # whether its flux enters the energy ledger, see `Node.contributes`
    active: mi.Bool  # whether there is one


class Branching:
    """
    Branching at the nodes of a trace: throughput of the children, roulette, splitting and choice of a child.

    Parameters
    ----------
    scene : KernelScene
        Scene at one wavelength, as the kernel sees it.
    settings : Settings
        Settings of the trace.
    limits : BranchLimits
        Limits on single branches.
    lose : callable
        ``lose(channel, flux, active, memory)``, see `mistray.recorders.recorder.Recorder.lose`.
    batch : mi.UInt32
        Index of the batch of each start ray.
    """

    def __init__(
        self, scene: KernelScene, settings: Settings, limits: BranchLimits, lose: Loss, batch: mi.UInt32
    ) -> None:
        self._optics, self._scattering, self._probabilities = scene.table.optics, scene.scattering, scene.probabilities
        self._backward, self._vertices, self._windows = scene.backward, scene.vertices, scene.windows is not None
        self._batch = batch
        self._limits, self._lose, self._max_events = limits, lose, settings.max_events
        self._bulk, self._scatters = scene.table.optics.scatters, scene.scatters(settings)
        self._draws = scene.draws(settings)
        self._threshold, self._scatter_threshold = (
            dr.opaque(mi.Float, limit) for limit in (settings.flux_threshold, settings.scatter_threshold)
        )
        self._scatter_limits = [dr.opaque(mi.UInt32, limit) for limit in settings.scatter_limits]
        self._max_reflections, self._scatter_rays, self.max_segments = (
            dr.opaque(mi.UInt32, limit) for limit in settings.tree_limits
        )
        self._split, self._roulette = settings.splitting == "split", settings.below_threshold == "roulette"

    def _lost(self, node: Node, channel: int | mi.UInt32, flux: mi.Float, active: mi.Bool, memory: Memory) -> None:
        """Record throughput lost at a node in a loss channel of the energy ledger, for lanes that count in it."""
        self._lose(channel, flux, active & node.contributes, memory)

    # ---- the flux of each child

    def children(self, node: Node, memory: Memory) -> Children:
        """Return the child rays of nodes. At the first visit, flux that limits cut is recorded as lost."""
        state, it, budget, first = node.state, node.interaction, node.budget, node.first
        w, depth, visit, reflections = state["w"], state["depth"], node.visit, state["reflections"]

        # Throughput of each event, by the shares of the coating and of scatter
        w_t, w_r = w * node.T, w * node.R
        w_s = w * budget.scattered if budget is not None else mi.Float(0)
        w_m = dr.select(visit, state["in_scattered"], 0) if self._bulk else mi.Float(0)

        # Limits of events, segments and reflections. A node that is visited again empties itself whatever the limit
        counted = counts_as_reflection(it)
        room = (depth + 1 < self._max_events) & (node.again | (state["segments"] < self.max_segments))
        may_reflect = ~counted | (reflections < self._max_reflections)
        w_all = w_t + w_r + w_s + w_m
        self._lost(node, EVENTS, w_all, first & ~room & (w_all > 0), memory)
        self._lost(node, REFLECTIONS, w_r, first & room & ~may_reflect & (node.R > 0), memory)
        w_t = dr.select(room, w_t, 0)
        w_r = dr.select(room & may_reflect, w_r, 0)
        generations = reflections + (state["scatters"] & COUNT_MASK)
        w_t, w_r, w_s, w_m = self._limits.follow(it, generations, (w_t, w_r, w_s, w_m), first & room & node.contributes)

        # Numbers of scattered rays, by the limits of scatter, the surface, its targets and its weight window
        transmits = (it.word & OPAQUE) == 0
        random_rays = aimed_rays = connected_rays = random_medium_rays = medium_rays = mi.UInt32(0)
        remainder: mi.UInt32 | int = SCATTERS
        may_scatter = may_scatter_in_medium = mi.Bool(False)
        bulk_aim = None
        if self._scatters:
            if self._scattering.bulk is not None:
                bulk_aim = self._scattering.bulk.aim(state["s"], it, visit)
            done, at_random, at_optics = scatters_done(state["scatters"])
            may_scatter = room & (done < self._scatter_limits[0])
            at_random, at_optics = at_random < self._scatter_limits[1], at_optics < self._scatter_limits[2]
            random_medium_rays = dr.select(at_random, mi.UInt32(1), 0)
            if bulk_aim is not None:
                medium_rays = random_medium_rays + bulk_aim.rays
            may_scatter_in_medium = may_scatter & at_optics & (medium_rays > 0)
            rays = self._scatter_rays
            if budget is not None:
                rays = dr.select(budget.random_rays > 0, budget.random_rays, rays)
            if self._windows:
                rays *= node.split
            random_rays = dr.select(at_random, rays, 0)
            remainder = dr.select(at_random, mi.UInt32(SAMPLING), mi.UInt32(SCATTERS))  # aimed rays leave light out
            aimed_rays = budget.aimed_t + budget.aimed_r if budget is not None else mi.UInt32(0)
            may_scatter &= (~transmits | at_optics) & (random_rays + aimed_rays > 0)
            if self._vertices is not None:
                # A ray that is connected to a light vertex scatters once more, there
                connected_rays = dr.select(done + 1 < self._scatter_limits[0], mi.UInt32(1), 0)
                w_t, w_r, w_s = self._connected(node, w_t, w_r, w_s)

        # Scatter that the limits end
        stopped = dr.select(may_scatter, 0, w_s) + dr.select(may_scatter_in_medium, 0, w_m)
        self._lost(node, SCATTERS, stopped, first & room & (stopped > 0), memory)
        w_s, w_m = dr.select(may_scatter, w_s, 0), dr.select(may_scatter_in_medium, w_m, 0)
        return Children(
            transmitted=w_t,
            reflected=w_r,
            scattered=w_s,
            in_scattered=w_m,
            counted=counted,
            transmits=transmits,
            random_rays=random_rays,
            aimed_rays=aimed_rays,
            connected_rays=connected_rays,
            random_medium_rays=random_medium_rays,
            medium_rays=medium_rays,
            bulk_aim=bulk_aim,
            remainder=remainder,
        )

    # ---- connections to light vertices

    def _connected(
        self, node: Node, w_t: mi.Float, w_r: mi.Float, w_s: mi.Float
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """
        Return the transmitted, reflected and scattered throughput that remains to each ray where rays are connected.

        A ray on its way to a light vertex only scatters, and only there. One that has been there scatters no more.
        Other rays keep all their throughput.
        """
        assert self._vertices is not None
        state, it = node.state, node.interaction
        vertex = state["light_vertex"]
        # It goes straight to its vertex: all that it meets before ends it
        under_way = (vertex != 0) & (vertex < CONNECTED)
        there = self._vertices.meets(vertex - 1, state["s"], it.p, under_way)
        w_s = dr.select((vertex == 0) | (under_way & there), w_s, 0)
        return dr.select(under_way, 0, w_t), dr.select(under_way, 0, w_r), w_s

    def _connection(self, node: Node, u: mi.Float) -> Connection:
        """
        Return the connection of a node to a light vertex, or at that vertex back along its incident light.

        The random number u chooses the light vertex.
        """
        assert self._vertices is not None
        it, vertex = node.interaction, node.state["light_vertex"]
        # The word of a ray at its vertex gets the flag CONNECTED
        there = vertex != 0
        number, factor = self._vertices.pick(self._batch, u)
        number = dr.select(there, vertex - 1, number)
        to_vertex = dr.normalize(self._vertices.point(number, ~there) - it.p)
        direction = dr.select(there, -self._vertices.heading(number, there), to_vertex)
        reflect = dr.dot(direction, it.axis) < 0
        word = dr.select(there, vertex | CONNECTED, number + 1)
        return Connection(direction, reflect, dr.select(there, 1, factor), word)

    # ---- thresholds and roulette

    def choose(self, node: Node, children: Children, memory: Memory) -> Choice:
        """
        Return the child ray of this visit to a node, after thresholds and Russian roulette.

        Unscattered rays below the flux threshold are cut or play roulette. Scattered rays play roulette below the
        scatter threshold.
        """
        state, first = node.state, node.first
        unscattered = (state["scatters"] & COUNT_MASK) == 0 if self._scatters else mi.Bool(True)
        scatter_limit = state["reference"] * self._scatter_threshold
        limit = dr.select(unscattered, self._flux_limit(node) if self._roulette else 0, scatter_limit)
        # One random number for all children, whose survival may depend on each other's without bias
        u, choice = node.sampler.pair(BRANCH) if self._draws else (mi.Float(0), mi.Float(0))
        if not self._split:
            return self._one(node, children, unscattered, limit, (u, choice), memory)
        factor = mi.Float(1)
        if self._scatters:  # later visits draw the same numbers, and so come to the same result
            factor = self._scatter_factor(node, children, scatter_limit, u)
        medium_factor = factor
        if self._optics.one_child:
            factor = self._only_child(node, children, factor, choice)
        if self._scatters:
            scattered = children.scattered + children.in_scattered
            self._lost(node, children.remainder, scattered, first & (scattered > 0), memory)
        self._cut_weak(node, children, unscattered, limit, u, memory)
        return self._next(node, children, factor, medium_factor)

    def _flux_limit(self, node: Node) -> mi.Float:
        """Return the throughput of `flux_threshold`, below which unscattered light is cut or plays roulette."""
        return self._threshold * node.start.given("scale", 1)

    def _scatter_factor(self, node: Node, children: Children, scatter_limit: mi.Float, u: mi.Float) -> mi.Float:
        """
        Return the roulette factors 1/q of nodes that scatter, 0 for others, by the random number `u`.

        The probability q grows with throughput relative to `scatter_limit`.
        """
        state, w = node.state, node.state["w"]
        # q = β/β_min, where β includes what the medium has scattered
        limit = scatter_limit
        if self._backward:
            limit = dr.select(children.transmits, limit, limit * DARK_THRESHOLD_SHARE)
        if self._bulk:
            # Of all rays of a segment one scatters again on average: trees in a medium would grow without end
            limit = dr.maximum(limit, state["shared"])
        q = dr.minimum((w + state["in_scattered"] if self._bulk else w) / limit, 1)
        # Probabilities by surface, and by weight window; a connected ray always scatters at its vertex
        if self._probabilities is not None:
            q = q * dr.gather(mi.Float, self._probabilities.scatter, state["s"], node.visit)
        if self._windows:
            connected = mi.Bool(False) if self._vertices is None else state["light_vertex"] != 0
            q = q * dr.select(connected, 1, node.survival)
        return dr.select(1 - u <= q, dr.rcp(q), 0)

    def plays_roulette(self, it: Interaction, children: Children) -> mi.Bool:
        """Return a mask of nodes at which a reflection of unscattered light plays roulette by branch probabilities."""
        return children.transmits & children.counted & ((it.word & ONE_CHILD) == 0)

    def reference(self, state: dict[str, Any], by_roulette: mi.Bool) -> mi.Float:
        """
        Return the throughput to which the scatter threshold is relative, for rays that this node does not scatter.

        A reflection that is followed by roulette raises the throughput of a ray, and so it raises the reference. Their
        ratio is then that of the light, and the same for forward and backward rays on one path. Without such roulette,
        and with ``splitting="one"``, the reference stays the same.
        """
        if self._probabilities is None or not self._split:  # one child takes all
            return state["reference"]
        unscattered = (state["scatters"] & COUNT_MASK) == 0
        raised = state["reference"] / self._probabilities.reflection
        return dr.select(by_roulette & unscattered, raised, state["reference"])

    @staticmethod
    def _only_child(node: Node, children: Children, factor: mi.Float, u: mi.Float) -> mi.Float:
        """
        Return the roulette factor after one of transmission, reflection and scatter has taken all the throughput.

        The random number u draws one. This holds for surfaces with the flag `ONE_CHILD`; `children` is changed in
        place. Light that the medium has scattered is still sent on.
        """
        # Each with a probability in proportion to its flux, and with the flux of all
        w_t, w_r, w_s = children.transmitted, children.reflected, children.scattered
        w_all = w_t + w_r + w_s
        chosen = u * w_all
        only = node.visit & ((node.interaction.word & ONE_CHILD) != 0)
        to_t, to_r = chosen < w_t, (chosen >= w_t) & ((chosen < w_t + w_r) | (w_s == 0))
        factor = dr.select(only, dr.select(to_t | to_r, 0, factor * w_all / w_s), factor)
        children.transmitted = dr.select(only, dr.select(to_t, w_all, 0), w_t)
        children.reflected = dr.select(only, dr.select(to_r, w_all, 0), w_r)
        children.scattered = dr.select(only, dr.select(to_t | to_r, 0, w_all), w_s)
        return factor

    def _cut_weak(
        self, node: Node, children: Children, unscattered: mi.Bool, limit: mi.Float, u: mi.Float, memory: Memory
    ) -> None:
        """
        Cut unscattered specular children below the flux threshold, or let weak ones play roulette; change `children`.

        Roulette is played with the random number `u`: by children below the throughput `limit`, and by unscattered
        reflections where there are branch probabilities. Which of these apply depends on the settings.
        """
        first, probabilities = node.first, self._probabilities
        w_t, w_r, u_r = children.transmitted, children.reflected, u

        # Cut unscattered light below the flux threshold
        if not self._roulette:
            least = self._flux_limit(node)
            cut_t, cut_r = unscattered & (w_t < least), unscattered & (w_r < least)
            cut = dr.select(cut_t, w_t, 0) + dr.select(cut_r, w_r, 0)
            self._lost(node, THRESHOLD, cut, first & (cut > 0), memory)
            w_t, w_r = dr.select(cut_t, 0, w_t), dr.select(cut_r, 0, w_r)

        # Roulette of reflections, whose probability is the same for all
        if probabilities is not None:
            by_roulette = unscattered & self.plays_roulette(node.interaction, children)
            u_r = dr.select(by_roulette, u / probabilities.reflection, u)  # of those that survive uniform again
            kept_r = dr.select(by_roulette, dr.select(u_r < 1, w_r / probabilities.reflection, 0), w_r)
            self._lost(node, ROULETTE, w_r - kept_r, first & by_roulette, memory)
            w_r = kept_r

        # Roulette of weak light
        if self._roulette or self._scatters:
            kept_t, kept_r = (
                dr.select((v > 0) & (v < limit), dr.select(draw * limit < v, limit, 0), v)
                for v, draw in ((w_t, u), (w_r, u_r))
            )
            self._lost(node, ROULETTE, w_t + w_r - kept_t - kept_r, first & (dr.minimum(w_t, w_r) < limit), memory)
            w_t, w_r = kept_t, kept_r
        children.transmitted, children.reflected = w_t, w_r

    # ---- the choice

    def _next(self, node: Node, children: Children, factor: mi.Float, medium_factor: mi.Float) -> Choice:
        """
        Return the next child with flux at each node; with ``splitting="split"`` each visit sends on one.

        The factors are those of roulette on what the surface scatters, and on what the medium does.
        """
        first, visit, budget, bulk_aim = node.first, node.visit, node.budget, children.bulk_aim
        w_t, w_r, w_s, w_m = children.transmitted, children.reflected, children.scattered, children.in_scattered
        random_rays, random_medium_rays = children.random_rays, children.random_medium_rays

        # Children: transmitted, reflected, scattered by the surface (random, aimed, connected), scattered by the medium
        own_rays = random_rays + children.aimed_rays
        scattered_rays = dr.select((factor > 0) & (w_s > 0), own_rays + children.connected_rays, 0)
        if self._vertices is not None:  # at its light vertex a connected ray has one child, backward to the light
            at_vertex = node.state["light_vertex"] != 0
            scattered_rays = dr.select(at_vertex, dr.minimum(scattered_rays, 1), scattered_rays)
        end = SCATTER + scattered_rays + dr.select((medium_factor > 0) & (w_m > 0), children.medium_rays, 0)

        # This one, and whether the lane has to come back for another
        after_t = dr.select(w_r > 0, mi.UInt32(REFLECT), mi.UInt32(SCATTER))
        number = dr.select(first, dr.select(w_t > 0, mi.UInt32(TRANSMIT), after_t), node.state["child"])
        later = dr.select(number == TRANSMIT, after_t, dr.maximum(number + 1, SCATTER))
        pending = visit & ((later == REFLECT) | (later < end))

        # Its flux; scattered rays take theirs from the direction that is drawn
        flux = dr.select(number == TRANSMIT, w_t, dr.select(number == REFLECT, w_r, 0))
        scatter = visit & (number >= SCATTER) & (number < SCATTER + scattered_rays)
        by_medium = visit & (number >= SCATTER + scattered_rays) & (number < end)
        flux = dr.select(by_medium, w_m * medium_factor, flux)
        sampler = node.sampler.child(number)

        def draw() -> ScatteredRay:
            assert budget is not None
            event, vertex = sampler.pair(EVENT)
            if self._vertices is None:
                return budget.ray(number - SCATTER, random_rays, event)
            connection = self._connection(node, vertex)
            return budget.ray(dr.select(at_vertex, own_rays, number - SCATTER), random_rays, event, connection)

        def draw_in_medium() -> MediumRay:
            assert bulk_aim is not None
            aimed = number >= SCATTER + scattered_rays + random_medium_rays
            return MediumRay(aimed, mi.Float(random_medium_rays), mi.Float(bulk_aim.rays))

        return Choice(
            number=number,
            later=later,
            pending=pending,
            flux=flux,
            scatter=scatter,
            by_medium=by_medium,
            factor=factor,
            sampler=sampler,
            draw=draw,
            draw_in_medium=draw_in_medium,
        )

    def _one(
        self,
        node: Node,
        children: Children,
        unscattered: mi.Bool,
        limit: mi.Float,
        u: tuple[mi.Float, mi.Float],
        memory: Memory,
    ) -> Choice:
        """
        Return the child of ``splitting="one"``, drawn in proportion to flux, with that of all; see `_cut_weak`.

        The two random numbers u are for roulette and for the choice of the child.
        """
        first, visit, budget, bulk_aim = node.first, node.visit, node.budget, children.bulk_aim
        w_t, w_r, w_s, w_m = children.transmitted, children.reflected, children.scattered, children.in_scattered
        random_rays, random_medium_rays = children.random_rays, children.random_medium_rays
        # A share of the flux of all, drawn uniformly, falls to one of them
        w_all = w_t + w_r + w_s + w_m
        chosen = u[1] * w_all
        number = dr.select(
            chosen < w_t,
            mi.UInt32(TRANSMIT),
            dr.select((chosen < w_t + w_r) | (w_s + w_m == 0), mi.UInt32(REFLECT), mi.UInt32(SCATTER)),
        )

        # Roulette, or the cut, of the flux of all
        flux = w_all
        if self._roulette or self._scatters:
            small = (w_all > 0) & (w_all < limit)
            flux = dr.select(small, dr.select(u[0] * limit < w_all, limit, 0), w_all)
            self._lost(node, ROULETTE, w_all - flux, visit & small, memory)
        if not self._roulette:
            cut = unscattered & (w_all < self._flux_limit(node))
            self._lost(node, THRESHOLD, w_all, first & cut & (w_all > 0), memory)
            flux = dr.select(cut, 0, flux)

        # Scatter by the medium or by the surface
        scatter = visit & (number == SCATTER) & (flux > 0)
        by_medium = scatter & (chosen >= w_t + w_r + w_s) & (w_m > 0)
        scatter &= ~by_medium & (w_s > 0)
        flux = dr.select((number == SCATTER) & ~scatter & ~by_medium, 0, flux)
        if self._scatters:
            self._lost(node, children.remainder, flux, scatter | by_medium, memory)
        sampler = node.sampler.child(number)

        def draw() -> ScatteredRay:
            assert budget is not None
            return budget.one_ray(w_s / w_all, random_rays, sampler.pair(EVENT))

        def draw_in_medium() -> MediumRay:
            bulk = self._scattering.bulk
            assert bulk is not None
            assert bulk_aim is not None
            return bulk.one_ray(bulk_aim, random_medium_rays, sampler.pair(EVENT)[1])

        return Choice(
            number=number,
            later=number,
            pending=mi.Bool(False),
            flux=flux,
            scatter=scatter,
            by_medium=by_medium,
            factor=flux / w_all,
            sampler=sampler,
            draw=draw,
            draw_in_medium=draw_in_medium,
        )
