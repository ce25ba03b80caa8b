"""The design path: the surfaces from the source over lenses and mirrors to the detector, forward and backward."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mitsuba as mi
import numpy as np

from mistray.coatings import METAL_K
from mistray.errors import MistrayError
from mistray.kernel.targets import Target
from mistray.materials import complex_index
from mistray.sampling.design.probes import DesignStep, Order, Probes
from mistray.sampling.design.sequences import chosen_orders, has_optics, is_plane
from mistray.sampling.outlines import outline
from mistray.sampling.source import SceneSource, Sphere
from mistray.sampling.sources import scene_sources, source_emitters
from mistray.surfaces.host_points import sphere_points
from mistray.surfaces.host_rays import crossings, first_hit, inside, normals, onward, specular
from mistray.surfaces.optics import MIRROR, OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

PROBES, MANY_PROBES = 256, 4096  # rays of a source that search for the design path
MOST_AIMS = 8  # lenses and mirrors, the nearest first, at which a source is aimed to find the path
# Lit part of the first aperture: fewest probes by which it is found, margin of its radius, and the largest radius, in
# units of the aperture's, at which it is a target of its own
LEAST_ARRIVALS, MARGIN, LARGEST_RATIO = 64, 1.05, 0.8
LARGE_FRONT = 1 / 3  # radius, in units of that of a front, below which a surface behind the front is the aperture
STRAIGHT = 1e-6  # rad by which light may turn that still counts as going straight on
SAME_PLACE = 1e-9  # relative difference of the distances to two surfaces in one plane
OPENING = -1  # stands for the number of a surface where a backward path leaves the system


class Unobstructed(NamedTuple):
    """
    Outcome of rays sent along a design path: whether each passes, else the surface and the step at which it stopped.

    Attributes
    ----------
    passes : (n,) bool
        Whether a ray reaches the detector by the design path.
    ends : (n,) int
        Surface at which the ray leaves the design path: one that it meets instead of the step's, or the step's own if
        it goes the other way there. -1: none, since it passes or leaves the scene.
    place : (n,) int
        Index of the step at which, or on the way to which, the ray leaves the path; -1 if it passes.
    missed : (n,) bool
        Whether a ray crossed the unbounded surface of that step, outside its edge, before it met something else.
    """

    passes: np.ndarray
    ends: np.ndarray
    place: np.ndarray
    missed: np.ndarray


class DesignPath:
    """
    Sequence of surfaces that the light of the design meets on its way to the detector, or backward to the opening.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    steps : tuple of DesignStep
        Steps, of which the last is the detector or the opening.
    end : Target
        Outline of the detector or of the opening.
    """

    def __init__(self, table: SurfaceTable, steps: tuple[DesignStep, ...], end: Target) -> None:
        self.table = table
        self.steps = steps
        self.end = end

    @property
    def has_optics(self) -> bool:
        """True if the path meets at least one surface, such as a lens or mirror, before its end."""
        return len(self.steps) > 1

    def at(self, wavelength_nm: float) -> DesignPath:
        """Return the path over the same surfaces at another wavelength, nm; the base ray stays the same."""
        return DesignPath(self.table.at(wavelength_nm), self.steps, self.end)

    def reversed(self, opening: Target) -> DesignPath:
        """Return the backward path, from the detector to the opening in front of the path's first surface."""
        # All steps but the detector, in reverse order
        steps = [
            DesignStep(step.surface, step.reflects, step.point, step.normal, -step.after, -step.before)
            for step in self.steps[-2::-1]
        ]
        # The base ray leaves at the plane of the opening
        first = self.steps[0]
        normal = opening.normal if opening.normal @ first.before < 0 else -opening.normal
        t = ((opening.centre - first.point) @ normal) / (-first.before @ normal)
        out = DesignStep(OPENING, False, first.point - t * first.before, normal, -first.before, np.zeros(3))
        return DesignPath(self.table, (*steps, out), opening)

    def follow(self, o: np.ndarray, d: np.ndarray, first: int, bounded: bool = False) -> np.ndarray:
        """
        Return the points, mm, at which rays that follow the surfaces of the path meet its end.

        Parameters
        ----------
        o, d : (n, 3) float64
            Origins (mm) and unit directions before step `first`.
        first : int
            Index of the first step to follow.
        bounded : bool
            Whether rays end that miss a surface of the path, meet it from its other side or would have to go backwards;
            else surfaces have no bounds and rays go both ways.

        Returns
        -------
        (n, 3) float64
            Hits on the detector's surface or in the plane of the opening, mm; NaN where a ray ends.
        """
        # Step by step, with the rays that are left
        hits = np.full(o.shape, np.nan)
        alive = np.arange(len(o))
        for step in self.steps[first:]:
            p, normal = self.meet(step, o, d)
            good = np.isfinite(p[:, 0])
            # Forward along the ray, from the side of the base ray, and within the bounds
            if bounded:
                with np.errstate(invalid="ignore"):
                    good &= np.einsum("ij,ij->i", p - o, d) > 0
                    good &= (np.einsum("ij,ij->i", d, normal) > 0) == step.from_front
                good &= self._inside(step, p)
            if step is self.steps[-1]:
                hits[alive[good]] = p[good]
            else:
                d = self.leave(step, d[good], normal[good])
                o, alive = p[good], alive[good]
        return hits

    def unobstructed(self, o: np.ndarray, d: np.ndarray, beyond_end: bool = False) -> Unobstructed:
        """
        Trace rays along the path through the whole scene; return whether each passes, and where others stop.

        Parameters
        ----------
        o, d : (n, 3) float64
            Origins (mm) and unit directions before the first step.
        beyond_end : bool
            Whether the detector has no edge: rays pass if they meet its sheet before they meet something else.
        """
        o, d = o.copy(), d.copy()
        passes, missed = (np.zeros(len(o), dtype=bool) for _ in range(2))
        last, ends, place = (np.full(len(o), -1) for _ in range(3))
        alive = np.arange(len(o))
        for number, step in enumerate(self.steps):
            # Intersect with the whole scene
            surface, p, normal = first_hit(self.table, o[alive], d[alive], last[alive])
            good, final = surface == step.surface, step is self.steps[-1]
            # Rays that meet something else: whether they crossed the unbounded surface of the step before it
            past = np.zeros(len(alive), dtype=bool)
            astray = np.flatnonzero(~good)
            away = self.meet(step, o[alive[astray]], d[alive[astray]])[0] - o[alive[astray]]
            to_sheet = np.einsum("ij,ij->i", away, d[alive[astray]])
            to_hit = np.where(surface >= 0, np.linalg.norm(p - o[alive], axis=1), np.inf)[astray]
            with np.errstate(invalid="ignore"):
                past[astray] = (to_sheet > 0) & (to_sheet <= to_hit * (1 + SAME_PLACE))
            if final and beyond_end:
                good = good | past
            # End those, and go on with the others if they are reflected or transmitted as the base ray is
            lost = alive[~good]
            ends[lost], place[lost], missed[lost] = surface[~good], number, past[~good]
            if final:
                passes[alive[good]] = True
                break
            alive, p, normal = alive[good], p[good], normal[good]
            after, reflects = onward(self.table, surface[good], d[alive], normal)
            kept = np.isfinite(after[:, 0]) & (reflects == step.reflects)
            ends[alive[~kept]], place[alive[~kept]] = step.surface, number
            alive = alive[kept]
            o[alive], d[alive], last[alive] = p[kept], after[kept], step.surface
        return Unobstructed(passes, ends, place, missed)

    def _inside(self, step: DesignStep, p: np.ndarray) -> np.ndarray:
        """Return a mask of points (n, 3), mm, within the bounds of the surface of a step, (n,) bool."""
        if step.surface == OPENING:
            return self.end.holds(p)
        if step.surface < len(self.table.pieces):
            return inside(self.table, step.surface, p)
        return outline(self.table.shapes[step.surface]).holds(p)

    def meet(self, step: DesignStep, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the points, mm, at which lines cross a step's unbounded surface, and the unit normals, (n, 3) each.

        Normals are from front to back. Of several crossings it is the one nearest to the base ray.

        For the opening and for a Mitsuba shape it is the tangent plane that is crossed. Points are NaN where a line
        does not cross the surface.
        """
        # The opening is plane, and of one of Mitsuba's own shapes it is the tangent plane
        if step.surface == OPENING or step.surface >= len(self.table.pieces):
            with np.errstate(all="ignore"):
                t = ((step.point - o) @ step.normal) / (d @ step.normal)
            return o + t[:, None] * d, np.tile(step.normal, (len(o), 1))
        # Of several intersections that next to the base ray
        t = crossings(self.table, step.surface, o, d)
        away = np.linalg.norm(o[:, None, :] + t[:, :, None] * d[:, None, :] - step.point, axis=2)
        pick = np.argmin(np.where(np.isfinite(away), away, np.inf), axis=1)
        p = o + np.take_along_axis(t, pick[:, None], axis=1) * d
        return p, normals(self.table, step.surface, p)

    def leave(self, step: DesignStep, d: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Return unit directions after a step's reflection or refraction, (n, 3); NaN where TIR prevents the latter."""
        n_front, n_back = self.table.optics.host_indices[step.surface, :2]
        eta = n_front / n_back if step.from_front else n_back / n_front
        reflected, transmitted, total = specular(d, normal, eta)
        return reflected if step.reflects else np.where(total[:, None], np.nan, transmitted)


def find_design_path(table: SurfaceTable, scene: mi.Scene) -> DesignPath | None:
    """
    Return the design path of a scene: the surfaces by which light of a source forms the image on the detector.

    It is the main order of the strongest arm, see `mistray.sampling.design.sequences`.

    Probe rays of each source are followed, on its axis (field angle 0) and then at its own field angle. They are
    reflected where a surface is declared ``mirror``, is opaque and reflects more than half, or reflects totally, and
    transmitted elsewhere. The search ends when some reach the detector over optics, however small a share of a wide
    beam that is. Only if none do, the path is the most frequent order of the first probes that reach it.

    Returns
    -------
    DesignPath or None
        None if no probe reaches the detector, there is no source, or the base ray fails, see `_with_base_ray`.
    """
    # An order without optics is kept until all sources and fields have been tried
    by_passing: DesignPath | None = None
    for source, probes in design_probes(table, scene):
        found = probes.orders(table.detector)
        arms = chosen_orders(table, found)
        if arms:
            return _with_base_ray(table, source, probes, arms[0][0])
        if found and by_passing is None:
            by_passing = _with_base_ray(table, source, probes, found.most_common(1)[0][0])
        if by_passing is not None and not has_optics(table):
            break
    return by_passing


def design_probes(table: SurfaceTable, scene: mi.Scene) -> Iterator[tuple[SceneSource, Probes]]:
    """
    Yield each source of a scene with its probe rays, first on its axis, then at its own field angle.

    A source is yielded several times: with few probes, with many, and aimed at optics and detectors. Nothing is yielded
    without a source.
    """
    if not source_emitters(scene):
        return
    for field in (0.0, None):
        for source in scene_sources(scene, field_deg=field):
            for light, count in _attempts(table, source):
                yield light, Probes(table, light, count)


def _attempts(table: SurfaceTable, source: SceneSource) -> Iterator[tuple[SceneSource, int]]:
    """
    Yield a source with the number of probe rays to try: twice as it is, then aimed at optics and detectors.

    The nearest `MOST_AIMS` of these are tried, if the source can be aimed.
    """
    # All of it, with few probes and with many
    yield source, PROBES
    yield source, MANY_PROBES
    # Aimed at optics and detectors, the nearest first
    words = table.optics.host_words
    optics = [k for k in range(table.count) if (words[k] & OPAQUE) == 0 or (words[k] & MIRROR) != 0]
    aims = [sphere_of(outline(table.shapes[k])) for k in (*optics, *table.detectors)]
    places = source.probes(mi.Point2f(mi.Float([0.5]), mi.Float([0.5])))[0]
    aims.sort(key=lambda aim: float(np.linalg.norm(aim.centre - places[0])))
    for aim in aims[:MOST_AIMS]:
        if (light := source.aimed_at(aim)) is not source:
            yield light, PROBES


def medium_around(table: SurfaceTable, source: SceneSource) -> int:
    """
    Return the position in `Optics.media` of the medium in which a near source stands, if that weakens its light.

    It is the one that all surfaces declare which its probes meet first; walls are asked where there are no others. A
    source that has a medium keeps it. One with a middle ray, as from far away, has 0, and so has one in several media.

    Raises
    ------
    MistrayError
        If all light of the source meets surfaces from sides through which no light travels.
    """
    if source.middle is not None:
        return source.medium
    # Sides of surfaces that its probes meet first
    rng = np.random.default_rng(0)
    o, d = source.probes(mi.Point2f(*(upload(mi.Float, v) for v in rng.random((2, PROBES)))))
    surface, front = _first_sides(table, source, o, d)
    # One of them in a material that transmits is enough
    materials = [
        (table.interfaces[s].front if from_front else table.interfaces[s].back, table.ids[s])
        for s, from_front in sorted(set(zip(surface.tolist(), front.tolist(), strict=True)))
    ]
    if materials and all(complex_index(one, source.wavelength_nm).imag > METAL_K for one, _ in materials):
        material, name = materials[0]
        raise MistrayError(
            f"source '{source.name}': it stands in '{material}' behind surface '{name}', where nothing travels; move it"
        )
    if source.medium or not table.optics.absorbs:
        return source.medium
    # The medium that they declare; where a narrow cone meets walls alone, other directions may know
    number = _declared_medium(table, surface, front)
    if not number and not source.shape:
        number = _declared_medium(table, *_first_sides(table, source, o, sphere_points(rng, PROBES)))
    return number if np.array(table.optics.extinction)[number] > 0 else 0


def _first_sides(
    table: SurfaceTable, source: SceneSource, o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the surfaces that rays of a source meet first, (m,) int, and a mask of those met from the front."""
    start = table.ids.index(source.shape) if source.shape else -1
    surface, _, normal = first_hit(table, o, d, np.full(len(o), start))
    met = surface >= 0
    return surface[met], (np.einsum("ij,ij->i", d, normal) > 0)[met]


def _declared_medium(table: SurfaceTable, surface: np.ndarray, front: np.ndarray) -> int:
    """Return the position of the medium that all these sides of surfaces declare, of walls if there are only such."""
    said, walls = table.optics.declared[surface, 1 - front], (table.optics.host_words[surface] & OPAQUE) != 0
    found = set((said[~walls] if np.any(~walls) else said).tolist()) - {0}  # 0: a wall that declares nothing
    return found.pop() if len(found) == 1 else 0


def sphere_of(target: Target) -> Sphere:
    """Return the sphere that encloses a flat target, about the target's centre."""
    a, b = float(np.linalg.norm(target.u)), float(np.linalg.norm(target.v))
    return Sphere(target.centre, max(a, b) if target.shape == "ellipse" else float(np.hypot(a, b)))


def first_aperture(table: SurfaceTable, scene: mi.Scene) -> Sphere | None:
    """
    Return the sphere around the design path's first aperture, at which start rays are aimed; None without one.

    Light goes straight on through planes, and between equal indices. Where such surfaces form a far larger front, the
    sphere is around the smallest of them and the surface behind. So light is aimed at a lens behind haze, or behind a
    large window.
    """
    path = find_design_path(table.on(table.detectors[0]) if len(table.detectors) > 1 else table, scene)
    if path is None:
        return None
    # Surfaces up to the first that bends the light
    spheres: list[Sphere] = []
    for step in path.steps:
        if spheres and (step is path.steps[-1] or np.linalg.norm(step.before - path.steps[0].before) > STRAIGHT):
            break
        spheres.append(sphere_of(outline(table.shapes[step.surface])))
        n_front, n_back = path.table.optics.host_indices[step.surface, :2]
        if step.reflects or not (n_front == n_back or is_plane(path.table, step.surface)):
            break
    least = min(spheres, key=lambda sphere: sphere.radius)
    return least if least.radius < LARGE_FRONT * spheres[0].radius else spheres[0]


def footprint(table: SurfaceTable, source: SceneSource, aperture: Sphere) -> Sphere | None:
    """
    Return a sphere around that part of the first aperture through which a source's light reaches the first detector.

    Returns
    -------
    Sphere or None
        None where too few probes arrive, or where the sphere is hardly smaller than the aperture.
    """
    # Probes by the most frequent order
    first = table.on(table.detectors[0]) if len(table.detectors) > 1 else table
    detector = first.detector
    probes = Probes(first, source.aimed_at(aperture), MANY_PROBES)
    found = probes.orders(detector)
    taking = probes.taking(found.most_common(1)[0][0], detector) if found else np.zeros(0, dtype=np.int64)
    if len(taking) < LEAST_ARRIVALS:
        return None
    points = probes.first_points(taking)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    sphere = Sphere(centre, MARGIN * float(np.linalg.norm(points - centre, axis=1).max()))
    return sphere if 0 < sphere.radius < LARGEST_RATIO * aperture.radius else None


def _with_base_ray(table: SurfaceTable, source: SceneSource, probes: Probes, order: Order) -> DesignPath | None:
    """
    Return the design path of an event sequence, along the source's middle ray or else its most central probe.

    None if that ray misses an unbounded surface or is totally reflected where it should pass.
    """
    # The probe nearest to the middle has the branch of each surface that is meant
    taking = probes.taking(order, table.detector)
    first = probes.first_points(taking)
    middle = int(taking[np.argmin(np.linalg.norm(first - first.mean(axis=0), axis=1))])
    probed = probes.steps(middle)
    path = DesignPath(table, tuple(probed), outline(table.shapes[table.detector]))
    # The middle ray of the source, if it has one, along the same steps
    o, d = source.middle or tuple(vectors[[probes.ray[middle]]] for vectors in probes.start)
    steps = []
    for step in probed:
        o, normal = path.meet(step, o, d)
        after = np.zeros((1, 3)) if step is probed[-1] else path.leave(step, d, normal)
        if not np.all(np.isfinite([o, normal, after])):
            return None
        steps.append(DesignStep(step.surface, step.reflects, o[0], normal[0], d[0], after[0]))
        d = after
    return DesignPath(table, tuple(steps), path.end)
