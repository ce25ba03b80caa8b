"""PST from backward rays, alone or joined with forward rays: tracing by passes, saving and continuing."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mistray.analyses.pst.cells import cells_up_to
from mistray.analyses.pst.found_paths import FoundPaths
from mistray.analyses.pst.pilot import Pilot
from mistray.analyses.pst.plan import Plan
from mistray.analyses.pst.progress import Progress, PstProgress
from mistray.analyses.pst.request import MOST_RAYS
from mistray.analyses.pst.result import BACKWARD, FORWARD, Pst, notes
from mistray.errors import MistrayWarning, UnfinishedError
from mistray.execute.all_cells import AllCells
from mistray.execute.backward import FIRST_PASS, BackwardTrace
from mistray.execute.cell_sums import under
from mistray.execute.forecast import LONG, duration
from mistray.files.saved_state import load_state, require_same, save_state
from mistray.gradients.pst_gradient import PstRays
from mistray.interrupts import later, requested
from mistray.messages import Message, fewer_rays
from mistray.percent import percent_text
from mistray.recorders.path_sums import PathsByCell
from mistray.recorders.tallies import MEDIUM
from mistray.time_budget import is_limited, left, share, time_is_up

PILOT_SHARE = 6  # rays of a run to an error over those of its pilot, about;
MOST_LONGER = 2.0  # most by which a run gets longer at once if its error is too large
SHORT_OF_IT = 1.5  # up to this factor the pilot may fall short: each further round is as long as all before
DARK_AFTER = 4_000_000  # rays without light in a cell after which it counts as dark
SAVING = 0.1  # fraction of the time that saving the state may take
LONG_PASS = 0.5  # s; a longer pass is saved at once, for an interrupt may not wait for the next
LEAST_PASS = 1 << 11  # least rays of a pass, however short the time is
LEAST_STRAYED = 1e-4  # share of what the detector sees, lost in wrong materials, from which on a note says so
PLAN, LIGHT, DONE = "plan_", "light_", "done"  # prefixes of the names of saved arrays; rounds and seconds


class BackwardRun:
    """
    Run of a PST by passes of backward rays, together with forward rays if there is a plan.

    The finished part can be saved and continued.

    Parameters
    ----------
    trace : BackwardTrace
        Backward rays, with their sums so far.
    points : (p, 3) float64
        Hull of the illuminated volume, mm.
    method : {"joined", "adjoint"}
        "joined": forward and backward rays share the light by multiple importance sampling. "adjoint": there are
        backward rays alone.
    state : Path, optional
        File of the state; None: it is not saved.
    resume : bool
        Whether to continue the run of `state`.

    Attributes
    ----------
    pilot : Pilot or None
        Pilot that made the plan; None before `plan`, or if the plan is that of a saved run.
    """

    def __init__(self, trace: BackwardTrace, points: np.ndarray, method: str, state: Path | None, resume: bool) -> None:
        self._trace, self._state, self._points, self._method = trace, state, points, method
        self._light: AllCells | None = None
        self._plan: Plan | None = None
        self.pilot: Pilot | None = None
        self._pilot_seconds, self._seconds_left = 0.0, math.nan
        self._first_pass = FIRST_PASS  # rays of the first pass; fewer if a time budget is shorter than that
        self._needed: tuple[float | None, float | None] = (None, None)
        self._paths_read: PathsByCell | None = None  # those of all passes so far, once they are read
        settings = asdict(trace.settings)
        del settings["rays"]
        self._signature = {
            "method": method,
            "scene": trace.fingerprint,
            "detector": trace.table.ids[trace.table.detector],
            "grid": trace.grid.facts(),
            "wavelength_nm": trace.wavelength_nm,
            "weights": trace.weights,
            "map_size": trace.map_size,
            "paths": trace.lists_paths,
            "settings": settings,
        }
        # Continue a saved run: plan, forward sums, backward sums
        if resume and state is not None:
            arrays, facts = load_state(state)
            require_same(state, facts, self._signature)
            trace.go_on_from(trace.sums.continued(arrays, int(facts["passes"]), float(facts["seconds"])))
            if method == "joined":
                light, saved = self._take(Plan.of_arrays(under(arrays, PLAN))), under(arrays, LIGHT)
                rounds, seconds = saved[DONE]
                light.total = light.total.continued(saved, int(rounds), float(seconds))

    @property
    def _open_ended(self) -> bool:
        """True if only the time budget, not a number of rays, ends the run."""
        return self._trace.settings.rays >= MOST_RAYS and is_limited()

    def _take(self, plan: Plan) -> AllCells:
        """Adopt the plan that divides paths between forward and backward rays, and return the forward trace."""
        self._plan = plan
        self._trace.share_paths(plan.sharing)
        self._light = AllCells(self._trace)
        return self._light

    def plan(self, needed: float | None, up_to_deg: float | None, earlier: Pilot | None = None) -> Plan | None:
        """
        Return the plan of the forward rays, by a pilot or from the continued run; None for backward rays alone.

        Parameters
        ----------
        needed : float or None
            Requested relative standard error of the PST; None: the number of rays is given.
        up_to_deg : float or None
            Largest field angle at which it is required, degrees; None: all.
        earlier : Pilot, optional
            Earlier pilot that the pilot of this run continues; None: it starts anew. It does so too if an error is
            requested, because that needs variances of its own, or if the earlier pilot left cells dark.
        """
        self._needed = needed, up_to_deg
        if self._plan is not None or self._method != "joined":
            return self._plan
        started = time.perf_counter()
        counts = cells_up_to(self._trace.grid, up_to_deg).ravel()
        # A run that may be continued can become long. For an error these are the most rays that it may take; the pilot
        # grows, because its first variances are unreliable
        run_rays = self._trace.settings.rays if self._state is None else math.inf
        earlier = earlier if needed is None and earlier is not None and earlier.lit else None
        self.pilot = pilot = Pilot(self._trace, self._points, counts, needed is not None, run_rays, earlier)
        with share(1 / (1 + PILOT_SHARE)):
            plan = pilot.search(0)
            while needed is not None and not time_is_up():
                asked = min(plan.rays_for(needed, counts), self._trace.settings.rays) / PILOT_SHARE
                if asked <= SHORT_OF_IT * pilot.rays:
                    break
                plan = pilot.search(min(asked, 2 * pilot.rays))
            # A run that takes all of a time has the longest pilot that fits; a round takes twice the time of the last
            while needed is None and self._open_ended and 2 * pilot.took < left():
                plan = pilot.search(pilot.rays + 1)
        if needed is not None:
            plan = plan.beside(max(plan.rays_for(needed, counts), int(plan.pilot_rays[1])), self._budget(plan, needed))
        self._pilot_seconds = time.perf_counter() - started
        # Forecast; a time budget may shorten the first pass
        budget = self._budget(plan, needed)
        self._seconds_left = pilot.seconds_for(plan, budget)
        if (takes := pilot.seconds_for(plan, FIRST_PASS)) > left():
            self._first_pass = max(LEAST_PASS, int(FIRST_PASS * left() / takes))
        if self._seconds_left > LONG and not is_limited():
            goal = "" if needed is None else f"; an error of {percent_text(needed)} takes {budget:.2g} rays"
            warnings.warn(
                f"the PST takes about {duration(self._seconds_left)}{goal}; "
                f"lower {'rays' if needed is None else 'the number of rays, allow a larger error'}, or give a time "
                "with seconds",
                MistrayWarning,
                stacklevel=2,
            )
        return plan

    def go_on(self, plan: Plan | None, progress: Progress | None) -> None:
        """
        Trace pass after pass until all rays are traced, the requested error is reached or the time is up.

        An interrupt waits for the end of a pass, so that nothing is lost, but not for long.

        Parameters
        ----------
        plan : Plan, optional
            Plan of the forward rays; None: there are none.
        progress : callable, optional
            Called with a `PstProgress` after every pass.

        Raises
        ------
        UnfinishedError
            If all workers are lost; the finished passes are saved, and it has the PST so far.
        KeyboardInterrupt
            After the pass in which an interrupt came, once the state is saved.
        """
        needed, up_to_deg = self._needed
        trace = self._trace
        before = float(trace.rays.sum())
        started, saved, saving = time.perf_counter() - self._pilot_seconds, -np.inf, 0.0
        all_saved, took = True, 0.0  # s of the last pass
        if self._light is None and plan is not None:
            self._take(plan)
        most = self._budget(plan, needed) if plan is not None else trace.settings.rays
        if needed is not None and before >= most:  # of a continued run that had become longer
            most = self._longer(round(before), self._worst(up_to_deg) / needed)
        if progress and math.isfinite(self._seconds_left):
            done, spent = round(before), time.perf_counter() - started
            progress(PstProgress(done, max(most, done), math.inf, needed, spent, self._seconds_left))
        with later(), trace.shared(most):
            while trace.rays.sum() < most and not requested() and not (trace.sums.passes and left() < took):
                # Pass: backward rays, then the forward rays beside them
                began = time.perf_counter()
                try:
                    trace.advance(self._own_size(most))
                except UnfinishedError as error:
                    self._keep(error, not all_saved)
                    raise
                if self._light is not None and plan is not None:
                    self._light.go_on(plan.forward_rays(float(trace.rays.sum())))
                self._paths_read, all_saved = None, False
                now = time.perf_counter()
                took = now - began
                # Save, within a fraction of the time
                if self._state is not None and (saving <= SAVING * (now - saved) or now - began > LONG_PASS):
                    self._save()
                    saved, all_saved = time.perf_counter(), True
                    saving = saved - now
                # The pilot's variances may have been too small; they only say that more rays are needed
                if needed is not None and trace.rays.sum() >= most:
                    most = self._longer(most, self._worst(up_to_deg) / needed)
                if progress:
                    done, worst = round(float(trace.rays.sum())), self._worst(up_to_deg)
                    progress(PstProgress.after(done, max(most, done), worst, needed, now - started, round(before)))
            if self._state is not None and not all_saved:
                self._save()
            if requested():
                raise KeyboardInterrupt

    def _longer(self, rays: int, over: float) -> int:
        """
        Return the new number of backward rays of the run, if after `rays` the error is `over` times too large.

        It grows with the square of `over`, but at most by `MOST_LONGER` and up to the number in the settings. It stays
        if the error is small enough, or infinite because there is no light.
        """
        if not 1 < over < math.inf:
            return rays
        return min(math.ceil(rays * min(over**2, MOST_LONGER)), self._trace.settings.rays)

    def _own_size(self, most: int) -> int | None:
        """
        Return the number of rays of the next pass, in a run of `most` rays, if it is below `FIRST_PASS`; else None.

        Only the first pass, or any pass of a run of fewer rays than that, is so short. All others have the usual size,
        so that a run may be continued at any time.
        """
        missing = math.ceil(most - float(self._trace.rays.sum()))  # at least 1
        begun = self._trace.sums.passes > 0
        size = min(missing, FIRST_PASS if begun else self._first_pass)
        return size if size < FIRST_PASS and (most < FIRST_PASS or not begun) else None

    def _budget(self, plan: Plan, needed: float | None) -> int:
        """
        Return the number of backward rays of the run: those that the plan found necessary; all if `needed` is None.

        They are at least as many as those of the pilot, since fewer might miss the paths that made its variance. If it
        found no light in a cell, they are at least `DARK_AFTER`, after which the cell counts as dark. They never exceed
        the number in the settings.
        """
        most = self._trace.settings.rays
        if needed is None:
            return most
        counts = cells_up_to(self._trace.grid, self._needed[1]).ravel()
        least = DARK_AFTER if np.any(plan.light[counts] == 0) else int(plan.pilot_rays[1])
        return min(max(plan.rays_for(needed, counts), least), most)

    def _keep(self, error: UnfinishedError, unsaved: bool) -> None:
        """
        Save the finished passes after all workers were lost; attach the saved file and the PST so far to the error.

        `unsaved` tells whether a finished pass is not yet in the saved file.
        """
        where = ""
        if self._state is not None and self._trace.sums.passes:
            if unsaved:
                self._save()
            where = f" in {self._state}, go on with resume"
        rays = float(self._trace.rays.sum())
        error.args = (f"{error}; {rays:.4g} of {self._trace.settings.rays:.4g} rays are finished and kept{where}",)
        error.partial = self.result() if self._trace.sums.passes else None

    def _worst(self, up_to_deg: float | None) -> float:
        """
        Return the largest relative standard error of the PST over lit cells up to a field angle, degrees; None: all.

        The result is infinite if none is lit.
        """
        value, se = (part[cells_up_to(self._trace.grid, up_to_deg)] for part in self._pst().map())
        lit = value > 0
        return float(np.max(se[lit] / value[lit], initial=0.0)) if lit.any() else np.inf

    def _save(self) -> None:
        assert self._state is not None
        sums, light = self._trace.sums, self._light
        arrays = sums.arrays(self._paths())
        if light is not None and self._plan is not None:
            done = {DONE: np.array([light.total.passes, light.total.seconds])}
            arrays |= {LIGHT + key: values for key, values in (light.total.arrays(light.paths) | done).items()}
            arrays |= {PLAN + key: values for key, values in self._plan.arrays().items()}
        facts = {
            "signature": self._signature,
            "passes": sums.passes,
            "rays": float(sums.rays.sum()),
            "seconds": sums.seconds,
        }
        save_state(self._state, arrays, facts)

    def _paths(self) -> PathsByCell:
        """Return the recorded paths of all backward rays so far, read from the device once."""
        if self._paths_read is None:
            self._paths_read = self._trace.paths() or PathsByCell()
        return self._paths_read

    def _pst(self) -> Pst:
        trace, light = self._trace, self._light
        techniques = {BACKWARD: trace.sums.by_batch(trace.unit)}
        if light is not None:
            techniques[FORWARD] = light.total.by_batch(light.unit)
        return Pst(
            trace.grid, np.sum([*techniques.values()], axis=0), trace.rays / trace.rays.sum(), techniques=techniques
        )

    def result(self) -> Pst:
        """Return the PST of all passes so far, with its paths, maps and notes."""
        trace, bare, light = self._trace, self._pst(), self._light
        sums, rays = trace.sums, float(trace.rays.sum())
        largest = sums.strongest(trace.unit)
        maps = None if sums.maps is None else sums.by_pixel(trace.unit)
        if light is not None:
            largest = np.maximum(largest, light.total.strongest(light.unit))
            maps = None if maps is None else maps + light.by_pixel
        largest = bare.share_of_scattered(largest)
        found = None
        if paths := self._paths():
            along = light.found if light is not None else None
            found = FoundPaths.of(trace, against=sums.found(trace.unit, paths), along=along)
        # Notes and facts
        lines = [*notes(bare, largest, rays), *trace.notes]
        strayed = float(sums.channels[MEDIUM].sum()) / rays
        if strayed > LEAST_STRAYED:
            lines.append(Message.VIEW_LOST.note(share=strayed))
        needed, up_to_deg = self._needed
        if needed is None and rays < trace.settings.rays and not self._open_ended:
            lines.append(fewer_rays(rays, trace.settings.rays))
        if needed is not None and (worst := self._worst(up_to_deg)) > needed and np.isfinite(worst):
            texts = {"worst": percent_text(worst), "requested": percent_text(needed)}
            lines.append(Message.ERROR_LEFT.note(**texts, remedy="ask for less, or allow more rays"))
        facts: dict[str, Any] = {
            **trace.facts,
            "rays": round(rays),
            "segments": sums.segments,
            "seconds": self._pilot_seconds + sums.seconds + (light.total.seconds if light is not None else 0.0),
            "settings": asdict(trace.settings),
            "relative_error": needed,
            "error_up_to_deg": up_to_deg,
            "notes": lines,
        }
        if light is not None and self._plan is not None:
            with_light, against = self._plan.pilot_rays
            facts |= {
                "rays_with_the_light": round(light.rays.sum()),
                "unscattered_rays_with_the_light": round(light.unscattered_rays),
                "connections": trace.connects,
                "pilot_rays": round(against),
                "pilot_rays_with_the_light": round(with_light),
                "seen_by_one_direction": found.one_sided() if found is not None else [],
            }
        return Pst(
            trace.grid,
            bare.by_batch,
            bare.weight,
            method=self._method,
            facts=facts,
            largest_share=largest,
            path_rows=found.rows() if found is not None else None,
            maps=None if maps is None else trace.maps(maps),
            extent_mm=trace.extent,
            source=PstRays(trace, light),
            plan=self._plan,
            techniques=bare.techniques,
        )
