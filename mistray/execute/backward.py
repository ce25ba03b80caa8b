"""Backward traces: from the detector to the sky, which is every direction that stray light can come from."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.backward_parts import Ahead, BackwardTask
from mistray.execute.fingerprint import fingerprint, kernel_arrays
from mistray.execute.workers import current_workers
from mistray.kernel.kernel_scene import BranchProbabilities, KernelScene, Opposite, WeightWindows
from mistray.kernel.launches import launches_of
from mistray.kernel.ray_tree import trace_tree
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.notes import Note
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.direction_recorder import DirectionRecorder
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.film import Film
from mistray.recorders.path_sums import PathSums, join_sums
from mistray.recorders.recorder import Recorder, Recorders
from mistray.recorders.start_rays import StartRays
from mistray.recorders.start_samples import SAMPLES, WAYS, DepartureSamples, Samples
from mistray.recorders.tallies import CHANNEL_COUNT, CUTS, SEGMENTS, SURFACE_SUMS, Tallies
from mistray.recorders.weighing import Weighing
from mistray.sampling.backward_targets import backward_targets
from mistray.sampling.design.search import design_sequences, traced_table
from mistray.sampling.detector_start import DetectorStart
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.sharing.balance import Balance, Sharing
from mistray.sampling.sharing.cell_starts import cell_starts, whole_batches
from mistray.sampling.sharing.families import FamilyShares
from mistray.sampling.sharing.light_vertices import LightVertexRecorder, LightVertices
from mistray.sampling.sources import spectrum_of
from mistray.settings import BATCHES, NO_LIMIT, Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.thin_gaps import thin_gaps
from mistray.surfaces.upload import upload

FIRST_PASS, PASS_LANES = 1 << 14, 1 << 18  # rays of the smallest passes, and of the largest
PASSES_OF_A_SIZE = 4  # a run is at most about 1 / 4 longer than was requested
PATH_SLOTS, ENTRY_SLOTS = 1 << 17, 1 << 20
VERTICES_OF_RAY, VERTEX_SEED = 1.0, 2  # points of light for one ray of a pass
ROOM = 1.3  # for points of light, over those of the pass before
FIRST_SEARCH, SEARCHES = 1 << 24, 64  # number of a pass, beyond those of any run; searches of a pilot
# Of a ray that meets all optics about so many hits scatter, and so many reflections are followed; but a surface that
# sees the sky scatters with so many times the share of its rays that get there
SCATTERS_OF_RAY, REFLECTIONS_OF_RAY, VIEWS_OF_SKY = 2.0, 4.0, 2.0


@dataclass(frozen=True)
class Band:
    """One wavelength of a trace."""

    table: SurfaceTable
    scattering: Scattering
    start: DetectorStart
    share: float


@dataclass(frozen=True)
class Rival:
    """
    The trace with the light that shares the paths of one wavelength.

    Attributes
    ----------
    scattering : Scattering
        Of rays with the light.
    balance : Balance
    """

    scattering: Scattering
    balance: Balance


class BackwardTrace:
    """
    A backward trace that can go on for as long as one likes.

    A ray leaves the detector like light from a Lambertian surface and goes on as the light came that would be detected
    there. Of light of radiance L that a cell of directions sends towards the scene, the irradiance on the detector is
    E = n² π L mean(w), where w is the weight of the rays that leave within the cell; for a distant source that is
    PST_normal = n² π/ΔΩ mean(w). The factor n², for a detector in a medium, is part of the weights.

    Parameters
    ----------
    scene : mi.Scene
    grid : DirectionGrid
    settings : Settings
    wavelength_nm : float or sequence of float, optional
        By default those of the first source, else 550 nm.
    weights : sequence of float, optional
        Shares of the flux.
    detector : str, optional
    map_pixels : int
        Longer side of the maps of the detector; 0: none.
    paths : bool
        Keep a table of the paths.
    both_sides : bool
        Light that meets the detector from behind counts as well, as in a forward trace.
    sharing : Sharing, optional
        How rays with the light share the paths; None: all are counted here.

    Attributes
    ----------
    sums : dict of str to np.ndarray
        Everything that has been counted, see `DirectionRecorder.read`, and ``surfaces``, ``media``, ``channels`` (see
        `mistray.recorders.tallies`); sums over all passes.
    passes : int
        That have been traced.
    pass_rays : list of int or None
        Rays of each of them; None if the trace has gone on from another.
    area : float
        Of the detector, mm².
    design : DesignSequences
        The sequences of the direct image; in a scene without optics light that meets nothing forms it.

    Raises
    ------
    MistrayError
        For settings that a backward trace does not know.
    """

    # More than 8 parameters: what a saved run must have in common with the one that goes on, each an argument
    def __init__(
        self,
        scene: mi.Scene,
        grid: DirectionGrid,
        settings: Settings,
        wavelength_nm: float | Sequence[float] | None = None,
        weights: Sequence[float] | None = None,
        detector: str | None = None,
        map_pixels: int = 0,
        paths: bool = False,
        both_sides: bool = True,
        sharing: Sharing | None = None,
    ) -> None:
        if settings.stokes:
            raise MistrayError("polarization is 'stokes'; backward rays know unpolarised light only")
        if settings.max_random_scatters < NO_LIMIT:
            raise MistrayError(
                f"max_random_scatters is {settings.max_random_scatters}; it limits how light is sampled, which is "
                "another thing in a backward trace: use max_scatters"
            )
        self.grid, self.settings = grid, settings
        self._scene = scene
        self._elsewhere: Ahead | None = None
        self._arguments = (grid, settings, wavelength_nm, weights, detector, map_pixels, paths, both_sides, sharing)
        self.rivals: list[Rival] = []
        self.points_of_ray = 2.0  # points of light for a start ray with the light
        self._paths_elsewhere: dict[str, np.ndarray] = {}
        wavelengths, shares = spectrum_of(scene, wavelength_nm, weights)
        self.wavelength_nm, self.weights = tuple(map(float, wavelengths)), tuple(map(float, shares))
        first = traced_table(scene, self.wavelength_nm[0], detector)
        self.intersector = Intersector(first)
        axis = np.asarray(grid.rotation)[:, 2]
        found = backward_targets(first, scene, settings, axis)
        optics = max(len(found.views), 1)
        chance = np.ones(first.count)
        for surface, share in found.views.items():
            chance[surface] = np.clip(VIEWS_OF_SKY * share, min(1.0, SCATTERS_OF_RAY / optics), 1.0)
        ghosts = dr.opaque(mi.Float, min(1.0, REFLECTIONS_OF_RAY / optics))
        self._probabilities = BranchProbabilities(upload(mi.Float, chance), ghosts)
        chance = np.ones(first.count)
        chance[list(found.views)] = min(1.0, SCATTERS_OF_RAY / optics)
        self._with_light = BranchProbabilities(upload(mi.Float, chance), ghosts)
        self.bands = []
        for wavelength, share in zip(self.wavelength_nm, self.weights, strict=True):
            table = first if wavelength == first.wavelength_nm else first.at(wavelength)
            scattering = Scattering(ScatterTables(table, found.aims, backward=True))
            light = found.light if found.light is not None else axis
            self.bands.append(Band(table, scattering, DetectorStart(table, light, found.start, both_sides), share))
        self.design = design_sequences(scene, *(band.table for band in self.bands), free=True)
        self.design_keys = DesignKeys(self.design, first.detector)
        start = self.bands[0].start
        self.table, self.area, self.extent = first, start.area, start.extent
        long_side = max(start.width, start.height)
        self.map_size = (
            (max(1, round(map_pixels * start.width / long_side)), max(1, round(map_pixels * start.height / long_side)))
            if map_pixels
            else (0, 0)
        )
        self._path_sums = self.new_paths() if paths else None
        corner_x, corner_y, per_mm_x, per_mm_y = (dr.opaque(mi.Float, v) for v in (0.0, 0.0, 1.0, 1.0))
        self.film = Film(1, 1, corner_x, corner_y, per_mm_x, per_mm_y, groups=1)
        self.passes = 0
        self.pass_rays: list[int] | None = []
        self.seconds = 0.0
        self.sums: dict[str, np.ndarray] = {}
        if sharing is not None:
            self.share_paths(sharing)

    def share_paths(self, sharing: Sharing) -> None:
        """Share the paths with rays that follow the light from now on, see `mistray.sampling.sharing.balance`."""
        self._arguments = (*self._arguments[:-1], sharing)
        windows = np.zeros((2, self.table.count, WAYS)) if sharing.windows is None else sharing.windows
        many, few = windows[0], np.where(windows[1] > 0, windows[1], np.inf)
        self._windows = WeightWindows(upload(mi.Float, many.ravel()), upload(mi.Float, few.ravel()))
        if self.rivals:
            self.rivals = [replace(one, balance=one.balance.at(sharing)) for one in self.rivals]
            return
        targets = importance_targets(self.table, self._scene, self.settings)
        self.rivals = [
            Rival(
                Scattering(ScatterTables(band.table, targets)),
                Balance(sharing, self.grid, band.start, band.table.centre),
            )
            for band in self.bands
        ]

    @property
    def notes(self) -> list[Note]:
        """Gaps too thin for float32, and what was assumed of the media, see `Optics.notes`."""
        return [
            *thin_gaps(self.table),
            *dict.fromkeys(text for band in self.bands for text in (*band.table.optics.notes, *band.start.notes)),
        ]

    @property
    def lists_paths(self) -> bool:
        """Whether there is a table of the paths."""
        return self._path_sums is not None

    def go_on_from(self, sums: dict[str, np.ndarray], passes: int, seconds: float) -> None:
        """Take over what another trace with the same arguments has counted."""
        self.sums, self.passes, self.seconds = dict(sums), passes, seconds
        self.pass_rays = None

    @property
    def next_pass(self) -> int:
        """Rays of the next pass."""
        return self.pass_size(self.passes)

    @staticmethod
    def pass_size(number: int) -> int:
        """Rays of a pass: few at first, so that there is a result after seconds, and later a quarter of all before."""
        return min(FIRST_PASS << max(0, number // PASSES_OF_A_SIZE - 1), PASS_LANES)

    def advance(self, rays: int | None = None) -> None:
        """Trace one more pass of about so many rays, by default `next_pass`; `sums` grow."""
        rays = self.next_pass if rays is None else rays
        started = time.perf_counter()
        sums_of_paths: list[dict[str, np.ndarray]] = []
        # What an interrupt leaves out is a whole pass
        if self._elsewhere is None:
            new = [self.band_sums(number, self.passes, rays) for number in range(len(self.bands))]
        else:
            new, sums_of_paths = self._elsewhere.whole_pass(self.passes, rays)
        for sums in new:
            self._add(sums)
        for found in sums_of_paths:
            before = self._paths_elsewhere
            self._paths_elsewhere = join_sums(before, found) if before else found
        self.passes += 1
        if self.pass_rays is not None:
            self.pass_rays.append(rays)
        self.seconds += time.perf_counter() - started

    def band_sums(self, number: int, done: int, rays: int) -> dict[str, np.ndarray]:
        """What a pass of so many rays, after so many passes, adds to `sums` at one wavelength."""
        one = self.bands[number]
        vertices = self.light_vertices(number, (0, done), rays)
        sky = self.make_directions(maps=True, weighing=self.balance(number, vertices))
        tallies = Tallies(one.table.count, len(one.table.optics.media))
        start = self.start_pass(number, done, rays)
        self.trace_shared(number, start, vertices, tallies, sky)
        # Sums by surface are in the order of the first wavelength's media
        return sky.read() | {
            "surfaces": np.array(tallies.surfaces).reshape(-1, SURFACE_SUMS, BATCHES)[: one.table.count],
            "media": self._by_medium(one.table, np.array(tallies.media).reshape(-1, BATCHES)),
            "channels": np.array(tallies.channels).reshape(CHANNEL_COUNT, BATCHES),
            "rays": np.full(BATCHES, rays * one.share / BATCHES),
        }

    def samples(self, rays: int, number: int, values: np.ndarray | None = None) -> list[Samples]:
        """
        Light that arrives, from rays that are in no sums, by wavelength.

        Parameters
        ----------
        rays : int
            In passes of at most `PASS_LANES`, so that memory is bounded.
        number : int
            Of this search, below `SEARCHES`: another number is another sample.
        values : (c,) float64, optional
            See `DepartureSamples`; None: `Samples.worth` is of no use.
        """
        found = []
        if values is None:
            values = np.zeros(self.unit.size)
        passes = max(1, -(-rays // PASS_LANES))
        here = rays // passes
        for band in range(len(self.bands)):
            parts = []
            for k in range(passes):
                stream = number + SEARCHES * k
                vertices = self.light_vertices(band, (1, stream), here)
                balance = self.balance(band, vertices)
                assert balance is not None
                room = SAMPLES // passes
                recorder = DepartureSamples(self.grid, self.design_keys, balance, self.table.count, values, room)
                self.trace_shared(band, self.start_pass(band, FIRST_SEARCH + stream, here), vertices, recorder)
                parts.append(recorder.read())
            found.append(Samples.together(parts, here))
        return found

    def trace_shared(self, number: int, start: StartRays, vertices: LightVertices | None, *recorders: Recorder) -> None:
        """Trace the trees of some start rays of a wavelength, whose paths are shared if any are."""
        scene = self.split_scene(number)
        if self.rivals:
            opposite = Opposite(self.rivals[number].scattering, self._with_light, self.connects)
            scene = replace(scene, opposite=opposite, connections=vertices)
        self._launch(scene, start, recorders)

    def split_scene(self, number: int) -> KernelScene:
        """What the kernel traces at a wavelength, with rays split where a pilot says that they matter."""
        band = self.bands[number]
        # What a medium scatters is sent on by the chance of the surface behind it, which knows nothing of its worth
        windows = self._windows if self.rivals and not band.table.optics.scatters else None
        return replace(self.scene(band), windows=windows)

    @property
    def connects(self) -> bool:
        """Whether rays are connected to points of light, see `mistray.sampling.sharing.light_vertices`."""
        return bool(self.rivals) and self.rivals[0].balance.sharing.connects

    @property
    def scatters(self) -> bool:
        """Whether anything scatters."""
        return any(self.scene(one).scatters(self.settings) for one in self.bands)

    @property
    def may_connect(self) -> bool:
        """Whether they can be: at surfaces, where light is scattered twice, and rays with it are not left to chance."""
        settings, optics = self.settings, self.table.optics
        surfaces = any(one.scattering.any for one in self.bands) and not optics.scatters
        return surfaces and settings.max_scatters > 1 and settings.splitting == "split" and not optics.one_child

    def balance(self, number: int, vertices: LightVertices | None, same_rays: bool = False) -> Balance | None:
        """
        Who counts how much of a path at a wavelength; None: there are rays of one direction only.

        With `same_rays` light that nothing scatters has no rays of its own.
        """
        if not self.rivals:
            return None
        balance = self.rivals[number].balance
        if same_rays and balance.sharing.unscattered is not None:
            balance = balance.at(replace(balance.sharing, unscattered=None))
        return balance if vertices is None else balance.beside(vertices)

    def family_shares(self) -> FamilyShares | None:
        """Who counts how much of a path where it moves; None: there are rays of one direction only."""
        if not self.rivals:
            return None
        families = self.rivals[0].balance.sharing.families
        assert families is not None
        return FamilyShares(families.shares(), self.design_keys)

    def light_vertices(self, number: int, stream: tuple[int, int], rays: int) -> LightVertices | None:
        """Points of light for a pass of so many rays, if rays are connected to any; a stream for each pass."""
        if not self.connects:
            return None
        rival, one = self.rivals[number], self.bands[number]
        linked = rival.balance.sharing.linked
        lanes = whole_batches(np.ceil(VERTICES_OF_RAY * rays * one.share * linked))
        seed = (self.settings.seed, VERTEX_SEED, *stream, number)
        start = cell_starts(rival.balance, seed, lanes, (lanes > 0).astype(float))
        scene = KernelScene(one.table, rival.scattering, self.intersector, self._with_light)
        settings = replace(self.settings, max_scatters=0)

        def traced(room: int) -> LightVertexRecorder:
            recorder = LightVertexRecorder(room)
            launches = launches_of(one.table, settings, recorder.code)
            launches.whole(start, lambda part: trace_tree(scene, part, settings, [recorder]))
            return recorder

        recorder = traced(round(ROOM * max(self.points_of_ray, 1.0) * lanes.sum()))
        if recorder.count > recorder.room:
            recorder = traced(recorder.count)
        self.points_of_ray = recorder.count / float(lanes.sum())
        return LightVertices(*recorder.read(), linked, lanes, rival.balance.extent)

    def rival_scene(self, number: int) -> KernelScene:
        """What rays with the light that share the paths of a wavelength trace."""
        band, scattering = self.bands[number], self.rivals[number].scattering
        opposite = Opposite(band.scattering, self._probabilities, self.connects)
        return KernelScene(band.table, scattering, self.intersector, self._with_light, opposite=opposite)

    def scene(self, band: Band) -> KernelScene:
        """What the kernel traces at a wavelength."""
        return KernelScene(band.table, band.scattering, self.intersector, self._probabilities, backward=True)

    def trace_split(self, number: int, start: StartRays, *recorders: Recorder) -> None:
        """Trace the trees of some start rays of a wavelength, with those split that matter, and no others beside."""
        self._launch(self.split_scene(number), start, recorders)

    def _launch(self, scene: KernelScene, start: StartRays, recorders: Sequence[Recorder]) -> None:
        def trace(part: StartRays) -> None:
            trace_tree(scene, part, self.settings, recorders)

        shared = None if scene.opposite is None else scene.opposite.connects
        launches_of(scene.table, self.settings, Recorders(recorders).code, shared).whole(start, trace)

    def adjoint(self, derivative: np.ndarray, weighing: Weighing | None = None) -> Adjoint:
        """The gain of a metric, see `make_directions`."""
        return Adjoint(0, self.film, directions=self.make_directions(derivative, weighing=weighing))

    def forget_paths(self) -> None:
        """Empty the table of the paths."""
        if self._path_sums is not None:
            self._path_sums = self.new_paths()

    def new_paths(self) -> PathSums:
        """An empty table of paths by cell."""
        return PathSums(PATH_SLOTS, ENTRY_SLOTS, self.settings.max_events, int(np.prod(self.grid.shape)))

    @contextlib.contextmanager
    def shared(self, rays: int) -> Iterator[None]:
        """Let other processes, if there are any, trace the passes of the block, which take so many rays in all."""
        workers = current_workers()
        if workers is None:
            yield
            return
        with workers.job(BackwardTask(self._scene, self._arguments, self.kernel_arrays())) as job:
            self._elsewhere = Ahead(self, job, workers.count(), rays)
            try:
                yield
            finally:
                self._elsewhere = None

    def make_directions(
        self, derivative: np.ndarray | None = None, maps: bool = False, weighing: Weighing | None = None
    ) -> DirectionRecorder:
        """Sums at zero for one pass, or with a derivative what tells the gain of a metric, see `DirectionRecorder`."""
        pixels = self.map_size[0] * self.map_size[1] if maps else 0
        paths = self._path_sums if derivative is None else None
        return DirectionRecorder(self.grid, self.design_keys, pixels, paths, derivative, weighing)

    def start_pass(self, number: int, done: int, rays: int) -> StartRays:
        """The start rays of a wavelength in a pass of so many rays, after so many passes."""
        one = self.bands[number]
        lanes = max(BATCHES, round(rays * one.share / BATCHES) * BATCHES)
        seed = self.settings.seed + 0x9E3779B9 * (number + len(self.bands) * done)
        # The share of a wavelength is that of its rays, but for rounding
        start = one.start.pass_rays(seed, lanes, one.share * rays / lanes, self.map_size)
        dr.eval(
            start.lane,
            start.batch,
            start.rng,
            start.o,
            start.d,
            start.w,
            start.left,
            start.normal,
            start.pixel,
            start.medium,
        )
        return start

    def _by_medium(self, table: SurfaceTable, sums: np.ndarray) -> np.ndarray:
        """Rows of media in the order of the first wavelength, where numbers by index may fall together otherwise."""
        names = self.table.optics.media
        found = np.zeros((len(names), BATCHES))
        for name, row in zip(table.optics.media, sums, strict=True):
            found[names.index(name) if name in names else 0] += row
        return found

    def _add(self, more: Mapping[str, np.ndarray]) -> None:
        for key, values in more.items():
            if key == "largest":
                self.sums[key] = np.maximum(self.sums.get(key, 0.0), values)
            else:
                self.sums[key] = self.sums.get(key, 0.0) + values

    @property
    def fingerprint(self) -> str:
        """Hash of all that the kernel reads: geometry, coatings, media, scatter, of every wavelength."""
        return fingerprint((one.table, one.scattering) for one in self.bands)

    def kernel_arrays(self) -> list[list[np.ndarray]]:
        """What the kernel reads, for each wavelength."""
        return [kernel_arrays(one.table, one.scattering) for one in self.bands]

    def paths(self) -> dict[str, np.ndarray] | None:
        """The path table so far, see `PathSums.read`."""
        if self._path_sums is None:
            return None
        here = self._path_sums.read()
        return join_sums(self._paths_elsewhere, here) if self._paths_elsewhere else here

    @property
    def unit(self) -> np.ndarray:
        """(n, m) PST_normal of a mean weight of 1 of the start rays."""
        return np.asarray(np.repeat(np.pi / self.grid.solid_angle[:, None], self.grid.shape[1], axis=1))

    @property
    def rays(self) -> np.ndarray:
        """(BATCHES,) rays that have been started, by batch."""
        return np.asarray(self.sums.get("rays", np.zeros(BATCHES)))

    @property
    def segments(self) -> float:
        """Ray segments that have been traced."""
        return float(self.sums["channels"][SEGMENTS].sum())

    @property
    def lost(self) -> np.ndarray:
        """(BATCHES,) weight that limits and thresholds cut, and what random choices have taken or added so far."""
        return np.asarray(self.sums["channels"][list(CUTS.values())].sum(axis=0))
