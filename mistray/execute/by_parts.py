"""
Forward traces by other processes: parts of passes are sent, sums come back and are merged.

A part is some batches of the start rays of a pass, with the random numbers that they have in any process. Its sums are
added once, so that the merged sums are those of one process but for the rounding of float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError, UnfinishedError
from mistray.execute.fingerprint import agree, kernel_arrays
from mistray.execute.sparse import Packed, pack
from mistray.execute.tracer import FIRST_CAPACITY, LAST_CAPACITY, PASS_LANES, Part, Run, prepare
from mistray.execute.workers import Workers, do_parts
from mistray.light import Light
from mistray.recorders.ledger import STOKES_SUMS, SUMS, DecodedPaths, Ledger
from mistray.recorders.tallies import CHANNEL_COUNT, STARTED, SURFACE_SUMS
from mistray.settings import BATCHES, Settings
from mistray.surfaces.upload import upload

PARTS_PER_WORKER = 4  # so that a slow worker does not keep the others waiting for long
LEAST_RAYS = 1 << 14  # rays of a part: fewer take no longer than the overhead of a part
LOAD = 0.35  # load factor of a table of paths

Progress = Callable[[int, int], None]


class RunPart(NamedTuple):
    """A part of one of the runs of a trace."""

    run: int
    part: Part


@dataclass(frozen=True)
class PartSums:
    """
    Sums of a part; `surfaces`, `media`, `channels` and the sums of `paths` have its own batches only.

    See `Run` for their meaning.
    """

    surfaces: np.ndarray
    media: np.ndarray
    channels: np.ndarray
    largest: float
    films: tuple[Packed, ...]
    paths: DecodedPaths | None
    seconds: float

    @classmethod
    def of(cls, run: Run, part: Part) -> PartSums:
        """Return the sums of a run that has traced this part alone."""
        # Other batches are zero and are not sent
        own = slice(part.low, part.high)
        paths = run.paths
        if paths is not None:
            paths = DecodedPaths(paths.keys, paths.slots, paths.events, paths.lengths, paths.sums[:, own])
        return cls(
            run.surfaces[..., own], run.media[:, own], run.channels[:, own], run.largest,
            tuple(map(pack, run.films)), paths,
            run.seconds,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class TraceTask:
    """
    The runs of a trace, for `mistray.execute.workers`.

    Attributes
    ----------
    scene : mi.Scene
    settings : Settings
    light : Light
    ledger : bool
        Whether paths are kept.
    arrays : sequence of list of array
        Arrays that the kernel reads here, for each wavelength: workers check that they have the same.
    only : int or None
        Number of the detector that results are for, of several whose light was traced.
    """

    scene: mi.Scene
    settings: Settings
    light: Light
    ledger: bool
    arrays: Sequence[list[np.ndarray]]
    only: int | None = None

    def make(self) -> list[Run]:
        """Return the runs, which are the same in all processes."""
        runs = prepare(self.scene, self.settings, self.light)
        require_same(self.arrays, tables_of(runs))
        if self.only is not None:
            for run in runs:
                run.table = run.table.on(self.only)
        return runs

    def do(self, made: list[Run], part: RunPart | MapPlace) -> PartSums | Packed:
        """Trace a part, and return its sums or its images."""
        run = made[part.run]
        run.parts = (part.part,)
        if isinstance(part, MapPlace):
            return pack(_images(run, part))
        run.execute(self.ledger, None)
        return PartSums.of(run, part.part)


@dataclass(frozen=True, eq=False)
class SceneTask:
    """
    An object that a worker builds again from a scene; the class of the task selects its class and its use.

    Attributes
    ----------
    scene : mi.Scene
    arguments : tuple
        Other arguments of its class.
    arrays : sequence of list of array
        Arrays that the kernel reads here, for each wavelength.
    """

    scene: mi.Scene
    arguments: tuple[Any, ...]
    arrays: Sequence[list[np.ndarray]]

    def build(self, kind: Callable[..., Any]) -> Any:
        """Return an object of the class at a worker; raise an error if its kernel would read other arrays."""
        made = kind(self.scene, *self.arguments)
        require_same(self.arrays, made.kernel_arrays())
        return made


def tables_of(runs: Sequence[Run]) -> list[list[np.ndarray]]:
    """Return the arrays that the kernel reads, for each wavelength of some runs."""
    return [kernel_arrays(run.table, run.scattering) for run in {id(run.table): run for run in runs}.values()]


def require_same(here: Sequence[list[np.ndarray]], there: Sequence[list[np.ndarray]]) -> None:
    """Raise an error if the scene at a worker differs from the one here."""
    if len(here) != len(there) or not all(agree(a, b) for a, b in zip(here, there, strict=True)):
        raise MistrayError(
            "the scene is another one at the worker than here: it, or a file that it names, has changed since it was "
            "loaded or traced; load it again"
        )


def split(runs: Sequence[Run], workers: int) -> list[RunPart]:
    """Return parts of runs, enough to keep workers busy to the end; parts of different runs alternate."""
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


@dataclass
class _Merged:
    """Sums of the parts of a run so far."""

    run: Run
    parts: list[Part] = field(default_factory=list)
    sums: np.ndarray = field(default_factory=lambda: np.zeros(0))
    places: dict[int, int] = field(default_factory=dict)  # row of each key
    events: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        run = self.run
        self.films = tuple(np.zeros((film.images, film.height, film.width)) for film in run.make_films())
        self.surfaces = np.zeros((run.table.count + len(run.table.optics.media), SURFACE_SUMS, BATCHES))
        self.media = np.zeros((len(run.table.optics.media), BATCHES))
        self.channels = np.zeros((CHANNEL_COUNT, BATCHES))
        self.largest = self.seconds = 0.0
        self.sums = np.zeros((0, BATCHES, STOKES_SUMS if run.settings.stokes else SUMS))

    def add(self, part: Part, found: PartSums) -> int:
        """Add the sums of a part; return the number of its start rays."""
        own = slice(part.low, part.high)
        self.parts.append(part)
        self.surfaces[..., own] += found.surfaces
        self.media[:, own] += found.media
        self.channels[:, own] += found.channels
        self.largest, self.seconds = max(self.largest, found.largest), self.seconds + found.seconds
        for one, total in zip(found.films, self.films, strict=True):
            one.add_to(total)
        # Paths: new keys get the next rows, in the order in which they come
        if found.paths is not None:
            before = len(self.places)
            rows = [self.places.setdefault(key, len(self.places)) for key in found.paths.keys.tolist()]
            place = np.array(rows, dtype=np.int64)
            self.events += [
                found.paths.events[k, : found.paths.lengths[k]] for k in np.flatnonzero(place >= before).tolist()
            ]
            if len(self.places) > len(self.sums):
                room = max(len(self.places), 2 * len(self.sums)) - len(self.sums)
                self.sums = np.concatenate([self.sums, np.zeros((room, *self.sums.shape[1:]))])
            self.sums[place, own] += found.paths.sums
        return round(float(found.channels[STARTED].sum()))

    def finish(self, ledger: bool, whole: bool) -> None:
        """Assign the sums to the run; an incomplete run is scaled from the rays of its parts."""
        run = self.run
        run.surfaces, run.media, run.channels, run.films = self.surfaces, self.media, self.channels, self.films
        run.largest, run.seconds = self.largest, self.seconds
        if not whole:
            run.stand_for(sorted(self.parts))
        # Ledger on the device, with the paths in the order of its slots as `Ledger.decode` returns them
        if ledger:
            keys = np.array(list(self.places), dtype=np.uint64)
            lengths = np.array([len(events) for events in self.events], dtype=np.int64)
            events = np.zeros((len(keys), int(lengths.max(initial=0))), dtype=np.uint32)
            for row, path in zip(events, self.events, strict=True):
                row[: len(path)] = path
            run.ledger, slots = _filled(run, keys, events, lengths)
            order = np.argsort(slots)
            sums = self.sums[: len(keys)]
            run.paths = DecodedPaths(keys[order], slots[order], events[order], lengths[order], sums[order])


def _filled(
    run: Run, keys: np.ndarray, events: np.ndarray, lengths: np.ndarray, least: int = FIRST_CAPACITY
) -> tuple[Ledger, np.ndarray]:
    """Return a ledger of at least `least` slots that holds some paths, and their slots in it."""
    settings = run.settings
    capacity = max(least, 1 << math.ceil(math.log2(max(len(keys), 1) / LOAD)))
    if capacity > LAST_CAPACITY:
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


def execute_by_parts(workers: Workers, task: TraceTask, runs: Sequence[Run], progress: Progress | None = None) -> None:
    """
    Let workers trace some runs, which receive the sums of `Run.execute`.

    ``seconds`` of a run is the total of its parts over all workers.

    Raises
    ------
    UnfinishedError
        If no worker is left. Partly traced runs have the sums of their traced parts, and list these in ``parts``.
    """
    merged = [_Merged(run) for run in runs]
    places = split(runs, workers.count())
    expected = [sum(place.run == number for place in places) for number in range(len(runs))]
    rays, done = sum(run.rays for run in runs), 0
    lost: UnfinishedError | None = None
    try:
        with do_parts(workers, task, places) as results:
            for place, found in results:
                done += merged[place.run].add(place.part, found)
                if progress:
                    progress(done, rays)
    except UnfinishedError as error:
        lost = error
    # Results are assigned even where workers were lost, and then the error is raised
    for one, count in zip(merged, expected, strict=True):
        one.finish(task.ledger, len(one.parts) == count)
    if lost is not None:
        raise lost


class MapPlace(NamedTuple):
    """A part of a run whose images are requested: keys of paths, uint64, and the image word of each, uint32."""

    run: int
    part: Part
    keys: bytes
    words: bytes
    images: int
    capacity: int  # of the table of paths


def images_by_parts(
    workers: Workers, task: TraceTask, runs: Sequence[Run], words: Sequence[Mapping[int, int]], count: int
) -> list[np.ndarray]:
    """
    Return the images of `Run.images` for some runs of a trace, by workers.

    Parameters
    ----------
    workers : Workers
    task : TraceTask
    runs : sequence of Run
    words : sequence of mapping of int to int
        For each run, ledger slot → word of the image that its light enters; runs without any are not traced.
    count : int
        Number of images.
    """
    totals = [np.zeros((count, *run.film.shape[1:])) for run in runs]
    # Slots differ from process to process, so that paths are sent by their keys
    groups, capacities = {}, {}
    for number, (run, slots) in enumerate(zip(runs, words, strict=True)):
        assert run.paths is not None
        assert run.ledger is not None
        capacities[number] = run.ledger.capacity
        place = np.searchsorted(run.paths.slots, np.array(list(slots), dtype=np.int64))
        groups[number] = run.paths.keys[place].tobytes(), np.array(list(slots.values()), dtype=np.uint32).tobytes()
    places = [
        MapPlace(place.run, place.part, *groups[place.run], count, capacities[place.run])
        for place in _traced(runs, workers.count())
        if words[place.run]
    ]
    with do_parts(workers, task, places) as results:
        for place, found in results:
            found.add_to(totals[place.run])
    return totals


def _traced(runs: Sequence[Run], workers: int) -> list[RunPart]:
    """Return the parts of runs that have been traced."""
    if all(run.parts is None for run in runs):
        return split(runs, workers)
    return [RunPart(k, part) for k, run in enumerate(runs) for part in run.parts or map(Part, range(run.passes))]


def _images(run: Run, place: MapPlace) -> np.ndarray:
    """Return the images of a part, at a worker, whose ledger is filled with the paths before rays are traced."""
    before = run.ledger
    keys = np.frombuffer(place.keys, dtype=np.uint64)
    empty = np.zeros((len(keys), 0), dtype=np.uint32)
    run.ledger, slots = _filled(run, keys, empty, np.zeros(len(keys)), place.capacity)
    try:
        words = np.frombuffer(place.words, dtype=np.uint32).tolist()
        return run.images(dict(zip(slots.tolist(), words, strict=True)), place.images)
    finally:
        run.ledger = before
