"""The point source transmittance of a system: for all angles from one trace against the light, or angle by angle."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from mistray.analysis.pst.forward import forward_pst
from mistray.analysis.pst.result import Pst, notes
from mistray.analysis.pst.state import PstProgress, load_state, require_same, save_state
from mistray.errors import MistrayError, UnfinishedError
from mistray.trace.backward import FIRST_PASS, BackwardTrace
from mistray.trace.directions import DirectionGrid
from mistray.trace.ledger import ABSORBED, EVENT_BITS
from mistray.trace.path_books import join_books
from mistray.trace.path_events import DIRECT, describe_events
from mistray.trace.settings import Settings
from mistray.trace.sky import DIFFRACTED, MULTIPLE, SINGLE

if TYPE_CHECKING:
    import pandas as pd

METHODS = ("adjoint", "forward")
RAYS = {"adjoint": 4_000_000, "forward": 200_000}  # where a call says nothing; forward: at each angle
MOST_RAYS = 2_000_000_000  # where a call wants an error and does not say how many rays it may take
PATHS_LISTED = 200  # of a cell, the strongest
DARK_AFTER = 4_000_000  # rays without light in a cell after which it is taken for dark
SAVING = 0.1  # share of the time that saving the state may take

Progress = Callable[[PstProgress], None]


def pst(
    scene: mi.Scene,
    angles_deg: Sequence[float] | np.ndarray = range(0, 81, 2),
    *,
    method: str = "adjoint",
    convention: str = "normal",
    azimuths_deg: Sequence[float] | np.ndarray | None = None,
    cell_deg: float | None = None,
    azimuth_cell_deg: float | None = None,
    wavelength_nm: float | Sequence[float] | None = None,
    weights: Sequence[float] | None = None,
    detector: str | None = None,
    rays: int | None = None,
    relative_error: float | None = None,
    error_up_to_deg: float | None = None,
    paths: bool = True,
    map_pixels: int = 0,
    state: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> Pst:
    """
    Point source transmittance over field angle, by class of the light, with standard errors and paths.

    The adjoint method sends rays from the detector against the light; where they leave the scene is where light comes
    from, so that one trace gives all angles and azimuths. The forward method sends a plane wave over the whole scene
    from one cell of directions after the other. Both have the same mean.

    Parameters
    ----------
    scene : mi.Scene
        Angles are measured from the axis of its first `collimated` source, or from +z if it has none; the size of the
        source does not matter, the light fills everything.
    angles_deg : sequence of float
        Field angles, 0 … 90, ascending; each is the middle of a cell over which the PST is averaged.
    method : {"adjoint", "forward"}
    convention : {"normal", "projected"}
        See `Pst`.
    azimuths_deg : sequence of float, optional
        Azimuths of a two-dimensional map, from +y towards -x; by default the mean over all azimuths.
    cell_deg, azimuth_cell_deg : float, optional
        Widths of the cells, see `DirectionGrid.of`.
    wavelength_nm : float or sequence of float, optional
        By default those of the scene's first source, else 550 nm.
    weights : sequence of float, optional
        Shares of the flux at the wavelengths; equal by default.
    detector : str, optional
        Shape id, where the scene has several.
    rays : int, optional
        Start rays: of the whole trace (adjoint, 4e6), or at each angle (forward, 2e5). With `relative_error` the most
        there may be.
    relative_error : float, optional
        Go on until the relative standard error of the PST is below this at all angles.
    error_up_to_deg : float, optional
        Only angles up to this one count for `relative_error`.
    paths : bool
        Keep the strongest paths of each angle.
    map_pixels : int
        Longer side of maps of the detector for each angle; 0: none.
    state : str or Path, optional
        File that holds all that is finished, renewed as the run goes on (adjoint only).
    resume : bool
        Go on from `state`.
    progress : callable, optional
        Gets a `PstProgress` after every pass.
    **settings
        Fields of `mistray.trace.Settings`, such as ``max_reflections`` and ``max_scatters``; the others are those of
        the scene's integrator.

    Returns
    -------
    Pst

    Raises
    ------
    MistrayError
        For arguments out of range, or a state that belongs to another run.
    UnfinishedError
        If workers of `mistray.distribute` are gone; ``partial`` is the PST of the passes before, or, forward, the
        finished cells by their numbers of angle and azimuth.
    """
    if method not in METHODS:
        raise MistrayError(f"method is '{method}'; use 'adjoint' or 'forward'")
    if relative_error is not None and not 0 < relative_error < 1:
        raise MistrayError(f"relative_error is {relative_error:g}; it must lie between 0 and 1, 0.02 say")
    if not 0 <= map_pixels <= 4096 or map_pixels != int(map_pixels):
        raise MistrayError(f"map_pixels is {map_pixels}; give a whole number between 0 (no maps) and 4096")
    if resume and state is None:
        raise MistrayError("resume needs the file of the state; give state=…")
    grid = DirectionGrid.of(angles_deg, azimuths_deg, cell_deg, azimuth_cell_deg, _axes(scene))
    if error_up_to_deg is not None and not np.any(grid.angles_deg <= error_up_to_deg):
        raise MistrayError(f"error_up_to_deg is {error_up_to_deg:g}; no angle is as small as that")
    if rays is None:
        rays = RAYS[method] if relative_error is None else MOST_RAYS
    chosen = Settings.of(scene, rays=rays, **settings)
    if method == "forward":
        if state is not None:
            raise MistrayError("state is given with method 'forward'; only the adjoint method can be continued")
        found = forward_pst(
            scene,
            grid,
            wavelength_nm=wavelength_nm,
            weights=weights,
            detector=detector,
            rays=rays,
            relative_error=relative_error,
            error_up_to_deg=error_up_to_deg,
            paths=paths,
            map_pixels=int(map_pixels),
            progress=progress,
            settings=chosen,
        )
        return found.to(convention)
    trace = BackwardTrace(scene, grid, chosen, wavelength_nm, weights, detector, int(map_pixels), paths)
    run = _AdjointRun(trace, Path(state) if state is not None else None, resume)
    try:
        run.go_on(relative_error, error_up_to_deg, progress)
    except UnfinishedError as error:
        if error.partial is not None:
            error.partial = error.partial.to(convention)
        raise
    return run.result().to(convention)


class _AdjointRun:
    """Passes of a backward trace, until it is good enough; what is finished can be saved and continued."""

    def __init__(self, trace: BackwardTrace, state: Path | None, resume: bool) -> None:
        self._trace, self._state = trace, state
        self._wanted: tuple[float | None, float | None] = (None, None)
        self._before: dict[str, np.ndarray] = {}  # path table of the run that this one goes on from
        self._book: dict[str, np.ndarray] | None = None  # the path table of both, once it is read
        settings = asdict(trace.settings)
        del settings["rays"]
        self._signature = {
            "scene": trace.fingerprint,
            "detector": trace.table.ids[trace.table.detector],
            "grid": trace.grid.facts(),
            "wavelength_nm": trace.wavelength_nm,
            "weights": trace.weights,
            "map_size": trace.map_size,
            "paths": trace.lists_paths,
            "settings": settings,
        }
        if resume and state is not None:
            arrays, facts = load_state(state)
            require_same(state, facts, self._signature)
            self._before = {key[5:]: values for key, values in arrays.items() if key.startswith("path_")}
            sums = {key: values for key, values in arrays.items() if not key.startswith("path_")}
            trace.go_on_from(sums, int(facts["passes"]), float(facts["seconds"]))

    def go_on(self, wanted: float | None, up_to_deg: float | None, progress: Progress | None) -> None:
        """Trace pass after pass; an interrupt waits for the end of a pass, so that nothing is lost."""
        self._wanted = wanted, up_to_deg
        trace, most = self._trace, self._trace.settings.rays
        before = float(trace.rays.sum())
        worst = self._worst(up_to_deg) if trace.passes else np.inf
        started, saved, saving = time.perf_counter(), -np.inf, 0.0
        all_saved = True
        with _interrupt_later() as interrupted, trace.shared(most):
            while trace.rays.sum() < most and not (wanted is not None and worst <= wanted) and not interrupted():
                # Only a run of a single pass has a pass of its own size, so that a run may be continued at any time
                try:
                    trace.advance(most if most < FIRST_PASS else None)
                except UnfinishedError as error:
                    self._keep(error, not all_saved)
                    raise
                self._book, all_saved, worst = None, False, self._worst(up_to_deg)
                now = time.perf_counter()
                if self._state is not None and saving <= SAVING * (now - saved):
                    self._save()
                    saved, all_saved = time.perf_counter(), True
                    saving = saved - now
                if progress:
                    done = round(float(trace.rays.sum()))
                    progress(PstProgress.after(done, max(most, done), worst, wanted, now - started, round(before)))
            if self._state is not None and not all_saved:
                self._save()
            if interrupted():
                raise KeyboardInterrupt

    def _keep(self, error: UnfinishedError, unsaved: bool) -> None:
        """Save what was finished, and tell with an error that the workers are gone where it is."""
        where = ""
        if self._state is not None and self._trace.passes:
            if unsaved:
                self._save()
            where = f" in {self._state}, go on with resume"
        rays = float(self._trace.rays.sum())
        error.args = (f"{error}; {rays:.4g} of {self._trace.settings.rays:.4g} rays are finished and kept{where}",)
        error.partial = self.result() if self._trace.passes else None

    def _worst(self, up_to_deg: float | None) -> float:
        """
        Largest relative standard error of the cells that count; infinite where one has no light yet.

        Cells in which so many rays find no light are taken for dark: they do not count any more.
        """
        value, se = self._pst().map()
        counts = self._trace.grid.angles_deg <= (90.0 if up_to_deg is None else up_to_deg)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.where(value > 0, se / value, 0.0 if self._trace.rays.sum() >= DARK_AFTER else np.inf)
        return float(np.max(error[counts]))

    def _save(self) -> None:
        assert self._state is not None
        paths = self._paths()
        arrays = self._trace.sums | {f"path_{key}": values for key, values in paths.items()}
        facts = {
            "signature": self._signature,
            "passes": self._trace.passes,
            "rays": float(self._trace.rays.sum()),
            "seconds": self._trace.seconds,
        }
        save_state(self._state, arrays, facts)

    def _paths(self) -> dict[str, np.ndarray]:
        """The path table of this run and of the one before."""
        if self._book is None:
            here = self._trace.paths() or {}
            self._book = join_books(self._before, here) if self._before and here else here
        return self._book

    def _pst(self) -> Pst:
        trace = self._trace
        rays = trace.rays
        scale = np.pi / trace.grid.solid_angle[None, :, None, None]
        return Pst(trace.grid, scale * trace.sums["cells"] / rays, rays / rays.sum())

    def result(self) -> Pst:
        """The PST of all that has been traced."""
        trace, bare = self._trace, self._pst()
        table, rays = trace.table, float(trace.rays.sum())
        scattered = trace.sums["cells"][[SINGLE, MULTIPLE, DIFFRACTED]].sum(axis=(0, 3))
        with np.errstate(divide="ignore", invalid="ignore"):
            largest = np.where(scattered > 0, trace.sums["largest"] / scattered, 0.0)
        maps = None
        if "maps" in trace.sums:
            columns, rows = trace.map_size
            n, m = trace.grid.shape
            weight, squares = trace.sums["maps"].reshape(2, n, m, rows, columns)
            # The map is a rectangle; a round detector does not fill it
            x0, x1, y0, y1 = trace.extent
            pixels = rows * columns * trace.area / ((x1 - x0) * (y1 - y0))
            unit = np.pi * pixels / trace.grid.solid_angle[:, None, None, None] / rays
            maps = np.stack([unit * weight, unit * np.sqrt(np.maximum(squares - weight**2 / rays, 0))])
        facts = {
            "detector": table.ids[table.detector],
            "detector_area_mm2": trace.area,
            "wavelength_nm": list(trace.wavelength_nm),
            "weights": list(trace.weights),
            "rays": round(rays),
            "segments": trace.segments,
            "seconds": trace.seconds,
            "settings": asdict(trace.settings),
            "relative_error": self._wanted[0],
            "error_up_to_deg": self._wanted[1],
            "notes": [*notes(bare, largest), *trace.notes],
        }
        return Pst(
            trace.grid,
            bare.by_batch,
            bare.weight,
            method="adjoint",
            facts=facts,
            largest_share=largest,
            path_rows=self._path_rows(rays),
            maps=maps,
            extent_mm=trace.extent,
            source=trace,
        )

    def _path_rows(self, rays: float) -> pd.DataFrame | None:
        import pandas as pd

        book = self._paths()
        if not book:
            return None
        m = self._trace.grid.shape[1]
        kept = _strongest(book["cell"], book["weight"], PATHS_LISTED)
        path, cell = book["path"][kept], book["cell"][kept]
        used, place = np.unique(path, return_inverse=True)
        events, lengths = with_the_light(book["events"][used], book["lengths"][used], self._trace.table.detector)
        facts = describe_events(events, lengths, self._trace.table.event_ids, self._trace.table.event_words)
        if not self._trace.has_optics:  # light that meets nothing is the image then
            facts["kind"][lengths == 1] = DIRECT
        unit = np.pi / self._trace.grid.solid_angle[cell // m] / rays
        weight, squares = book["weight"][kept], book["squares"][kept]
        columns: dict[str, Any] = {"cell": cell // m, "azimuth_cell": cell % m}
        columns |= {name: values[place] for name, values in facts.items()}
        columns["rays"] = book["hits"][kept].astype(np.int64)
        columns["pst_normal"] = unit * weight
        columns["pst_normal_se"] = unit * np.sqrt(np.maximum(squares - weight**2 / rays, 0.0))
        return pd.DataFrame(columns)


def with_the_light(events: np.ndarray, lengths: np.ndarray, detector: int) -> tuple[np.ndarray, np.ndarray]:
    """Event lists of rays against the light as those of the light, the absorption in the detector at their ends."""
    order = lengths[:, None] - 1 - np.arange(events.shape[1] + 1)
    turned = np.take_along_axis(np.pad(events, ((0, 0), (0, 1))), np.maximum(order, 0), axis=1)
    turned = np.where(order >= 0, turned, 0).astype(np.uint32)
    turned[np.arange(len(turned)), lengths] = (detector << EVENT_BITS) | ABSORBED
    return turned, lengths + 1


def _strongest(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Numbers of the largest values of each group, at most `count` of each."""
    order = np.lexsort((-values, group))
    sizes = np.bincount(group) if len(group) else np.zeros(0, dtype=np.int64)
    rank = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.asarray(order[rank < count])


def _axes(scene: mi.Scene) -> np.ndarray:
    """Axes that field angles are measured in: those of the first source, else of the world."""
    for emitter in scene.emitters():
        if hasattr(emitter, "start_distance"):
            return np.asarray(emitter.matrix[:3, :3], dtype=np.float64)
    return np.eye(3)


@contextlib.contextmanager
def _interrupt_later() -> Iterator[Callable[[], bool]]:
    """Let Ctrl-C wait, but not when pressed again: gives a function that says whether it was pressed."""
    pressed: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return

    def note(*_: Any) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(1)

    old = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, old)
