"""
Path replay: derivatives of a metric along recorded paths, with respect to all requested parameters.

A recorded ray is a start ray, a list of events and its contribution G to the metric. G is the product of the flux
factors f_k of the events, and each hit x_k follows from the one before by refraction or reflection. With parameters π

    ∂G/∂π = Σ_k [G ∂ ln f_k/∂π + (∂G/∂x_k) · ∂x_k/∂π + (∂G/∂d_k) · ∂d_k/∂π],

where x_k and the outgoing direction d_k vary with the parameters of surface k alone, the incident ray held. The
adjoints ∂G/∂x_k and ∂G/∂d_k are carried back from the end of the path. In the code G is `weight`, ln f_k `factor`, and
the adjoints are `by_p` and `by_d`. The replay goes back along the recorded hits and directions, and lets Dr.Jit
differentiate one event at a time, so that memory does not grow with the number of parameters. Source: reverse mode of a
chain; compare D. Vicini et al., "Path replay backpropagation", ACM Trans. Graph. 40, 108 (2021).

An event is differentiated in float32, as it was traced, or in float64 where `ReplaySurfaces` has values of that type.
Contributions to the metric and all sums are in float64.

Visibility is held: the contribution of rims comes from `mistray.gradients.edges`. The direction after a scatter event
is held ("detached sampling"), and the flux varies with the BSDF; random choices keep their probabilities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.events import place_of, stays
from mistray.gradients.recorded_rays import RecordedRays
from mistray.gradients.replay_surfaces import ReplaySurfaces
from mistray.gradients.replayed_event import ReplayedEvent
from mistray.gradients.scatter_replay import ScatterReplay
from mistray.recorders.branch_recorder import Node

# Contribution of a ray to the metric as a function of its last event
End = Callable[[ReplaySurfaces, ReplayedEvent], mi.Float64]


@dataclass
class Exit:
    """
    Rays that leave the scene after their last event: contribution to the metric, and direction.

    Attributes
    ----------
    gain : mi.Float64
        Contribution of each ray to the metric.
    heading : mi.Vector3f
        Recorded unit direction, in the world, in which the ray leaves.
    """

    gain: mi.Float64
    heading: mi.Vector3f


class SegmentMedia:
    """
    Media that the segments of recorded rays run through, by index.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Surfaces that the rays meet.
    rays : RecordedRays
        Recorded rays.
    """

    def __init__(self, surfaces: ReplaySurfaces, rays: RecordedRays) -> None:
        count = dr.width(rays.row)
        self._count = dr.opaque(mi.UInt32, count)
        self._media = dr.empty(mi.UInt32, count * rays.longest)

        def step(k: mi.UInt32, medium: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
            active = k < rays.length
            node = rays.node(k, active)
            side, beyond = surfaces.media(node.p, node.d, place_of(node.code), active)
            # 0 on the side of incidence is not known, and keeps the present medium
            medium = dr.select(side == 0, medium, side)
            dr.scatter(self._media, medium, self._index(k), active)
            return k + 1, dr.select(stays(node.code), medium, beyond)

        known = rays.start.medium
        first = dr.zeros(mi.UInt32, count) if known is None else dr.gather(mi.UInt32, known, rays.lane)
        start = dr.zeros(mi.UInt32, count), first
        dr.while_loop(start, lambda k, _: k < rays.length, step, mode="symbolic", label="media")
        dr.eval(self._media)

    def _index(self, k: mi.UInt32) -> mi.UInt32:
        return k * self._count + dr.arange(mi.UInt32, self._count[0])

    def of(self, k: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return the index of the medium of the segment that leads to event `k` of each ray."""
        return dr.gather(mi.UInt32, self._media, self._index(k), active)


def replay_rays(
    surfaces: ReplaySurfaces, rays: RecordedRays, end: End | Exit, scatter: ScatterReplay | None = None
) -> None:
    """
    Accumulate derivatives of recorded rays' contributions to a metric with respect to the requested parameters.

    Those with respect to surfaces, and to the source or the surface where rays start, are added to `surfaces`. Those
    with respect to scatter parameters are added to `scatter`.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Surfaces that the rays meet, with sums of the derivatives.
    rays : RecordedRays
        Recorded rays to replay.
    end : callable or Exit
        Contribution of rays to the metric: a differentiable function of their last hit, which ends them, or `Exit` for
        rays that leave the scene after it.
    scatter : ScatterReplay, optional
        Scatter of the scene, with sums of its derivatives; None: scatter has no part in the flux.
    """
    real, vector = surfaces.real, surfaces.vector
    media = SegmentMedia(surfaces, rays) if surfaces.table.optics.absorbs else None

    def differentiate(
        k: mi.UInt32, node: Node, active: mi.Bool, gain: Callable[[ReplayedEvent, mi.Float], Any]
    ) -> tuple[Node, mi.Vector3f, mi.Vector3f, Any]:
        """
        Return the event before event k, and `gain` with its derivatives.

        They are those with respect to the origin (per mm) and the direction of the segment that leads to event k.
        """
        first = k == 0
        before = rays.node(dr.maximum(k, 1) - 1, active & ~first)
        origin = dr.select(first, vector(rays.o), vector(before.p))

        def attenuated(event: ReplayedEvent) -> Any:
            # With the logarithm of the transmittance of the segment
            absorbed = real(0) if media is None else surfaces.extinction(media.of(k, active), active) * event.length
            return gain(event, -absorbed)

        by_o, by_d, value = surfaces.differentiate(origin, node, rays.batch, active, attenuated)
        return before, dr.select(active, by_o, 0), dr.select(active, by_d, 0), dr.select(active, value, 0)

    # End of the path: its contribution, and the adjoints of the last hit or direction
    if isinstance(end, Exit):
        gain, last, heading = end.gain, mi.UInt32(rays.length), vector(end.heading)
        by_p, by_d = (dr.zeros(vector, dr.width(rays.row)) for _ in range(2))
        node = rays.node(dr.maximum(last, 1) - 1, last > 0)
    else:
        active = rays.length > 0
        last = dr.select(active, rays.length - 1, 0)
        node = rays.node(last, active)
        heading = vector(node.d)

        def at_end(event: ReplayedEvent, log_transmittance: mi.Float) -> mi.Float64:
            gain = end(surfaces, event)
            # The recorded flux holds the value of the transmittance: only the derivative is added
            return gain + dr.detach(gain) * (log_transmittance - dr.detach(log_transmittance))

        node, by_p, by_d, gain = differentiate(last, node, active, at_end)
    weight = real(gain)

    def step(
        k: mi.UInt32, node: Node, heading: mi.Vector3f, by_p: mi.Vector3f, by_d: mi.Vector3f
    ) -> tuple[mi.UInt32, Node, mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        active = k > 0
        k = k - 1

        # One event as a function of its incident ray, with the derivative of G in the module docstring
        def gain(event: ReplayedEvent, log_transmittance: mi.Float) -> mi.Float:
            specular, scattered = active & ~event.scattered, active & event.scattered
            # Flux factor of a specular event
            share = dr.select(event.reflect, event.R, event.T)
            factor = dr.log(dr.select(specular & (share > 0), share, 1))
            if scatter is not None:
                # Flux factor of scatter: the BSDF along the recorded direction, or the specular fraction
                ahead = surfaces.to_local(heading, event.s, event.active)
                at_surface = ahead - dr.cross(event.turn, ahead)  # moves with the frame of the surface
                factor = factor + scatter.log_kept(event, specular)
                factor = factor + scatter.log_flux(event, at_surface, scattered)
            # A scattered direction is held: it passes no adjoint on
            by_heading = dr.select(event.scattered, 0, dr.dot(by_d, event.heading))
            return weight * (factor + log_transmittance) + dr.dot(by_p, event.p) + by_heading

        before, by_o, by_i, _ = differentiate(k, node, active, gain)
        heading = dr.select(active, vector(node.d), heading)
        return k, before, heading, dr.select(active, by_o, by_p), dr.select(active, by_i, by_d)

    _, _, _, by_p, by_d = dr.while_loop(
        (mi.UInt32(last), node, heading, by_p, by_d),
        lambda k, *_: k > 0,
        step,
        mode="symbolic",
        label="replay rays",
    )
    surfaces.move_start(rays, by_p, by_d, rays.length > 0)
    dr.eval(by_p, by_d)
    dr.sync_thread()
