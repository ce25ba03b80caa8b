"""Directional derivative of an image as scene parameters move together, with visibility held fixed, by path replay.

Recorded rays are followed in float64 with the parameters of the surfaces moved a little to either side, through the
same events. The tangent of the flux and of the place on the detector is a central difference of the two. See
`mistray.gradients.replay` for the reverse mode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.tracer import Run
from mistray.gradients.parameter_gradient import number_tangent
from mistray.gradients.path_replay import PathReplay
from mistray.gradients.recorded_rays import RecordedRays
from mistray.gradients.replay import SegmentMedia
from mistray.gradients.replay_surfaces import ReplaySurfaces
from mistray.gradients.replayed_event import ReplayedEvent
from mistray.gradients.scatter_replay import ScatterEvent, ScatterReplay
from mistray.gradients.surface_numbers import SurfaceNumbers, numbers_of
from mistray.gradients.table_gradient import GradientRequest
from mistray.recorders.film import Film
from mistray.surfaces.gradient_columns import GEOMETRY

FAR_OFF = 1e-3  # distance from a recorded point, over 1 + its norm, beyond which the ray counts as another one
EVENT_VALUES = ("d", "axis", "cos_i", "cos_t", "eta", "R", "T", "q")  # of events that scatter depends on
STEP = 1e-6  # largest move of a number, in units of its scale


def step_of(direction: SurfaceNumbers, sizes: np.ndarray) -> float:
    """
    Return the factor that scales a direction of parameter change to the step of the central difference.

    Parameters
    ----------
    direction : SurfaceNumbers
        Rates of change of the surfaces' geometry, indices, R and T.
    sizes : (surfaces,) float64
        Sizes of the surfaces, mm.

    Raises
    ------
    MistrayError
        If nothing moves.
    """
    # Scale of each number: its unit as a power of mm, of the size of the surface
    powers = {"curvature": -1, "conic": 0, "slope": 0, "tilt_x": 0, "tilt_y": 0, "tilt_z": 0}
    powers |= {name: 1 - int(name[1:]) for name in GEOMETRY if name[0] == "a"}
    scale = np.stack([sizes ** powers.get(name, 1) for name in GEOMETRY], axis=1)
    largest = [
        np.max(np.abs(part), initial=0.0)
        for part in (direction.geometry / scale, direction.indices, direction.rows, direction.ideal)
    ]
    if not max(largest) > 0:
        raise MistrayError("no parameter moves; set derivatives with dr.set_grad before a forward pass")
    return float(STEP / max(largest))


class Followed:
    """
    Hit points of recorded rays, mm, recomputed in float64 event by event.

    Attributes
    ----------
    rays : mi.UInt32
        Number of rays.
    points : list of mi.Float64
        x, y and z of the hits relative to the centre of the scene, mm, (longest · rays,) each.
    strayed : mi.Bool
        Rays of which a hit is not where it was recorded.
    """

    def __init__(self, rays: int, longest: int) -> None:
        self.rays = dr.opaque(mi.UInt32, rays)
        # Separate arrays: equal ones would share memory, and be copied before each write
        self.points = [dr.empty(mi.Float64, rays * longest) for _ in range(3)]
        self.strayed = dr.zeros(mi.Bool, rays)
        dr.eval(self.points, self.strayed)

    def _index(self, k: mi.UInt32) -> mi.UInt32:
        return k * self.rays + dr.arange(mi.UInt32, self.rays[0])

    def write(self, k: mi.UInt32, p: mi.Vector3d, active: mi.Bool) -> None:
        """Store the points, mm, of event `k` of each ray."""
        for values, value in zip(self.points, p, strict=True):
            dr.scatter(values, value, self._index(k), active)

    def point(self, k: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        """Return the stored points, mm, of event `k` of each ray."""
        return mi.Vector3d(*(dr.gather(mi.Float64, values, self._index(k), active) for values in self.points))


def march(
    surfaces: ReplaySurfaces,
    rays: RecordedRays,
    near: Callable[[mi.UInt32, mi.Bool], mi.Vector3d],
    visit: Callable[..., tuple[mi.Vector3d, tuple[Any, ...]]],
    state: tuple[Any, ...],
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
        (k, active) → points near event k of each ray, mm, as those of `Followed`.
    visit : callable
        (k, event, last, *state) → origins of directions after scatter events, and the next state; `last` marks the last
        events.
    state : tuple
        Variables of the loop.

    Returns
    -------
    tuple
        State after the last events.
    """

    def step(k: mi.UInt32, p: mi.Vector3d, d: mi.Vector3d, *state: Any) -> tuple[Any, ...]:
        active, last = k < rays.length, k + 1 == rays.length
        t = dr.dot(near(k, active) - p, d)
        event = surfaces.followed(p, d, t, rays.node(k, active).code, rays.batch, active)
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
    Return the hit points of recorded rays, mm, recomputed in float64 event by event.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Surfaces that the rays meet.
    rays : RecordedRays
        Recorded rays to follow.

    Returns
    -------
    Followed
        Points; `strayed` marks rays of which a hit is not where it was recorded.
    """
    found = Followed(dr.width(rays.row), rays.longest)

    def recorded_point(k: mi.UInt32, active: mi.Bool) -> mi.Vector3d:
        return mi.Vector3d(rays.node(k, active).p)

    def visit(
        k: mi.UInt32, event: ReplayedEvent, last: mi.Bool, strayed: mi.Bool
    ) -> tuple[mi.Vector3d, tuple[Any, ...]]:
        # Compare with the record
        recorded = recorded_point(k, event.active)
        off = dr.norm(event.p - recorded) > FAR_OFF * (1 + dr.norm(recorded))
        strayed = strayed | event.active & (off | ~dr.isfinite(dr.squared_norm(event.p)))
        found.write(k, event.p, event.active)
        return event.p, (strayed,)

    (found.strayed,) = march(surfaces, rays, recorded_point, visit, (dr.full(mi.Bool, False, dr.width(rays.row)),))
    dr.eval(found.points, found.strayed)
    return found


def arrivals(
    surfaces: ReplaySurfaces, rays: RecordedRays, base: Followed, media: SegmentMedia | None, scatters: bool
) -> tuple[mi.Float64, mi.Float64, mi.Float64, mi.Float64]:
    """
    Return the places where recorded rays meet the detector, mm, and the logarithms of their flux factors.

    Parameters
    ----------
    surfaces : ReplaySurfaces
        Surfaces with present or changed parameters.
    rays : RecordedRays
        Recorded rays that end at the detector.
    base : Followed
        Result of `follow` with the present parameters.
    media : SegmentMedia or None
        Media of the segments; None: none absorbs.
    scatters : bool
        Whether surfaces scatter: the factors of scatter events and of the detector are then left to `scatter_factors`.

    Returns
    -------
    x, y : mi.Float64
        Place on the detector in its own frame, mm.
    factor, absorbed : mi.Float64
        Logarithms of the product of all flux factors, and of the last of them, the absorption in the detector.
    """

    def visit(
        k: mi.UInt32,
        event: ReplayedEvent,
        last: mi.Bool,
        q: mi.Vector3d,
        total: mi.Float64,
        absorbed: mi.Float64,
    ) -> tuple[mi.Vector3d, tuple[Any, ...]]:
        # Flux factor of the event, and of the segment before it
        share = dr.select(last, 1 - event.R - event.T, dr.select(event.reflect, event.R, event.T))
        own = event.active & (share > 0)
        if scatters:
            own &= ~event.scattered & ~last
        factor = dr.log(dr.select(own, share, 1))
        absorbed = dr.select(event.active & last, factor, absorbed)
        if media is not None:
            factor -= surfaces.extinction(media.of(k, event.active), event.active) * event.length
        # After a scatter event the direction is held
        return base.point(k, event.active), (mi.Vector3d(event.q), total + factor, absorbed)

    nothing = (dr.zeros(kind, dr.width(rays.row)) for kind in (mi.Vector3d, mi.Float64, mi.Float64))
    q, total, absorbed = march(surfaces, rays, base.point, visit, tuple(nothing))
    return q.x, q.y, total, absorbed


def scatter_factors(
    sides: tuple[ReplaySurfaces, ReplaySurfaces],
    rays: RecordedRays,
    base: Followed,
    scatter: ScatterReplay,
    per: mi.Float64,
) -> tuple[mi.Float64, mi.Float64]:
    """
    Return the rate of the logarithm of the flux factors of scatter along recorded rays, and what the detector absorbs.

    The factors are single precision, too coarse for differences: the events have the rates of a central difference, and
    Dr.Jit's forward mode gives those of the factors.

    Parameters
    ----------
    sides, rays, base
        See `add_tangent`.
    scatter : ScatterReplay
        Scatter of the surfaces.
    per : mi.Float64
        Inverse of the difference of the common variable between the two sides.

    Returns
    -------
    rate, absorbed : mi.Float64
        Rate of the logarithm of specular shares, BSDFs and absorption in the detector, and the latter, 0 … 1.
    """

    def step(k: mi.UInt32, rate: mi.Float64, absorbed: mi.Float64, *state: mi.Vector3d) -> tuple[Any, ...]:
        active, last = k < rays.length, k + 1 == rays.length
        here, onward, code = base.point(k, active), active & ~last, rays.node(k, active).code
        held = base.point(k + 1, onward) - here
        events: list[ReplayedEvent] = []
        ahead: list[mi.Vector3d] = []
        after: list[mi.Vector3d] = []
        for surfaces, p, d in zip(sides, state[::2], state[1::2], strict=True):
            event = surfaces.followed(p, d, dr.dot(here - p, d), code, rays.batch, active)
            out = dr.normalize(surfaces.to_local(held, event.s, onward))
            events.append(event)
            ahead.append(out - dr.cross(event.turn, out))
            after += [event.p, dr.normalize(dr.select(event.scattered & onward, held, event.heading))]
        pairs: dict[str, list[Any]] = {name: [getattr(event, name) for event in events] for name in EVENT_VALUES}
        with dr.resume_grad():
            leaves: dict[str, Any] = {}
            for name, (low, high) in {**pairs, "ahead": ahead}.items():
                single = mi.Float if dr.depth_v(low) == 1 else mi.Vector3f
                leaves[name] = single(0.5 * (low + high))
                dr.enable_grad(leaves[name])
                dr.set_grad(leaves[name], single((high - low) * per))
            moved = list(leaves.values())
            towards, first = leaves.pop("ahead"), events[0]
            middle = ScatterEvent(
                first.s, first.batch, first.reflect, first.from_front, coating=first.coating, **leaves
            )
            share = scatter.absorbed(middle, active & last)
            factor = scatter.log_kept(middle, onward & ~first.scattered)
            factor += scatter.log_flux(middle, towards, onward & first.scattered)
            factor += dr.log(dr.select(share > 0, share, 1))
            dr.enqueue(dr.ADMode.Forward, moved)
            dr.traverse(dr.ADMode.Forward)
            grown = mi.Float64(dr.grad(factor))
        absorbed = dr.select(active & last, mi.Float64(dr.detach(share)), absorbed)
        return k + 1, rate + dr.select(active, grown, 0), absorbed, *after

    count = dr.width(rays.row)
    zeros = dr.zeros(mi.UInt32, count), dr.zeros(mi.Float64, count), dr.zeros(mi.Float64, count)
    start = [mi.Vector3d(v) for _ in sides for v in (rays.o, rays.d)]
    _, rate, absorbed, *_ = dr.while_loop(
        (*zeros, *start), lambda k, *_: k < rays.length, step, mode="symbolic", label="scatter of rays"
    )
    return rate, absorbed


def add_tangent(
    image: mi.Float64,
    film: Film,
    rays: RecordedRays,
    base: Followed,
    media: SegmentMedia | None,
    sides: tuple[ReplaySurfaces, ReplaySurfaces],
    step: float,
    scatter: ScatterReplay | None,
) -> None:
    """
    Add the directional derivative of the detected flux from recorded rays to an image, visibility held fixed.

    Rays that strayed from their record are left out.

    Parameters
    ----------
    image : (height · width,) mi.Float64
        Derivative of the flux in each pixel, in units of the start ray's flux per unit of the common variable of the
        parameters.
    film : Film
        Pixel grid of the detector.
    rays, base, media
        Recorded rays, their hit points and the media of their segments, see `arrivals`.
    sides : (ReplaySurfaces, ReplaySurfaces)
        Surfaces with their parameters moved back and forth.
    step : float
        Move to either side, as a factor on the rates of the parameters, see `step_of`.
    scatter : ScatterReplay or None
        Scatter of the surfaces; None: none scatters.
    """
    (x0, y0, f0, last0), (x1, y1, f1, last1) = (
        arrivals(surfaces, rays, base, media, scatter is not None) for surfaces in sides
    )
    per = dr.opaque(mi.Float64, 0.5 / step)
    alive = ~base.strayed
    flux = rays.weight * dr.exp(0.5 * (last0 + last1))
    move_x, move_y, growth = (x1 - x0) * per, (y1 - y0) * per, (f1 - f0) * per
    if scatter is not None:
        rate, absorbed = scatter_factors(sides, rays, base, scatter, per)
        flux, growth = flux * absorbed, growth + rate
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    # Change of the flux, at a fixed place
    for pixel, share in film.places(mi.Float(x), mi.Float(y)):
        part = flux * growth * (mi.Float64(1) if share is None else mi.Float64(share))
        dr.scatter_reduce(dr.ReduceOp.Add, image, part, pixel, alive)
    # Change of the place, at a fixed flux: the tent filter is bilinear between the centres of the pixels, and has a
    # derivative there
    with dr.resume_grad():
        at = mi.Float(x), mi.Float(y)
        dr.enable_grad(at)
        dr.set_grad(at[0], mi.Float(move_x))
        dr.set_grad(at[1], mi.Float(move_y))
        places = replace(film, tent=True).places(*at)
        dr.enqueue(dr.ADMode.Forward, at)
        dr.traverse(dr.ADMode.Forward)
        speeds = [(pixel, mi.Float64(dr.grad(share))) for pixel, share in places]
    for pixel, speed in speeds:
        dr.scatter_reduce(dr.ReduceOp.Add, image, flux * speed, pixel, alive)


def run_tangent(run: Run, tangents: Mapping[tuple[int, str], np.ndarray]) -> np.ndarray:
    """
    Return the directional derivative of the flux in each pixel as parameters of plugins move at given rates.

    Parameters
    ----------
    run : Run
        Run of which all start rays are traced; it need not have been executed.
    tangents : mapping
        (id of a plugin, name of a parameter) → (entries,) rate, in the unit of the parameter, per unit of a common
        variable.

    Returns
    -------
    (height, width) float64
        Derivative of the flux in each pixel with respect to that variable, visibility held fixed, in units of the start
        ray's flux.

    Raises
    ------
    MistrayError
        If nothing moves, or the scene has what `PathReplay` cannot treat.
    """
    table, film = run.table, run.make_film()
    nothing = GradientRequest(rows=False)
    path_replay = PathReplay(run.scene, run.settings, nothing, run.settings.max_events)
    # Surfaces as they are, and moved to either side
    direction = number_tangent(table, tangents)
    step = step_of(direction, np.array([piece.size for piece in table.pieces]))
    still = ReplaySurfaces(table, nothing)
    pairs = list(zip(vars(numbers_of(table)).values(), vars(direction).values(), strict=True))
    back, forth = (
        ReplaySurfaces(table, nothing, SurfaceNumbers(*(now + move * rate for now, rate in pairs)))
        for move in (-step, step)
    )
    image = dr.zeros(mi.Float64, film.width * film.height)
    with dr.suspend_grad():
        for number in range(run.passes):
            for rays in path_replay.recorded(run.start_pass(number), run.trace_trees):
                base = follow(still, rays)
                media = SegmentMedia(still, rays) if table.optics.absorbs else None
                add_tangent(image, film, rays, base, media, (back, forth), step, path_replay.scatter)
                dr.eval(image)
    return np.array(image).reshape(film.height, film.width)
