"""Point source transmittance of a system: for all angles together by forward and backward rays, or angle by angle."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.backward_run import BackwardRun
from mistray.analyses.pst.cells import grid_of
from mistray.analyses.pst.forward import forward_pst
from mistray.analyses.pst.next_order import with_next_orders
from mistray.analyses.pst.pilot import Pilot
from mistray.analyses.pst.plan import Plan, shared
from mistray.analyses.pst.progress import Progress
from mistray.analyses.pst.request import MOST_RAYS, PstRequest
from mistray.analyses.pst.result import Pst
from mistray.errors import MistrayError, UnfinishedError
from mistray.execute.backward import BackwardTrace
from mistray.execute.workers import refuse_workers_in_time
from mistray.light import Light
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.plane_wave import hull_points
from mistray.sampling.sources import field_axes, spectrum_of
from mistray.settings import Settings
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import share, within
from mistray.toolkit.analysis import analysis
from mistray.trace.host.polarization_choice import unpolarized_notes

FIRST_SHARE = 0.5  # fraction of the time for the first measurement, if further ones follow


def run(
    scene: mi.Scene,
    request: PstRequest,
    *,
    state: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    seconds: float | None = None,
) -> Pst:
    """
    Compute the point source transmittance (PST) over field angle, by class of light, with standard errors and paths.

    The adjoint method traces rays from the detector backwards. They leave the scene in directions from which light
    arrives, so that one trace covers all angles and azimuths. The forward method traces a plane wave over the whole
    scene from each cell of directions. The joined method, the default, does both: rays start from the
    detector and from all cells, and each path is weighted by the balance heuristic (E. Veach, Robust Monte Carlo
    methods for light transport simulation, 1997, section 9.2). A pilot learns where light gets in and how many rays
    each direction needs. All three have the same mean.

    Parameters
    ----------
    scene : mi.Scene
        Angles are measured from the axis of its first `collimated` source, or from +z if it has none. The size of the
        source does not matter: the light covers the whole scene.
    request : PstRequest
    state : str or Path, optional
        File with the finished part of the run, updated during the run; not with the method "forward".
    resume : bool
        Whether to continue the run of `state`.
    progress : callable, optional
        Called with a `PstProgress` after every pass.
    seconds : float, optional
        Time, s, after which the run ends with the rays traced so far, once the current pass is complete; a note reports
        their number. With the method "forward" the cells share the time. The other methods take all of it if neither a
        number of rays nor a relative error is given.

    Returns
    -------
    Pst

    Raises
    ------
    MistrayError
        If an argument is out of range, or a state belongs to another run.
    UnfinishedError
        If workers of `mistray.distribute` are lost; ``partial`` is the PST of the passes before, or, forward, the sums
        of the finished cells by their indices.
    KeyboardInterrupt
        After the pass in which an interrupt came; the finished part is then in `state`, if that is given.

    Examples
    --------
    >>> pst = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> stray, error = pst.curve("stray")
    >>> for angle, value, se in zip(pst.field_deg, stray, error):
    ...     print(f"{angle:.0f}°: {value:.1e} ± {se:.0e}")
    10°: 4.7e-05 ± 1e-06
    30°: 3.8e-05 ± 5e-07
    """
    if seconds is not None and request.method == "forward":
        refuse_workers_in_time()
    # A time without a number of rays is all for rays
    if seconds is not None and request.method != "forward" and request.rays is None:
        request = replace(request, rays=MOST_RAYS)
    # Measure, and measure again with one more event of either kind; a saved state belongs to the first
    began, pilots = time.perf_counter(), list[Pilot]()
    with within(seconds):
        with share(FIRST_SHARE if request.next_order else 1.0):
            result = next(pst_of_each([scene], request, state=state, resume=resume, progress=progress, pilots=pilots))
        if request.next_order:

            def again(rays: int, **limit: int) -> Pst:
                more = replace(request, rays=rays, settings={**request.settings, **limit})
                return next(pst_of_each([scene], more, progress=progress, pilots=pilots))

            result = with_next_orders(scene, result, time.perf_counter() - began, again)
    # Notes on polarisation that is neglected
    beams = [replace(Light(**request.light), field_deg=float(angle)) for angle in result.field_deg]
    result.facts["notes"] = [*result.facts["notes"], *unpolarized_notes(scene, beams, **request.settings)]
    return result


pst = analysis("pst", PstRequest, run)


def pst_of_each(
    scenes: Iterable[mi.Scene],
    request: PstRequest,
    *,
    state: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    plan: Plan | None = None,
    pilots: list[Pilot] | None = None,
) -> Iterator[Pst]:
    """
    Yield the PSTs of scenes to be compared, computed with common random numbers.

    Light covers the surfaces of all scenes and starts from the same points: the common part of two scenes is traced
    with the same rays in both.

    Parameters
    ----------
    scenes : iterable of mi.Scene
        Scenes, all read before the first run. Angles are measured from the axis of each scene's own source.
    request : PstRequest
    state, resume, progress
        See `run`. With a `state`, or a `relative_error`, one scene only.
    plan : Plan, optional
        `Pst.plan` of an earlier PST, of a scene much like these: it replaces the pilot, and rays start as they did. A
        plan that does not fit is not used.
    pilots : list of Pilot, optional
        List whose first entry is the pilot of an earlier PST of the one scene, which the pilot of this one continues.
        An empty list gets the pilot of this one.

    Yields
    ------
    Pst
        PST of each scene, in their order.

    Raises
    ------
    MistrayError, UnfinishedError
        See `run`.
    """
    if resume and state is None:
        raise MistrayError("resume needs the file of the state; give state=…")
    # A state holds the sums of a trace from the detector
    if request.method == "forward" and state is not None:
        raise MistrayError("state is given with method 'forward'; only a run from the detector can be continued")
    light = Light(**request.light)
    # All scenes first: their light has to cover the surfaces of all of them
    prepared: list[tuple[mi.Scene, DirectionGrid, Settings]] = []
    traces: list[BackwardTrace] = []
    for scene in scenes:
        grid, chosen = grid_of(request, field_axes(scene)), request.settings_for(scene)
        if request.method != "forward":
            traces.append(BackwardTrace(scene, grid, chosen, light, request.map_pixels, request.paths))
        prepared.append((scene, grid, chosen))
    if request.method == "forward":
        # One scene after the other
        points = None  # a single scene computes its own hull
        if len(prepared) > 1:
            first = [spectrum_of(scene, light.wavelength_nm, light.weights)[0][0] for scene, *_ in prepared]
            tables = [
                SurfaceTable(scene, float(nm), light.detector) for (scene, *_), nm in zip(prepared, first, strict=True)
            ]
            points = hull_points(*tables)
        for scene, grid, chosen in prepared:
            found = forward_pst(scene, grid, request, settings=chosen, points=points, progress=progress)
            yield found.to(request.convention)
        return
    lit = hull_points(*(trace.table for trace in traces))
    place = Path(state) if state is not None else None
    runs = [BackwardRun(trace, lit, request.method, place, resume) for trace in traces]
    # A given plan, or that of a pilot of each scene, with common forward rays
    plans: list[Plan | None]
    if plan is not None and all(plan.fits(trace.unit.size, trace.table.count) for trace in traces):
        plans = [replace(plan, pilot_rays=np.zeros(2)) for _ in runs]
    else:
        earlier = next(iter(pilots or ()), None)
        plans = [run.plan(request.relative_error, request.error_up_to_deg, earlier) for run in runs]
        if pilots is not None and earlier is None:
            pilots += [run.pilot for run in runs if run.pilot is not None]
        if known := [plan for plan in plans if plan is not None]:
            plans = [*shared(known)]
    for run, of_run in zip(runs, plans, strict=True):
        try:
            run.go_on(of_run, progress)
        except UnfinishedError as error:
            if error.partial is not None:
                error.partial = error.partial.to(request.convention)
            raise
        yield run.result().to(request.convention)
