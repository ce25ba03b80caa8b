"""The way of the light that a system is made for: from the source over lenses and mirrors to the detector, and back."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from mistray.kernel.targets import Target
from mistray.sampling.outlines import outline
from mistray.sampling.source import SceneSource
from mistray.sampling.sources import scene_sources, source_emitters
from mistray.surfaces.host_rays import crossings, first_hit, inside, normals, onward, specular
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

PROBES = 256  # rays of a beam that look for the design path
MOST_STEPS = 64
OPENING = -1  # in place of the number of a surface: where a backward path leaves the system


@dataclass(frozen=True)
class Step:
    """
    One surface of the design path.

    Attributes
    ----------
    surface : int
        Or `OPENING`.
    reflects : bool
    point : (3,) float64
        Where the base ray meets it, mm; bounds of surfaces do not matter for the base ray.
    normal : (3,) float64
        There, from front to back.
    before, after : (3,) float64
        Directions of the base ray; `after` is zero at the end of a path.
    """

    surface: int
    reflects: bool
    point: np.ndarray
    normal: np.ndarray
    before: np.ndarray
    after: np.ndarray

    @property
    def from_front(self) -> bool:
        """Whether the light comes from the front."""
        return bool(self.before @ self.normal > 0)

    @property
    def to_back(self) -> bool:
        """Whether the light leaves to the back."""
        return bool(self.after @ self.normal > 0)


class DesignPath:
    """
    The surfaces that most of the light of a beam meets on its way to the detector, or the same backwards.

    Parameters
    ----------
    table : SurfaceTable
    steps : tuple of Step
        The last one is the detector, or the opening.
    end : Target
        Outline of the detector or of the opening.
    """

    def __init__(self, table: SurfaceTable, steps: tuple[Step, ...], end: Target) -> None:
        self.table = table
        self.steps = steps
        self.end = end

    @property
    def has_optics(self) -> bool:
        """Whether there is a lens or a mirror on the way."""
        return len(self.steps) > 1

    def reversed(self, opening: Target) -> DesignPath:
        """The backward path, from the detector to an opening before its first surface."""
        steps = [
            Step(step.surface, step.reflects, step.point, step.normal, -step.after, -step.before)
            for step in self.steps[-2::-1]
        ]
        first = self.steps[0]
        normal = opening.normal if opening.normal @ first.before < 0 else -opening.normal
        t = ((opening.centre - first.point) @ normal) / (-first.before @ normal)
        out = Step(OPENING, False, first.point - t * first.before, normal, -first.before, np.zeros(3))
        return DesignPath(self.table, (*steps, out), opening)

    def follow(self, o: np.ndarray, d: np.ndarray, first: int, bounded: bool = False) -> np.ndarray:
        """
        Send rays along the path to its end.

        Parameters
        ----------
        o, d : (n, 3) float64
            Origins (mm) and unit directions before step `first`.
        first : int
        bounded : bool
            End rays that pass by a surface of the path, meet it from its other side or would have to go backwards;
            else surfaces have no bounds and rays go both ways.

        Returns
        -------
        (n, 3) float64
            Hits on the detector's surface or in the plane of the opening, mm; NaN where a ray ends.
        """
        hits = np.full(o.shape, np.nan)
        alive = np.arange(len(o))
        for step in self.steps[first:]:
            p, normal = self.meet(step, o, d)
            good = np.isfinite(p[:, 0])
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

    def _inside(self, step: Step, p: np.ndarray) -> np.ndarray:
        """Whether points lie within the bounds of the surface of a step."""
        if step.surface == OPENING:
            return self.end.holds(p)
        if step.surface < len(self.table.pieces):
            return inside(self.table, step.surface, p)
        return outline(self.table.shapes[step.surface]).holds(p)

    def meet(self, step: Step, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where lines meet the surface of a step, next to the step's point, and the normals there."""
        if step.surface == OPENING or step.surface >= len(self.table.pieces):  # a stock shape: its tangent plane
            with np.errstate(all="ignore"):
                t = ((step.point - o) @ step.normal) / (d @ step.normal)
            return o + t[:, None] * d, np.tile(step.normal, (len(o), 1))
        t = crossings(self.table, step.surface, o, d)
        away = np.linalg.norm(o[:, None, :] + t[:, :, None] * d[:, None, :] - step.point, axis=2)
        pick = np.argmin(np.where(np.isfinite(away), away, np.inf), axis=1)
        p = o + np.take_along_axis(t, pick[:, None], axis=1) * d
        return p, normals(self.table, step.surface, p)

    def leave(self, step: Step, d: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Directions after a step; NaN beyond the critical angle."""
        n_front, n_back = self.table.optics.host_indices[step.surface, :2]
        eta = n_front / n_back if step.from_front else n_back / n_front
        reflected, transmitted, total = specular(d, normal, eta)
        return reflected if step.reflects else np.where(total[:, None], np.nan, transmitted)


def find_design_path(table: SurfaceTable, scene: mi.Scene) -> DesignPath | None:
    """
    The design path of a scene.

    Probe rays of each source on its axis (field angle 0), then at its own field angle, are followed: reflected where a
    surface is declared ``mirror``, is opaque and reflects more than half, or in total reflection; transmitted
    elsewhere. The path that most of them take to the detector is it.

    Returns
    -------
    DesignPath or None
        None where no probe reaches the detector, or there is no source.
    """
    if not source_emitters(scene):
        return None
    for field in (0.0, None):
        for source in scene_sources(scene, field_deg=field):
            probed = _probe(table, source)
            path = _with_base_ray(table, source, probed) if probed else None
            if path is not None:
                return path
    return None


def _probe(table: SurfaceTable, source: SceneSource) -> list[Step] | None:
    """The steps that most probes take to the detector, each with the hit of one of them."""
    sample = mi.Point2f(*(upload(mi.Float, v) for v in np.random.default_rng(0).random((2, PROBES))))
    o, d = source.probes(sample)
    last = np.full(PROBES, -1)
    trails: list[list[Step]] = [[] for _ in range(PROBES)]
    arrived = []
    alive = np.arange(PROBES)
    for _ in range(MOST_STEPS):
        surface, p, normal = first_hit(table, o[alive], d[alive], last[alive])
        alive, p, normal, surface = (values[surface >= 0] for values in (alive, p, normal, surface))
        after, reflects = onward(table, surface, d[alive], normal)
        after[surface == table.detector] = 0.0
        for ray, *step in zip(alive, surface, reflects, p, normal, d[alive], after, strict=True):
            trails[ray].append(Step(int(step[0]), bool(step[1]), *step[2:]))
        arrived += alive[surface == table.detector].tolist()
        o[alive], d[alive], last[alive] = p, after, surface
        alive = alive[(surface != table.detector) & np.isfinite(after[:, 0])]
        if not len(alive):
            break
    orders = {ray: tuple((step.surface, step.reflects) for step in trails[ray]) for ray in arrived}
    if not orders:
        return None
    most = Counter(orders.values()).most_common(1)[0][0]
    return next(trails[ray] for ray, order in orders.items() if order == most)


def _with_base_ray(table: SurfaceTable, source: SceneSource, probed: list[Step]) -> DesignPath | None:
    """The path with the steps of the ray in the middle of the light; None if that ray misses a surface altogether."""
    path = DesignPath(table, tuple(probed), outline(table.shapes[table.detector]))
    o, d = source.middle
    steps = []
    for step in probed:
        o, normal = path.meet(step, o, d)
        after = np.zeros((1, 3)) if step is probed[-1] else path.leave(step, d, normal)
        if not np.all(np.isfinite([o, normal, after])):
            return None
        steps.append(Step(step.surface, step.reflects, o[0], normal[0], d[0], after[0]))
        d = after
    return DesignPath(table, tuple(steps), path.end)
