"""A PST from backward rays: pass after pass, beside what is counted forwards; saved and continued."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import mitsuba as mi
import numpy as np

from mistray.analysis.pst.forward_part import PLAN, SUMS, ForwardPart, saved_plan
from mistray.analysis.pst.found_pairs import FoundPairs
from mistray.analysis.pst.pilot import BACKWARD, FORWARD, PILOT_SHARE, Pilot, Plan
from mistray.analysis.pst.result import Pst, notes
from mistray.analysis.pst.state import PstProgress, load_state, require_same, save_state
from mistray.errors import UnfinishedError
from mistray.execute.backward import FIRST_PASS, BackwardTrace
from mistray.interrupts import later, requested
from mistray.recorders.direction_recorder import DIFFRACTED, MULTIPLE, SINGLE
from mistray.recorders.path_sums import join_sums
from mistray.sampling.plane_wave import PlaneWaves
from mistray.time_budget import time_is_up
from mistray.trace.all_cells import AllCells

DARK_AFTER = 4_000_000  # rays without light in a cell after which it is taken for dark
FIRST_SEARCH = 1 << 16  # rays of the first pilot where an error is requested
SAVING = 0.1  # share of the time that saving the state may take
LONG_PASS = 0.5  # s, from which an interrupt may not wait for the end of the next pass

Progress = Callable[[PstProgress], None]


class AdjointRun:
    """
    Passes of a backward trace, as many as its pilot asks for; what is finished can be saved and continued.

    Ways that the backward rays find by chance only are counted forwards, see
    `mistray.analysis.pst.pilot`.
    """

    def __init__(
        self, scene: mi.Scene, trace: BackwardTrace, points: np.ndarray, state: Path | None, resume: bool
    ) -> None:
        self._trace, self._state = trace, state
        tables, shares = zip(*((band.table, band.share) for band in trace.bands), strict=True)
        waves = PlaneWaves(points, trace.grid)
        self._cells = AllCells(
            scene, waves, trace.settings, tables, shares, trace.intersector, trace.map_size, trace.extent
        )
        self._forward_part: ForwardPart | None = None
        self._pilot_seconds = 0.0
        self._wanted: tuple[float | None, float | None] = (None, None)
        self._before: dict[str, np.ndarray] = {}  # path table of the run that this one goes on from
        self._table: dict[str, np.ndarray] | None = None  # the path table of both, once it is read
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
            self._forward_part = ForwardPart(trace, self._cells, saved_plan(arrays), arrays)
            others = ("path_", PLAN, SUMS)
            sums = {key: values for key, values in arrays.items() if not key.startswith(others)}
            trace.go_on_from(sums, int(facts["passes"]), float(facts["seconds"]))

    def plan(self, wanted: float | None, up_to_deg: float | None) -> Plan:
        """What a pilot finds for a relative error up to a field angle; that of the run which this one continues."""
        self._wanted = wanted, up_to_deg
        if self._forward_part is not None:
            return self._forward_part.plan
        started = time.perf_counter()
        plan = self._search(wanted, up_to_deg)
        self._pilot_seconds = time.perf_counter() - started
        return plan

    def go_on(self, plan: Plan, forward_rays: Callable[[float], np.ndarray], progress: Progress | None) -> None:
        """
        Trace pass after pass; an interrupt waits for the end of a pass, so that nothing is lost, but not for long.

        Parameters
        ----------
        plan : Plan
        forward_rays : callable
            Gives (c,) forward rays beside so many against it.
        progress : callable, optional
        """
        wanted, up_to_deg = self._wanted
        trace = self._trace
        before = float(trace.rays.sum())
        started, saved, saving = time.perf_counter() - self._pilot_seconds, -np.inf, 0.0
        all_saved = True
        if self._forward_part is None:
            self._forward_part = ForwardPart(trace, self._cells, plan)
        most = self._budget(plan, wanted, up_to_deg)
        if wanted is not None:
            self._forward_part.go_on(forward_rays(max(most, before)))
        with later(), trace.shared(most):
            while trace.rays.sum() < most and not requested() and not (trace.passes and time_is_up()):
                began = time.perf_counter()
                # Only a run of a single pass has a pass of its own size, so that a run may be continued at any time
                try:
                    trace.advance(most if most < FIRST_PASS else None)
                except UnfinishedError as error:
                    self._keep(error, not all_saved)
                    raise
                if wanted is None:  # in steps that hang on what is done alone, so that a run may be continued
                    self._forward_part.go_on(forward_rays(2.0 ** np.floor(np.log2(trace.rays.sum()))))
                self._table, all_saved = None, False
                now = time.perf_counter()
                if self._state is not None and (saving <= SAVING * (now - saved) or now - began > LONG_PASS):
                    self._save()
                    saved, all_saved = time.perf_counter(), True
                    saving = saved - now
                if progress:
                    done = round(float(trace.rays.sum()))
                    worst = self._worst(up_to_deg)
                    progress(PstProgress.after(done, max(most, done), worst, wanted, now - started, round(before)))
            if self._state is not None and not all_saved:
                self._save()
            if requested():
                raise KeyboardInterrupt

    def _search(self, wanted: float | None, up_to_deg: float | None) -> Plan:
        """What a pilot finds: of the least size, so that a run may be continued, or of what the error asks for."""
        pilot = Pilot(self._trace, self._cells)
        rays = FIRST_SEARCH if wanted is not None else 0.0
        while True:
            pilot.search(rays)
            plan = pilot.plan()
            if wanted is None:
                return plan
            asked = self._budget(plan, wanted, up_to_deg) / PILOT_SHARE
            if asked <= pilot.rays[BACKWARD, 0]:
                return plan
            rays = min(asked, 2 * pilot.rays[BACKWARD, 0])  # its first variances know little: it grows in steps

    def _budget(self, plan: Plan, wanted: float | None, up_to_deg: float | None) -> int:
        """
        Backward rays that there will be.

        Cells in which the pilot finds no light get `DARK_AFTER` of them, and are taken for dark after that.
        """
        most = self._trace.settings.rays
        if wanted is None:
            return most
        counts = np.repeat(self._counts(up_to_deg), self._trace.grid.shape[1])
        least = DARK_AFTER if np.any(plan.light[counts] == 0) else 1
        return min(max(plan.rays_for(wanted, counts), least), most)

    def _counts(self, up_to_deg: float | None) -> np.ndarray:
        """(n,) bool: the field angles whose error counts."""
        return np.asarray(self._trace.grid.field_deg <= (90.0 if up_to_deg is None else up_to_deg))

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
        """Largest relative standard error of the cells that count and have light; infinite where none has light yet."""
        value, se = (part[self._counts(up_to_deg)] for part in self._pst().map())
        lit = value > 0
        return float(np.max(se[lit] / value[lit], initial=0.0)) if lit.any() else np.inf

    def _save(self) -> None:
        assert self._state is not None
        paths = self._paths()
        assert self._forward_part is not None
        arrays = (
            self._trace.sums | {f"path_{key}": values for key, values in paths.items()} | self._forward_part.arrays()
        )
        facts = {
            "signature": self._signature,
            "passes": self._trace.passes,
            "rays": float(self._trace.rays.sum()),
            "seconds": self._trace.seconds,
        }
        save_state(self._state, arrays, facts)

    def _paths(self) -> dict[str, np.ndarray]:
        """The path table of this run and of the one before."""
        if self._table is None:
            here = self._trace.paths() or {}
            self._table = join_sums(self._before, here) if self._before and here else here
        return self._table

    def _pst(self) -> Pst:
        assert self._forward_part is not None
        trace = self._trace
        rays = trace.rays
        scale = np.pi / trace.grid.solid_angle[None, :, None, None]
        by_batch = scale * trace.sums["cells"] / rays + self._forward_part.by_batch
        return Pst(trace.grid, by_batch, rays / rays.sum())

    def result(self) -> Pst:
        """The PST of all that has been traced."""
        assert self._forward_part is not None
        trace, bare, light = self._trace, self._pst(), self._forward_part
        table, rays = trace.table, float(trace.rays.sum())
        unit = np.pi / trace.grid.solid_angle[:, None] / rays
        scattered = np.mean(bare.by_batch[[SINGLE, MULTIPLE, DIFFRACTED]].sum(axis=0), axis=-1)
        largest = np.maximum(unit * trace.sums["largest"], light.largest)
        largest = np.divide(largest, scattered, out=np.zeros_like(largest), where=scattered > 0)
        maps = None
        if "maps" in trace.sums:
            columns, rows = trace.map_size
            n, m = trace.grid.shape
            weight, squares = trace.sums["maps"].reshape(2, n, m, -1)
            value, variance = light.maps
            value = value + unit[..., None] * weight
            variance = variance + unit[..., None] ** 2 * np.maximum(squares - weight**2 / rays, 0)
            # The map is a rectangle; a round detector does not fill it
            x0, x1, y0, y1 = trace.extent
            pixels = rows * columns * trace.area / ((x1 - x0) * (y1 - y0))
            maps = pixels * np.stack([value, np.sqrt(variance)]).reshape(2, n, m, rows, columns)
        found = FoundPairs.of(trace, light, self._paths())
        hidden, seldom = found.seldom(trace, light)
        lines = [*notes(bare, largest, rays, seldom), *trace.notes]
        wanted, up_to_deg = self._wanted
        if wanted is None and rays < trace.settings.rays:
            lines.append(f"{rays:.4g} of {trace.settings.rays:.4g} rays were traced; errors are theirs")
        if wanted is not None and (worst := self._worst(up_to_deg)) > wanted and np.isfinite(worst):
            lines.append(
                f"errors of up to {100 * worst:.2g} % are left where {100 * wanted:.2g} % was requested; ask for "
                "less, or allow more rays"
            )
        facts = {
            "detector": table.ids[table.detector],
            "detector_area_mm2": trace.area,
            "wavelength_nm": list(trace.wavelength_nm),
            "weights": list(trace.weights),
            "rays": round(rays),
            "rays_with_the_light": round(light.rays.sum()),
            "pilot_rays": round(light.plan.rays[BACKWARD].max(initial=0)),
            "pilot_rays_with_the_light": round(light.plan.rays[FORWARD].sum()),
            "segments": trace.segments,
            "seconds": self._pilot_seconds + light.seconds + trace.seconds,
            "settings": asdict(trace.settings),
            "relative_error": self._wanted[0],
            "error_up_to_deg": self._wanted[1],
            "seldom_sampled": seldom,
            "notes": lines,
        }
        return Pst(
            trace.grid,
            bare.by_batch,
            bare.weight,
            hidden_variance=hidden,
            method="adjoint",
            facts=facts,
            largest_share=largest,
            path_rows=found.path_rows(trace),
            maps=maps,
            extent_mm=trace.extent,
            source=trace,
        )
