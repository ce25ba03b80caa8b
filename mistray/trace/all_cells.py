"""Forward traces that light a scene from all cells of a grid of directions in one launch of the kernel."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.launches import launches_of
from mistray.kernel.ray_tree import trace_tree
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.recorders.arrivals import CountedWays, FoundWays
from mistray.recorders.film import Film
from mistray.recorders.path_sums import PathSums
from mistray.recorders.recorder import Recorder
from mistray.recorders.start_rays import StartRays, generators
from mistray.recorders.tallies import CHANNEL_COUNT, SEGMENTS, Tallies
from mistray.recorders.way_table import WayTable
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.plane_wave import PlaneWaves, wave_rays
from mistray.sampling.space_filling import curve_points
from mistray.settings import BATCHES, Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

PASS_LANES = 1 << 19
PATH_SLOTS, ENTRY_SLOTS = 1 << 16, 1 << 19


class AllCells:
    """
    Plane waves from all cells of a grid, each of 1 W/mm², traced together; every ray knows its cell.

    Parameters
    ----------
    scene : mi.Scene
    waves : PlaneWaves
        Of the scene, or of all that share their rays.
    settings : Settings
        But for the number of rays.
    tables : sequence of SurfaceTable
        Of the wavelengths; the first gives the geometry.
    shares : sequence of float
        Their shares of the flux.
    intersector : Intersector
    map_size : tuple of int
        Columns and rows of the maps of the detector; 0, 0: none.
    extent : tuple of float
        x0, x1, y0, y1 of the maps, mm.

    Attributes
    ----------
    areas : (n, m) float64
        Cross-sections of the waves, mm². Light of 1 W/mm² from a cell, of which rays of a mean weight w̄ meet the
        detector, brings it ``area · w̄``.
    """

    def __init__(
        self,
        scene: mi.Scene,
        waves: PlaneWaves,
        settings: Settings,
        tables: Sequence[SurfaceTable],
        shares: Sequence[float],
        intersector: Intersector,
        map_size: tuple[int, int],
        extent: tuple[float, float, float, float],
    ) -> None:
        self._settings, self._intersector, self._map_size = settings, intersector, map_size
        targets = importance_targets(tables[0], scene, settings)
        self._bands = [
            (table, Scattering(ScatterTables(table, targets)), share)
            for table, share in zip(tables, shares, strict=True)
        ]
        cells = [waves.at(i, j, 0.0, 1.0) for i, j in np.ndindex(*waves.grid.shape)]
        self.areas = np.array([wave.area for wave in cells]).reshape(waves.grid.shape)
        self._rotation, self._centre = cells[0].rotation, cells[0].centre - tables[0].centre
        self._numbers = [upload(mi.Float, column) for column in np.array([wave.numbers for wave in cells]).T]
        x0, x1, y0, y1 = extent
        columns, rows = (max(size, 1) for size in map_size)
        per_mm = columns / (x1 - x0), rows / (y1 - y0)
        left, low, per_x, per_y = (dr.opaque(mi.Float, float(v)) for v in (x0, y0, *per_mm))
        self._film = Film(columns, rows, left, low, per_x, per_y, groups=1, incident=True)

    def find(self, rays: np.ndarray, number: int) -> tuple[dict[str, np.ndarray], float]:
        """
        List the ways by which light reaches the detector.

        Parameters
        ----------
        rays : (n, m) int
            Start rays of each cell, multiples of `BATCHES`.
        number : int
            Of this search: another number is another sample.

        Returns
        -------
        recorder : dict
            See `PathSums.read`; event lists in the order of the light, the absorption in the detector at their ends.
        segments : float
            Ray segments that were traced.
        """
        found = FoundWays(PathSums(PATH_SLOTS, ENTRY_SLOTS, self._settings.max_events, rays.size))
        segments = sum(self._trace(band, rays, number, found) for band in range(len(self._bands)))
        return found.path_sums.read(), segments

    def count(self, ways: WayTable, rays: np.ndarray, number: int) -> tuple[dict[str, np.ndarray], float]:
        """
        Sum the light of chosen ways.

        Parameters
        ----------
        ways : WayTable
        rays, number
            See `find`.

        Returns
        -------
        sums : dict
            See `CountedWays.read`; in units of a start ray.
        segments : float
        """
        counted = CountedWays(ways, rays.size, self._film if all(self._map_size) else None)
        segments = sum(self._trace(band, rays, number, counted) for band in range(len(self._bands)))
        return counted.read(), segments

    def _trace(self, band: int, rays: np.ndarray, number: int, recorder: Recorder) -> float:
        """Trace a wavelength, in as many passes as it takes; gives the number of segments."""
        table, scattering, share = self._bands[band]
        wanted = rays.ravel() * share
        passes = max(1, -(-int(wanted.sum()) // PASS_LANES))
        lanes = np.where(wanted > 0, np.maximum(np.round(wanted / passes / BATCHES), 1) * BATCHES, 0).astype(np.int64)
        # The share of a wavelength is that of its rays, but for rounding
        weight = np.divide(wanted, passes * lanes, out=np.zeros(len(lanes)), where=lanes > 0)
        tallies = Tallies(table.count, len(table.optics.media))
        scene = KernelScene(table, scattering, self._intersector)
        for k in range(passes):
            start = self._start((number, band, k), lanes, weight)

            def trace(part: StartRays) -> None:
                trace_tree(scene, part, self._settings, [tallies, recorder])

            launches_of(table, self._settings, recorder.code).whole(start, trace)
        return float(np.array(tallies.channels).reshape(CHANNEL_COUNT, BATCHES)[SEGMENTS].sum())

    def _start(self, stream: tuple[int, int, int], lanes: np.ndarray, weight: np.ndarray) -> StartRays:
        """Start rays of a pass, the rays of a cell side by side; places and directions are stratified in each batch."""
        cell = upload(mi.UInt32, np.repeat(np.arange(len(lanes)), lanes))
        index = upload(mi.UInt32, np.arange(lanes.sum()) - np.repeat(np.cumsum(lanes) - lanes, lanes))
        strata = dr.gather(mi.UInt32, upload(mi.UInt32, lanes // BATCHES), cell)
        lane = dr.arange(mi.UInt32, int(lanes.sum()))
        seed = int(np.random.SeedSequence((self._settings.seed, 1, *stream)).generate_state(1)[0])
        rng, _ = generators(seed, lane)
        batch = index // strata
        within = mi.Float64(index - batch * strata) + mi.Float64(rng.next_float32())
        x, y, u, v = curve_points(within / mi.Float64(strata), 4, rng)
        numbers = [dr.gather(mi.Float, column, cell) for column in self._numbers]
        o, d = wave_rays(numbers, self._rotation, self._centre, mi.Point2f(x, y), u, v)
        w = dr.gather(mi.Float, upload(mi.Float, weight), cell)
        dr.eval(lane, batch, rng, o, d, w, cell)
        return StartRays(lane, batch, rng, o, d, w, cell=cell)


def whole_batches(rays: np.ndarray) -> np.ndarray:
    """Numbers of rays, rounded up to multiples of `BATCHES`."""
    return np.asarray(-(-np.asarray(rays, dtype=np.int64) // BATCHES) * BATCHES)
