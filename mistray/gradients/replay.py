"""
Path replay: derivatives of a metric along recorded paths, by geometry, indices and all other parameters.

A recorded ray is a start ray, a list of events and its contribution G to the metric. G is the product of the flux
factors f_k of the events, and each hit x_k follows from the one before by refraction or reflection. With parameters π

    ∂G/∂π = Σ_k [G ∂ ln f_k/∂π + (∂G/∂x_k) · ∂x_k/∂π + (∂G/∂d_k) · ∂d_k/∂π],

where x_k and the outgoing direction d_k vary with the numbers of surface k alone, the incident ray held. The adjoints
∂G/∂x_k and ∂G/∂d_k are carried back from the end of the path. In the code G is `weight`, ln f_k `factor`, and the
adjoints are `by_p` and `by_d`. A first pass follows the rays forward in float64 and stores their hits. A second goes
back along them and lets Dr.Jit differentiate one event at a time, so that memory does not grow with the number of
parameters. Source: reverse mode of a chain; compare D. Vicini et al., "Path replay backpropagation", ACM Trans. Graph.
40, 108 (2021).

Visibility is held: the contribution of rims comes from `mistray.gradients.edges`. The direction after a scatter event
is held ("detached sampling"), and the flux varies with the BSDF; random choices keep their probabilities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from mistray.gradients.replay_surfaces import Hit, ReplaySurfaces, Split
from mistray.gradients.scatter_replay import ScatterEvent, ScatterReplay
from mistray.recorders.path_key import EVENT_BITS, EVENT_MASK, RANDOM_TRANSMITTED, TRANSMITTED

if TYPE_CHECKING:
    from mistray.gradients.start_motion import StartMotion

NEWTON_STEPS = 1  # of the first pass, from the float32 point with its error of 1e-6; the second pass squares it again
FAR_OFF = 1e-3  # distance from a recorded point, over 1 + its norm, beyond which the ray counts as another one


@dataclass
class Branches:
    """
    Recorded rays, one lane each.

    Attributes
    ----------
    o, d : mi.Vector3d
        Origins, mm, and unit directions.
    batch, length : mi.UInt32
        Batch of the start ray, number of events.
    row : mi.UInt32
        Row of the lane in `codes` and `nodes`.
    codes : mi.UInt32
        (rows, stride) events, surface << EVENT_BITS | kind of event.
    nodes : mi.Float
        (rows, stride, node_floats) recorded points in the first three floats of a node.
    stride : mi.UInt32
        Capacity of a row in events, opaque.
    node_floats, longest : int
        Floats of a node, and events of the longest ray.
    """

    o: mi.Vector3d
    d: mi.Vector3d
    batch: mi.UInt32
    length: mi.UInt32
    row: mi.UInt32
    codes: mi.UInt32
    nodes: mi.Float
    stride: mi.UInt32
    node_floats: int
    longest: int

    def code(self, k: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return event k."""
        return dr.gather(mi.UInt32, self.codes, self.row * self.stride + k, active)

    def point(self, k: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return the recorded point of event k, mm."""
        base = (self.row * self.stride + k) * self.node_floats
        return mi.Vector3d(*(mi.Float64(dr.gather(mi.Float, self.nodes, base + j, active)) for j in range(3)))


class Followed:
    """Points of all rays in float64 (mm) and media of their segments, event by event."""

    def __init__(self, rays: int, longest: int) -> None:
        self.rays = dr.opaque(mi.UInt32, rays)
        # Separate arrays: equal ones would share memory, and be copied before each write
        self.points = [dr.empty(mi.Float64, rays * longest) for _ in range(3)]
        self.media = dr.empty(mi.UInt32, rays * longest)
        self.strayed = dr.zeros(mi.Bool, rays)
        dr.eval(self.points, self.media, self.strayed)

    def _index(self, k: mi.UInt32) -> mi.UInt32:
        return k * self.rays + dr.arange(mi.UInt32, self.rays[0])

    def write(self, k: mi.UInt32, p: mi.Vector3d, medium: mi.UInt32, active: mi.Bool) -> None:
        """Store the point of event k and the medium of the segment that led to it."""
        for values, value in zip(self.points, p, strict=True):
            dr.scatter(values, value, self._index(k), active)
        dr.scatter(self.media, medium, self._index(k), active)

    def point(self, k: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return the point of event k."""
        return mi.Vector3d(*(dr.gather(mi.Float64, values, self._index(k), active) for values in self.points))

    def medium(self, k: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return the medium of the segment that led to event k."""
        return dr.gather(mi.UInt32, self.media, self._index(k), active)


# Contribution of a ray to the metric as a function of its last hit; the third argument is the recorded point
End = Callable[[ReplaySurfaces, Hit, mi.Vector3d, Split, mi.UInt32, mi.UInt32, mi.Bool], mi.Float64]


@dataclass
class Exit:
    """
    Rays that leave the scene after their last event.

    Attributes
    ----------
    gain : mi.Float64
        Contribution of each ray to the metric.
    by_direction : mi.Vector3d
        Derivative of the contribution by the direction in which the ray leaves.
    heading : mi.Vector3d
        Recorded direction in which the ray leaves.
    """

    gain: mi.Float64
    by_direction: mi.Vector3d
    heading: mi.Vector3d


def follow(surfaces: ReplaySurfaces, rays: Branches) -> Followed:
    """
    Follow recorded rays through their events in float64.

    Parameters
    ----------
    surfaces : ReplaySurfaces
    rays : Branches

    Returns
    -------
    Followed
        Points and media; `strayed` marks rays of which a hit is not where it was recorded.
    """
    count = dr.width(rays.row)
    found = Followed(count, rays.longest)
    start = dr.full(mi.UInt32, 0, count)

    def step(
        k: mi.UInt32, p: mi.Vector3d, d: mi.Vector3d, medium: mi.UInt32, strayed: mi.Bool
    ) -> tuple[mi.UInt32, mi.Vector3d, mi.Vector3d, mi.UInt32, mi.Bool]:
        active = k < rays.length
        code = rays.code(k, active)
        s, what = code >> EVENT_BITS, code & EVENT_MASK
        recorded = rays.point(k, active)
        # Intersect: Newton from the recorded point
        met = surfaces.meet(p, d, dr.dot(recorded - p, d), s, rays.batch, active, NEWTON_STEPS, still=True)
        split = surfaces.split(met, s, what, rays.batch, active)
        # Compare with the record
        here = surfaces.world_point(met, s, active)
        off = dr.norm(here - recorded) > FAR_OFF * (1 + dr.norm(recorded))
        strayed |= active & (off | ~dr.isfinite(dr.squared_norm(here)))
        found.write(k, here, dr.select(split.medium_in == 0, medium, split.medium_in), active)
        # Next direction: Snell's law, or towards the recorded point after a scatter event
        heading = surfaces.world_direction(
            met, dr.select(what == TRANSMITTED, split.transmitted, split.reflected), s, active
        )
        more = active & (k + 1 < rays.length)
        scattered = what >= RANDOM_TRANSMITTED
        heading = dr.select(scattered & more, rays.point(k + 1, more) - here, heading)
        # Next medium; 0 on the side of incidence is not known, and keeps the present one
        through = (what == TRANSMITTED) | (scattered & ((what & 1) == 0))
        medium = dr.select(through, split.medium_out, dr.select(split.medium_in == 0, medium, split.medium_in))
        return k + 1, here, dr.normalize(heading), medium, strayed

    _, _, _, _, found.strayed = dr.while_loop(
        (start, mi.Vector3d(rays.o), mi.Vector3d(rays.d), dr.zeros(mi.UInt32, count), dr.full(mi.Bool, False, count)),
        lambda k, *_: k < rays.length,
        step,
        mode="symbolic",
        label="follow rays",
    )
    dr.eval(found.points, found.media, found.strayed)
    return found


def replay_rays(
    surfaces: ReplaySurfaces,
    rays: Branches,
    found: Followed,
    end: End | Exit,
    scatter: ScatterReplay | None = None,
    start: StartMotion | None = None,
) -> None:
    """
    Accumulate the derivatives of the contributions of recorded rays in the numbers of the surfaces.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Accumulates the derivatives.
    rays : Branches
    found : Followed
        Result of `follow`; rays that strayed are left out.
    end : callable or Exit
        Contribution of a ray as a differentiable function of its last hit, or that of rays that leave.
    scatter : ScatterReplay, optional
        Scatter of the scene; None: no surface scatters.
    start : StartMotion, optional
        Receives the derivatives by the starts of the rays.
    """
    alive = ~found.strayed
    away = end if isinstance(end, Exit) else None

    def differentiate(
        k: mi.UInt32,
        here: mi.Vector3d,
        active: mi.Bool,
        gain: Callable[[mi.Vector3d, mi.Vector3d, mi.Float64], mi.Float64],
    ) -> tuple[mi.Vector3d, mi.Vector3d, mi.Vector3d, mi.Float64]:
        """Return the origin of the segment to event k, derivatives of `gain` by origin and direction, and its value."""
        first = k == 0
        origin = dr.select(first, rays.o, found.point(dr.maximum(k, 1) - 1, active & ~first))
        along = here - origin
        length = dr.norm(along)
        with dr.resume_grad():
            o, d = mi.Vector3d(origin), dr.select(first, rays.d, along / length)
            dr.enable_grad(o, d)
            value = gain(o, d, length)
            result = mi.Float64(dr.detach(value))
            dr.set_grad(value, dr.select(active, mi.Float64(1), 0))
            dr.enqueue(dr.ADMode.Backward, value)
            dr.traverse(dr.ADMode.Backward)
            by_o, by_d = mi.Vector3d(dr.grad(o)), mi.Vector3d(dr.grad(d))
        return origin, dr.select(active, by_o, 0), dr.select(active, by_d, 0), dr.select(active, result, 0)

    def thin(met: Hit, k: mi.UInt32, active: mi.Bool) -> mi.Float64:
        """Return the logarithm of the transmittance of the segment that led to event k."""
        if not surfaces.table.optics.absorbs:
            return mi.Float64(0)
        return -surfaces.extinction(found.medium(k, active), active) * met.length

    def event_at(k: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
        code = rays.code(k, active)
        return code >> EVENT_BITS, code & EVENT_MASK

    # End of the path: its contribution, and the adjoints of the last hit or direction
    if isinstance(end, Exit):
        weight = end.gain
        by_p, by_d, last = (
            dr.zeros(mi.Vector3d, dr.width(rays.row)),
            mi.Vector3d(end.by_direction),
            mi.UInt32(rays.length),
        )
        here = found.point(dr.maximum(last, 1) - 1, alive & (last > 0))
    else:
        meets = end
        alive &= rays.length > 0
        last = dr.select(alive, rays.length - 1, 0)

        def at_end(o: mi.Vector3d, d: mi.Vector3d, t: mi.Float64) -> mi.Float64:
            s, what = event_at(last, alive)
            met = surfaces.meet(o, d, t, s, rays.batch, alive)
            split = surfaces.split(met, s, what, rays.batch, alive)
            gain = meets(surfaces, met, rays.point(last, alive), split, s, rays.batch, alive)
            left = thin(met, last, alive)  # the recorded flux holds its value: only the derivative is added
            return gain + dr.detach(gain) * (left - dr.detach(left))

        here, by_p, by_d, weight = differentiate(last, found.point(last, alive), alive, at_end)

    def step(
        k: mi.UInt32, here: mi.Vector3d, by_p: mi.Vector3d, by_d: mi.Vector3d
    ) -> tuple[mi.UInt32, mi.Vector3d, mi.Vector3d, mi.Vector3d]:
        active = alive & (k > 0)
        k = k - 1
        s, what = event_at(k, active)
        scattered, transmitted = what >= RANDOM_TRANSMITTED, what == TRANSMITTED

        # One event as a function of its incident ray; `gain` has the derivative of G in the module docstring
        def event(o: mi.Vector3d, d: mi.Vector3d, t: mi.Float64) -> mi.Float64:
            met = surfaces.meet(o, d, t, s, rays.batch, active)
            split = surfaces.split(met, s, what, rays.batch, active)
            p = surfaces.world_point(met, s, active)
            heading = surfaces.world_direction(
                met, dr.select(transmitted, split.transmitted, split.reflected), s, active
            )
            # Flux factor of a specular event
            share = dr.select(transmitted, split.T, split.R)
            factor = dr.log(dr.select(active & ~scattered & (share > 0), share, 1))
            if scatter is not None:
                # Flux factor of scatter: the BSDF along the recorded direction, or the specular fraction
                reflect = dr.select(scattered, (what & 1) != 0, ~transmitted)
                ahead = found.point(k + 1, active & (k + 1 < rays.length)) - dr.detach(p)
                if away is not None:
                    ahead = dr.select(k + 1 < rays.length, ahead, away.heading)
                at_surface = surfaces.local_direction(met, dr.normalize(ahead), s, active)
                hit = scatter_event(met, split, s, reflect, rays.batch)
                coating = surfaces.coating(split, s, rays.batch, active)
                factor = factor + scatter.log_kept(hit, active & ~scattered)
                factor = factor + scatter.log_flux(hit, at_surface, active & scattered, coating)
            # A scattered direction is held: it passes no adjoint on
            gain = weight * (factor + thin(met, k, active)) + dr.dot(by_p, p)
            return gain + dr.select(scattered, 0, dr.dot(by_d, heading))

        before, before_p, before_d, _ = differentiate(k, here, active, event)
        here = dr.select(active, before, here)
        return k, here, dr.select(active, before_p, by_p), dr.select(active, before_d, by_d)

    _, _, by_p, by_d = dr.while_loop(
        (mi.UInt32(last), here, by_p, by_d),
        lambda k, *_: alive & (k > 0),
        step,
        mode="symbolic",
        label="replay rays",
    )
    # Adjoints of the start
    if start is not None:
        start.add(rays, by_p, by_d, alive)
    dr.eval(by_p, by_d)
    dr.sync_thread()


def scatter_event(met: Hit, split: Split, s: mi.UInt32, reflect: mi.Bool, batch: mi.UInt32) -> ScatterEvent:
    """Return a hit as a `ScatterEvent`, in the frame of the surface."""
    return ScatterEvent(
        s,
        batch,
        reflect,
        split.from_front,
        met.d,
        split.axis,
        split.cos_i,
        split.cos_t,
        split.eta,
        split.R,
        split.T,
        met.q,
    )
