"""
Forward traces in which rays from all cells of a grid of directions share the launches of the kernel.

A plane wave of 1 W/mm² and cross-section A, mm², brings the detector of area A_d, mm², the flux A · mean(w), W, so that

    PST_normal = A/A_d · mean(w)

with w the weight with which a start ray meets the detector, 0 if it misses. `AllCells.areas` are A, and `AllCells.unit`
is A/A_d.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from mistray.execute.backward import BackwardTrace
from mistray.execute.cell_sums import FoundByCell, WaveSums
from mistray.execute.grid_trace import WaveTrace
from mistray.execute.launching import trace_whole
from mistray.kernel.launches import Launches
from mistray.recorders.direction_recorder import ArrivalRecorder, MisWeighting
from mistray.recorders.film import Film
from mistray.recorders.path_sums import PathsByCell, PathSums
from mistray.recorders.recorder import Recorder
from mistray.recorders.start_rays import StartRays
from mistray.recorders.start_samples import ArrivalSamples, Samples
from mistray.sampling.sharing.cell_waves import cell_starts
from mistray.settings import BATCHES

PASS_LANES = 1 << 19
# First number of a stream of random numbers: for rays of sums, of samples, and (added) for unscattered rays of either
SUMS, SAMPLES, OWN = 0, 1, 4


class AllCells:
    """
    Forward trace of plane waves of 1 W/mm², one from each cell of a grid; every ray carries the index of its cell.

    Parameters
    ----------
    trace : WaveTrace or BackwardTrace
        Trace that provides the scene, the grid and the settings. A `BackwardTrace` also provides MIS weights, see
        `BackwardTrace.share_paths`.

    Attributes
    ----------
    areas : (n, m) float64
        Cross-sections of the waves, mm². A wave of 1 W/mm² brings the detector the flux ``area · w̄``, W, where w̄ is
        the mean weight with which its start rays meet the detector.
    unit : (n, m) float64
        PST_normal of each cell if the mean weight of its start rays is 1.
    rounds : list of tuple
        Index of the round, and number of start rays of each cell, (c,), for each call of `sums`.
    total : WaveSums
        Sums of all rays so far, see `go_on`.
    after_pass : callable or None
        Called with the number of start rays of each pass that `sums` has traced; None: nothing is called.
    """

    total: WaveSums

    def __init__(self, trace: WaveTrace | BackwardTrace) -> None:
        self._trace = trace
        self.areas = trace.waves.areas.reshape(trace.grid.shape)
        self.cells = self.areas.size
        self.after_pass: Callable[[int], None] | None = None
        self._launches: dict[int, Launches] = {}  # by wavelength, of the latest rays
        self.rounds: list[tuple[int, np.ndarray]] = []
        self.unit = self.areas / trace.area
        self._film = Film.of(*trace.map_size, trace.extent) if all(trace.map_size) else None
        self._paths: PathSums | None = None  # made with the first sums: a pilot needs none
        self.begin()

    def samples(self, rays: np.ndarray, number: int, values: np.ndarray | None = None) -> list[Samples]:
        """
        Trace rays apart from the sums, and return samples of those that meet the detector, by wavelength.

        Where unscattered light has rays of its own, see `mistray.sampling.sharing.mis_weights.Sharing`, each wavelength
        has two parts; the first is the scattered light.

        Parameters
        ----------
        rays : (c,) int
            Number of start rays of each cell, multiples of `BATCHES`.
        number : int
            Index of this search, which selects its random numbers.
        values : (c,) float64, optional
            Factor on the contributions of each cell in `Samples.importance`; None: 0 for all cells.
        """
        found = []
        values = np.zeros(self.cells) if values is None else values
        for band in range(len(self._trace.bands)):
            mis = self._trace.balance(band)
            assert mis is not None
            for scatter, only in self._kinds:
                surfaces = self._trace.bands[band].table.count
                recorder = ArrivalSamples(
                    self.cells, self._trace.design_keys, mis, surfaces, values, scattered_only=only
                )
                for start in self.starts(band, rays, (SAMPLES, number), scatter):
                    self.trace_trees(band, start, recorder, scatter)
                found.append(recorder.read())
        return found

    def _read(self, recorder: ArrivalRecorder) -> WaveSums:
        """Return a recorder's sums as `WaveSums`, with zero start rays and no paths."""
        return WaveSums(rays=np.zeros((*self.areas.shape, BATCHES)), paths=PathsByCell(), **recorder.read())

    def _recorder(self, mis: MisWeighting | None, film: Film | None = None, **options: Any) -> ArrivalRecorder:
        return ArrivalRecorder(self._trace.grid.shape, self._trace.design_keys, mis, film=film, **options)

    def go_on(self, rays: np.ndarray, number: int | None = None) -> None:
        """
        Trace more forward rays until each cell has had the given number of them.

        Parameters
        ----------
        rays : (c,) int
            Number of start rays of each cell. Multiples of `BATCHES` are traced; start weights make up for rounding.
        number : int, optional
            Index of the round, which selects its random numbers; by default the next one.
        """
        missing = np.maximum(rays - self.rays, 0)
        if missing.any():
            self.total = self.total + self.sums(missing, self.total.passes if number is None else number)

    @property
    def rays(self) -> np.ndarray:
        """Number of start rays so far from each cell, (c,), without the additional ones for unscattered light."""
        return np.asarray(self.total.rays.sum(axis=-1).ravel())

    def sums(self, rays: np.ndarray, number: int) -> WaveSums:
        """
        Trace forward rays from all cells, and return the sums of their light at the detector, by class and cell.

        Parameters
        ----------
        rays : (c,) int
            Number of start rays of each cell. Multiples of `BATCHES` are traced; start weights make up for rounding.
        number : int
            Index of the round, which selects its random numbers.

        Returns
        -------
        WaveSums
            Its paths stay in the memory of the device, see `paths`.
        """
        trace, started = self._trace, time.perf_counter()
        self.rounds.append((number, rays))
        if self._paths is None and trace.lists_paths:
            self._paths = trace.new_paths()
        parts = []
        for band in range(len(trace.bands)):
            mis = trace.balance(band)
            for scatter, only in self._kinds:
                recorder = self._recorder(mis, self._film, paths=self._paths, scattered_only=only)
                for start in self.starts(band, rays, (SUMS, number), scatter):
                    self.trace_trees(band, start, recorder, scatter)
                    if self.after_pass:
                        self.after_pass(dr.width(start.lane))
                parts.append(self._read(recorder))
        total = sum(parts[1:], start=parts[0])
        of_batch = np.repeat(rays / BATCHES, BATCHES).reshape(total.rays.shape)
        return replace(total, rays=of_batch, passes=1, seconds=time.perf_counter() - started)

    @property
    def _kinds(self) -> list[tuple[bool, bool]]:
        """
        Kinds of rays to trace, as pairs of flags: rays may scatter; their unscattered light is left out.

        There is one kind, which carries all light, unless unscattered light has rays of its own.
        """
        return [(True, False)] if self.unscattered is None else [(True, True), (False, False)]

    @property
    def unscattered(self) -> np.ndarray | None:
        """Additional rays for unscattered light per start ray of each cell, (c,); None if there are none."""
        balance = self._trace.balance(0)
        return None if balance is None else balance.sharing.unscattered

    @property
    def lanes(self) -> float:
        """
        Number of start rays over all wavelengths such that the share of each wavelength fits in one launch.

        Before the first launch it is `BATCHES`.
        """
        parts = [self._trace.bands[band].share / one.lanes for band, one in self._launches.items()]
        return 1 / max(parts) if parts else BATCHES

    @property
    def unscattered_rays(self) -> float:
        """Total number of additional rays so far that carry only unscattered light."""
        return 0.0 if self.unscattered is None else float(np.sum(self.rays * self.unscattered))

    @property
    def paths(self) -> PathsByCell:
        """
        Paths recorded so far with their throughput sums by cell, events in the order of the light.

        Without a table of paths there are none.
        """
        return self.total.paths if self._paths is None else self.total.paths + self._paths.read()

    @property
    def found(self) -> FoundByCell:
        """Paths so far, and PST_normal per unit weight of a start ray, see `CellSums.found`."""
        return self.total.found(self.unit, self.paths)

    @property
    def by_pixel(self) -> np.ndarray:
        """Contribution of each pixel to PST_normal so far, and its variance, see `CellSums.by_pixel`."""
        return self.total.by_pixel(self.unit, self.unscattered)

    def begin(self) -> None:
        """Reset all sums to zero, and discard the paths."""
        self.total = self._read(self._recorder(None, self._film))
        self._paths = None

    def gains(self, derivative: np.ndarray, mis: MisWeighting) -> ArrivalRecorder:
        """
        Return a recorder whose `gain` is each ray's weight times the metric's derivative for its class and cell.

        `derivative` and `mis` are those of `SkyRecorder`.
        """
        return self._recorder(mis, derivative=derivative)

    def starts(self, band: int, rays: np.ndarray, stream: tuple[int, int], scatter: bool = True) -> Iterator[StartRays]:
        """
        Yield the start rays of the wavelength of index `band`, pass by pass.

        `rays`, (c,), is their number in each cell over all wavelengths. `stream`, `SUMS` or `SAMPLES` and the number of
        the round, selects the random numbers. Without `scatter` they are the additional rays for unscattered light.
        """
        # Rays of each cell
        trace = self._trace
        balance = trace.balance(band)
        requested = count = rays * trace.bands[band].share
        if not scatter:
            assert self.unscattered is not None
            count = requested * self.unscattered
            stream = (OWN + stream[0], stream[1])
        # With MIS every pass has rays of all cells. Without it each cell is split by itself, so that its rays do not
        # depend on those of other cells
        apart = balance is None
        passes = np.maximum(1, -(-(count if apart else count.sum()).astype(np.int64) // PASS_LANES))
        lanes = np.where(requested > 0, np.maximum(np.round(count / passes / BATCHES), 1) * BATCHES, 0).astype(np.int64)
        # The rays of a wavelength are in proportion to its share; the weight corrects the rounding of their number
        weight = np.divide(requested, passes * lanes, out=np.zeros(len(lanes)), where=lanes > 0)
        for k in range(int(np.max(passes))):
            here = np.where(k < passes, lanes, 0)
            group = (np.cumsum(here) - 1) // PASS_LANES if apart else np.zeros(len(here))
            for number in np.unique(group[here > 0]):
                yield cell_starts(
                    trace.waves,
                    None if balance is None else balance.starts,
                    (trace.settings.seed, *stream, band, k),
                    np.where(group == number, here, 0),
                    weight,
                    trace.bands[band].outside,
                )

    def trace_trees(self, band: int, start: StartRays, recorder: Recorder, scatter: bool = True) -> None:
        """Trace ray trees of start rays at the wavelength of index `band` into a recorder, with or without scatter."""
        trace = self._trace
        scene, settings = trace.forward_scene(band), trace.settings
        if not scatter:
            assert scene.competing is not None
            # These rays start with 1/unscattered of the weight; thresholds are lowered alike, so that none ends early
            assert self.unscattered is not None
            most = float(self.unscattered.max())
            below = tuple(one / most for one in settings.cut_below)
            settings = replace(settings, max_scatters=0, flux_threshold=settings.flux_threshold / most, cut_below=below)
            # Nothing is split that does not scatter, nor counts as throughput that could
            scene = replace(scene, competing=replace(scene.competing, connects=False), windows=None)

        # The thresholds of unscattered light change from round to round, but the time per ray, by which launches are
        # sized, does not
        usual = trace.settings
        kind = replace(settings, flux_threshold=usual.flux_threshold, cut_below=usual.cut_below)
        self._launches[band] = trace_whole(scene, start, settings, [recorder], kind)
