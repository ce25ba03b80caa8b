"""Results of unsplit rays: flux on both sides of all surfaces, samples of hits, and exits from the scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mistray.analyses.objects.places import Places
from mistray.recorders.sampled import batch_error
from mistray.settings import BATCHES
from mistray.surfaces.optics import MIRROR, OPAQUE
from mistray.time_budget import is_limited, left
from mistray.trace.host.ray_sources import RaySource
from mistray.trace.host.single_rays import ChainTracer, Escape, Hits

PASS_RAYS = 1 << 18
SMALLER = 64  # times smaller is the first pass where there is a time budget
KEPT_HITS = 16_384  # of each side of a surface: no more are kept once there are so many
SIDES = 2  # of a surface: front, back
NO_HITS = {  # arrays of `HitSamples`
    **dict.fromkeys(("point", "direction", "normal"), np.zeros((0, 3))),
    **dict.fromkeys(("weight", "index"), np.zeros(0)),
    "from_front": np.zeros(0, dtype=bool),
    "batch": np.zeros(0, dtype=int),
}
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class HitSamples:
    """
    Sample of the hits of one object by `rays` start rays.

    Attributes
    ----------
    point, direction, normal : (m, 3) float64
        Points, mm, unit directions of arrival, and unit normals on the side that the rays head for.
    weight : (m,) float64
        Weight of each ray: mm² for a source outside, see `mistray.trace.host.ray_sources`; from the detector
        relative to a mean of 1.
    index : (m,) float64
        Refractive index of the medium at the hit over that at the start of the ray.
    from_front : (m,) bool
        Whether the ray arrives from the front.
    batch : (m,) int
        Index of the batch of each ray.
    rays : int
        Number of start rays that were traced while these hits were kept.
    """

    point: np.ndarray
    direction: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    index: np.ndarray
    from_front: np.ndarray
    batch: np.ndarray
    rays: int

    def only(self, here: np.ndarray) -> HitSamples:
        """Return the hits where `here`, (m,) bool, is true."""
        return HitSamples(**{name: getattr(self, name)[here] for name in NO_HITS}, rays=self.rays)


@dataclass
class _Kept:
    """Hits of one object kept so far, by pass of the trace, and the number of start rays behind them."""

    parts: list[dict[str, np.ndarray]] = field(default_factory=list)
    count: int = 0
    rays: int = 0


@dataclass(frozen=True)
class WayOut:
    """
    Rays that leave the scene after the same sequence of surfaces.

    Attributes
    ----------
    surfaces : tuple of int
        Indices of the surfaces in the order of the rays.
    turned : bool
        Whether light is reflected on the way, totally or by anything but a mirror.
    rays : int
        Number of these rays.
    share, share_se : float
        Share of the started flux and its standard error.
    field_deg : (2,) float
        Smallest and largest field angle of light in the opposite direction, degrees.
    """

    surfaces: tuple[int, ...]
    turned: bool
    rays: int
    share: float
    share_se: float
    field_deg: tuple[float, float]


class Trails:
    """
    Numbering of the sequences of surfaces that rays have met, so that a sequence is one integer; 0: no surface yet.

    Parameters
    ----------
    surfaces : int
        Number of surfaces in the scene.
    """

    def __init__(self, surfaces: int) -> None:
        self._count = surfaces
        self._numbers: dict[int, int] = {}  # of the trail before and the surface, as one number
        self._ends: list[tuple[int, int]] = [(0, -1)]

    def longer(self, trail: np.ndarray, surface: np.ndarray) -> np.ndarray:
        """Return the indices of surface sequences after one more surface each; all arrays are (m,) int."""
        steps, inverse = np.unique(trail * self._count + surface, return_inverse=True)
        for step in map(int, steps):
            if step not in self._numbers:
                self._numbers[step] = len(self._ends)
                self._ends.append(divmod(step, self._count))
        return np.array([self._numbers[int(step)] for step in steps], dtype=np.int64)[inverse]

    def surfaces(self, number: int) -> tuple[int, ...]:
        """Return the indices of the surfaces in the sequence of index `number`, in the order in which rays met them."""
        found: list[int] = []
        while number:
            number, surface = self._ends[number]
            found.append(surface)
        return tuple(reversed(found))


class RayView:
    """
    Trace of rays from a source, with the flux and hits on the objects that they meet.

    An *object* is a surface, or one side of it if it is opaque. Its index is 2 s for the front of surface s (and for
    both sides of one that transmits), 2 s + 1 for its back.

    Parameters
    ----------
    tracer : ChainTracer
        Tracer of unsplit rays.
    places : Places
        Gaps of the design path, to which hits are assigned.
    source : RaySource
        Source of the start rays.
    rays : int
        Number of start rays; fewer are traced if a time budget ends.
    seed : int
        Seed of the random numbers.
    backward : bool
        Whether the rays run from the detector outwards.
    axis : (3,) float64
        Unit direction of light at field angle 0.
    progress : callable, optional
        Called with (rays done, rays in all).

    Attributes
    ----------
    name : str
        Name of the source.
    rays : (BATCHES,) int
        Number of rays started in each batch.
    started : float
        Sum of their weights, in the unit of `HitSamples.weight`.
    flux : (objects, BATCHES) float64
        Sum of the weights of the rays that meet each object, in the same unit.
    hits : (objects,) int
        Number of hits of each object.
    in_gap : (objects, gaps) int
        Hits by the gap of the design path that the rays were in.
    along : (objects,) float64
        Mean position along the base ray of the hits in the gap of the stop, mm; NaN without any.
    lost : float
        Fraction of the started flux that met a surface from a material that does not border on it.
    """

    def __init__(
        self,
        tracer: ChainTracer,
        places: Places,
        source: RaySource,
        rays: int,
        seed: int,
        backward: bool,
        axis: np.ndarray,
        progress: Progress | None = None,
    ) -> None:
        table = tracer.table
        self.name = source.name
        self._opaque = (table.optics.host_words & OPAQUE) != 0
        self._mirrors = places.mirrors | ((table.optics.host_words & MIRROR) != 0)
        self._places, self._backward, self._axis = places, backward, axis
        objects = SIDES * table.count
        self.rays = np.zeros(BATCHES, dtype=np.int64)
        self.flux = np.zeros((objects, BATCHES))
        self.hits = np.zeros(objects, dtype=np.int64)
        self.in_gap = np.zeros((objects, places.gaps), dtype=np.int64)
        self._along = np.zeros((objects, 2))
        self._kept = [_Kept() for _ in range(objects)]
        self._trails = Trails(table.count)
        self._ways: dict[tuple[tuple[int, ...], bool], dict[str, np.ndarray]] = {}
        self.started = 0.0
        rng = np.random.default_rng((int(backward), seed))
        tracer.lost = 0.0
        done, size, took = 0, PASS_RAYS // SMALLER if is_limited() else PASS_RAYS, 0.0
        while done < rays and not (done and left() < took):
            n, began = min(size, rays - done), time.perf_counter()
            self._pass(tracer, source, n, rng)
            done, size = done + n, min(2 * size, PASS_RAYS)
            took = 2 * (time.perf_counter() - began)  # of the next one, which is twice as large
            if progress:
                progress(done, rays)
        self.lost = tracer.lost / self.started
        with np.errstate(invalid="ignore", divide="ignore"):
            self.along = self._along[:, 0] / self._along[:, 1]

    def _pass(self, tracer: ChainTracer, source: RaySource, n: int, rng: np.random.Generator) -> None:
        start = source.sample(n, rng)
        batch = np.concatenate([np.full(len(part), k) for k, part in enumerate(np.array_split(np.arange(n), BATCHES))])
        self.rays += np.bincount(batch, minlength=BATCHES)
        self.started += float(start.weight.sum())
        gap = self._places.start_gap(self._backward, n)
        trail, turned = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool)
        open_objects = {k for k, kept in enumerate(self._kept) if kept.count < KEPT_HITS}
        fresh: dict[int, list[dict[str, np.ndarray]]] = {}
        for step in tracer.follow(start, rng):
            if isinstance(step, Escape):
                if self._backward:
                    self._leave(step, trail, turned, batch)
                continue
            here, gap[step.lane] = self._places.advance(step, gap[step.lane], self._backward)
            if self._backward:
                trail[step.lane] = self._trails.longer(trail[step.lane], step.surface)
                turned[step.lane] |= step.total | (step.reflects & ~self._mirrors[step.surface])
            self._record(step, here, batch[step.lane], open_objects, fresh)
        for k in open_objects:
            kept = self._kept[k]
            kept.parts += fresh.get(k, [])
            kept.count += sum(len(part["weight"]) for part in fresh.get(k, []))
            kept.rays += n

    def objects(self, hits: Hits) -> np.ndarray:
        """Return the index of the object, a surface or one side of it, that each ray hits, (m,) int."""
        back = self._opaque[hits.surface] & ~hits.from_front
        return SIDES * hits.surface + back

    def _record(
        self,
        hits: Hits,
        gap: np.ndarray,
        batch: np.ndarray,
        open_objects: set[int],
        fresh: dict[int, list[dict[str, np.ndarray]]],
    ) -> None:
        number, size = self.objects(hits), len(self.hits)
        flux = np.bincount(number * BATCHES + batch, hits.weight, minlength=size * BATCHES)
        self.flux += flux.reshape(size, BATCHES)
        self.hits += np.bincount(number, minlength=size)
        gaps = self.in_gap.shape[1]
        self.in_gap += np.bincount(number * gaps + gap, minlength=size * gaps).reshape(size, gaps)
        if self._places.stop is not None:
            there = gap == self._places.stop.gap
            along = self._places.along(gap[there], hits.point[there])
            self._along[:, 0] += np.bincount(number[there], along, minlength=size)
            self._along[:, 1] += np.bincount(number[there], minlength=size)
        order = np.argsort(number.astype(np.min_scalar_type(size)), kind="stable")  # few numbers sort ten times as fast
        for part in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
            k = int(number[part[0]])
            if k in open_objects:
                found = {name: getattr(hits, name)[part] for name in NO_HITS if name != "batch"}
                fresh.setdefault(k, []).append(found | {"batch": batch[part]})

    def _leave(self, out: Escape, trail: np.ndarray, turned: np.ndarray, batch: np.ndarray) -> None:
        """
        Record rays that leave the scene, grouped by the sequence of surfaces that they have met.

        `trail` (see `Trails`), `turned` (see `WayOut`) and `batch` have an entry for each start ray.
        """
        cosine = np.clip(-(out.direction @ self._axis), -1, 1)
        angle = np.degrees(np.arccos(cosine))
        ways = 2 * trail[out.lane] + turned[out.lane]
        order = np.argsort(ways, kind="stable")
        for here in np.split(order, np.flatnonzero(np.diff(ways[order])) + 1):
            lanes = out.lane[here]
            number, reflected = divmod(int(ways[here[0]]), 2)
            way = self._ways.setdefault(
                (self._trails.surfaces(number), bool(reflected)),
                {"flux": np.zeros(BATCHES), "rays": np.zeros(1), "angles": np.array([180.0, 0.0])},
            )
            way["flux"] += np.bincount(batch[lanes], out.weight[here], minlength=BATCHES)
            way["rays"] += len(lanes)
            way["angles"][:] = min(way["angles"][0], angle[here].min()), max(way["angles"][1], angle[here].max())

    # ---- results

    def power(self, number: int) -> tuple[float, float]:
        """Return the flux on the object of index `number` and its standard error, as fractions of the started flux."""
        return self._share(self.flux[number])

    def area(self, number: int) -> tuple[float, float]:
        """Return flux and standard error, W, on the object of index `number`, for a beam from outside of 1 W/mm²."""
        value, se = self.power(number)
        scale = self.started / float(self.rays.sum())
        return value * scale, se * scale

    def samples(self, number: int) -> HitSamples:
        """Return the stored sample of hits of the object of index `number`; empty if it was not met."""
        kept = self._kept[number]
        joined = {
            name: np.concatenate([empty, *(part[name] for part in kept.parts)]) for name, empty in NO_HITS.items()
        }
        return HitSamples(**joined, rays=kept.rays)

    def ways_out(self) -> list[WayOut]:
        """Return the exits of rays by the surfaces met before, the strongest first; empty unless rays run backward."""
        found = []
        for (surfaces, turned), way in self._ways.items():
            share, se = self._share(way["flux"])
            low, high = (float(angle) for angle in way["angles"])
            found.append(WayOut(surfaces, turned, int(way["rays"][0]), share, se, (low, high)))
        return sorted(found, key=lambda way: -way.share)

    def _share(self, by_batch: np.ndarray) -> tuple[float, float]:
        return float(by_batch.sum()) / self.started, float(batch_error(by_batch, self.rays)) / self.started
