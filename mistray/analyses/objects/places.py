"""Places of objects along the optical system: gap between design surfaces, and side of the aperture stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.sampling.design_path import find_design_path
from mistray.sampling.sources import source_emitters
from mistray.surfaces.host_points import across
from mistray.surfaces.optics import OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.host.single_rays import ChainTracer, Escape, Hits, StartPoints

FAN_HEIGHTS, FAN_AZIMUTHS, FAN_ROUNDS = 4096, 8, 2  # rounds: each divides the last interval again
NEAR = 1e-5  # of the size of the scene: no distance at all
MakeTracer = Callable[[np.ndarray], ChainTracer]
BEFORE, AT_STOP, AFTER = "before", "stop", "after"


@dataclass(frozen=True, eq=False)
class ApertureStop:
    """
    Aperture that limits the on-axis beam, with its place along the design path.

    Attributes
    ----------
    part : str
        Part of the scene that it belongs to.
    gap : int
        Number of design surfaces upstream of it.
    along : float
        Position along the base ray within the gap, mm from the surface upstream of it (from the first one in gap 0);
        infinite for a stop that is the design surface at the end of the gap.
    """

    part: str
    gap: int
    along: float


@dataclass(frozen=True, eq=False)
class _FanEnds:
    """
    Hits at which rays of a fan, parallel to the base ray, leave the design path.

    Attributes
    ----------
    reached : (n,) int
        Number of design surfaces that each ray met in their order before anything else.
    surface : (n,) int
        Surface that it met then; -1: none.
    point, direction : (n, 3) float64
        Point of that hit, mm, and unit direction of the ray.
    """

    reached: np.ndarray
    surface: np.ndarray
    point: np.ndarray
    direction: np.ndarray


class Places:
    """
    Positions along the design path of a scene: gap g lies between its surfaces g - 1 and g, gap 0 before the first.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    scene : mi.Scene
        Loaded scene.
    tracer : callable
        Makes a `ChainTracer` for given mirrors: surfaces that reflect by design, (s,) bool.
    stop : str, optional
        Part or shape id of the aperture stop. Default: the aperture that limits the on-axis beam.

    Attributes
    ----------
    path : DesignPath or None
        None if the scene has no source or no light of it reaches the detector; all places are then unknown.
    stop : ApertureStop or None
        Aperture stop; None if it is unknown.

    Raises
    ------
    MistrayError
        If no part and no shape is called `stop`.
    """

    def __init__(self, table: SurfaceTable, scene: mi.Scene, tracer: MakeTracer, stop: str | None = None) -> None:
        self.table = table
        has_source = bool(source_emitters(scene))
        self.path = find_design_path(table, scene) if has_source else None
        if stop is not None and stop not in (*table.ids, *table.parts):
            raise MistrayError(f"stop: no part and no shape of the scene is called '{stop}'; parts: {_names(table)}")
        self.stop: ApertureStop | None = None
        self.optics = np.zeros(table.count, dtype=bool)
        self.mirrors = np.zeros(table.count, dtype=bool)
        if self.path is None:
            return
        for step in self.path.steps:
            self.optics[step.surface] = True
            self.mirrors[step.surface] |= step.reflects
        self._index_steps()
        self.stop = self._named_stop(stop) if stop is not None else self._find_stop(tracer(self.mirrors))

    @property
    def gaps(self) -> int:
        """Number of gaps along the design path, one before each surface and the detector; 1 without such a path."""
        return len(self.path.steps) if self.path is not None else 1

    # ---- the gap of a ray

    def _index_steps(self) -> None:
        """
        Assign to each surface the design steps at which light meets it.

        A transparent surface off the path, such as a bevel, has the steps of the design surfaces of its part with the
        same media.
        """
        assert self.path is not None
        table, steps = self.table, self.path.steps
        words = table.optics.host_words
        numbers: list[list[int]] = [[] for _ in range(table.count)]
        for number, step in enumerate(steps):
            numbers[step.surface].append(number)
        media = [(bsdf.front, bsdf.back) for bsdf in table.interfaces]
        for i in range(table.count):
            if not numbers[i] and not words[i] & OPAQUE:
                same = [
                    k for k, step in enumerate(steps)
                    if table.parts[step.surface] == table.parts[i] and media[step.surface] == media[i]
                ]  # fmt: skip
                numbers[i] = same
        most = max(map(len, numbers))
        self._steps = np.array([row + [-1] * (most - len(row)) for row in numbers])
        self._from_front = np.array([step.from_front for step in steps])

    def start_gap(self, backward: bool, n: int) -> np.ndarray:
        """Return the index of the first gap between design surfaces, or of the last if `backward`, for n rays, (n,)."""
        return np.full(n, self.gaps - 1 if backward else 0)

    def advance(self, hits: Hits, gap: np.ndarray, backward: bool) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the gaps between design surfaces in which rays are at a hit and after it.

        Parameters
        ----------
        hits : Hits
            Hits of the rays.
        gap : (m,) int
            Gap of each ray before the hit.
        backward : bool
            Whether the rays run from the detector outwards.

        Returns
        -------
        here, after : (m,) int
        """
        if self.path is None:
            return gap, gap
        candidates = self._steps[hits.surface]
        expected = gap - 1 if backward else gap
        apart = np.where(candidates >= 0, np.abs(candidates - expected[:, None]), 1 << 30)
        step = np.take_along_axis(candidates, np.argmin(apart, axis=1)[:, None], axis=1)[:, 0]
        known = step >= 0
        upstream = hits.from_front == self._from_front[step]
        side = np.where(upstream, step, step + 1)
        mirror = hits.reflects & ~hits.total
        here = np.where(known & ~self.mirrors[hits.surface], side, gap)
        through = np.where(upstream, step + 1, step)
        bounced = step if backward else step + 1
        after = np.where(hits.transmits, through, np.where(mirror, bounced, here))
        # Behind the detector is no gap of its own
        return np.minimum(here, self.gaps - 1), np.minimum(np.where(known, after, gap), self.gaps - 1)

    def along(self, gap: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Return the distance of points, (m, 3), mm, along the base ray from the start of their gap, (m,), mm."""
        assert self.path is not None
        steps = self.path.steps
        start = np.array([steps[max(g - 1, 0)].point for g in range(self.gaps)])
        direction = np.array([steps[g].before for g in range(self.gaps)])
        return np.asarray(np.einsum("ij,ij->i", point - start[gap], direction[gap]))

    def between(self, gap: int) -> str:
        """Return the name of a gap: the design surfaces that it lies between; "" without a design path."""
        if self.path is None:
            return ""
        names = [self.table.ids[step.surface] for step in self.path.steps]
        return f"before {names[0]}" if gap == 0 else f"{names[gap - 1]} – {names[gap]}"

    def against_stop(self, part: str, gap: int, along: float) -> str:
        """
        Return the place of an object relative to the aperture stop: "before", "after", "stop", or "" if unknown.

        The object belongs to part `part` and lies in gap `gap`; `along` is its distance along the base ray from the
        start of that gap, mm, as from `Places.along`.
        """
        if self.stop is None:
            return ""
        if part == self.stop.part:
            return AT_STOP
        if gap != self.stop.gap:
            return BEFORE if gap < self.stop.gap else AFTER
        # What lies in the plane of the stop faces the light
        return BEFORE if along < self.stop.along + NEAR * self._size() else AFTER

    # ---- the stop

    def _named_stop(self, name: str) -> ApertureStop:
        """Return the stop given by name: at its design surface, or else at the centre of its bounding boxes."""
        assert self.path is not None
        table = self.table
        members = [i for i in range(table.count) if name in (table.ids[i], table.parts[i])]
        part = table.parts[members[0]]
        on_path = [k for k, step in enumerate(self.path.steps) if step.surface in members]
        if on_path:
            return ApertureStop(part, on_path[0], np.inf)
        boxes = [table.shapes[i].bbox() for i in members]
        middle = np.mean([(np.array(box.min) + np.array(box.max)) / 2 for box in boxes], axis=0)
        gaps = np.arange(self.gaps)
        along = self.along(gaps, np.tile(middle, (self.gaps, 1)))
        points = np.array([step.point for step in self.path.steps])
        length = np.array([np.inf, *np.linalg.norm(np.diff(points, axis=0), axis=1)])
        # The gap on whose piece of the base ray, or nearest to it, the middle of the stop lies
        foot = np.where(gaps == 0, np.minimum(along, 0), np.clip(along, 0, length))
        directions = np.array([step.before for step in self.path.steps])
        starts = points[np.maximum(gaps - 1, 0)]
        gap = int(np.argmin(np.linalg.norm(starts + foot[:, None] * directions - middle, axis=1)))
        return ApertureStop(part, gap, float(along[gap]))

    def _find_stop(self, tracer: ChainTracer) -> ApertureStop | None:
        """
        Return the aperture stop, found by fans of rays parallel to the base ray, of which the outermost just arrives.

        The stop is whatever ends the next ray outside it: a surface in the way, or the rim of a design surface that the
        ray misses. The fan whose beam is narrowest decides. The result is None if in every fan no ray arrives or the
        outermost does, or if that next ray just misses the detector.
        """
        assert self.path is not None
        size, first = self._size(), self.path.steps[0]
        phi = 2 * np.pi * (np.arange(FAN_AZIMUTHS) + 0.5) / FAN_AZIMUTHS
        out = np.stack([np.cos(phi), np.sin(phi)], axis=1) @ across(first.before).T
        low, high = np.zeros(FAN_AZIMUTHS), np.full(FAN_AZIMUTHS, size)
        for _ in range(FAN_ROUNDS):
            heights = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, FAN_HEIGHTS + 1)
            arrives = self._fan(tracer, np.repeat(out, FAN_HEIGHTS + 1, axis=0), heights.ravel()).reached == self.gaps
            # The last of each fan that arrives; those that none of arrives, or all of, say nothing
            last = np.where(arrives.reshape(heights.shape), np.arange(FAN_HEIGHTS + 1), -1).max(axis=1)
            use = (last >= 0) & (last < FAN_HEIGHTS)
            if not np.any(use):
                return None
            out, heights, last = out[use], heights[use], last[use]
            low, high = (np.take_along_axis(heights, (last + k)[:, None], axis=1)[:, 0] for k in (0, 1))
        ends = self._fan(tracer, out, high)
        return self._limit(ends, int(np.argmin(high)))

    def _limit(self, ends: _FanEnds, ray: int) -> ApertureStop | None:
        """
        Return the aperture stop as what ends the ray of index `ray`, the first one outside the beam.

        That is the part that blocks it, or the design surface that it misses. The result is None for the detector.
        """
        assert self.path is not None
        gap, surface = int(ends.reached[ray]), int(ends.surface[ray])
        step, point, direction = self.path.steps[gap], ends.point[ray : ray + 1], ends.direction[ray : ray + 1]
        if surface >= 0 and gap:
            # A wall that begins at the rim of the surface passed last: which of the two is met first is rounding
            before = self.path.steps[gap - 1]
            if np.linalg.norm(self.path.meet(before, point, direction)[0] - point) < NEAR * self._size():
                return ApertureStop(self.table.parts[before.surface], gap - 1, np.inf)
        rim = ApertureStop(self.table.parts[step.surface], gap, np.inf)
        if surface < 0 or not self.table.optics.host_words[surface] & OPAQUE:
            return rim if gap < self.gaps - 1 else None
        sheet, _ = self.path.meet(step, point, direction)
        ahead = float(np.einsum("ij,ij->i", sheet - point, direction)[0])
        if self.table.parts[surface] == rim.part or not ahead > NEAR * self._size():
            return rim if gap < self.gaps - 1 else None
        return ApertureStop(self.table.parts[surface], gap, float(self.along(np.array([gap]), point)[0]))

    def _fan(self, tracer: ChainTracer, out: np.ndarray, heights: np.ndarray) -> _FanEnds:
        """Return where rays parallel to the base ray, at `heights`, (n,), mm along `out`, (n, 3), leave the path."""
        assert self.path is not None
        steps, n = self.path.steps, len(out)
        o = steps[0].point + heights[:, None] * out - 4 * self._size() * steps[0].before
        reached = np.zeros(n, dtype=int)
        start = StartPoints(o, np.tile(steps[0].before, (n, 1)), np.ones(n))
        surface, point, direction = np.full(n, -1), np.zeros((n, 3)), np.zeros((n, 3))
        for hits in tracer.follow(start, np.random.default_rng(0)):
            if isinstance(hits, Escape) or hits.number >= len(steps):
                continue
            ours = reached[hits.lane] == hits.number
            lane = hits.lane[ours]
            surface[lane], point[lane], direction[lane] = hits.surface[ours], hits.point[ours], hits.direction[ours]
            right = hits.surface[ours] == steps[hits.number].surface
            reached[lane[right]] += 1
            surface[lane[right]] = -1
        return _FanEnds(reached, surface, point, direction)

    def _size(self) -> float:
        """Return the largest absolute coordinate of the scene's bounding box, mm."""
        return max(float(np.max(np.abs([*shape.bbox().min, *shape.bbox().max]))) for shape in self.table.shapes)


def _names(table: SurfaceTable) -> str:
    return ", ".join(sorted(set(table.parts)))
