"""
Forward traces by other processes: parts of passes are sent, sums come back and are added.

A part is some batches of the start rays of a pass, with the random numbers that they have in any process. Its sums are
added once, so that the sums of all parts are those of one process but for the rounding of float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError, UnfinishedError
from mistray.execute.scene_task import SceneTask, kernel_arrays
from mistray.execute.sums import Sums
from mistray.execute.tracer import FIRST_CAPACITY, LAST_CAPACITY, PASS_LANES, Part, Run, RunSums, prepare
from mistray.execute.workers import Workers, do_parts
from mistray.light import Light
from mistray.recorders.ledger import FULL, Ledger
from mistray.recorders.tallies import STARTED
from mistray.settings import BATCHES, Settings
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

PARTS_PER_WORKER = 4  # so that a slow worker does not keep the others waiting for long
LEAST_RAYS = 1 << 14  # rays of a part: fewer take no longer than the overhead of a part
LOAD = 0.35  # load factor of a table of paths

Progress = Callable[[int, int], None]


class RunPart(NamedTuple):
    """Work unit for one worker: the index of a run, and a part of its start rays."""

    run: int
    part: Part


class MapPlace(NamedTuple):
    """
    Work unit for one worker: images of some paths from a part of a run.

    Attributes
    ----------
    run : int
        Index of the run.
    part : Part
        Part of the start rays of that run.
    detector : int
        Index of the detector's surface.
    keys, words : bytes
        Keys of the paths, uint64, and image word of each, uint32, see `mistray.recorders.film.image_word`.
    images : int
        Number of images.
    capacity : int
        Slots of the table of paths.
    """

    run: int
    part: Part
    detector: int
    keys: bytes
    words: bytes
    images: int
    capacity: int  # of the table of paths


@dataclass(frozen=True, eq=False)
class ImageSums(Sums):
    """Images of some paths of a run, (images, height, width), in units of a start ray's flux."""

    images: np.ndarray


class TracedRuns:
    """
    Runs of a trace, which every process builds alike from the same arguments, see `SceneTask`.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    settings : Settings
        Settings of the trace.
    light : Light
        Light of the trace and the detector that records it.
    ledger : bool
        Whether the paths are recorded in a ledger.
    runs_of : callable, optional
        Function that returns the runs of the settings and the light; by default `prepare` of the scene.
    """

    def __init__(
        self,
        scene: mi.Scene,
        settings: Settings,
        light: Light,
        ledger: bool,
        runs_of: Callable[[Settings, Light], list[Run]] | None = None,
    ) -> None:
        self.runs = prepare(scene, settings, light) if runs_of is None else runs_of(settings, light)
        self._arguments, self._ledger = (scene, settings, light, ledger), ledger
        self._tables: dict[tuple[int, int], SurfaceTable] = {}  # with one detector alone, by run and detector

    @property
    def task(self) -> SceneTask:
        """Task from which workers rebuild these runs, to trace parts of them."""
        scene, *arguments = self._arguments
        return SceneTask(TracedRuns, scene, tuple(arguments), self.kernel_arrays())

    def kernel_arrays(self) -> list[list[np.ndarray]]:
        """Return the arrays of geometry, coatings, media and scatter that the kernel reads, one list per wavelength."""
        return [kernel_arrays(run.table, run.scattering) for run in {id(run.table): run for run in self.runs}.values()]

    def do(self, part: RunPart | MapPlace) -> RunSums | ImageSums:
        """Trace a part of a run, and return its sums, or images of its paths for a `MapPlace`."""
        run = replace(self.runs[part.run], parts=(part.part,))
        if isinstance(part, MapPlace):
            key = part.run, part.detector
            if key not in self._tables:
                self._tables[key] = run.table.on(part.detector)
            return ImageSums(_images(replace(run, table=self._tables[key]), part))
        # Later parts start with the capacity that sufficed
        self.runs[part.run] = run = run.execute(self._ledger)
        return run.sums


def split(runs: Sequence[Run], workers: int) -> list[RunPart]:
    """Return the parts into which runs are divided for workers, several per worker, those of all runs alternating."""
    requested = max(LEAST_RAYS, sum(run.rays for run in runs) / (PARTS_PER_WORKER * workers))
    placed = []
    for number, run in enumerate(runs):
        found = []
        for k in range(run.passes):
            # Powers of two, so that all parts of a pass have the same number of batches
            rays = min(PASS_LANES, run.rays - k * PASS_LANES)
            pieces = 1 << int(math.log2(min(max(rays / requested, 1), BATCHES)))
            step = BATCHES // pieces
            found += [Part(k, low, low + step) for low in range(0, BATCHES, step)]
        # Sorted by their place in their own run, so that all runs end together
        placed += [((k + 0.5) / len(found), RunPart(number, part)) for k, part in enumerate(found)]
    return [place for _, place in sorted(placed)]


def filled(
    run: Run, keys: np.ndarray, events: np.ndarray, lengths: np.ndarray, least: int = FIRST_CAPACITY
) -> tuple[Ledger, np.ndarray]:
    """
    Return a ledger with the settings of a run that holds given paths with zero sums, and the slot of each, (p,).

    It has at least `least` slots, a power of 2. The paths have keys, (p,) uint64, event codes, (p, e) uint32, and
    lengths, (p,), their numbers of events.

    Raises
    ------
    MistrayError
        If there are more paths than the largest ledger holds.
    """
    settings = run.settings
    capacity = min(max(least, 1 << math.ceil(math.log2(max(len(keys), 1) / LOAD))), LAST_CAPACITY)
    if len(keys) > FULL * capacity:
        raise MistrayError(
            f"{len(keys)} paths reach the detector; raise flux_threshold ({settings.flux_threshold:g}), lower "
            f"max_reflections ({settings.max_reflections}) or set ledger=False"
        )
    ledger = Ledger(capacity, settings.max_events, settings.stokes)
    if not len(keys):
        return ledger, np.zeros(0, dtype=np.int64)
    # Claim the slots on the device, then write the event lists on the host
    slot, _, _ = ledger.find(upload(mi.UInt64, keys), mi.Bool(True))
    dr.eval(slot, ledger.keys)
    slots = np.array(slot).astype(np.int64)
    whole = np.zeros((capacity, settings.max_events), dtype=np.uint32)
    whole[slots, : events.shape[1]] = events
    all_lengths = np.zeros(capacity, dtype=np.uint32)
    all_lengths[slots] = lengths
    ledger.events, ledger.lengths = upload(mi.UInt32, whole), upload(mi.UInt32, all_lengths)
    return ledger, slots


def _with_sums(run: Run, parts: Sequence[Part], sums: RunSums | None, whole: bool) -> Run:
    """
    Return a run with the sums of its traced parts.

    Unless the parts are the `whole` run, the flux of a start ray is raised so that they stand for it. Without sums the
    run has no parts.
    """
    if sums is None:
        return replace(run, parts=())
    ledger = None
    if sums.paths is not None:
        # Ledger on the device, with the paths in the order of its slots as `Ledger.decode` returns them
        ledger, slots = filled(run, sums.paths.keys, sums.paths.events, sums.paths.lengths)
        sums = replace(sums, paths=replace(sums.paths, slots=slots).take(np.argsort(slots)))
    run = replace(run, executed=sums, ledger=ledger)
    return run if whole else run.stand_for(sorted(parts))


def execute_by_parts(
    workers: Workers, task: SceneTask, runs: Sequence[Run], progress: Progress | None = None
) -> list[Run]:
    """
    Let workers trace some runs, and return the runs with the sums that `Run.execute` would find.

    ``seconds`` of a run is the time of its parts in all workers together, s. `progress` is called with the numbers of
    rays done and of all rays.

    Raises
    ------
    UnfinishedError
        If no worker is left; ``partial`` has the runs with the sums of their traced parts, which are in ``parts``.
    """
    parts: list[list[Part]] = [[] for _ in runs]
    sums: list[RunSums | None] = [None for _ in runs]
    places = split(runs, workers.count())
    rays, done = sum(run.rays for run in runs), 0
    try:
        with do_parts(workers, task, places) as results:
            for place, found in results:
                before = sums[place.run]
                sums[place.run] = found if before is None else before + found
                parts[place.run].append(place.part)
                done += round(float(found.channels[STARTED].sum()))
                if progress:
                    progress(done, rays)
    except UnfinishedError as error:
        whole = [sum(place.run == number for place in places) == len(own) for number, own in enumerate(parts)]
        error.partial = list(map(_with_sums, runs, parts, sums, whole))
        raise
    return [_with_sums(run, own, found, whole=True) for run, own, found in zip(runs, parts, sums, strict=True)]


def images_by_parts(
    workers: Workers,
    task: SceneTask,
    runs: Sequence[Run],
    paths: Sequence[tuple[np.ndarray, np.ndarray]],
    count: int,
) -> list[np.ndarray]:
    """
    Let workers trace some paths again, and return their images, (count, height, width) for each run.

    Images are in units of a start ray's flux.

    Parameters
    ----------
    workers : Workers
        Processes that do the work.
    task : SceneTask
        Task from which workers build the runs.
    runs : sequence of Run
        Runs of the trace.
    paths : sequence of tuple
        For each run the keys of paths, (p,) uint64, and for each path the word that says to which images it adds,
        (p,) uint32, see `mistray.recorders.film.image_word`; runs without paths are not traced.
    count : int
        Number of images.
    """
    totals = [np.zeros((count, *run.film.shape[1:])) for run in runs]
    parts = [RunPart(k, part) for k, run in enumerate(runs) for part in run.parts or map(Part, range(run.passes))]
    if all(run.parts is None for run in runs):
        parts = split(runs, workers.count())
    places = []
    for number, part in parts:
        (keys, words), run = paths[number], runs[number]
        if len(keys):
            assert run.ledger is not None
            given = keys.tobytes(), words.tobytes(), count, run.ledger.capacity
            places.append(MapPlace(number, part, run.table.detector, *given))
    with do_parts(workers, task, places) as results:
        for place, found in results:
            totals[place.run] += found.images
    return totals


def _images(run: Run, place: MapPlace) -> np.ndarray:
    """Return images of some paths from one part, (images, height, width), in units of a start ray's flux."""
    # Slots differ from process to process, so that paths are sent by their keys
    keys = np.frombuffer(place.keys, dtype=np.uint64)
    empty = np.zeros((len(keys), 0), dtype=np.uint32)
    ledger, slots = filled(run, keys, empty, np.zeros(len(keys)), place.capacity)
    words = np.frombuffer(place.words, dtype=np.uint32)
    return replace(run, ledger=ledger).images(slots, words, place.images)
