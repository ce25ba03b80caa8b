"""Forward traces: one run for each source and wavelength, passes of bounded size, ledgers that grow when full."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.events import EVENT_BITS
from mistray.execute.launching import launches_and_kernel, trace_whole
from mistray.execute.sums import Sums
from mistray.interrupts import requested
from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.launches import Spread
from mistray.kernel.scattering import Scattering
from mistray.light import AS_THE_SCENE, Light
from mistray.recorders.adjoint import CHANNELS, Adjoint
from mistray.recorders.branch_recorder import BranchRecorder, PathChoice
from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.film import Box, Film, Images, Pixels, groups_of, spreads
from mistray.recorders.ledger import FULL, DecodedPaths, Ledger
from mistray.recorders.path_derivative import MOMENTS, PathDerivative
from mistray.recorders.recorder import Recorder, Recorders
from mistray.recorders.sampler import tree_seeds
from mistray.recorders.start_rays import StartRays, generators
from mistray.recorders.tallies import STARTED, Tallies
from mistray.sampling.design.search import design_sequences, traced_tables
from mistray.sampling.design_path import first_aperture, footprint, medium_around
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.source import SceneSource
from mistray.sampling.sources import scene_sources
from mistray.settings import BATCHES, Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import download, upload
from mistray.time_budget import time_is_up

PASS_LANES = 1 << 20  # start rays of a pass, by which its memory is bounded
FIRST_CAPACITY, FIRST_CAPACITY_OF_SCATTER = 1 << 12, 1 << 15  # slots: there are more paths where surfaces scatter
RECORD_CAPACITY = 1 << 12  # branches that a recorder holds at least
LAST_CAPACITY = 1 << 20  # slots of the largest ledger
MOST_PATHS_KEPT = 10_000  # at an interrupt: decoding more paths takes longer than a second


class Part(NamedTuple):
    """
    Start rays of one pass whose batches are low ≤ batch < high; each batch is a sample of the whole beam.

    `number` is the index of the pass. A part that was not finished has the first `rays` of its start rays only, in the
    order of `mistray.kernel.launches.Spread`; None: it has all of them.
    """

    number: int
    low: int = 0
    high: int = BATCHES
    rays: int | None = None


@dataclass(frozen=True, eq=False)
class RunSums(Sums):
    """
    Sums over start rays of a run, by surface, medium, loss channel, pixel and path, in units of a start ray's flux.

    Attributes
    ----------
    surfaces : (s + m, SURFACE_SUMS, BATCHES) float64
        Number of hits, incident and absorbed flux of every surface; number of rays that it scatters towards targets,
        and of those that reach the detector undeflected. Rows of media follow; they have the last two only.
    media : (m, BATCHES) float64
        Flux that each medium absorbs.
    channels : (CHANNEL_COUNT, BATCHES) float64
        Sums of the energy ledger, see `mistray.recorders.tallies`.
    largest : float
        Largest flux of a scattered ray at the detector, in units of a start ray's flux.
    films : tuple of (images, height, width) float64
        Detected flux on each detector; see `mistray.recorders.film.Film`.
    paths : DecodedPaths or None
        Paths that reach the detectors, with their sums; None if no ledger was kept.
    seconds : float
        Time in the kernel, compilation included, s; of workers all together.
    """

    surfaces: np.ndarray
    media: np.ndarray
    channels: np.ndarray
    largest: float
    films: tuple[np.ndarray, ...]
    paths: DecodedPaths | None
    seconds: float


@dataclass(frozen=True, eq=False)
class Preparation:
    """Arguments of `prepare`, from which another process prepares the same runs."""

    scene: mi.Scene
    settings: Settings
    light: Light

    @cached_property
    def runs(self) -> list[Run]:
        """Runs that `prepare` makes of these arguments, at first use."""
        return prepare(self.scene, self.settings, self.light)

    def __reduce__(self) -> Any:
        return Preparation, (self.scene, self.settings, self.light)


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """
    One source at one wavelength: the kernel's input and, after execution, the sums of its trace.

    Attributes
    ----------
    source : SceneSource
        Source that is traced.
    table : SurfaceTable
        Surfaces of the scene at the wavelength.
    rays : int
        Number of start rays.
    unit : float
        Flux of a start ray, W.
    design : DesignSequences
        Event sequences of the direct image.
    prepared : Preparation
        Arguments from which this run and the other runs of its trace were prepared.
    number : int
        Index of the run among the runs of its trace.
    parts : tuple of Part or None
        Parts that are traced; None: all passes.
    ledger : Ledger or None
        Table of the paths that reach the detectors, on the device; None if none was kept.
    scattering : Scattering
        Scatter of the surfaces and media at the wavelength.
    intersector : Intersector
        Search for the hits of rays on the surfaces.
    settings : Settings
        Settings of the trace.
    seed : int
        Seed of the random numbers of this run.
    executed : RunSums or None
        Sums of the trace; None: the run has not been executed.
    """

    source: SceneSource
    table: SurfaceTable
    scattering: Scattering
    intersector: Intersector
    settings: Settings
    rays: int
    seed: int
    unit: float
    prepared: Preparation
    number: int
    design: DesignSequences = field(default_factory=DesignSequences)
    parts: tuple[Part, ...] | None = None
    ledger: Ledger | None = None
    executed: RunSums | None = None

    @property
    def sums(self) -> RunSums:
        """Sums over the traced start rays, in units of a start ray's flux; the run must have been executed."""
        assert self.executed is not None
        return self.executed

    @property
    def paths(self) -> DecodedPaths:
        """Paths of the run with their sums; it must have been executed with a ledger."""
        assert self.sums.paths is not None
        return self.sums.paths

    def make_film(self, detector: int | None = None) -> Film:
        """Return the kernel's pixel grid for the image of a detector (surface index); by default the only detector."""
        detector = self.table.detector if detector is None else detector
        width, height, extent = self.table.film(detector)
        tent = spreads(self.table.shapes[detector].sensor().film())
        return Film.of(width, height, extent, groups_of(width * height), tent)

    @property
    def light(self) -> Pixels:
        """Image of the only detector with its noise, (height, width), in units of a start ray's flux."""
        return Pixels.of_film(self.film, self.started)

    @property
    def film(self) -> np.ndarray:
        """Flux in each pixel of the only detector, (images, height, width), in units of a start ray's flux."""
        return self.sums.films[self.table.detectors.index(self.table.detector)]

    def on(self, detector: int, table: SurfaceTable) -> Run:
        """Return the run reduced to the results on one of its detectors; `table` must have this detector only."""
        # Paths end with the event of their detector
        paths = self.sums.paths
        if paths is not None:
            last = paths.events[np.arange(len(paths.keys)), paths.lengths - 1] >> EVENT_BITS
            paths = paths.take(last == detector)
        films = (self.sums.films[self.table.detectors.index(detector)],)
        return replace(self, table=table, executed=replace(self.sums, films=films, paths=paths))

    @property
    def passes(self) -> int:
        """Number of passes, of at most `PASS_LANES` rays each, needed for all start rays."""
        return -(-self.rays // PASS_LANES)

    @property
    def is_sample(self) -> bool:
        """True if the traced parts sample the whole beam; single passes of a grid of rays do not."""
        whole_rows = self.source.pattern != "grid" or self.passes == 1
        return self.parts is None or (bool(self.parts) and whole_rows)

    def start_pass(self, number: int) -> StartRays:
        """Return the start rays of one pass, with origins, directions, throughputs, batches and random numbers."""
        # Lanes and batches
        done = number * PASS_LANES
        lanes = min(PASS_LANES, self.rays - done)
        index = dr.arange(mi.UInt32, lanes)
        lane = index + dr.opaque(mi.UInt32, done)
        rng, scrambled = generators(self.seed, lane)
        # Batches of a grid are random, because blocks of its rows would be no samples of it
        blocks = mi.UInt32(mi.Float64(index) * dr.opaque(mi.Float64, BATCHES / lanes))
        batch = scrambled % BATCHES if self.source.pattern == "grid" else blocks
        # Rays of the source
        o, d, w, stokes = self.source.start(lane, batch, self.rays, rng, self.table.centre)
        seed = tree_seeds(self.seed, batch)
        dr.eval(lane, batch, o, d, w, stokes, seed)
        # A weight of 1 stays a literal, so that all such sources share one kernel
        start = StartRays(lane, batch, seed, o, d, dr.full(mi.Float, 1, lanes) if w is None else w, scale=w)
        if self.settings.stokes and self.source.polarized:
            start.stokes = self.source.stokes_along(d) if stokes is None else stokes
            dr.eval(start.stokes)
        if self.source.shape:
            # In memory: as a constant it would make a kernel for each shape
            start.left = dr.opaque(mi.UInt32, self.table.ids.index(self.source.shape), lanes)
            start.normal = mi.Vector3f(d)  # for Mitsuba's own shapes: the side that the rays leave to
        if self.source.medium:
            start.medium = dr.full(mi.UInt32, self.source.medium, lanes)
        return start

    def starts(self) -> Iterator[tuple[Part, StartRays]]:
        """Yield each part to be traced together with its start rays."""
        for part in self.parts if self.parts is not None else map(Part, range(self.passes)):
            start = self.start_pass(part.number)
            if (part.low, part.high) != (0, BATCHES):
                batch = np.array(start.batch)
                start = start.take(upload(mi.UInt32, np.flatnonzero((batch >= part.low) & (batch < part.high))))
            if part.rays is not None:
                first = Spread(dr.width(start.lane), self._order(part)).first(part.rays)
                start = start.take(upload(mi.UInt32, first))
            yield part, start

    def _order(self, part: Part) -> int:
        """Return the random seed for the order in which the rays of a part are traced."""
        return (self.seed << 32) | part.number

    def start_rays(self, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return origins (mm) and unit directions, (n, 3) float64 each, of start rays, given their indices, (n,)."""
        return self.weighted_start_rays(lanes)[:2]

    def weighted_start_rays(self, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return origins and directions of start rays, see `start_rays`, and their throughputs, (n,) float64."""
        origins, directions, weights = np.zeros((len(lanes), 3)), np.zeros((len(lanes), 3)), np.zeros(len(lanes))
        for number in np.unique(lanes // PASS_LANES):
            here = lanes // PASS_LANES == number
            start = self.start_pass(int(number)).take(upload(mi.UInt32, lanes[here] - number * PASS_LANES))
            origins[here], directions[here] = self.exact(start)
            weights[here] = start.weights
        return origins, directions, weights

    def exact(self, start: StartRays) -> tuple[np.ndarray, np.ndarray]:
        """Return origins (mm) and directions of start rays in the world, free of float32 rounding, (n, 3) float64."""
        return self.source.exact(self.table.download_points(start.o), download(start.d))

    @property
    def scene(self) -> KernelScene:
        """Kernel's scene at this wavelength: surfaces, their scatter, and ray intersection."""
        return KernelScene(self.table, self.scattering, self.intersector)

    def launches(self, *recorders: Recorder | None) -> Iterator[tuple[int, list[Part], float]]:
        """
        Trace the ray trees of all parts.

        Yield, after each launch, the rays and the parts so far, and the launch's duration, s.
        """
        launches, trace = launches_and_kernel(self.scene, self.settings, recorders)
        before = 0
        finished: list[Part] = []
        for part, start in self.starts():
            count = dr.width(start.lane)
            for done in launches.run(start, trace, self._order(part)):
                parts = [*finished, part if done == count else part._replace(rays=done)]
                yield before + done, parts, launches.on_device
            before += count
            finished.append(part)

    def trace_again(self, *recorders: Recorder | None) -> None:
        """Trace the ray trees of all parts again into recorders, regardless of the time budget."""
        for _, start in self.starts():
            self.trace_trees(start, *recorders)

    def trace_trees(self, start: StartRays, *recorders: Recorder | None) -> None:
        """Trace the ray trees of given start rays into recorders, regardless of the time budget."""
        trace_whole(self.scene, start, self.settings, recorders)

    def execute(
        self,
        ledger: bool,
        progress: Callable[[int, Tallies], None] | None = None,
        recorders: Sequence[Recorder] = (),
    ) -> Run:
        """
        Trace all start rays and return the run with its sums; if a ledger is full, start again with a larger one.

        The trace ends after a launch if an interrupt was requested or the time is up. Then `parts` holds the parts that
        were traced. Other recorders come after the ledger. At an interrupt a table of more than `MOST_PATHS_KEPT` paths
        is not read. `progress` is called with the number of rays so far and their sums.

        Raises
        ------
        MistrayError
            If more paths reach the detector than the largest ledger holds.
        """
        # Capacity of the ledger
        films = [self.make_film(detector) for detector in self.table.detectors]
        several = len(films) > 1
        capacity = FIRST_CAPACITY_OF_SCATTER if self.scattering.any and self.settings.max_scatters else FIRST_CAPACITY
        if self.ledger is not None:  # executed before: start with the capacity that sufficed
            capacity = self.ledger.capacity
        # Trace, with eight times the capacity whenever the ledger is full
        while True:
            tallies = Tallies(self.table)
            images = [
                Images(film, only=detector if several else None)
                for film, detector in zip(films, self.table.detectors, strict=True)
            ]
            table = Ledger(capacity, self.settings.max_events, self.settings.stokes) if ledger else None
            others = Recorders(recorders)
            others.attach(self.scene)
            found, seconds = None, 0.0  # parts that were traced, if not all were
            for done, traced, on_device in self.launches(tallies, table, others, *images):
                seconds += on_device
                if progress:
                    progress(done, tallies)
                if (table is not None and table.full) or time_is_up() or requested():
                    found = traced
                    break
            if requested() or table is None or not table.full:
                break
            if capacity >= LAST_CAPACITY:
                raise MistrayError(
                    f"more than {FULL * capacity:.0f} paths reach the detector; raise flux_threshold "
                    f"({self.settings.flux_threshold:g}), lower max_reflections ({self.settings.max_reflections}) or "
                    f"max_scatters ({self.settings.max_scatters}), or set ledger=False"
                )
            capacity = min(8 * capacity, LAST_CAPACITY)
        # Read the sums back
        readable = table is not None and (not requested() or table.used <= MOST_PATHS_KEPT)
        sums = RunSums(
            **tallies.read(),
            largest=float(np.array(tallies.largest).view(np.float32)[0]),
            films=tuple(
                image.sums.numpy().reshape(film.images, film.height, film.width)
                for film, image in zip(films, images, strict=True)
            ),
            paths=table.decode() if table is not None and readable else None,
            seconds=seconds,
        )
        run = replace(self, ledger=table, executed=sums)
        run = run if found is None else run.stand_for(found)
        others.collect(run.unit)
        return run

    def stand_for(self, parts: Sequence[Part]) -> Run:
        """Return the run as if given parts were all of it: the flux of a start ray, W, is raised to keep the total."""
        return replace(self, parts=tuple(parts), unit=self.source.power / max(float(self.started.sum()), 1.0))

    @property
    def started(self) -> np.ndarray:
        """Number of start rays in each batch, (BATCHES,)."""
        return np.asarray(self.sums.channels[STARTED])

    def images(self, slots: np.ndarray, images: np.ndarray, count: int) -> np.ndarray:
        """
        Return images of some paths on the detector, by tracing the same rays again.

        Parameters
        ----------
        slots : (p,) int
            Ledger slots of the paths; without any, nothing is traced.
        images : (p,) uint32
            Word of the image that the light of each enters, see `mistray.recorders.film.image_word`.
        count : int
            Number of images.

        Returns
        -------
        (count, height, width) float64
            Flux in each pixel, in units of a start ray's flux.
        """
        assert self.ledger is not None
        film = self.make_film()
        words = np.zeros(self.ledger.capacity, dtype=np.uint32)
        words[slots] = images
        film.image_of_slot = upload(mi.UInt32, words)
        found = Images(film, count)
        if len(slots):
            # The ledger holds every path already, and finds the slot of each hit
            self.trace_again(self.ledger, found)
        return np.asarray(found.sums.numpy()).reshape(count, film.height, film.width)

    @property
    def pixel_area(self) -> float:
        """Area of a pixel of the detector, mm²."""
        width, height, (x0, x1, y0, y1) = self.table.film()
        return (x1 - x0) * (y1 - y0) / (width * height)

    def adjoint(self, pixel: np.ndarray | None, paths: PathDerivative | None, rows: int) -> Adjoint:
        """
        Return an adjoint recorder, from the derivatives of a metric with respect to the flux in pixels and on paths.

        Parameters
        ----------
        pixel : (maps, height, width) or None
            Derivative of the metric with respect to the flux in each pixel, in units of a start ray's flux; None: the
            metric does not depend on the pixels.
        paths : PathDerivative or None
            Derivative of the metric with respect to the flux of hits on each path, which needs the ledger; None: the
            metric does not depend on the paths.
        rows : int
            See `Adjoint`.
        """
        # Tables by ledger slot; number 0 is no path
        by_path = number = None
        if paths is not None:
            assert self.ledger is not None
            coefficients = np.zeros((self.ledger.capacity, MOMENTS))
            coefficients[paths.slots] = paths.coefficients
            numbers = np.zeros(self.ledger.capacity, dtype=np.uint32)
            numbers[paths.slots] = paths.maps + 1
            by_path, number = upload(mi.Float64, coefficients), upload(mi.UInt32, numbers)
        image = None if pixel is None else upload(mi.Float, pixel)
        ledger = self.ledger if paths is not None else None
        return Adjoint(rows, self.make_film(), image, by_path, number, ledger)

    def derivatives(self, pixel: np.ndarray | None, paths: PathDerivative | None) -> np.ndarray:
        """
        Trace the same rays again; return the derivatives of a metric with respect to the rows of the tables of R and T.

        Parameters
        ----------
        pixel, paths
            See `adjoint`.

        Returns
        -------
        (BATCHES, rows, CHANNELS) float64
            Derivatives by batch of start rays; see `mistray.recorders.adjoint`.
        """
        adjoint = self.adjoint(pixel, paths, self.table.optics.rows)
        self.trace_again(adjoint)
        return np.array(adjoint.sums).reshape(BATCHES, -1, CHANNELS)

    def within(self, box: Sequence[float]) -> Run:
        """
        Trace the same rays again; return the run with the flux of its paths in a rectangle of the detector only.

        `box` is x0, x1, y0, y1 in the frame of the detector, mm. The run must have been executed with a ledger.
        """
        assert self.ledger is not None
        self.ledger.clear_sums()
        self.trace_again(Box(box), self.ledger)
        return replace(self, executed=replace(self.sums, paths=self.ledger.decode()))

    def recorder(self, capacity: int, slots: np.ndarray | None = None) -> BranchRecorder:
        """Return an empty recorder for up to `capacity` branches, on paths in these ledger slots; None: any path."""
        choice = None
        if slots is not None:
            assert self.ledger is not None
            chosen = np.zeros(self.ledger.capacity, dtype=np.uint32)
            chosen[slots] = 1
            choice = PathChoice(self.ledger, upload(mi.UInt32, chosen))
        return BranchRecorder(capacity, self.settings.max_events, choice=choice)

    def peak_W(self) -> float:
        """Return the incident flux of the strongest single ray at the detector, W, by tracing the same rays again."""
        recorder = self.recorder(RECORD_CAPACITY, np.zeros(0, dtype=np.int64))
        self.trace_again(recorder)
        return self.unit * float(np.array(recorder.peak).view(np.float32)[0])

    def record(self, slots: np.ndarray | None, count: int) -> BranchRecorder:
        """
        Return a recorder of branches that end in the detector, of paths in these slots of the ledger; None: any path.

        Start rays are traced until there are at least `count` branches or no more rays. One batch is first, which is a
        sample of the whole beam; then the others of the first pass follow, then the other passes.
        """
        recorder = self.recorder(max(count, RECORD_CAPACITY), slots)
        for part, start in self.starts():
            host_batch = np.array(start.batch) - part.low
            groups = [
                np.flatnonzero((host_batch >= low) & (host_batch < high))
                for low, high in (((0, 1), (1, 4), (4, BATCHES)) if part.number == 0 else ((0, BATCHES),))
            ]
            # The recorder keeps the first branches, so that rays spread over a large batch precede its others
            spread = slice(None, None, -(-len(groups[0]) // RECORD_CAPACITY) or 1)
            for lanes in (groups[0][spread], np.delete(groups[0], spread), *groups[1:]):
                if len(lanes):
                    self.trace_trees(start.take(upload(mi.UInt32, lanes)), recorder)
                if int(recorder.count[0]) >= count:
                    return recorder
        return recorder


def _ray_shares(sources: Sequence[SceneSource]) -> list[float]:
    """
    Return the fraction of rays for each source.

    Half of the rays are divided by flux, half equally among source names.
    """
    # The flux of a source says little about its stray light: none of them may be left with too few rays
    total = sum(source.power for source in sources)
    own: dict[str, float] = {}
    for source in sources:
        own[source.name] = own.get(source.name, 0.0) + source.power
    return [0.5 * source.power * (1 / total + 1 / (len(own) * own[source.name])) for source in sources]


def prepare(scene: mi.Scene, settings: Settings, light: Light = AS_THE_SCENE) -> list[Run]:
    """
    Return one `Run` for each source and wavelength; half of the rays are divided by flux, half equally by name.

    Raises
    ------
    MistrayError
        If the scene has no source or no detector, a source is polarised and the settings ignore polarisation, or a
        source stands in a metal.
    """
    sources = scene_sources(scene, light.field_deg, light.azimuth_deg, light.wavelength_nm, light.weights)
    if not settings.stokes and (polarized := [source.name for source in sources if source.polarized]):
        raise MistrayError(
            f"source '{polarized[0]}' is polarised, and polarization is '{settings.polarization}', which would forget "
            "it; leave polarization out, or give 'stokes'"
        )
    # Surfaces, and the importance targets of their scattered rays
    aims, shares = any(source.aims for source in sources), _ray_shares(sources)
    wavelengths = list(dict.fromkeys(source.wavelength_nm for source in sources))
    tables = dict(zip(wavelengths, traced_tables(scene, wavelengths, light.detector, settings.stokes), strict=True))
    first = tables[wavelengths[0]]
    targets = importance_targets(first, scene, settings)
    # Aim the sources at the first aperture
    if settings.aim == "none":
        sources = [source.unaimed() for source in sources]
    elif aims and (aperture := first_aperture(first, scene)):
        # All wavelengths of a source light the same part of it
        lit = {source.name: footprint(first, source, aperture) for source in sources if source.aims}
        sources = [source.aimed_at(aperture, lit.get(source.name)) for source in sources]
    if aims or any(table.optics.absorbs for table in tables.values()):
        sources = [replace(one, medium=medium_around(tables[one.wavelength_nm], one)) for one in sources]
    scattering = {nm: Scattering.of(table, targets) for nm, table in tables.items()}
    design = design_sequences(scene, *tables.values())
    # Runs, with a stream of random numbers each
    runs, prepared = [], Preparation(scene, settings, light)
    for number, source in enumerate(sources):
        count = source.count(max(1, round(settings.rays * shares[number])))
        unit = source.power / count
        runs.append(
            Run(
                source=source,
                table=tables[source.wavelength_nm],
                scattering=scattering[source.wavelength_nm],
                intersector=Intersector.of(first),
                settings=settings.with_unit(unit),
                rays=count,
                seed=(settings.seed + 0x9E3779B9 * number) % 2**32,
                unit=unit,
                prepared=prepared,
                number=number,
                design=design,
            )
        )
    return runs
