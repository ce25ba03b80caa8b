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
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.gradients.recorded_rays import RecordedRays
from mistray.gradients.replay_surfaces import ReplayedEvent, ReplaySurfaces
from mistray.gradients.scatter_replay import ScatterReplay

FAR_OFF = 1e-3  # distance from a recorded point, over 1 + its norm, beyond which the ray counts as another one


class Followed:
    """Points of the events of rays, mm, in float64, and media of the segments between them."""

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
        """Store the points of the rays' events k, mm, and the media of the segments that lead to them."""
        for values, value in zip(self.points, p, strict=True):
            dr.scatter(values, value, self._index(k), active)
        dr.scatter(self.media, medium, self._index(k), active)

    def point(self, k: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return the points of the rays' events k, mm."""
        return mi.Vector3d(*(dr.gather(mi.Float64, values, self._index(k), active) for values in self.points))

    def medium(self, k: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return the numbers of the media of the segments that lead to the rays' events k."""
        return dr.gather(mi.UInt32, self.media, self._index(k), active)


# Contribution of a ray to the metric as a function of its last event and the recorded point
End = Callable[[ReplaySurfaces, ReplayedEvent, mi.Vector3d], mi.Float64]


@dataclass
class Exit:
    """
    Contributions and exit directions of rays that leave the scene after their last event.

    Attributes
    ----------
    gain : mi.Float64
        Contribution of each ray to the metric.
    heading : mi.Vector3d
        Recorded direction in which the ray leaves.
    """

    gain: mi.Float64
    heading: mi.Vector3d


def march(
    surfaces: ReplaySurfaces,
    rays: RecordedRays,
    near: Callable[[mi.UInt32, mi.Bool], mi.Vector3d],
    visit: Callable[..., tuple[mi.Vector3d, tuple[Any, ...]]],
    state: tuple[Any, ...],
    still: bool = False,
) -> tuple[Any, ...]:
    """
    Follow recorded rays from event to event in float64, and call `visit` at each.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Surfaces that the rays meet.
    rays : RecordedRays
        Recorded rays to follow.
    near : callable
        (number, active) → points near the events, mm.
    visit : callable
        (number, event, last, *state) → origins of directions after scatter events, and the next state; `last` marks the
        last events.
    state : tuple
        Variables of the loop.
    still : bool
        See `ReplaySurfaces.event`; without derivatives a Newton step less will do.

    Returns
    -------
    tuple
        State after the last events.
    """

    def step(k: mi.UInt32, p: mi.Vector3d, d: mi.Vector3d, *state: Any) -> tuple[Any, ...]:
        active, last = k < rays.length, k + 1 == rays.length
        # Intersect: a Newton step from the float32 point, with its error of 1e-6, which the replay squares again
        t = dr.dot(near(k, active) - p, d)
        event = surfaces.event(p, d, t, rays.code(k, active), rays.batch, active, 1 if still else 2, still)
        origin, state = visit(k, event, last, *state)
        # Next direction: Snell's law, or towards the next point after a scatter event
        heading = dr.select(event.scattered & ~last, near(k + 1, active & ~last) - origin, event.heading)
        return k + 1, event.p, dr.normalize(heading), *state

    start = dr.zeros(mi.UInt32, dr.width(rays.row)), mi.Vector3d(rays.o), mi.Vector3d(rays.d)
    _, _, _, *state = dr.while_loop(
        (*start, *state), lambda k, *_: k < rays.length, step, mode="symbolic", label="follow rays"
    )
    return tuple(state)


def follow(surfaces: ReplaySurfaces, rays: RecordedRays) -> Followed:
    """
    Return the points, mm, and media of recorded rays' events, followed again in float64.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Surfaces that the rays meet.
    rays : RecordedRays
        Recorded rays to follow.

    Returns
    -------
    Followed
        Points and media; `strayed` marks rays of which a hit is not where it was recorded.
    """
    found = Followed(dr.width(rays.row), rays.longest)

    def visit(
        k: mi.UInt32, event: ReplayedEvent, last: mi.Bool, medium: mi.UInt32, strayed: mi.Bool
    ) -> tuple[mi.Vector3d, tuple[Any, ...]]:
        # Compare with the record
        recorded = rays.point(k, event.active)
        off = dr.norm(event.p - recorded) > FAR_OFF * (1 + dr.norm(recorded))
        strayed |= event.active & (off | ~dr.isfinite(dr.squared_norm(event.p)))
        # Next medium; 0 on the side of incidence is not known, and keeps the present one
        medium = dr.select(event.medium_in == 0, medium, event.medium_in)
        found.write(k, event.p, medium, event.active)
        return event.p, (dr.select(event.reflect, medium, event.medium_out), strayed)

    state = dr.zeros(mi.UInt32, dr.width(rays.row)), dr.full(mi.Bool, False, dr.width(rays.row))
    _, found.strayed = march(surfaces, rays, rays.point, visit, state, still=True)
    dr.eval(found.points, found.media, found.strayed)
    return found


def replay_rays(
    surfaces: ReplaySurfaces,
    rays: RecordedRays,
    found: Followed,
    end: End | Exit,
    scatter: ScatterReplay | None = None,
) -> None:
    """
    Accumulate derivatives of recorded rays' contributions to a metric with respect to the surfaces' numbers.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Accumulates the derivatives.
    rays : RecordedRays
        Recorded rays to replay.
    found : Followed
        Result of `follow`; rays that strayed are left out.
    end : callable or Exit
        Contribution of a ray as a differentiable function of its last hit, or that of rays that leave.
    scatter : ScatterReplay, optional
        Scatter of the scene; None: no surface scatters.
    """
    alive = ~found.strayed

    def differentiate(
        k: mi.UInt32,
        here: mi.Vector3d,
        active: mi.Bool,
        gain: Callable[[mi.Vector3d, mi.Vector3d, mi.Float64], mi.Float64],
    ) -> tuple[mi.Vector3d, mi.Vector3d, mi.Vector3d, mi.Float64]:
        """Return the origin of the segment to event k, mm, derivatives of `gain` by it and by direction, and `gain`."""
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

    def event_at(
        k: mi.UInt32, o: mi.Vector3d, d: mi.Vector3d, t: mi.Float64, active: mi.Bool
    ) -> tuple[ReplayedEvent, mi.Float64]:
        """Return event k as a function of its incident ray, and the logarithm of the transmittance before it."""
        event = surfaces.event(o, d, t, rays.code(k, active), rays.batch, active)
        if not surfaces.table.optics.absorbs:
            return event, mi.Float64(0)
        return event, -surfaces.extinction(found.medium(k, active), active) * event.length

    # End of the path: its contribution, and the adjoints of the last hit or direction
    if isinstance(end, Exit):
        weight, last = end.gain, mi.UInt32(rays.length)
        by_p, by_d = (dr.zeros(mi.Vector3d, dr.width(rays.row)) for _ in range(2))
        here = found.point(dr.maximum(last, 1) - 1, alive & (last > 0))
    else:
        alive &= rays.length > 0
        last = dr.select(alive, rays.length - 1, 0)

        def at_end(o: mi.Vector3d, d: mi.Vector3d, t: mi.Float64) -> mi.Float64:
            event, log_transmittance = event_at(last, o, d, t, alive)
            gain = end(surfaces, event, rays.point(last, alive))
            # The recorded flux holds the value of the transmittance: only the derivative is added
            return gain + dr.detach(gain) * (log_transmittance - dr.detach(log_transmittance))

        here, by_p, by_d, weight = differentiate(last, found.point(last, alive), alive, at_end)

    def step(
        k: mi.UInt32, here: mi.Vector3d, by_p: mi.Vector3d, by_d: mi.Vector3d
    ) -> tuple[mi.UInt32, mi.Vector3d, mi.Vector3d, mi.Vector3d]:
        active = alive & (k > 0)
        k = k - 1

        # One event as a function of its incident ray; `gain` has the derivative of G in the module docstring
        def gain(o: mi.Vector3d, d: mi.Vector3d, t: mi.Float64) -> mi.Float64:
            event, log_transmittance = event_at(k, o, d, t, active)
            specular, scattered = active & ~event.scattered, active & event.scattered
            # Flux factor of a specular event
            share = dr.select(event.reflect, event.R, event.T)
            factor = dr.log(dr.select(specular & (share > 0), share, 1))
            if scatter is not None:
                # Flux factor of scatter: the BSDF along the recorded direction, or the specular fraction
                more = k + 1 < rays.length
                ahead = found.point(k + 1, active & more) - dr.detach(event.p)
                if isinstance(end, Exit):
                    ahead = dr.select(more, ahead, end.heading)
                ahead = surfaces.to_local(dr.normalize(ahead), event.s, event.active)
                at_surface = ahead - dr.cross(event.turn, ahead)  # moves with the frame of the surface
                factor = factor + scatter.log_kept(event, specular)
                factor = factor + scatter.log_flux(event, at_surface, scattered)
            # A scattered direction is held: it passes no adjoint on
            by_heading = dr.select(event.scattered, 0, dr.dot(by_d, event.heading))
            return weight * (factor + log_transmittance) + dr.dot(by_p, event.p) + by_heading

        before, before_p, before_d, _ = differentiate(k, here, active, gain)
        here = dr.select(active, before, here)
        return k, here, dr.select(active, before_p, by_p), dr.select(active, before_d, by_d)

    _, _, by_p, by_d = dr.while_loop(
        (mi.UInt32(last), here, by_p, by_d),
        lambda k, *_: alive & (k > 0),
        step,
        mode="symbolic",
        label="replay rays",
    )
    surfaces.move_start(rays, by_p, by_d, alive)
    dr.eval(by_p, by_d)
    dr.sync_thread()
