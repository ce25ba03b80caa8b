"""Forward runs of the cells of a point source transmittance: a plane wave each, with as many rays as required."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.execute.by_parts import SceneTask, tables_of
from mistray.execute.tracer import Run
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.notes import Note
from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.direction_recorder import CLASSES
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.film import Film, Pixels, groups_of
from mistray.recorders.path_events import DIRECT, Events, describe_events, way
from mistray.recorders.path_key import host_keys, padded
from mistray.recorders.sampled import batch_error
from mistray.recorders.tallies import SCATTERED_FLUX, SEGMENTS
from mistray.sampling.design.search import design_sequences, traced_table
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.outlines import detector_area
from mistray.sampling.plane_wave import Entrance, PlaneWaves, hull_points
from mistray.settings import BATCHES, Settings
from mistray.surfaces.intersect import Intersector
from mistray.time_budget import time_is_up

if TYPE_CHECKING:
    import pandas as pd

FIRST_RAYS = 1 << 15  # rays of the first pass of a cell whose error is requested
DARK_RAYS = 1 << 22  # rays without light after which a cell is given up


@dataclass(kw_only=True)
class CellRun(Run):
    """
    Forward run whose film records the light that meets the detector, absorbed or not.

    Attributes
    ----------
    map_size : tuple of int
        Numbers of columns and rows of pixels.
    """

    map_size: tuple[int, int] = (1, 1)

    def make_film(self, detector: int | None = None) -> Film:
        """Return the pixel grid of the map."""
        x0, x1, y0, y1 = self.table.film(detector)[2]
        columns, rows = self.map_size
        corner_x, corner_y, per_mm_x, per_mm_y = (
            dr.opaque(mi.Float, v) for v in (x0, y0, columns / (x1 - x0), rows / (y1 - y0))
        )
        return Film(columns, rows, corner_x, corner_y, per_mm_x, per_mm_y, groups_of(columns * rows), incident=True)


class Ways:
    """
    Distinct paths of the light found so far; aimed and random scatter are not told apart.

    Parameters
    ----------
    ids : sequence of str
        Names of the places of events.
    words : (s,) uint32
        Bits of these places, see `mistray.recorders.path_events.describe_events`.
    design : DesignSequences
        Sequences of the direct image.

    Attributes
    ----------
    classes : (w,) int
        Number of the class of each path within `CLASSES`.
    """

    def __init__(self, ids: Sequence[str], words: np.ndarray, design: DesignSequences) -> None:
        self._ids, self._words, self._design = ids, words, design
        self._numbers: dict[int, int] = {}
        # Columns of no paths first: a scene may be dark
        self._facts = [describe_events(Events(*padded([]), ids, words, design))]
        self.classes = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._numbers)

    def number(self, events: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Return the numbers of the paths of event lists, (p,), see `DecodedPaths`."""
        ways = way(events)
        keys, first, place = np.unique(host_keys(ways, lengths), return_index=True, return_inverse=True)
        # Classify the paths that are new
        new = [k for k, key in enumerate(keys.tolist()) if key not in self._numbers]
        if new:
            found = Events(ways[first[new]], lengths[first[new]], self._ids, self._words, self._design)
            facts = describe_events(found)
            self._numbers |= {int(keys[k]): len(self._numbers) + n for n, k in enumerate(new)}
            self._facts.append(facts)
            # The kernel counts a reflection at a beam splitter even if a design sequence has one
            counted = replace(found, design=DesignSequences()).reflected
            self.classes = np.concatenate([self.classes, _classes(facts, np.asarray(counted.any(axis=1)))])
        return np.array([self._numbers[key] for key in keys.tolist()], dtype=np.int64)[place]

    def table(self, chosen: np.ndarray) -> pd.DataFrame:
        """Return the columns of `describe_events` of some paths."""
        import pandas as pd

        whole = {name: np.concatenate([facts[name] for facts in self._facts]) for name in self._facts[0]}
        return pd.DataFrame({name: column[chosen] for name, column in whole.items()})


def _classes(facts: dict[str, np.ndarray], reflected: np.ndarray) -> np.ndarray:
    """Return numbers of the classes of paths, (w,), from `describe_events` and whether a reflection counts."""
    scatters = facts["scatters"]
    # The first condition that holds decides
    names = np.select(
        [
            (scatters > 0) & (scatters == facts["diffractions"]),
            scatters > 1,
            scatters == 1,
            facts["kind"] == DIRECT,
            reflected,
        ],
        ["edge_diffraction", "multiple_scatter", "single_scatter", "direct", "ghost"],
        "straight_shot",
    )
    return np.array([CLASSES.index(name) for name in names], dtype=np.int64)


@dataclass
class Sums:
    """
    Sums of the runs of one wavelength in one cell, in units of the flux of a start ray.

    Attributes
    ----------
    ways : (w, BATCHES) float64
        Flux that meets the detector by each path.
    hits : (w,) float64
        Number of hits by each path.
    started : (BATCHES,) float64
        Number of start rays.
    film : (g, h, w) float64
        Flux in each pixel by group of batches.
    largest, scattered : float
        Largest absorbed flux of a scattered ray at the detector, and the absorbed flux of all scattered rays.
    segments : float
        Number of ray segments.
    """

    ways: np.ndarray = field(default_factory=lambda: np.zeros((0, BATCHES)))
    hits: np.ndarray = field(default_factory=lambda: np.zeros(0))
    started: np.ndarray = field(default_factory=lambda: np.zeros(BATCHES))
    film: np.ndarray = field(default_factory=lambda: np.zeros((1, 1, 1)))
    largest: float = 0.0
    scattered: float = 0.0
    segments: float = 0.0

    def add(self, run: Run, ways: Ways) -> None:
        """Add the results of a run."""
        assert run.paths is not None
        # A run may find new paths
        number = ways.number(run.paths.events, run.paths.lengths)
        self.widen(len(ways))
        np.add.at(self.ways, number, run.paths.sums[:, :, 1])
        np.add.at(self.hits, number, run.paths.sums[:, :, 0].sum(axis=1))
        self.started = self.started + run.started
        self.film = self.film + run.film
        self.largest = max(self.largest, run.largest)
        self.scattered += float(run.channels[SCATTERED_FLUX].sum())
        self.segments += float(run.channels[SEGMENTS].sum())

    def widen(self, count: int) -> None:
        """Extend the arrays to so many paths."""
        more = count - len(self.hits)
        self.ways = np.concatenate([self.ways, np.zeros((more, BATCHES))])
        self.hits = np.concatenate([self.hits, np.zeros(more)])


@dataclass(frozen=True)
class Cell:
    """
    PST_normal of one cell of directions.

    Attributes
    ----------
    parts : (c, BATCHES) float64
        Part of each batch of start rays in each class of light.
    weight : (BATCHES,) float64
        Fraction of the start rays in each batch.
    largest_share : float
        See `Pst`; NaN without scattered light.
    rays, segments : int
        Numbers of start rays and of ray segments.
    beam_area : float
        Cross-section of the beam, mm².
    rows : DataFrame, optional
        Paths of the light: the columns of `Pst.path_rows` except for those of the cell.
    map : (2, h, w) float64, optional
        PST_normal of each pixel and its standard error.
    """

    parts: np.ndarray
    weight: np.ndarray
    largest_share: float
    rays: int
    segments: int
    beam_area: float
    rows: pd.DataFrame | None = None
    map: np.ndarray | None = None

    @classmethod
    def not_traced(cls, like: Cell) -> Cell:
        """Make a cell that was not traced for lack of time, shaped like a traced one: its numbers are NaN."""
        return cls(
            parts=np.full_like(like.parts, np.nan),
            weight=np.full_like(like.weight, 1 / len(like.weight)),
            largest_share=np.nan,
            rays=0,
            segments=0,
            beam_area=np.nan,
            map=None if like.map is None else np.full_like(like.map, np.nan),
        )

    @property
    def error(self) -> float:
        """Relative standard error of all light together; infinite if there is none, NaN if not traced."""
        if not self.rays:
            return np.nan
        total = self.parts.sum(axis=0)
        value = float(total.sum())
        return float(batch_error(total, self.weight)) / value if value > 0 else np.inf

    @property
    def by_batch(self) -> np.ndarray:
        """PST_normal of each class from each batch alone, (c, BATCHES)."""
        return np.divide(self.parts, self.weight, out=np.zeros_like(self.parts), where=self.weight > 0)


class CellPass(NamedTuple):
    """
    Task of tracing a cell.

    Attributes
    ----------
    i, j : int
        Numbers of its field angle and azimuth.
    rays : int
        Largest number of start rays.
    wanted_error : float or None
        Relative standard error of all light at which the cell is done; each pass doubles the rays. None: one pass of
        all rays.
    paths : bool
        Whether to list the paths of the light.
    """

    i: int
    j: int
    rays: int
    wanted_error: float | None = None
    paths: bool = True


class ForwardCells:
    """
    Forward runs of the cells of a grid; the kernel is compiled once, so that further cells cost only their rays.

    Parameters
    ----------
    scene : mi.Scene
    grid : DirectionGrid
    settings : Settings
        Settings, except for the number of rays.
    spectrum : two (k,) float64
        Wavelengths and their fractions of the flux.
    detector : str, optional
    entrance : Entrance, optional
    map_pixels : int
        Longer side of the maps; 0: none.
    points : (p, 3) float64, optional
        Hull of the illuminated volume, from `hull_points`; by default that of the scene.

    Attributes
    ----------
    progress : callable or None
        Called after each pass of a cell with the cell, its rays so far and its relative error.
    """

    def __init__(
        self,
        scene: mi.Scene,
        grid: DirectionGrid,
        settings: Settings,
        spectrum: tuple[np.ndarray, np.ndarray],
        detector: str | None = None,
        entrance: Entrance | None = None,
        map_pixels: int = 0,
        points: np.ndarray | None = None,
    ) -> None:
        self.settings, self.grid, self.entrance = settings, grid, entrance
        self.wavelengths_nm, self.shares = spectrum
        self.table = traced_table(scene, float(self.wavelengths_nm[0]), detector, settings.stokes)
        self.area = detector_area(self.table)
        # Maps with square pixels
        width, height, self.extent = self.table.film()
        pixels = max(map_pixels, 1) / max(width, height)
        self._map_size = max(1, round(pixels * width)), max(1, round(pixels * height))
        self.has_maps = map_pixels > 0
        self._waves = PlaneWaves(hull_points(self.table) if points is None else points, grid, entrance)
        intersector, targets = Intersector(self.table), importance_targets(self.table, scene, settings)
        self._runs = []
        # A run for each wavelength; source, rays and seed are set for each pass of a cell
        for wavelength, share in zip(self.wavelengths_nm.tolist(), self.shares.tolist(), strict=True):
            table = self.table if wavelength == self.table.wavelength_nm else self.table.at(wavelength)
            scattering = Scattering(ScatterTables(table, targets))
            wave = self._waves.at(0, 0, wavelength, share)
            self._runs.append(
                CellRun(
                    source=wave,
                    table=table,
                    scattering=scattering,
                    intersector=intersector,
                    settings=settings,
                    rays=0,
                    seed=0,
                    unit=0.0,
                    map_size=self._map_size,
                )
            )
        design = design_sequences(scene, *(run.table for run in self._runs), free=True)
        self._ways = Ways(self.table.event_ids, self.table.event_words, design)
        self.progress: Callable[[CellPass, int, float], None] | None = None

    @property
    def notes(self) -> list[Note]:
        """Assumptions about the media, see `Optics.notes`."""
        return list(dict.fromkeys(text for run in self._runs for text in run.table.optics.notes))

    def kernel_arrays(self) -> list[list[np.ndarray]]:
        """Return the arrays that the kernel reads, for each wavelength."""
        return tables_of(self._runs)

    def cell(self, part: CellPass) -> Cell:
        """Trace a cell, and report to `progress` after each of its passes."""
        i, j, rays, wanted_error, paths = part
        sums = [Sums() for _ in self._runs]
        passes = done = 0
        todo = rays if wanted_error is None else min(FIRST_RAYS, rays)
        while True:
            for k, run in enumerate(self._runs):
                self._trace(run, sums[k], (i, j, passes, k), todo)
            passes, done = passes + 1, done + todo
            found = self._cell(sums)
            if self.progress:
                self.progress(part, done, found.error)
            # Done by error, time or rays; a cell without light so far ends earlier
            enough = time_is_up() or (wanted_error is not None and found.error <= wanted_error)
            if enough or done >= (rays if np.isfinite(found.error) else min(rays, DARK_RAYS)):
                return self._with_details(found, sums, paths)
            todo = min(done, rays - done)

    def _trace(self, run: CellRun, sums: Sums, stream: tuple[int, int, int, int], rays: int) -> None:
        i, j, _, k = stream
        run.source = self._waves.at(i, j, run.table.wavelength_nm, float(self.shares[k]))
        run.rays = max(1, round(rays * self.shares[k]))
        # Angle, azimuth, pass and wavelength make the seed: every cell has its own rays
        run.seed = int(np.random.SeedSequence((self.settings.seed, *stream)).generate_state(1)[0])
        run.unit = run.source.power / run.rays
        run.execute(True, None)
        sums.add(run, self._ways)

    def _scales(self, sums: Sequence[Sums]) -> list[float]:
        """Return the PST_normal of a start ray that arrives with all its flux, by wavelength."""
        return [run.source.power / (self.area * part.started.sum()) for run, part in zip(self._runs, sums, strict=True)]

    def _parts(self, sums: Sequence[Sums]) -> np.ndarray:
        """Return the part of each batch in the PST_normal of each path, (w, BATCHES)."""
        for part in sums:
            part.widen(len(self._ways))
        return np.asarray(sum(scale * part.ways for scale, part in zip(self._scales(sums), sums, strict=True)))

    def _cell(self, sums: Sequence[Sums]) -> Cell:
        """Return the cell from the sums of the wavelengths, without paths and map."""
        parts = np.zeros((len(CLASSES), BATCHES))
        np.add.at(parts, self._ways.classes, self._parts(sums))
        weight = sum(share * part.started / part.started.sum() for share, part in zip(self.shares, sums, strict=True))
        # Strongest scattered ray over all scattered light
        scales = self._scales(sums)
        scattered = sum(scale * part.scattered for scale, part in zip(scales, sums, strict=True))
        largest = max(scale * part.largest for scale, part in zip(scales, sums, strict=True))
        return Cell(
            parts=parts,
            weight=np.asarray(weight),
            largest_share=largest / scattered if scattered > 0 else np.nan,
            rays=round(sum(part.started.sum() for part in sums)),
            segments=round(sum(part.segments for part in sums)),
            beam_area=sum(run.source.power for run in self._runs),  # the power of all wavelengths together at 1 W/mm²
        )

    def _with_details(self, cell: Cell, sums: Sequence[Sums], paths: bool) -> Cell:
        """Return the cell with its paths and its map, if requested."""
        rows = self._rows(cell, sums) if paths else None
        return replace(cell, rows=rows, map=self._map(sums) if self.has_maps else None)

    def _rows(self, cell: Cell, sums: Sequence[Sums]) -> pd.DataFrame:
        parts = self._parts(sums)
        hits = np.sum([part.hits for part in sums], axis=0)
        met = np.flatnonzero(hits)
        rows = self._ways.table(met)
        rows["rays"] = hits[met].astype(np.int64)
        rows["pst_normal"] = parts[met].sum(axis=1)
        rows["pst_normal_se"] = batch_error(parts[met], cell.weight)
        return rows.sort_values("pst_normal", ascending=False, kind="stable", ignore_index=True)

    def _map(self, sums: Sequence[Sums]) -> np.ndarray:
        columns, rows = self._map_size
        x0, x1, y0, y1 = self.extent
        pixels = self.area * columns * rows / ((x1 - x0) * (y1 - y0))  # on the detector
        first, *others = (
            Pixels.of_film(part.film, part.started, pixels * scale)
            for part, scale in zip(sums, self._scales(sums), strict=True)
        )
        found = sum(others, start=first)
        return np.stack([found.value, found.se])


class CellsTask(SceneTask):
    """Cells of a grid, for `mistray.execute.passes`."""

    def make(self) -> ForwardCells:
        """Make the cells at a worker."""
        cells: ForwardCells = self.build(ForwardCells)
        return cells

    def do(self, made: ForwardCells, part: CellPass) -> Cell:
        """Trace a cell."""
        return made.cell(part)
