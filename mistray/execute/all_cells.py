"""Traces with the light that light a scene from all cells of a grid of directions in one launch of the kernel."""

from __future__ import annotations

from collections.abc import Iterator

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
from mistray.sampling.sharing.cell_starts import cell_starts
from mistray.settings import BATCHES

PASS_LANES = 1 << 19


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

        Parameters
        ----------
        rays : (c,) int
            Start rays of each cell, multiples of `BATCHES`.
        number : int
            Of this search: another number is another sample.
        """
        found = []
        for band, rival in enumerate(self._trace.rivals):
            recorder = ArrivalSamples(self.cells, self._trace.has_optics, rival.balance)
            self._run(band, rays, (1, number), recorder)
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
            recorder = ArrivalRecorder(self.cells, trace.has_optics, rival.balance, self._paths, film)
            self._run(band, rays, (0, number), recorder)
            for name, values in recorder.read().items():
                join = np.maximum if name == "largest" else np.add
                total[name] = join(total[name], values) if name in total else values
        return total

    def paths(self) -> dict[str, np.ndarray]:
        """The path table so far, see `PathSums.read`; empty where there is none."""
        return self._paths.read() if self._paths is not None else {}

    def gains(self, derivative: np.ndarray, weighing: Weighing) -> ArrivalRecorder:
        """What a metric gains, by its derivative by the sums of each class in each cell."""
        return ArrivalRecorder(self.cells, self._trace.has_optics, weighing, derivative=derivative)

    def starts(self, band: int, rays: np.ndarray, stream: tuple[int, int]) -> Iterator[StartRays]:
        """Start rays of a wavelength, in as many passes as it takes; a stream for each round."""
        trace = self._trace
        one = trace.bands[band]
        wanted = rays * one.share
        passes = max(1, -(-int(wanted.sum()) // PASS_LANES))
        lanes = np.where(wanted > 0, np.maximum(np.round(wanted / passes / BATCHES), 1) * BATCHES, 0).astype(np.int64)
        # The share of a wavelength is that of its rays, but for rounding
        weight = np.divide(wanted, passes * lanes, out=np.zeros(len(lanes)), where=lanes > 0)
        for k in range(passes):
            yield cell_starts(trace.rivals[band].balance, (trace.settings.seed, *stream, band, k), lanes, weight)

    def trace_trees(self, band: int, start: StartRays, recorder: Recorder) -> None:
        """Trace the trees of some start rays of a wavelength."""
        trace = self._trace
        scene, table = trace.rival_scene(band), trace.bands[band].table

        def launch(part: StartRays) -> None:
            trace_tree(scene, part, trace.settings, [recorder])

        launches_of(table, trace.settings, recorder.code, "with the light", trace.connects).whole(start, launch)

    def _run(self, band: int, rays: np.ndarray, stream: tuple[int, int], recorder: Recorder) -> None:
        for start in self.starts(band, rays, stream):
            self.trace_trees(band, start, recorder)
