"""Traces with the light that light a scene from all cells of a grid of directions in one launch of the kernel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.execute.backward import BackwardTrace
from mistray.kernel.launches import launches_of
from mistray.kernel.ray_tree import trace_tree
from mistray.recorders.arrivals import ArrivalRecorder
from mistray.recorders.film import Film
from mistray.recorders.path_sums import PathSums
from mistray.recorders.recorder import Recorder
from mistray.recorders.start_rays import StartRays
from mistray.recorders.start_samples import ArrivalSamples, Samples
from mistray.recorders.weighing import Weighing
from mistray.sampling.sharing.balance import Sharing
from mistray.sampling.sharing.cell_starts import cell_starts
from mistray.settings import BATCHES

PASS_LANES = 1 << 19
# First numbers of a stream of random numbers: rays of sums and of samples, and those that are not scattered of either
SUMS, SAMPLES, OWN = 0, 1, 4


class AllCells:
    """
    Plane waves from all cells of a grid, each of 1 W/mm², traced together; every ray knows its cell.

    Parameters
    ----------
    trace : BackwardTrace
        That shares its paths with these rays, see `BackwardTrace.share_paths`.

    Attributes
    ----------
    areas : (n, m) float64
        Cross-sections of the waves, mm². Light of 1 W/mm² from a cell, of which rays of a mean weight w̄ meet the
        detector, brings it ``area · w̄``.
    unit : (c,) float64
        PST_normal of a mean weight of 1 of the start rays of a cell.
    rounds : list of tuple
        Number and rays, as `sums` has taken them.
    """

    def __init__(self, trace: BackwardTrace) -> None:
        self._trace = trace
        self.areas = trace.rivals[0].balance.areas.reshape(trace.grid.shape)
        self.cells = self.areas.size
        self.rounds: list[tuple[int, np.ndarray]] = []
        self.unit = self.areas.ravel() / trace.area
        x0, x1, y0, y1 = trace.extent
        columns, rows = (max(size, 1) for size in trace.map_size)
        per_mm = columns / (x1 - x0), rows / (y1 - y0)
        left, low, per_x, per_y = (dr.opaque(mi.Float, float(v)) for v in (x0, y0, *per_mm))
        self._film = Film(columns, rows, left, low, per_x, per_y, groups=1, incident=True)
        self._paths: PathSums | None = None  # made with the first sums: a pilot needs none

    def samples(self, rays: np.ndarray, number: int) -> list[Samples]:
        """
        Light that arrives, from rays that are in no sums, by wavelength.

        Where what is not scattered has rays of its own, see `mistray.sampling.sharing.balance.Sharing`, each wavelength
        has two parts; the first is what is scattered.

        Parameters
        ----------
        rays : (c,) int
            Start rays of each cell, multiples of `BATCHES`.
        number : int
            Of this search: another number is another sample.
        """
        found = []
        for band, rival in enumerate(self._trace.rivals):
            for scatter, only in self._kinds:
                recorder = ArrivalSamples(self.cells, self._trace.design_keys, rival.balance, only)
                self._run(band, rays, (SAMPLES, number), recorder, scatter)
                found.append(recorder.read())
        return found

    def sums(self, rays: np.ndarray, number: int) -> dict[str, np.ndarray]:
        """
        Sum the light that meets the detector.

        Parameters
        ----------
        rays, number
            See `samples`.

        Returns
        -------
        dict
            See `ArrivalRecorder.read`.
        """
        trace = self._trace
        self.rounds.append((number, rays))
        total: dict[str, np.ndarray] = {}
        if self._paths is None and trace.lists_paths:
            self._paths = trace.new_paths()
        for band, rival in enumerate(trace.rivals):
            film = self._film if all(trace.map_size) else None
            for scatter, only in self._kinds:
                recorder = ArrivalRecorder(self.cells, trace.design_keys, rival.balance, self._paths, film, only)
                self._run(band, rays, (SUMS, number), recorder, scatter)
                for name, values in recorder.read().items():
                    join = np.maximum if name == "largest" else np.add
                    total[name] = join(total[name], values) if name in total else values
        return total

    @property
    def _kinds(self) -> list[tuple[bool, bool]]:
        """Of the rays: whether they may be scattered, and whether they leave out what was not."""
        return [(True, False)] if self.sharing.unscattered is None else [(True, True), (False, False)]

    @property
    def sharing(self) -> Sharing:
        """How the rays share the light with the trace."""
        return self._trace.rivals[0].balance.sharing

    def paths(self) -> dict[str, np.ndarray]:
        """The path table so far, see `PathSums.read`; empty where there is none."""
        return self._paths.read() if self._paths is not None else {}

    def gains(self, derivative: np.ndarray, weighing: Weighing) -> ArrivalRecorder:
        """What a metric gains, by its derivative by the sums of each class in each cell."""
        return ArrivalRecorder(self.cells, self._trace.design_keys, weighing, derivative=derivative)

    def starts(self, band: int, rays: np.ndarray, stream: tuple[int, int], scatter: bool = True) -> Iterator[StartRays]:
        """Start rays of a wavelength, in as many passes as it takes; a stream for each round."""
        trace = self._trace
        one = trace.bands[band]
        wanted = many = rays * one.share
        if not scatter:
            assert self.sharing.unscattered is not None
            many = wanted * self.sharing.unscattered
            stream = (OWN + stream[0], stream[1])
        passes = max(1, -(-int(many.sum()) // PASS_LANES))
        lanes = np.where(wanted > 0, np.maximum(np.round(many / passes / BATCHES), 1) * BATCHES, 0).astype(np.int64)
        # The share of a wavelength is that of its rays, but for rounding
        weight = np.divide(wanted, passes * lanes, out=np.zeros(len(lanes)), where=lanes > 0)
        for k in range(passes):
            yield cell_starts(trace.rivals[band].balance, (trace.settings.seed, *stream, band, k), lanes, weight)

    def trace_trees(self, band: int, start: StartRays, recorder: Recorder, scatter: bool = True) -> None:
        """Trace the trees of some start rays of a wavelength."""
        trace = self._trace
        scene, table = trace.rival_scene(band), trace.bands[band].table
        settings, connects = trace.settings, trace.connects
        if not scatter:
            assert scene.opposite is not None
            # Each of them carries less, and none may end before its share of the light does
            assert self.sharing.unscattered is not None
            threshold = settings.flux_threshold / float(self.sharing.unscattered.max())
            settings, connects = replace(settings, max_scatters=0, flux_threshold=threshold), False
            scene = replace(scene, opposite=replace(scene.opposite, connects=False))

        def launch(part: StartRays) -> None:
            trace_tree(scene, part, settings, [recorder])

        # The threshold of light that nothing scatters changes from round to round, and the pace does not
        kind = replace(settings, flux_threshold=trace.settings.flux_threshold)
        launches_of(table, kind, recorder.code, "with the light", connects).whole(start, launch)

    def _run(self, band: int, rays: np.ndarray, stream: tuple[int, int], recorder: Recorder, scatter: bool) -> None:
        for start in self.starts(band, rays, stream, scatter):
            self.trace_trees(band, start, recorder, scatter)
