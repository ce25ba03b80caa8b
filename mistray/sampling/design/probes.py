"""
Probe rays of a source that follow the design: mirrors and total reflection reflect them, other surfaces transmit them.

At a beam splitter, a coated surface whose R and T are both at least `SPLITS`, a probe continues both ways.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields

import mitsuba as mi
import numpy as np

from mistray.coatings import Bare
from mistray.events import REFLECTED, TOTAL, TRANSMITTED, event_of
from mistray.sampling.source import SceneSource
from mistray.surfaces.host_rays import first_hit, onward, specular
from mistray.surfaces.optics import MIRROR, OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

MOST_STEPS = 64  # hits of a probe
SPLITS = 0.1  # least R and least T of a beam splitter
MOST_SPLIT = 4  # probes per start ray, by beam splitters

Order = tuple[int, ...]
"""Events, see `mistray.events`, of a probe before the detector."""


@dataclass(frozen=True)
class DesignStep:
    """
    Surface of the design path, with point, normal and directions of the base ray there.

    Attributes
    ----------
    surface : int
        Index of the surface, or `mistray.sampling.design_path.OPENING`.
    reflects : bool
        Whether the base ray is reflected there.
    point : (3,) float64
        Point where the base ray meets it, mm; the base ray ignores the bounds of surfaces.
    normal : (3,) float64
        Unit normal there, from front to back.
    before, after : (3,) float64
        Unit directions of the base ray; `after` is zero at the end of a path.
    """

    surface: int
    reflects: bool
    point: np.ndarray
    normal: np.ndarray
    before: np.ndarray
    after: np.ndarray

    @property
    def from_front(self) -> bool:
        """True if the base ray meets the surface from the front."""
        return bool(self.before @ self.normal > 0)

    @property
    def to_back(self) -> bool:
        """True if the base ray leaves the surface to the back."""
        return bool(self.after @ self.normal > 0)


@dataclass(frozen=True)
class _Hits:
    """Hits of probes at one step: index of probe and surface, whether reflected or TIR, point, mm, and unit vectors."""

    lane: np.ndarray
    surface: np.ndarray
    reflects: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    before: np.ndarray
    after: np.ndarray


class Probes:
    """
    Probe rays of a source, traced through the scene by the specular events of its design.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene; probes end at its detectors.
    source : SceneSource
        Source whose design is probed.
    count : int
        Number of start rays.

    Attributes
    ----------
    start : tuple of (count, 3) float64
        Origins (mm) and unit directions of the start rays.
    ray, end : (p,) int
        Index of the start ray of each probe, and of the detector that it reaches; -1: none.
    """

    def __init__(self, table: SurfaceTable, source: SceneSource, count: int) -> None:
        # Start rays, and room for those that beam splitters add
        sample = mi.Point2f(*(upload(mi.Float, v) for v in np.random.default_rng(0).random((2, count))))
        self.start = source.probes(sample)
        most = MOST_SPLIT * count
        o, d = (np.concatenate([vectors, np.zeros((most - count, 3))]) for vectors in self.start)
        last = np.full(most, table.ids.index(source.shape) if source.shape else -1)
        self.ray, self._parent = np.arange(most), np.full(most, -1)
        self._codes = np.zeros((most, MOST_STEPS), dtype=np.uint32)
        self._lengths, self.end = np.zeros(most, dtype=np.int64), np.full(most, -1)
        self._steps: list[_Hits] = []
        # All probes together, hit by hit
        alive, lanes = np.arange(count), count
        for number in range(MOST_STEPS):
            # Intersect, and follow the event of the design
            surface, p, normal = first_hit(table, o[alive], d[alive], last[alive])
            alive, p, normal, surface = (values[surface >= 0] for values in (alive, p, normal, surface))
            before = d[alive]
            after, reflects = onward(table, surface, before, normal)
            total = reflects & ((table.optics.host_words[surface] & (OPAQUE | MIRROR)) == 0)
            what = np.select([total, reflects], [TOTAL, REFLECTED], TRANSMITTED).astype(np.uint32)
            ends = np.isin(surface, table.detectors)
            after[ends] = 0.0
            hits = _Hits(alive, surface, what != TRANSMITTED, p, normal, before, after)
            # Beam splitters: a new lane takes over the history of the old one, and the other event
            split = np.flatnonzero(~ends & _splits(table, surface, before, normal))[: most - lanes]
            if len(split):
                new = lanes + np.arange(len(split))
                lanes += len(split)
                for values in (o, d, last, self.ray, self._codes):
                    values[new] = values[alive[split]]
                self._parent[new] = alive[split]
                hits, what = _with_others(table, hits, what, split, new)
                alive, ends = hits.lane, np.concatenate([ends, np.zeros(len(split), dtype=bool)])
            # Record, and go on with those that neither end at a detector nor are absorbed
            self._steps.append(hits)
            self._codes[alive, number] = event_of(hits.surface, what)
            self._lengths[alive] = number
            self.end[alive[ends]] = hits.surface[ends]
            o[alive], d[alive], last[alive] = hits.point, hits.after, hits.surface
            alive = alive[~ends & np.isfinite(hits.after[:, 0])]
            if not len(alive):
                break

    def orders(self, detector: int) -> Counter[Order]:
        """Return the event sequences by which probe rays reach a detector, each with its number of rays."""
        arrived = np.flatnonzero(self.end == detector)
        return Counter(tuple(self._codes[k, : self._lengths[k]].tolist()) for k in arrived)

    def taking(self, order: Order, detector: int) -> np.ndarray:
        """Return the indices of the probe rays that reach a detector by the event sequence `order`, (n,) int."""
        codes = np.array(order, dtype=np.uint32)
        same = (self.end == detector) & (self._lengths == len(codes))
        return np.flatnonzero(same & np.all(self._codes[:, : len(codes)] == codes, axis=1))

    def steps(self, lane: int) -> list[DesignStep]:
        """Return the steps at surfaces, `DesignStep`, of one probe ray from its first surface to its last."""
        # From the end back to the start: before the split a lane has the hits of its parent
        found = []
        for hits in self._steps[int(self._lengths[lane]) :: -1]:
            if lane not in hits.lane:
                lane = int(self._parent[lane])
            k = int(np.argmax(hits.lane == lane))
            surface, reflects = int(hits.surface[k]), bool(hits.reflects[k])
            found.append(DesignStep(surface, reflects, hits.point[k], hits.normal[k], hits.before[k], hits.after[k]))
        return found[::-1]

    def first_points(self, lanes: np.ndarray) -> np.ndarray:
        """Return the points at which probe rays meet their first surfaces, (n, 3) float64, mm; NaN if they miss all."""
        # Lanes that split off at the first hit have that of their start ray
        first = self._steps[0]
        points = np.full((len(self.start[0]), 3), np.nan)
        own = first.lane < len(points)
        points[first.lane[own]] = first.point[own]
        return points[self.ray[lanes]]


def _splits(table: SurfaceTable, surface: np.ndarray, d: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return a mask of hits at beam splitters, (n,): coated surfaces with R and T at least `SPLITS` at that angle."""
    found = np.zeros(len(surface), dtype=bool)
    optics = table.optics
    along = np.einsum("ij,ij->i", d, normal)
    for number in np.unique(surface).tolist():
        if optics.host_words[number] & OPAQUE or isinstance(optics.bsdfs[number].coating, Bare):
            continue
        # R and T of a coating may differ from side to side
        for from_front in (True, False):
            here = np.flatnonzero((surface == number) & ((along > 0) == from_front))
            if len(here):
                R, T = optics.shares(number, from_front, np.abs(along[here]))
                found[here] = np.minimum(R, T) >= SPLITS
    return found


def _with_others(
    table: SurfaceTable, hits: _Hits, what: np.ndarray, split: np.ndarray, new: np.ndarray
) -> tuple[_Hits, np.ndarray]:
    """
    Return the hits and events of a step, with added probes that take the other way at beam splitters.

    `what` are the kinds of event, `split` the rows of `hits` at beam splitters, and `new` the lanes of added probes.
    """
    n = table.optics.host_indices[hits.surface[split], :2]
    before, normal = hits.before[split], hits.normal[split]
    from_front = np.einsum("ij,ij->i", before, normal) > 0
    reflected, transmitted, _ = specular(before, normal, np.where(from_front, n[:, 0] / n[:, 1], n[:, 1] / n[:, 0]))
    reflects = ~hits.reflects[split]
    after = np.where(reflects[:, None], reflected, transmitted)
    others = np.where(reflects, REFLECTED, TRANSMITTED).astype(np.uint32)
    added = new, hits.surface[split], reflects, hits.point[split], normal, before, after
    both = (np.concatenate([getattr(hits, f.name), one]) for f, one in zip(fields(_Hits), added, strict=True))
    return _Hits(*both), np.concatenate([what, others])
