"""
Backward traces: from the detector to the sky, over all directions that stray light can come from.

Let w be the weight of rays from the Lambertian start of `mistray.sampling.detector_start` that leave the scene within a
cell of directions, and ΔΩ the solid angle of the cell. Then

    PST_normal = π/ΔΩ · mean(w),

that is, the irradiance on the detector per irradiance of a plane wave across its own direction. The mean is over all
start rays, and w includes the factor n², with the refractive index n of the medium before the detector.
`BackwardTrace.unit` is π/ΔΩ.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.cell_sums import BackwardSums
from mistray.execute.grid_trace import Band, GridTrace
from mistray.execute.launching import trace_whole
from mistray.execute.scene_task import SceneTask
from mistray.execute.workers import Job, current_workers
from mistray.kernel.kernel_scene import BranchProbabilities, CompetingTrace, KernelScene, WeightWindows
from mistray.kernel.light_vertices import LightVertexRecorder, LightVertices
from mistray.light import AS_THE_SCENE, Light
from mistray.notes import Note
from mistray.recorders.direction_recorder import DirectionRecorder, MisWeighting
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.film import Film
from mistray.recorders.importance import WAYS
from mistray.recorders.path_sums import PathsByCell
from mistray.recorders.recorder import Recorder
from mistray.recorders.start_rays import StartRays
from mistray.recorders.start_samples import SAMPLES, DepartureSamples, Samples
from mistray.recorders.tallies import Tallies
from mistray.sampling.backward_targets import backward_targets
from mistray.sampling.detector_start import DetectorStart
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.sharing.cell_waves import CellWaves, cell_starts, whole_batches
from mistray.sampling.sharing.mis_weights import Balance, Sharing
from mistray.sampling.sharing.path_classes import PathClassWeights
from mistray.settings import BATCHES, NO_LIMIT, Settings
from mistray.surfaces.upload import upload, upload_rows

FIRST_PASS, PASS_LANES = 1 << 14, 1 << 18  # rays of the smallest passes, and of the largest
PASSES_OF_A_SIZE = 4  # a run is at most about 1 / 4 longer than was requested
VERTICES_OF_RAY, VERTEX_SEED = 1.0, 2  # forward rays of the light vertex cache per ray of a pass; their random stream
AHEAD = 2  # passes per worker that are handed over before they are needed
ROOM = 1.3  # capacity of the cache, in units of the number of vertices expected from the last pass
FIRST_SEARCH, SEARCHES = 1 << 24, 64  # number of the first pass of a pilot, beyond those of any run; its searches
PLACES = 32  # along the longest side of the lit volume, that weight windows tell apart
# Branch probabilities: numbers of scatter events, and of reflections that are followed, of a ray that meets all optics;
# and the least probability of scatter at a surface, in units of the share of its rays that reach the sky
SCATTERS_OF_RAY, REFLECTIONS_OF_RAY, VIEWS_OF_SKY = 2.0, 4.0, 2.0


class Pass(NamedTuple):
    """One wavelength of a pass: indices of wavelength and pass, and number of rays of the pass over all wavelengths."""

    band: int
    done: int
    rays: int


class BackwardTrace(GridTrace):
    """
    Trace of Lambertian rays from the detector back to a grid of directions, to which any number of passes can be added.

    A ray leaves the detector like light from a Lambertian surface and follows, in reverse, the way of light that would
    be detected there. Let w be the weight of the rays that leave within a cell of directions, of the solid angle ΔΩ,
    sr. Light of radiance L, W/mm²/sr, from the cell has the irradiance E = π L mean(w), W/mm², on the detector. For a
    distant source this gives PST_normal = π/ΔΩ mean(w). For a detector in a medium of refractive index n the weights
    include the factor n².

    Parameters
    ----------
    scene, grid, settings, light, map_pixels, paths
        See `GridTrace`.
    both_sides : bool
        Whether light that meets the detector from behind contributes, as in a forward trace.
    sharing : Sharing, optional
        Numbers of forward rays for MIS weights; None: there are backward rays only.

    Attributes
    ----------
    starts : list of DetectorStart
        Start of the rays, by wavelength.
    forward : list of Band
        Wavelengths with the scatter of competing forward rays; empty: there are backward rays only.
    vertices_per_ray : float
        Light vertices per forward start ray, from the last pass.
    sums : BackwardSums
        Sums over all passes.
    pass_rays : list of int or None
        Rays of each pass; None if the trace continues another one.

    Raises
    ------
    MistrayError
        For settings that a backward trace does not support.
    """

    def __init__(
        self,
        scene: mi.Scene,
        grid: DirectionGrid,
        settings: Settings,
        light: Light = AS_THE_SCENE,
        map_pixels: int = 0,
        paths: bool = False,
        both_sides: bool = True,
        sharing: Sharing | None = None,
    ) -> None:
        if settings.stokes:
            raise MistrayError("polarization is 'stokes'; backward rays are traced for unpolarised light only")
        if settings.max_random_scatters < NO_LIMIT:
            raise MistrayError(
                f"max_random_scatters is {settings.max_random_scatters}; it limits how light is sampled, which is "
                "another thing in a backward trace: use max_scatters"
            )
        super().__init__(scene, grid, settings, light, map_pixels, paths)
        # State of the forward trace, if there is one
        self._elsewhere: Ahead | None = None
        self._arguments = (grid, settings, light, map_pixels, paths, both_sides)
        self._sharing: Sharing | None = None
        self.forward: list[Band] = []
        self._balances: list[Balance] = []  # MIS weights of both directions, by wavelength
        self.vertices_per_ray = 2.0  # first guess, before any pass
        axis = np.asarray(grid.rotation)[:, 2]
        found = backward_targets(self.table, scene, settings, axis)
        # Branch probabilities: every hit of a wall scatters, those of optics share `SCATTERS_OF_RAY`
        optics = max(len(found.views), 1)
        probability = np.ones(self.table.count)
        for surface, share in found.views.items():
            probability[surface] = np.clip(VIEWS_OF_SKY * share, min(1.0, SCATTERS_OF_RAY / optics), 1.0)
        ghosts = dr.opaque(mi.Float, min(1.0, REFLECTIONS_OF_RAY / optics))
        self._probabilities = BranchProbabilities(upload(mi.Float, probability), ghosts)
        probability = np.ones(self.table.count)
        probability[list(found.views)] = min(1.0, SCATTERS_OF_RAY / optics)
        self._forward_probabilities = BranchProbabilities(upload(mi.Float, probability), ghosts)
        # Scatter and start rays of each wavelength
        self.bands = self.with_aims(found.aims, backward=True)
        towards = found.light if found.light is not None else axis
        self.starts = [DetectorStart(band.table, towards, found.start, both_sides) for band in self.bands]
        self._path_sums = self.new_paths() if paths else None
        self.film = Film.of(1, 1, (0.0, 1.0, 0.0, 1.0))
        self.pass_rays: list[int] | None = []
        self.sums = self._read(0, self.make_directions(maps=True), Tallies(self.table), 0.0)
        if sharing is not None:
            self.share_paths(sharing)

    def share_paths(self, sharing: Sharing) -> None:
        """Weight paths by MIS against forward rays from now on, see `mistray.sampling.sharing.mis_weights`."""
        self._sharing = sharing
        # Weight windows: inverse bounds, of which 0 and inf have no effect
        self._windows = self._uploaded(sharing.windows, sharing.points)
        # Without values, too, they are read: the kernel remains the same
        values = np.ones(self.unit.size) if sharing.values is None else sharing.values
        self._forward_windows = self._uploaded(sharing.forward_windows, sharing.points, values)
        for start in self.starts:
            start.guide(sharing.ends)
        if self.forward:
            self._balances = [balance.at(sharing) for balance in self._balances]
            return
        self.waves = CellWaves(sharing.points, self.grid, self.table.centre)
        self.forward = self.with_aims(importance_targets(self.table, self._scene, self.settings))
        self._balances = [Balance(sharing, self.waves, start) for start in self.starts]

    def _uploaded(
        self, windows: np.ndarray | None, points: np.ndarray, values: np.ndarray | None = None
    ) -> WeightWindows:
        """
        Return weight windows on the device, for parameters that are fields of `Sharing`.

        `windows`, (2, n, WAYS), holds the inverse of upper and lower bounds, 0 where there is none; None: no bounds.
        """
        inverse_upper, inverse_lower = np.zeros((2, self.table.count, WAYS)) if windows is None else windows
        inverse_lower = np.where(inverse_lower > 0, inverse_lower, np.inf)
        size = float(np.ptp(points, axis=0).max())
        return WeightWindows(
            upload(mi.Float, inverse_upper.ravel()),
            upload(mi.Float, inverse_lower.ravel()),
            per_mm=dr.opaque(mi.Float, PLACES / size),
            values=None if values is None else upload_rows(mi.Float, values),
        )

    @property
    def notes(self) -> list[Note]:
        """Notes on gaps too thin for float32, on assumed media, and on the medium in front of the detector."""
        return [*dict.fromkeys([*super().notes, *(note for start in self.starts for note in start.notes)])]

    def go_on_from(self, sums: BackwardSums) -> None:
        """Continue from `sums`, the result so far of another trace with the same arguments."""
        self.sums, self.pass_rays = sums, None

    @staticmethod
    def pass_size(number: int) -> int:
        """
        Return the number of rays of the pass of index `number`, over all wavelengths.

        It is `FIRST_PASS` at first, later up to a quarter of all rays before, and at most `PASS_LANES`.
        """
        return min(FIRST_PASS << max(0, number // PASSES_OF_A_SIZE - 1), PASS_LANES)

    def advance(self, rays: int | None = None) -> None:
        """Trace one more pass of about `rays` rays, by default `pass_size`, and add its sums to `sums`."""
        started, done = time.perf_counter(), self.sums.passes
        rays = self.pass_size(done) if rays is None else rays
        # Sums are added after a whole pass, so that an interrupt loses a pass but leaves no part of one
        parts = [Pass(number, done, rays) for number in range(len(self.bands))]
        new = map(self.pass_sums, parts) if self._elsewhere is None else self._elsewhere.whole_pass(parts)
        total = sum(new, start=self.sums)
        if self.pass_rays is not None:
            self.pass_rays.append(rays)
        self.sums = replace(total, passes=done + 1, seconds=total.seconds + time.perf_counter() - started)

    def pass_sums(self, part: Pass) -> BackwardSums:
        """Trace one wavelength of a pass; return its sums by class, cell and surface. Paths stay on the device."""
        number, done, rays = part
        one = self.bands[number]
        vertices = self.light_vertices(number, (0, done), rays)
        sky = self.make_directions(maps=True, mis=self.balance(number, rays, vertices))
        tallies = Tallies(one.table)
        self.trace_shared(number, self.start_pass(number, done, rays), vertices, tallies, sky)
        return self._read(number, sky, tallies, rays * one.share)

    def do(self, part: Pass) -> BackwardSums:
        """Trace one wavelength of a pass on a worker; return its sums, with its table of paths."""
        if self._path_sums is not None:
            self._path_sums = self.new_paths()
        return replace(self.pass_sums(part), paths=self.paths() or PathsByCell())

    def _read(self, number: int, sky: DirectionRecorder, tallies: Tallies, rays: float) -> BackwardSums:
        """Return recorded sums of `rays` start rays of wavelength index `number`, in units of a start ray's flux."""
        table, names = self.bands[number].table, self.table.optics.media
        found = tallies.read()
        # Media are in the order of the first wavelength: another one may number them otherwise
        media = np.zeros((len(names), BATCHES))
        for name, row in zip(table.optics.media, found["media"], strict=True):
            media[names.index(name) if name in names else 0] += row
        return BackwardSums(
            rays=np.full(BATCHES, rays / BATCHES),
            surfaces=found["surfaces"][: table.count],
            media=media,
            channels=found["channels"],
            paths=PathsByCell(),
            **sky.read(),
        )

    def samples(self, rays: int, number: int, values: np.ndarray | None = None) -> list[Samples]:
        """
        Trace rays apart from the sums, and return samples of those that leave within a cell, by wavelength.

        Parameters
        ----------
        rays : int
            Number of rays, traced in passes of at most `PASS_LANES` to bound memory.
        number : int
            Index of this search, below `SEARCHES`, which selects its random numbers.
        values : (c,) float64, optional
            Factor on the contributions of each cell in `Samples.importance`; None: 0 for all cells.
        """
        found = []
        values = np.zeros(self.unit.size) if values is None else values
        passes = max(1, -(-rays // PASS_LANES))
        here = rays // passes
        for band in range(len(self.bands)):
            parts = []
            for k in range(passes):
                stream = number + SEARCHES * k
                vertices = self.light_vertices(band, (1, stream), here)
                balance = self.balance(band, here, vertices)
                assert balance is not None
                room = SAMPLES // passes
                recorder = DepartureSamples(self.grid, self.design_keys, balance, self.table.count, values, room)
                self.trace_shared(band, self.start_pass(band, FIRST_SEARCH + stream, here), vertices, recorder)
                parts.append(recorder.read())
            found.append(Samples.together(parts, here))
        return found

    def trace_shared(self, number: int, start: StartRays, vertices: LightVertices | None, *recorders: Recorder) -> None:
        """
        Trace ray trees of the wavelength with index `number` into recorders, with MIS if there are forward rays.

        These rays are connected to `vertices`; None: no ray is connected.
        """
        scene = self.split_scene(number)
        if self.forward:
            competing = CompetingTrace(self.forward[number].scattering, self._forward_probabilities, self.connects)
            scene = replace(scene, competing=competing, vertices=vertices)
        trace_whole(scene, start, self.settings, recorders)

    def split_scene(self, number: int) -> KernelScene:
        """
        Return the kernel's scene for backward rays of the wavelength with index `number`, with weight windows.

        There are no windows without forward rays, or if a medium scatters.
        """
        band = self.bands[number]
        # Light that a medium scatters branches with the probability of the surface behind it, whose weight window does
        # not account for the importance of the medium
        windows = self._windows if self.forward and not band.table.optics.scatters else None
        return replace(self.scene(band), windows=windows)

    @property
    def connects(self) -> bool:
        """True if backward rays are connected to light vertices of forward rays."""
        return bool(self._balances) and self._balances[0].sharing.connects

    @property
    def scatters(self) -> bool:
        """True if any surface or medium scatters backward rays at any wavelength, under the settings."""
        return any(self.scene(one).scatters(self.settings) for one in self.bands)

    @property
    def may_connect(self) -> bool:
        """True if connections to light vertices are possible: only surfaces scatter, at least twice, and rays split."""
        settings, optics = self.settings, self.table.optics
        surfaces = any(one.scattering.any for one in self.bands) and not optics.scatters
        return surfaces and settings.max_scatters > 1 and settings.splitting == "split" and not optics.one_child

    def balance(
        self, number: int, rays: int | None = None, vertices: LightVertices | None = None, same_rays: bool = False
    ) -> Balance | None:
        """
        Return the MIS weights of forward rays, backward rays and connections; None if there are no forward rays.

        They are for the wavelength of index `number`. Those of backward rays need the number of `rays` of their pass,
        over all wavelengths. Connections count if their light vertices are given. With `same_rays`, the additional
        forward rays for unscattered light are left out of the weights.
        """
        if not self.forward:
            return None
        balance = self._balances[number]
        if same_rays and balance.sharing.unscattered is not None:
            balance = balance.at(replace(balance.sharing, unscattered=None))
        return balance if rays is None else balance.of_pass(self._lanes(number, rays)[1], vertices)

    def path_class_weights(self) -> PathClassWeights | None:
        """Return MIS weights by path class, for derivatives of paths that move; None without forward rays."""
        if not self.forward:
            return None
        path_classes = self._balances[0].sharing.path_classes
        assert path_classes is not None
        return PathClassWeights(path_classes.mis_weights(), self.design_keys)

    def light_vertices(self, number: int, stream: tuple[int, int], rays: int) -> LightVertices | None:
        """
        Return light vertices for a pass: hits of scattering surfaces by forward rays; None without connections.

        `number` is the index of the wavelength, `rays` the number of rays of the pass over all wavelengths. `stream`
        selects the random numbers.
        """
        if not self.connects:
            return None
        # Forward start rays, none of which scatters: a vertex is where the first scatter event would be
        forward, balance = self.forward[number], self._balances[number]
        starts_per_connection = balance.sharing.starts_per_connection
        lanes = whole_batches(np.ceil(VERTICES_OF_RAY * rays * forward.share * starts_per_connection))
        seed = (self.settings.seed, VERTEX_SEED, *stream, number)
        start = cell_starts(self.waves, balance.starts, seed, lanes, (lanes > 0).astype(float), forward.outside)
        scene = KernelScene(forward.table, forward.scattering, self.intersector, self._forward_probabilities)
        settings = replace(self.settings, max_scatters=0)

        def traced(room: int) -> LightVertexRecorder:
            recorder = LightVertexRecorder(room)
            trace_whole(scene, start, settings, [recorder])
            return recorder

        # If the cache is too small, trace the same rays again with room for all
        recorder = traced(round(ROOM * max(self.vertices_per_ray, 1.0) * lanes.sum()))
        if recorder.count > recorder.room:
            recorder = traced(recorder.count)
        self.vertices_per_ray = recorder.count / float(lanes.sum())
        return LightVertices(*recorder.read(), starts_per_connection, lanes, self.waves.extent)

    def forward_scene(self, number: int) -> KernelScene:
        """Return the kernel's scene for forward rays of wavelength index `number`, with the competing backward rays."""
        band, competing = self.forward[number], self.bands[number].scattering
        return KernelScene(
            band.table,
            band.scattering,
            self.intersector,
            self._forward_probabilities,
            competing=CompetingTrace(competing, self._probabilities, self.connects),
            windows=None if band.table.optics.scatters else self._forward_windows,
        )

    def scene(self, band: Band) -> KernelScene:
        """Return the kernel's scene for backward rays at a wavelength, without weight windows or a competing trace."""
        given = band.table, band.scattering, self.intersector, self._probabilities
        return KernelScene(*given, backward=True, closed=band.closed)

    def trace_split(self, number: int, start: StartRays, *recorders: Recorder) -> None:
        """Trace ray trees of wavelength index `number` into recorders, with weight windows, without MIS weights."""
        trace_whole(self.split_scene(number), start, self.settings, recorders)

    @contextlib.contextmanager
    def shared(self, rays: int) -> Iterator[None]:
        """Let workers, if there are any, trace passes ahead within a block that will take about `rays` rays."""
        workers = current_workers()
        if workers is None:
            yield
            return
        task = SceneTask(BackwardTrace, self._scene, (*self._arguments, self._sharing), self.kernel_arrays())
        with workers.job(task) as job:
            self._elsewhere = Ahead(self, job, workers.count(), rays)
            try:
                yield
            finally:
                self._elsewhere = None

    def make_directions(
        self, derivative: np.ndarray | None = None, maps: bool = False, mis: MisWeighting | None = None
    ) -> DirectionRecorder:
        """
        Return a zeroed recorder of light by class and cell, with `maps` also by pixel of the detector.

        `derivative` and `mis` are those of `SkyRecorder`.
        """
        pixels = self.map_size[0] * self.map_size[1] if maps else 0
        paths = self._path_sums if derivative is None else None
        return DirectionRecorder(self.grid, self.design_keys, mis, paths, pixels, derivative)

    def start_pass(self, number: int, done: int, rays: int) -> StartRays:
        """
        Return Lambertian start rays at the detector for the wavelength with index `number`, in a pass of `rays` rays.

        `rays` counts all wavelengths; `done` is the number of earlier passes.
        """
        seed = self.settings.seed + 0x9E3779B9 * (number + len(self.bands) * done)
        return self.starts[number].pass_rays(seed, *self._lanes(number, rays), self.map_size).evaluated()

    def _lanes(self, number: int, rays: int) -> tuple[int, float]:
        """
        Return the number of start rays of one wavelength in a pass of `rays` rays, and their mean start weight.

        The number is in proportion to the wavelength's share of the flux; the weight corrects its rounding.
        """
        share = self.bands[number].share
        lanes = max(BATCHES, round(rays * share / BATCHES) * BATCHES)
        return lanes, share * rays / lanes

    def paths(self) -> PathsByCell | None:
        """Return the paths so far with sums by cell, events in order from the detector; None if none are kept."""
        return None if self._path_sums is None else self.sums.paths + self._path_sums.read()

    @property
    def unit(self) -> np.ndarray:
        """PST_normal of each cell per unit mean weight of start rays, π/ΔΩ in 1/sr, (n, m)."""
        return np.asarray(np.repeat(np.pi / self.grid.solid_angle[:, None], self.grid.shape[1], axis=1))

    @property
    def rays(self) -> np.ndarray:
        """Number of start rays so far in each batch, (BATCHES,)."""
        return self.sums.rays


class Ahead:
    """
    Queue of passes traced by workers, some of them before they are requested.

    Parameters
    ----------
    trace : BackwardTrace
        Trace whose passes are done.
    job : Job
        Job that hands passes to workers.
    workers : int
        Number of workers.
    rays : int
        Number of rays that the trace will take in all.
    """

    def __init__(self, trace: BackwardTrace, job: Job, workers: int, rays: int) -> None:
        self._trace, self._job, self._workers, self._planned = trace, job, workers, rays
        self._handed_over: set[Pass] = set()

    def whole_pass(self, parts: Sequence[Pass]) -> list[BackwardSums]:
        """Return the sums of one pass for each wavelength, traced by workers, and hand later passes to them."""
        # Hand over this pass and those after it, as far as the planned rays go
        _, done, size = parts[0]
        total, number = float(self._trace.rays.sum()), done
        while number == done or (total < self._planned and number < done + AHEAD * self._workers):
            for part in (one._replace(done=number, rays=size) for one in parts):
                if part not in self._handed_over:
                    self._job.submit(part)
                    self._handed_over.add(part)
            total, number = total + size, number + 1
            size = self._trace.pass_size(number)
        # Wait for this pass
        return [self._job.result(part) for part in parts]
