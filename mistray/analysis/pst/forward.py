"""Point source transmittance by forward runs: one plane wave for each cell of directions."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace

import mitsuba as mi
import numpy as np

from mistray.analysis.pst.forward_cells import FIRST_RAYS, Cell, CellPass, CellsTask, ForwardCells
from mistray.analysis.pst.request import PstRequest
from mistray.analysis.pst.result import Pst, notes
from mistray.analysis.pst.state import PstProgress
from mistray.errors import MistrayError
from mistray.execute.passes import execute_passes
from mistray.execute.workers import current_workers
from mistray.notes import Code, Note
from mistray.percent import percent_text
from mistray.ranges import RELATIVE_ERROR
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.plane_wave import Entrance
from mistray.sampling.sources import spectrum_of
from mistray.scene.check import require_scene
from mistray.settings import Settings
from mistray.surfaces.thin_gaps import thin_gaps
from mistray.time_budget import not_traced

Progress = Callable[[PstProgress], None]


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
    Compute the point source transmittance by one forward run for each cell of directions.

    A run lights the whole scene with a plane wave of 1 W/mm² from directions that are uniform within the cell. Errors
    of cells are independent.

    Parameters
    ----------
    scene : mi.Scene
        Scene of `mistray.load`; its sources only determine the wavelengths.
    grid : DirectionGrid
    request : PstRequest, optional
        Light, detector, paths and maps, and the requested error. With `relative_error` the rays of a cell are doubled
        until the standard error of all light together over its value is at most this. A cell in which no light is
        found has `DARK_RAYS` at most, and cells of field angles beyond `error_up_to_deg` end with the first
        `FIRST_RAYS` rays. The angles are those of `grid`.
    entrance : Entrance, optional
        Disc through which alone light is traced.
    points : (p, 3) float64, optional
        Hull of the illuminated volume, mm, see `mistray.sampling.plane_wave.hull_points`. Default: that of the scene.
    progress : callable, optional
        Called after each pass of a cell.
    settings : Settings, optional
        Settings with the start rays of a cell, or their largest number if an error is requested. Default: those of the
        scene.

    Returns
    -------
    Pst
        PST in the convention "normal". ``facts`` hold detector, detector_area_mm2, wavelength_nm, weights, rays (of all
        cells together), seconds, segments, settings, seed, relative_error, error_up_to_deg, entrance, rays_of_cell and
        beam_area_mm2 (n, m); ``unseen``: cells (angle, azimuth) in which no light was found, whose PST of 0 is an upper
        limit only by the number of their rays; ``unfinished``: cells whose error is larger than requested;
        ``not_traced``: cells for which a time budget was too short, whose numbers are NaN;
        ``notes``: these facts in words, and other notes on the reliability.

    Raises
    ------
    MistrayError
        If an argument is out of range, the scene has no detector, or where `mistray.trace` raises.
    UnfinishedError
        If workers of `mistray.distribute` are lost; ``partial`` has the finished cells by their numbers.
    """
    # Arguments and defaults
    require_scene(scene, "forward_pst")
    request = PstRequest(method="forward") if request is None else request
    settings = Settings.without_sources(scene, "a PST") if settings is None else settings
    settings = settings if request.rays is None else replace(settings, rays=request.rays)
    relative_error = request.relative_error
    limited = _angles_that_count(grid, relative_error, request.error_up_to_deg)
    wavelengths, shares = spectrum_of(scene, request.wavelength_nm, request.weights)
    spectrum = wavelengths[shares > 0], shares[shares > 0]
    # Tasks: all cells, each with its own largest number of rays
    started = time.perf_counter()
    arguments = (grid, settings, spectrum, request.detector, entrance, int(request.map_pixels), points)
    cells = ForwardCells(scene, *arguments)
    n, m = grid.shape
    most = [settings.rays if counts or relative_error is None else min(FIRST_RAYS, settings.rays) for counts in limited]
    report = _Report(m * sum(most), relative_error, progress)
    passes = {
        (i, j): CellPass(i, j, most[i], relative_error if limited[i] else None, request.paths)
        for i, j in np.ndindex(n, m)
    }
    cells.progress = report.after_pass

    def done(part: CellPass, cell: Cell) -> None:
        if current_workers() is not None:  # without workers the cell has reported by itself
            report.after_pass(part, cell.rays, cell.error)
        report.close_cell(part.rays, cell, bool(limited[part.i]))

    # Trace the cells, here or by workers
    task = CellsTask(scene, arguments, cells.kernel_arrays())
    found = execute_passes(task, passes, cells, "cells", done)
    seconds = time.perf_counter() - started
    return _result(cells, found, limited, request, seconds)


def _angles_that_count(grid: DirectionGrid, relative_error: float | None, error_up_to_deg: float | None) -> np.ndarray:
    """Return a mask of the field angles whose error is to fall below `relative_error`, (n,) bool."""
    if relative_error is None:
        if error_up_to_deg is not None:
            raise MistrayError(
                "error_up_to_deg is given without relative_error; give the relative error that is wanted"
            )
        return np.zeros(grid.shape[0], dtype=bool)
    RELATIVE_ERROR.check("relative_error", relative_error)
    last = 90.0 if error_up_to_deg is None else float(error_up_to_deg)
    counts = grid.field_deg <= last
    if not counts.any():
        raise MistrayError(
            f"error_up_to_deg is {last:g}; no angle is that small, the smallest is {grid.field_deg[0]:g} deg"
        )
    return counts


class _Report:
    """
    Report of the progress of the cells.

    Parameters
    ----------
    planned : int
        Largest number of rays of all cells.
    wanted : float or None
        Requested relative error.
    progress : callable or None
        Called with a `PstProgress`.
    """

    def __init__(self, planned: int, wanted: float | None, progress: Progress | None) -> None:
        self._planned, self._wanted, self._progress = planned, wanted, progress
        self._started = time.perf_counter()
        self._rays = 0  # of finished cells
        self._spared = 0  # rays that they did not need
        self._worst = 0.0

    def after_pass(self, part: CellPass, rays: int, error: float) -> None:
        """Report progress: a cell has so many of its rays and this error."""
        if self._progress is None:
            return
        most, wanted = part.rays, part.wanted_error
        seconds = time.perf_counter() - self._started
        done = self._rays + rays
        # Fraction of the cell that is done: by rays, or by the error, which falls as 1/√rays
        share = rays / most
        if wanted is not None and np.isfinite(error):
            share = max(share, min(1.0, (wanted / error) ** 2))
        # The remaining cells are expected to save the same fraction of rays as this cell and those before it
        needed = (self._rays + min(rays / share, most)) / (self._rays + self._spared + most) * self._planned
        worst = self._worst if wanted is None else max(self._worst, error)
        left = seconds * max(needed - done, 0.0) / done
        self._progress(PstProgress(done, self._planned, worst, self._wanted, seconds, left))

    def close_cell(self, most: int, cell: Cell, counts: bool) -> None:
        """Close a finished cell."""
        self._rays += cell.rays
        self._spared += most - cell.rays
        if counts and np.isfinite(cell.error):
            self._worst = max(self._worst, cell.error)


def _result(
    cells: ForwardCells,
    found: dict[tuple[int, int], Cell],
    limited: np.ndarray,
    request: PstRequest,
    seconds: float,
) -> Pst:
    """Form the PST of all cells."""
    import pandas as pd

    relative_error = request.relative_error

    grid = cells.grid
    n, m = grid.shape
    # Cells for which the time was too short are NaN
    missing = [name for name in np.ndindex(n, m) if name not in found]
    if missing:
        found = found | dict.fromkeys(missing, Cell.not_traced(next(iter(found.values()))))

    def stack(name: str) -> np.ndarray:
        """Return an attribute of the cells, (n, m, …)."""
        return np.array([[getattr(found[i, j], name) for j in range(m)] for i in range(n)])

    def named(chosen: np.ndarray) -> list[list[float]]:
        return [[float(grid.field_deg[i]), float(grid.azimuths_deg[j])] for i, j in np.argwhere(chosen)]

    # Arrays over the grid, and lists of cells for the facts
    errors = stack("error")
    tables = [rows.assign(cell=i, azimuth_cell=j) for (i, j), cell in found.items() if (rows := cell.rows) is not None]
    late = limited[:, None] & (errors > (relative_error or np.inf))
    settings, entrance = cells.settings, cells.entrance
    largest = stack("largest_share")
    result = Pst(
        grid=grid,
        by_batch=np.moveaxis(stack("by_batch"), 2, 0),
        weight=stack("weight"),
        method="forward",
        facts={
            "detector": cells.table.ids[cells.table.detector],
            "detector_area_mm2": cells.area,
            "wavelength_nm": cells.wavelengths_nm.tolist(),
            "weights": cells.shares.tolist(),
            "rays": int(stack("rays").sum()),
            "rays_of_cell": stack("rays").tolist(),
            "beam_area_mm2": stack("beam_area").tolist(),
            "seed": settings.seed,
            "seconds": seconds,
            "segments": int(stack("segments").sum()),
            "settings": asdict(settings),
            "relative_error": relative_error,
            "error_up_to_deg": request.error_up_to_deg,
            "entrance": None if entrance is None else {"centre": list(entrance.centre), "radius": entrance.radius},
            "unseen": named(np.isinf(errors)),
            "unfinished": named(late),
            "not_traced": [[float(grid.field_deg[i]), float(grid.azimuths_deg[j])] for i, j in missing],
        },
        largest_share=largest,
        path_rows=pd.concat(tables, ignore_index=True) if tables else None,
        maps=np.moveaxis(stack("map"), 2, 0) if cells.has_maps else None,
        extent_mm=cells.extent,
    )
    # Notes
    fewest = min(cell.rays for cell in found.values() if cell.rays)
    lines = [*thin_gaps(cells.table), *notes(result, largest, float(fewest))]
    if late[np.isfinite(errors)].any():
        worst = float(errors[late & np.isfinite(errors)].max())
        text = (
            f"errors of up to {percent_text(worst)} are left where {percent_text(relative_error or 0)} was requested; "
            "take more rays"
        )
        lines.append(Note(text, Code.ERROR))
    if missing:
        names = [
            f"{grid.field_deg[i]:g}" if m == 1 else f"{grid.field_deg[i]:g}/{grid.azimuths_deg[j]:g}"
            for i, j in missing
        ]
        lines.append(Note(not_traced(names, n * m, "cells, deg"), Code.UNFINISHED))
    result.facts["notes"] = [*lines, *cells.notes]
    return result
