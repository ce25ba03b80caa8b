"""Point source transmittance by forward rays alone, in rounds over all cells of directions."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, replace

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.cells import cells_up_to
from mistray.analyses.pst.found_paths import FoundPaths
from mistray.analyses.pst.progress import Progress, PstProgress
from mistray.analyses.pst.request import PstRequest
from mistray.analyses.pst.result import Pst, notes
from mistray.execute.all_cells import AllCells
from mistray.execute.cell_sums import WaveSums
from mistray.execute.grid_trace import WaveTrace
from mistray.execute.scene_task import SceneTask
from mistray.execute.workers import current_workers, passes_by_workers
from mistray.light import Light
from mistray.messages import Message
from mistray.percent import percent_text
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.plane_wave import Entrance
from mistray.scene.check import require_scene
from mistray.settings import BATCHES, Settings
from mistray.time_budget import TimeShares, coarse_first, is_limited, not_traced, time_is_up

FIRST_RAYS = 1 << 15  # rays of the first round of a cell whose error is requested; each further one doubles them
DARK_RAYS = 1 << 22  # rays without light after which a cell is given up


def forward_pst(
    scene: mi.Scene,
    grid: DirectionGrid,
    request: PstRequest | None = None,
    *,
    entrance: Entrance | None = None,
    points: np.ndarray | None = None,
    progress: Progress | None = None,
    settings: Settings | None = None,
) -> Pst:
    """
    Compute the point source transmittance (PST) by forward rays from each cell of directions.

    A plane wave of 1 W/mm² lights the whole scene from directions that are uniform within the cell. Errors of cells are
    independent.

    Parameters
    ----------
    scene : mi.Scene
        Scene of `mistray.load`; its sources only determine the wavelengths.
    grid : DirectionGrid
        Cells of field angle and azimuth.
    request : PstRequest, optional
        Light, detector, paths and maps, and the requested error. With `relative_error` the rays of a cell are doubled
        until the standard error of all light together over its value is at most this. A cell in which no light is
        found has `DARK_RAYS` at most, and cells of field angles beyond `error_up_to_deg` end with the first
        `FIRST_RAYS` rays. The angles are those of `grid`. Default: no error requested, with all other defaults.
    entrance : Entrance, optional
        Disc through which alone light is traced; None: light covers the whole scene.
    points : (p, 3) float64, optional
        Hull of the illuminated volume, mm, see `mistray.sampling.plane_wave.hull_points`. Default: that of the scene.
    progress : callable, optional
        Called with a `PstProgress` after each pass.
    settings : Settings, optional
        Settings with the start rays of a cell, or their largest number if an error is requested. Default: those of
        `request` and the scene.

    Returns
    -------
    Pst
        PST in the convention "normal". ``facts`` hold detector, detector_area_mm2, wavelength_nm, weights, rays (of all
        cells together), seconds, segments, settings, seed, relative_error, error_up_to_deg, entrance, rays_of_cell and
        beam_area_mm2 (n, m); ``unseen``: cells (angle, azimuth) in which no light was found, whose PST of 0 is an upper
        limit only by the number of their rays; ``unfinished``: cells whose error is larger than requested;
        ``not_traced``: cells for which a time budget was too short, whose values are NaN; ``notes``: these facts in
        words, and other notes on the reliability.

    Raises
    ------
    MistrayError
        If an argument is out of range, the scene has no detector, or where `mistray.trace` raises.
    UnfinishedError
        If workers of `mistray.distribute` are lost; ``partial`` has the sums of finished cells by their indices.
    """
    # Arguments and defaults
    require_scene(scene, "forward_pst")
    request = PstRequest(method="forward") if request is None else request
    settings = request.settings_for(scene) if settings is None else settings
    # Trace all cells: by workers, or within a time budget, one by one, else together
    arguments = (grid, settings, request, entrance, points)
    rounds = CellRounds(scene, *arguments)
    rounds.progress = progress
    numbers = {name: number for number, name in enumerate(np.ndindex(*grid.shape))}
    if (workers := current_workers()) is not None:
        task = SceneTask(CellRounds, scene, arguments, rounds.kernel_arrays())
        passes_by_workers(workers, task, numbers, "cells", rounds.add)
    elif is_limited():
        # Coarse steps over all cells come first, so that those that are traced are spread evenly
        shares, order = TimeShares(len(numbers)), iter(coarse_first(list(numbers.values())))
        while shares.enough() and (cell := next(order, None)) is not None:
            with shares.one():
                rounds.trace_cells([cell])
    else:
        rounds.trace_cells(list(numbers.values()))
    return rounds.result()


class CellRounds:
    """
    Forward PST in rounds, each of which traces more rays for the cells of directions that are not finished.

    Parameters
    ----------
    scene, grid, settings, request, entrance, points
        See `forward_pst`.

    Attributes
    ----------
    trace : WaveTrace
        Trace of the cells.
    light : AllCells
        Forward rays, with their sums so far.
    progress : callable or None
        Called with a `PstProgress` after each pass; None: nothing is called.
    """

    def __init__(
        self,
        scene: mi.Scene,
        grid: DirectionGrid,
        settings: Settings,
        request: PstRequest,
        entrance: Entrance | None,
        points: np.ndarray | None,
    ) -> None:
        counts = cells_up_to(grid, request.error_up_to_deg).ravel() & (request.relative_error is not None)
        light = Light(**request.light)
        self.trace = WaveTrace(
            scene, grid, settings, light, int(request.map_pixels), request.paths, entrance=entrance, points=points
        )
        self.light = AllCells(self.trace)
        self.progress: Progress | None = None
        self._request, self._entrance, self._counts = request, entrance, counts
        # Largest number of rays of each cell, rays of its first round, and the error at which it is done
        self._requested = request.relative_error
        self._most = np.full(len(counts), settings.rays)
        self._first = self._most
        if self._requested is not None:
            self._first = np.minimum(self._most, FIRST_RAYS)
            self._most = np.where(counts, self._most, self._first)
        self._open = np.ones(len(counts), dtype=bool)  # cells that are not done
        self._error = np.full(len(counts), np.inf)  # relative standard error of all light of each cell
        self._began = time.perf_counter()
        self._of_round, self._in_round = 0.0, 0.0  # rays of the present round, and those that are traced
        self.light.after_pass = self._after_pass

    def kernel_arrays(self) -> list[list[np.ndarray]]:
        """Return the scene arrays that the kernel reads, one list for each wavelength."""
        return self.trace.kernel_arrays()

    def trace_cells(self, cells: Sequence[int]) -> None:
        """Trace the cells with these indices until each has the requested error or all its rays, or the time is up."""
        light = self.light
        going = np.isin(np.arange(len(self._open)), cells)
        goal, number = np.where(going, self._first, light.rays), 0
        while going.any():
            step = np.where(going, goal - light.rays, 0)
            # A time budget ends a cell between two launches
            if is_limited():
                step = np.minimum(step, BATCHES * max(light.lanes / len(cells) // BATCHES, 1))
            self._of_round = float(step.sum())
            light.go_on(light.rays + step, number)
            number, self._in_round = number + 1, 0.0
            self._judge()
            going &= self._open & (not time_is_up())
            self._open[cells] = going[cells]
            self._report()
            goal = np.where(going & (light.rays >= goal), np.minimum(2 * goal, self._most), goal)

    def do(self, part: int) -> WaveSums:
        """Trace one cell of directions on a worker process; return its sums of ray throughput and its path table."""
        self.light.begin()
        self.trace_cells([part])
        return replace(self.light.total, paths=self.light.paths)

    def add(self, cell: int, found: WaveSums) -> None:
        """Add the sums of a cell that a worker has traced, mark it as finished, and report progress."""
        self.light.total = self.light.total + found
        self._open[cell] = False
        self._judge()
        self._report()

    def _judge(self) -> None:
        """
        Mark cells of directions as finished once they have the requested error or all of their rays.

        Cells without light so far end earlier.
        """
        value, se = (part.ravel() for part in self._pst().map())
        self._error = np.divide(se, value, out=np.full(len(se), np.inf), where=value > 0)
        self._open &= self.light.rays < np.where(value > 0, self._most, np.minimum(self._most, DARK_RAYS))
        if self._requested is not None:
            self._open &= ~(self._counts & (self._error <= self._requested))

    def _after_pass(self, rays: int) -> None:
        """Report progress after a pass of `rays` rays; with a requested error only once the first errors are known."""
        self._in_round = min(self._in_round + rays, self._of_round)
        if self._requested is None or np.isfinite(self._error).any():
            self._report()

    def _report(self) -> None:
        """
        Call `progress`, if there is one, with the rays traced, the largest relative error and the time left, s.

        The error is that of the cells in which one is requested; NaN if none is.
        """
        if self.progress is None:
            return
        rays = self.light.rays
        # Rays that the cells need: the error falls as 1/√rays
        seen = self._counts & np.isfinite(self._error)
        needed = np.where(self._open, self._most, rays)
        worst = math.nan
        if self._requested is not None:
            by_error = rays * np.square(np.where(seen, self._error, 0) / self._requested)
            needed = np.where(self._open & seen, np.clip(by_error, rays, needed), needed)
            worst = float(np.max(self._error, where=seen | (self._counts & self._open), initial=0.0))
        done, seconds = rays.sum() + self._in_round, time.perf_counter() - self._began
        left = seconds * max(needed.sum() - done, 0.0) / done
        self.progress(PstProgress(round(done), int(self._most.sum()), worst, self._requested, seconds, left))

    def _pst(self) -> Pst:
        """Return the PST from the rays traced so far, without paths, maps and notes."""
        weight = np.full((*self.trace.grid.shape, BATCHES), 1 / BATCHES)
        return Pst(self.trace.grid, self.light.total.by_batch(self.light.unit), weight, method="forward")

    def result(self) -> Pst:
        """Return the PST of all rays so far; cells for which there was no time are NaN."""
        trace, light, grid = self.trace, self.light, self.trace.grid
        shape = grid.shape
        rays, error = light.rays.reshape(shape).round().astype(int), self._error.reshape(shape)
        missing = rays == 0
        bare = self._pst()
        bare = replace(bare, by_batch=np.where(missing[..., None], np.nan, bare.by_batch))

        def named(chosen: np.ndarray) -> list[list[float]]:
            return [[float(grid.field_deg[i]), float(grid.azimuths_deg[j])] for i, j in np.argwhere(chosen)]

        requested, entrance = self._requested, self._entrance
        late = self._counts.reshape(shape) & ~missing & (error > (requested or np.inf))
        sums, unit = light.total, light.unit
        largest = np.where(missing, np.nan, bare.share_of_scattered(sums.strongest(unit)))
        # Notes
        lines = [*notes(bare, largest, float(rays[~missing].min())), *trace.notes]
        if (seen := late & np.isfinite(error)).any():
            worst, needed = percent_text(error[seen].max()), percent_text(requested or 0)
            lines.append(Message.ERROR_LEFT.note(worst=worst, requested=needed, remedy="take more rays"))
        if missing.any():
            names = [f"{angle:g}" if shape[1] == 1 else f"{angle:g}/{azimuth:g}" for angle, azimuth in named(missing)]
            lines.append(Message.NOT_TRACED.note(what=not_traced(names, missing.size, "cells, deg")))
        facts = {
            **trace.facts,
            "rays": int(rays.sum()),
            "rays_of_cell": rays.tolist(),
            "beam_area_mm2": light.areas.tolist(),
            "seed": trace.settings.seed,
            "seconds": time.perf_counter() - self._began,
            "segments": round(sums.segments.sum()),
            "settings": asdict(trace.settings),
            "relative_error": requested,
            "error_up_to_deg": self._request.error_up_to_deg,
            "entrance": None if entrance is None else {"centre": list(entrance.centre), "radius": entrance.radius},
            "unseen": named(np.isinf(error) & ~missing),
            "unfinished": named(late),
            "not_traced": named(missing),
            "notes": lines,
        }
        return replace(
            bare,
            facts=facts,
            largest_share=largest,
            path_rows=FoundPaths.of(trace, light.found).rows() if trace.lists_paths else None,
            maps=None
            if sums.maps is None
            else np.where(missing[..., None, None], np.nan, trace.maps(sums.by_pixel(unit))),
            extent_mm=trace.extent,
        )
