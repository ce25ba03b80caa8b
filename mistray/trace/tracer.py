"""Runs the kernel: passes of bounded size, ledgers that grow when they are full, one run for each source and wavelength."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.trace.intersect import Intersector
from mistray.trace.ledger import BATCHES, DecodedPaths, Ledger
from mistray.trace.ray_tree import REASONS, Film, Recorder, Tallies, walk
from mistray.trace.settings import Settings
from mistray.trace.sources import Beam, beams
from mistray.trace.surfaces import SurfaceTable

PASS_LANES = 1 << 20
FIRST_CAPACITY = 1 << 12
LAST_CAPACITY = 1 << 20

Progress = Callable[[int, int], None]


@dataclass
class Run:
    """
    One source at one wavelength: what the kernel needs, and what it found.

    Attributes
    ----------
    beam : Beam
    table : SurfaceTable
    rays : int
        Start rays.
    unit : float
        Flux of a start ray, W.
    surfaces : (s, 3, BATCHES) float64
        Hits, incident and absorbed flux of every surface, in `unit`.
    reasons : (REASONS, BATCHES) float64
    film : (2, height, width) float64
        Sums of detected flux and of its square, in `unit` and `unit`².
    paths : DecodedPaths or None
    ledger : Ledger or None
    seconds : float
        Time in the kernel, compilation included.
    """

    beam: Beam
    table: SurfaceTable
    intersector: Intersector
    settings: Settings
    rays: int
    seed: int
    unit: float
    surfaces: np.ndarray = field(default_factory=lambda: np.zeros(0))
    reasons: np.ndarray = field(default_factory=lambda: np.zeros(0))
    film: np.ndarray = field(default_factory=lambda: np.zeros(0))
    paths: DecodedPaths | None = None
    ledger: Ledger | None = None
    seconds: float = 0.0

    def make_film(self) -> Film:
        """The detector's pixel grid for the kernel."""
        width, height, (x0, x1, y0, y1) = self.table.film()
        return Film(
            width,
            height,
            dr.opaque(mi.Float, x0),
            dr.opaque(mi.Float, y0),
            dr.opaque(mi.Float, width / (x1 - x0)),
            dr.opaque(mi.Float, height / (y1 - y0)),
        )

    def generator(self, lane: mi.UInt32) -> mi.PCG32:
        """Random numbers of start rays, the same for a ray however the passes are cut."""
        seed = mi.UInt64(dr.opaque(mi.UInt32, self.seed))
        return mi.PCG32(size=dr.width(lane), initstate=seed, initseq=mi.UInt64(lane))

    def start_rays(self, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins (mm) and directions of start rays, (n, 3) float64 each."""
        lane = mi.UInt32(lanes.astype(np.uint32))
        o, d = self.beam.start(lane, self.rays, self.generator(lane))
        return np.array(o, dtype=np.float64).T, np.array(d, dtype=np.float64).T

    def launch(
        self,
        tallies: Tallies,
        film: Film,
        ledger: Ledger | None,
        recorder: Recorder | None = None,
        box: Sequence[float] | None = None,
        rays: int | None = None,
        progress: Progress | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> int:
        """Run all passes; returns the rays that were started. `stop` is asked after every pass."""
        rays = self.rays if rays is None else rays
        corners = None if box is None else mi.Vector4f(*(dr.opaque(mi.Float, float(v)) for v in box))
        done = 0
        while done < rays:
            lanes = min(PASS_LANES, rays - done)
            index = dr.arange(mi.UInt32, lanes)
            offset = dr.opaque(mi.UInt32, done)
            lane = index + offset
            rng = self.generator(lane)
            o, d = self.beam.start(lane, self.rays, rng)
            batch = mi.UInt32(mi.Float(index) * (BATCHES / lanes)) if lanes >= BATCHES else lane % BATCHES
            walk(
                self.table,
                self.intersector,
                o,
                d,
                dr.minimum(batch, BATCHES - 1),
                lane,
                rng,
                self.settings,
                tallies,
                film,
                ledger,
                recorder,
                corners,
            )
            dr.eval()
            dr.sync_thread()
            done += lanes
            if progress:
                progress(done, rays)
            if stop and stop():
                break
        return done

    def execute(self, ledger: bool, progress: Progress | None) -> None:
        """Trace everything and read the sums back; a ledger that fills up is made larger and the trace starts again."""
        started = time.perf_counter()
        film = self.make_film()
        capacity = FIRST_CAPACITY
        while True:
            tallies = Tallies(self.table.count, film.width * film.height)
            self.ledger = Ledger(capacity, self.settings.max_events) if ledger else None
            held = self.ledger
            self.launch(tallies, film, held, progress=progress, stop=(lambda: held.full) if held else None)
            if held is None or not held.full:
                break
            if capacity >= LAST_CAPACITY:
                raise MistrayError(
                    f"more than {0.7 * capacity:.0f} paths reach the detector; raise flux_threshold "
                    f"({self.settings.flux_threshold:g}), lower max_reflections ({self.settings.max_reflections}) or set ledger=False"
                )
            capacity *= 8
        self.seconds = time.perf_counter() - started
        self.surfaces = np.array(tallies.surfaces).reshape(self.table.count, 3, BATCHES)
        self.reasons = np.array(tallies.reasons).reshape(REASONS, BATCHES)
        self.film = np.moveaxis(np.array(tallies.film).reshape(film.height, film.width, 2), 2, 0)
        self.paths = self.ledger.decode() if self.ledger else None

    def maps(self, number_of_slot: dict[int, int], count: int) -> np.ndarray:
        """
        Detector maps of groups of paths, by tracing the same rays again.

        Parameters
        ----------
        number_of_slot : dict
            Ledger slot → number of the map it goes to.
        count : int
            Number of maps.

        Returns
        -------
        (count, 2, height, width) float64
            Sums of flux and of its square, in `unit` and `unit`².
        """
        assert self.ledger is not None
        film = self.make_film()
        numbers = np.zeros(self.ledger.capacity, dtype=np.uint32)
        for slot, number in number_of_slot.items():
            numbers[slot] = number + 1
        film.map_of_slot = mi.UInt32(numbers)
        tallies = Tallies(self.table.count, film.width * film.height, count)
        self.launch(tallies, film, self.ledger)
        return np.moveaxis(np.array(tallies.film).reshape(count, film.height, film.width, 2), 3, 1)

    def paths_in_box(self, box: Sequence[float]) -> DecodedPaths:
        """The ledger of the same rays, of the hits within x0 ≤ x ≤ x1, y0 ≤ y ≤ y1 only; mm."""
        assert self.ledger is not None
        self.ledger.clear_sums()
        film = self.make_film()
        self.launch(Tallies(self.table.count, film.width * film.height), film, self.ledger, box=box)
        return self.ledger.decode()

    def record(self, key: int, count: int) -> Recorder:
        """Branches that end in the detector, node by node, of the path with this key (0: of any path)."""
        recorder = Recorder(count, self.settings.max_events, mi.UInt64(dr.opaque(mi.UInt64, key)))
        film = self.make_film()
        self.launch(
            Tallies(self.table.count, film.width * film.height),
            film,
            None,
            recorder,
            stop=lambda: int(recorder.count[0]) >= count,
        )
        return recorder


def prepare(
    scene: mi.Scene,
    settings: Settings,
    field_deg: float | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: float | Sequence[float] | None = None,
    detector: str | None = None,
) -> list[Run]:
    """Build one `Run` for each source and wavelength; the rays are shared in proportion to their flux."""
    sources = beams(scene, field_deg, azimuth_deg, wavelength_nm)
    total = sum(beam.power for beam in sources)
    tables: dict[float, tuple[SurfaceTable, Intersector]] = {}
    runs = []
    for number, beam in enumerate(sources):
        if beam.wavelength_nm not in tables:
            table = SurfaceTable(scene, beam.wavelength_nm, detector)
            tables[beam.wavelength_nm] = table, Intersector(table)
        count = beam.count(max(1, round(settings.rays * beam.power / total)))
        stream = (settings.seed + 0x9E3779B9 * number) % 2**32
        runs.append(Run(beam, *tables[beam.wavelength_nm], settings, count, stream, beam.power / count))
    return runs
