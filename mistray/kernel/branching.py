"""Which children a node of the ray tree has, and which of them a visit sends on.

A node has several children, in this order: the transmitted one, the reflected one, and the scattered ones. Light can be
split, so that each visit sends on the next child that has enough flux, or one child, drawn at random, takes it all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from mistray.kernel.branch_limits import BranchLimits
from mistray.kernel.bulk_scattering import BulkAim, CloudRay
from mistray.kernel.event_codes import scatters_done
from mistray.kernel.interaction import Interaction, counts_as_reflection
from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.scatter_shares import JOINED, Joint, ScatterBudget, ScatteredRay
from mistray.recorders.path_key import COUNT_MASK
from mistray.recorders.recorder import Memory
from mistray.recorders.tallies import EVENTS, REFLECTIONS, ROULETTE, SAMPLING, SCATTERS, THRESHOLD
from mistray.settings import Settings
from mistray.surfaces.optics import ONE_CHILD, OPAQUE

Loss = Callable[[int | mi.UInt32, Any, mi.Bool, Memory], None]

TRANSMIT, REFLECT, SCATTER = range(3)  # numbers of children; scattered ones follow
# Share of `scatter_threshold` that holds at walls of a backward trace: in the dark little is all there is
WORTH_IN_THE_DARK = 1e-3


@dataclass
class Node:
    """
    Nodes that the lanes visit.

    Attributes
    ----------
    state : dict
        Variables of the loop, see `mistray.kernel.ray_tree`.
    interaction : Interaction
    shares : ScatterBudget or None
        What the surface scatters; None: no surface does.
    R, T : mi.Float
        What it reflects and transmits as a specular beam.
    first, again : mi.Bool
        Lanes that visit for the first time, and that come back.
    rng : mi.PCG32
    row : mi.UInt32 or None
        Of its weight window, see `mistray.recorders.start_samples.worth_row`; None: there are no windows.
    scale : mi.Float or None
        Weights of the start rays, where `Settings.flux_threshold` is relative to them; None: to 1.
    """

    state: dict[str, Any]
    interaction: Interaction
    shares: ScatterBudget | None
    R: mi.Float
    T: mi.Float
    first: mi.Bool
    again: mi.Bool
    rng: mi.PCG32
    row: mi.UInt32 | None = None
    scale: mi.Float | None = None

    @property
    def visit(self) -> mi.Bool:
        """Lanes that send a ray on, if there is one."""
        return self.first | self.again


@dataclass
class Children:
    """
    Flux that goes on from nodes, after all limits but the thresholds.

    Attributes
    ----------
    transmitted, reflected, scattered, clouded : mi.Float
        The last is what the medium on the way has scattered.
    counted : mi.Bool
        Whether a reflection counts.
    transmits : mi.Bool
        Whether the surface is not opaque.
    random_rays, aimed_rays, connected_rays : mi.UInt32
        Scattered rays of a surface.
    random_clouds, clouded_rays : mi.UInt32
        Rays that a medium scatters at random, and all.
    bulk_aim : BulkAim or None
        Targets of the medium.
    remainder : mi.UInt32 or int
        Loss channel of what scattered rays leave over.
    """

    transmitted: mi.Float
    reflected: mi.Float
    scattered: mi.Float
    clouded: mi.Float
    counted: mi.Bool
    transmits: mi.Bool
    random_rays: mi.UInt32
    aimed_rays: mi.UInt32
    connected_rays: mi.UInt32
    random_clouds: mi.UInt32
    clouded_rays: mi.UInt32
    bulk_aim: BulkAim | None
    remainder: mi.UInt32 | int


class ScatterFactors(NamedTuple):
    """
    By what the scattered rays of a node are stronger because others like it scatter none; 0: it scatters none.

    Attributes
    ----------
    surface, medium : mi.Float
        Of the flux of a ray that the surface scatters, and of one that the medium before it does. They differ only
        where one of transmission, reflection and scatter of the surface takes the flux of all.
    """

    surface: mi.Float
    medium: mi.Float


@dataclass
class Choice:
    """
    The child that a visit sends on.

    Attributes
    ----------
    number : mi.UInt32
    later : mi.UInt32
        Number of the next one.
    pending : mi.Bool
        Whether there is a next one, for which the lane comes back.
    flux : mi.Float
        0: none is sent on.
    scatter, cloud : mi.Bool
        Whether the surface scatters it, or the medium before it has.
    kept : ScatterFactors
        For later visits.
    factor : mi.Float
        Of the flux of a ray that the surface scatters.
    draw, draw_cloud : callable
        ``draw(rng)`` gives the ray of the surface, ``draw_cloud(rng)`` that of the medium.
    """

    number: mi.UInt32
    later: mi.UInt32
    pending: mi.Bool
    flux: mi.Float
    scatter: mi.Bool
    cloud: mi.Bool
    kept: ScatterFactors
    factor: mi.Float
    draw: Callable[[mi.PCG32], ScatteredRay]
    draw_cloud: Callable[[mi.PCG32], CloudRay]


class Branching:
    """
    How the nodes of a trace branch.

    Parameters
    ----------
    scene : KernelScene
    settings : Settings
    limits : BranchLimits
    lose : callable
        ``lose(channel, flux, active, memory)``, see `mistray.recorders.recorder.Recorder.lose`.
    batch : mi.UInt32
        Of the start rays.
    """

    def __init__(
        self,
        scene: KernelScene,
        settings: Settings,
        limits: BranchLimits,
        lose: Loss,
        batch: mi.UInt32,
    ) -> None:
        self._optics, self._scattering, self._probabilities = scene.table.optics, scene.scattering, scene.probabilities
        self._backward, self._connections, self._windows = scene.backward, scene.connections, scene.windows
        self._batch = batch
        self._limits, self._lose, self._max_events = limits, lose, settings.max_events
        self._bulk, self._scatters = scene.table.optics.scatters, scene.scatters(settings)
        self._threshold, self._scatter_threshold = (
            dr.opaque(mi.Float, limit) for limit in (settings.flux_threshold, settings.scatter_threshold)
        )
        self._scatter_limits = [dr.opaque(mi.UInt32, limit) for limit in settings.scatter_limits]
        self._max_reflections, self._scatter_rays, self.max_segments = (
            dr.opaque(mi.UInt32, limit) for limit in settings.tree_limits
        )
        self._split, self._roulette = settings.splitting == "split", settings.below_threshold == "roulette"

    def children(self, node: Node, memory: Memory) -> Children:
        """What goes on from nodes; what the limits cut is lost at the first visit."""
        state, it, given, first, scatters = node.state, node.interaction, node.shares, node.first, self._scatters
        w, depth, visit, optics_bulk = state["w"], state["depth"], node.visit, self._bulk
        counted = counts_as_reflection(it)
        reflections = state["reflections"]
        # Pending nodes are emptied
        room = (depth + 1 < self._max_events) & (node.again | (state["segments"] < self.max_segments))
        may_reflect = ~counted | (reflections < self._max_reflections)
        w_t, w_r = w * node.T, w * node.R
        w_s = w * given.scattered if given is not None else mi.Float(0)
        w_b = dr.select(visit, state["clouded"], 0) if optics_bulk else mi.Float(0)
        self._lose(EVENTS, w_t + w_r + w_s + w_b, first & ~room & (w_t + w_r + w_s + w_b > 0), memory)
        self._lose(REFLECTIONS, w_r, first & room & ~may_reflect & (node.R > 0), memory)
        w_t = dr.select(room, w_t, 0)
        w_r = dr.select(room & may_reflect, w_r, 0)
        generations = reflections + (state["scatters"] & COUNT_MASK)
        w_t, w_r, w_s, w_b = self._limits.follow(it, generations, (w_t, w_r, w_s, w_b), first & room)
        transmits = (it.word & OPAQUE) == 0
        random_rays = aimed_rays = connected_rays = random_clouds = clouded_rays = mi.UInt32(0)
        remainder: mi.UInt32 | int = SCATTERS
        may_scatter = may_cloud = mi.Bool(False)
        bulk_aim = None
        if scatters:
            if self._scattering.bulk is not None:
                bulk_aim = self._scattering.bulk.aim(state["s"], it, visit)
            done = scatters_done(state["scatters"])
            may_scatter = room & (done[0] < self._scatter_limits[0])
            at_random, at_optics = done[1] < self._scatter_limits[1], done[2] < self._scatter_limits[2]
            random_clouds = dr.select(at_random, mi.UInt32(1), 0)
            if bulk_aim is not None:
                clouded_rays = random_clouds + bulk_aim.rays
            may_cloud = may_scatter & at_optics & (clouded_rays > 0)
            wanted_rays = self._scatter_rays
            if given is not None:
                wanted_rays = dr.select(given.random_rays > 0, given.random_rays, wanted_rays)
            if self._windows is not None:
                wanted_rays *= self._windows.split(node.row, w, visit)
            random_rays = dr.select(at_random, wanted_rays, 0)
            remainder = dr.select(at_random, mi.UInt32(SAMPLING), mi.UInt32(SCATTERS))  # aimed rays leave light out
            aimed_rays = given.aimed_t + given.aimed_r if given is not None else mi.UInt32(0)
            may_scatter &= (~transmits | at_optics) & (random_rays + aimed_rays > 0)
            if self._connections is not None:
                # A ray that is connected to light scatters once more
                connected_rays = dr.select(done[0] + 1 < self._scatter_limits[0], mi.UInt32(1), 0)
                w_t, w_r, w_s = self._joined(node, w_t, w_r, w_s)
        stopped = dr.select(may_scatter, 0, w_s) + dr.select(may_cloud, 0, w_b)
        self._lose(SCATTERS, stopped, first & room & (stopped > 0), memory)
        w_s, w_b = dr.select(may_scatter, w_s, 0), dr.select(may_cloud, w_b, 0)
        return Children(
            *(w_t, w_r, w_s, w_b, counted, transmits, random_rays, aimed_rays, connected_rays, random_clouds),
            *(clouded_rays, bulk_aim, remainder),
        )

    def _joined(self, node: Node, w_t: mi.Float, w_r: mi.Float, w_s: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Rays that are connected to light scatter at its point and nowhere else, and are sent on as they scatter."""
        assert self._connections is not None
        state, it = node.state, node.interaction
        joint = state["joint"]
        under_way = (joint != 0) & (joint < JOINED)
        there = self._connections.meets(joint - 1, state["s"], it.p, under_way)
        w_s = dr.select((joint == 0) | (under_way & there), w_s, 0)
        return dr.select(under_way, 0, w_t), dr.select(under_way, 0, w_r), w_s

    def _joint(self, node: Node, rng: mi.PCG32) -> Joint:
        """Where the rays of nodes go that are connected to light: to a point of it, or from there along the light."""
        assert self._connections is not None
        it, joint = node.interaction, node.state["joint"]
        there = joint != 0
        number, factor = self._connections.pick(self._batch, rng.next_float32())
        number = dr.select(there, joint - 1, number)
        to_point = dr.normalize(self._connections.point(number, ~there) - it.p)
        direction = dr.select(there, -self._connections.heading(number, there), to_point)
        reflect = dr.dot(direction, it.axis) < 0
        word = dr.select(there, joint | JOINED, number + 1)
        return Joint(direction, reflect, dr.select(there, 1, factor), word)

    def _least(self, node: Node) -> mi.Float:
        """What light has at least that nothing has scattered."""
        return self._threshold if node.scale is None else self._threshold * node.scale

    def choose(self, node: Node, children: Children, memory: Memory) -> Choice:
        """
        The child of this visit; what is below the thresholds is lost, or plays roulette.

        A ray that has not been scattered keeps to the flux threshold; one that has plays roulette below its own.
        """
        state, first = node.state, node.first
        fresh = (state["scatters"] & COUNT_MASK) == 0 if self._scatters else mi.Bool(True)
        own = state["birth"] * self._scatter_threshold
        limit = dr.select(fresh, self._least(node) if self._roulette else 0, own)
        # One for all children: none knows of another
        draws = self._roulette or self._scatters or self._probabilities is not None
        u = node.rng.next_float32() if draws else mi.Float(0)
        if not self._split:
            return self._one(node, children, fresh, limit, u, memory)
        scattering = self._kept(state)
        if self._scatters:
            scattering = self._scatter_factor(node, children, own, u)
        if self._optics.one_child:
            scattering = self._only_child(node, children, scattering)
        if self._scatters:
            scattered = children.scattered + children.clouded
            self._lose(children.remainder, scattered, first & (scattered > 0), memory)
        self._cut_weak(node, children, fresh, limit, u, memory)
        return self._next(node, children, scattering)

    def _scatter_factor(self, node: Node, children: Children, own: mi.Float, u: mi.Float) -> ScatterFactors:
        """Factor of scattered rays; a weak node scatters with a probability in proportion to the light there."""
        state, first, w = node.state, node.first, node.state["w"]
        least = own
        if self._backward:
            least = dr.select(children.transmits, own, own * WORTH_IN_THE_DARK)
        if self._bulk:
            # Of all rays of a segment one scatters again on average: trees in a medium would grow without end
            least = dr.maximum(least, state["shared"])
        chance = dr.minimum((w + state["clouded"] if self._bulk else w) / least, 1)
        if self._probabilities is not None:
            chance = chance * dr.gather(mi.Float, self._probabilities.scatter, state["s"], first)
        if self._windows is not None:
            wanted = self._windows.chance(node.row, w, first)
            if self._connections is not None:
                wanted = dr.select(state["joint"] == 0, wanted, 1)
            chance = chance * wanted
        factor = dr.select(1 - u <= chance, dr.rcp(chance), 0)
        return ScatterFactors(*(dr.select(first, factor, kept) for kept in self._kept(state)))

    def _kept(self, state: dict[str, Any]) -> ScatterFactors:
        """The factors of a node at its later visits."""
        surface = state["scatter_factor"]
        return ScatterFactors(surface, state["medium_factor"] if self._bulk and self._optics.one_child else surface)

    @staticmethod
    def thins(it: Interaction, children: Children) -> mi.Bool:
        """Where rays may follow a reflection by chance, unless something has scattered them."""
        return children.transmits & children.counted & ((it.word & ONE_CHILD) == 0)

    def birth(self, state: dict[str, Any], thinned: mi.Bool) -> mi.Float:
        """
        Weight with which rays began that no node scatters; the threshold of scatter is relative to it.

        Where only some rays follow a reflection, their weight is raised, and so is this one. The ratio of both is then
        that of the light, to which rays of the other direction come, too.
        """
        if self._probabilities is None or not self._split:  # one child takes all
            return state["birth"]
        fresh = (state["scatters"] & COUNT_MASK) == 0
        return dr.select(thinned & fresh, state["birth"] / self._probabilities.reflection, state["birth"])

    @staticmethod
    def _only_child(node: Node, children: Children, scattering: ScatterFactors) -> ScatterFactors:
        """
        Let one of transmission, reflection and scatter take the flux of all, at surfaces that are declared so.

        What the medium has scattered is sent on all the same.
        """
        w_t, w_r, w_s = children.transmitted, children.reflected, children.scattered
        w_all = w_t + w_r + w_s
        chosen = node.rng.next_float32() * w_all
        only = node.first & ((node.interaction.word & ONE_CHILD) != 0)
        to_t, to_r = chosen < w_t, (chosen >= w_t) & ((chosen < w_t + w_r) | (w_s == 0))
        factor = scattering.surface
        factor = dr.select(only, dr.select(to_t | to_r, 0, factor * w_all / w_s), factor)
        children.transmitted = dr.select(only, dr.select(to_t, w_all, 0), w_t)
        children.reflected = dr.select(only, dr.select(to_r, w_all, 0), w_r)
        children.scattered = dr.select(only, dr.select(to_t | to_r, 0, w_all), w_s)
        return scattering._replace(surface=factor)

    def _cut_weak(
        self, node: Node, children: Children, fresh: mi.Bool, limit: mi.Float, u: mi.Float, memory: Memory
    ) -> None:
        """Cut specular children below the threshold, or let them play roulette."""
        first, again, probabilities = node.first, node.again, self._probabilities
        w_t, w_r = children.transmitted, children.reflected
        if not self._roulette:
            least = self._least(node)
            cut_t, cut_r = fresh & (w_t < least), fresh & (w_r < least)
            cut = dr.select(cut_t, w_t, 0) + dr.select(cut_r, w_r, 0)
            self._lose(THRESHOLD, cut, first & (cut > 0), memory)
            w_t, w_r = dr.select(cut_t, 0, w_t), dr.select(cut_r, 0, w_r)
        if probabilities is not None:
            thinned = fresh & self.thins(node.interaction, children)
            followed = again | (u < probabilities.reflection)
            kept_r = dr.select(thinned, dr.select(followed, w_r / probabilities.reflection, 0), w_r)
            self._lose(ROULETTE, w_r - kept_r, first & thinned, memory)
            w_r = kept_r
        if self._roulette or self._scatters:
            # A later visit is for a child that has survived
            left_t, left_r = (
                dr.select((v > 0) & (v < limit), dr.select(u * limit < v, limit, 0), v) for v in (w_t, w_r)
            )
            left_r = dr.select(again & (w_r > 0), dr.maximum(w_r, limit), left_r)
            self._lose(ROULETTE, w_t + w_r - left_t - left_r, first & (dr.minimum(w_t, w_r) < limit), memory)
            w_t, w_r = left_t, left_r
        children.transmitted, children.reflected = w_t, w_r

    def _next(self, node: Node, children: Children, scattering: ScatterFactors) -> Choice:
        """Of all children the next that has flux."""
        first, visit, given, bulk_aim = node.first, node.visit, node.shares, children.bulk_aim
        w_t, w_r, w_s, w_b = children.transmitted, children.reflected, children.scattered, children.clouded
        random_rays, random_clouds = children.random_rays, children.random_clouds
        own_rays = random_rays + children.aimed_rays
        scattered_rays = dr.select((scattering.surface > 0) & (w_s > 0), own_rays + children.connected_rays, 0)
        if self._connections is not None:  # where light arrives the one ray that goes against it is sent on
            at_point = node.state["joint"] != 0
            scattered_rays = dr.select(at_point, dr.minimum(scattered_rays, 1), scattered_rays)
        end = SCATTER + scattered_rays + dr.select((scattering.medium > 0) & (w_b > 0), children.clouded_rays, 0)
        after_t = dr.select(w_r > 0, mi.UInt32(REFLECT), mi.UInt32(SCATTER))
        number = dr.select(first, dr.select(w_t > 0, mi.UInt32(TRANSMIT), after_t), node.state["child"])
        later = dr.select(number == TRANSMIT, after_t, dr.maximum(number + 1, SCATTER))
        pending = visit & ((later == REFLECT) | (later < end))
        flux = dr.select(number == TRANSMIT, w_t, dr.select(number == REFLECT, w_r, 0))
        scatter = visit & (number >= SCATTER) & (number < SCATTER + scattered_rays)
        cloud = visit & (number >= SCATTER + scattered_rays) & (number < end)
        flux = dr.select(cloud, w_b * scattering.medium, flux)

        def draw(rng: mi.PCG32) -> ScatteredRay:
            assert given is not None
            if self._connections is None:
                return given.ray(number - SCATTER, random_rays, rng)
            joint = self._joint(node, rng)
            return given.ray(dr.select(at_point, own_rays, number - SCATTER), random_rays, rng, joint)

        def draw_cloud(rng: mi.PCG32) -> CloudRay:
            assert bulk_aim is not None
            aimed = number >= SCATTER + scattered_rays + random_clouds
            return CloudRay(aimed, mi.Float(random_clouds), mi.Float(bulk_aim.rays))

        return Choice(number, later, pending, flux, scatter, cloud, scattering, scattering.surface, draw, draw_cloud)

    def _one(
        self, node: Node, children: Children, fresh: mi.Bool, limit: mi.Float, u: mi.Float, memory: Memory
    ) -> Choice:
        """One child takes the flux of all, at random in proportion to what each would have had."""
        first, visit, given, bulk_aim = node.first, node.visit, node.shares, children.bulk_aim
        w_t, w_r, w_s, w_b = children.transmitted, children.reflected, children.scattered, children.clouded
        random_rays, random_clouds = children.random_rays, children.random_clouds
        both = w_t + w_r + w_s + w_b
        chosen = node.rng.next_float32() * both
        number = dr.select(
            chosen < w_t,
            mi.UInt32(TRANSMIT),
            dr.select((chosen < w_t + w_r) | (w_s + w_b == 0), mi.UInt32(REFLECT), mi.UInt32(SCATTER)),
        )
        flux = both
        if self._roulette or self._scatters:
            small = (both > 0) & (both < limit)
            flux = dr.select(small, dr.select(u * limit < both, limit, 0), both)
            self._lose(ROULETTE, both - flux, visit & small, memory)
        if not self._roulette:
            cut = fresh & (both < self._least(node))
            self._lose(THRESHOLD, both, first & cut & (both > 0), memory)
            flux = dr.select(cut, 0, flux)
        scatter = visit & (number == SCATTER) & (flux > 0)
        cloud = scatter & (chosen >= w_t + w_r + w_s) & (w_b > 0)
        scatter &= ~cloud & (w_s > 0)
        flux = dr.select((number == SCATTER) & ~scatter & ~cloud, 0, flux)
        if self._scatters:
            self._lose(children.remainder, flux, scatter | cloud, memory)

        def draw(rng: mi.PCG32) -> ScatteredRay:
            assert given is not None
            return given.one_ray(w_s / both, random_rays, rng)

        def draw_cloud(rng: mi.PCG32) -> CloudRay:
            bulk = self._scattering.bulk
            assert bulk is not None
            assert bulk_aim is not None
            return bulk.one_ray(bulk_aim, random_clouds, rng)

        kept = self._kept(node.state)
        return Choice(number, number, mi.Bool(False), flux, scatter, cloud, kept, flux / both, draw, draw_cloud)
