"""Point source transmittance of a system: for all angles together by forward and backward rays, or angle by angle."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.backward_run import BackwardRun
from mistray.analyses.pst.forward import forward_pst
from mistray.analyses.pst.next_order import with_next_orders
from mistray.analyses.pst.plan import Plan, shared
from mistray.analyses.pst.request import Numbers, PstRequest
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.state import Progress
from mistray.errors import UnfinishedError
from mistray.execute.backward import BackwardTrace
from mistray.execute.workers import refuse_workers_in_time
from mistray.light import Light
from mistray.notes import warns
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.plane_wave import hull_points
from mistray.sampling.sources import field_axes, spectrum_of
from mistray.scene.check import require_scene
from mistray.settings import Settings
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import share, within
from mistray.trace.polarization_choice import unpolarized_notes

FIRST_SHARE = 0.5  # fraction of the time for the first measurement, if further ones follow


# More than 8 parameters: the keywords of a call, each with a default and used one by one
@warns
def pst(
    scene: mi.Scene,
    field_deg: float | Sequence[float] | np.ndarray = range(0, 81, 2),
    *,
    method: str = "joined",
    convention: str = "normal",
    azimuths_deg: float | Sequence[float] | np.ndarray | None = None,
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
    seconds: float | None = None,
    next_order: bool = False,
    **settings: Any,
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
        Angles are measured from the axis of its first `collimated` source, or from +z if it has none; the size of the
        source does not matter, the light covers the whole scene.
    field_deg : float or sequence of float
        Field angles, degrees, -90 … 90, ascending; each is the middle of a cell over which the PST is averaged. A
        negative one is the positive one at the opposite azimuth, see `DirectionGrid.of`.
    method : {"joined", "adjoint", "forward"}
    convention : {"normal", "projected"}
        See `Pst`.
    azimuths_deg : float or sequence of float, optional
        Azimuths of a two-dimensional map, degrees, from +y towards -x. By default the mean over all azimuths, which
        does not depend on the sign of an angle.
    cell_deg, azimuth_cell_deg : float, optional
        Widths of the cells, degrees, see `DirectionGrid.of`.
    wavelength_nm : float or sequence of float, optional
        Wavelengths, nm; by default those of the scene's first source, else 550 nm.
    weights : sequence of float, optional
        Fractions of the flux at the wavelengths; equal by default.
    detector : str, optional
        Shape id, if the scene has several detectors.
    rays : int, optional
        Start rays: from the detector (4e6; the joined method adds forward rays), or at each angle (forward,
        2e5). With `relative_error` their largest number.
    relative_error : float, optional
        Relative standard error of the PST at all angles; a pilot estimates the number of rays that it needs.
    error_up_to_deg : float, optional
        Largest field angle at which `relative_error` is required, degrees.
    paths : bool
        Whether to keep the strongest paths of each angle.
    map_pixels : int
        Longer side, in pixels, of maps of the detector for each angle; 0: none.
    state : str or Path, optional
        File with the finished part of the run, updated during the run (not forward).
    resume : bool
        Whether to continue the run of `state`.
    progress : callable, optional
        Called with a `PstProgress` after every pass.
    seconds : float, optional
        Time, s, after which the run ends with the rays traced so far; forward the cells share it. A note reports their
        number. The current pass is completed first.
    next_order : bool
        Whether to measure the PST again with one more scatter event and, apart from that, with one more reflection, see
        `Pst.next_orders`. These have together as many rays as the first, within `seconds`. If the stray light at some
        angle changes by more than 5 % and two errors, the result is the PST with that limit.
    **settings
        Fields of `mistray.trace.Settings`, such as ``max_reflections`` and ``max_scatters``; by default those of the
        scene's integrator.

    Returns
    -------
    Pst

    Raises
    ------
    MistrayError
        For arguments out of range, or a state that belongs to another run.
    UnfinishedError
        If workers of `mistray.distribute` are lost; ``partial`` is the PST of the passes before, or, forward, the sums
        of the finished cells by their numbers of angle and azimuth.
    """
    require_scene(scene, "pst")
    if seconds is not None and method == "forward":
        refuse_workers_in_time()
    arguments: dict[str, Any] = dict(
        method=method,
        convention=convention,
        azimuths_deg=azimuths_deg,
        cell_deg=cell_deg,
        azimuth_cell_deg=azimuth_cell_deg,
        wavelength_nm=wavelength_nm,
        weights=weights,
        detector=detector,
        rays=rays,
        relative_error=relative_error,
        error_up_to_deg=error_up_to_deg,
        paths=paths,
        map_pixels=map_pixels,
        state=state,
        resume=resume,
        progress=progress,
        **settings,
    )
    # Measure, and measure again with one more event of either kind; a saved state belongs to the first
    began = time.perf_counter()
    with within(seconds):
        with share(FIRST_SHARE if next_order else 1.0):
            result = next(pst_of_each([scene], field_deg, **arguments))
        if next_order:
            again = {**arguments, "state": None, "resume": False}
            spent = time.perf_counter() - began
            result = with_next_orders(
                scene, result, spent, lambda **limit: next(pst_of_each([scene], field_deg, **{**again, **limit}))
            )
    # Notes on polarisation that is neglected
    light = Light(wavelength_nm=wavelength_nm, weights=weights, detector=detector)
    beams = [replace(light, field_deg=float(angle)) for angle in result.field_deg]
    result.facts["notes"] = [*result.facts["notes"], *unpolarized_notes(scene, beams, **settings)]
    return result


def pst_of_each(
    scenes: Iterable[mi.Scene],
    field_deg: Numbers = range(0, 81, 2),
    *,
    progress: Progress | None = None,
    plan: Plan | None = None,
    **arguments: Any,
) -> Iterator[Pst]:
    """
    Yield the PSTs of scenes to be compared, computed with common random numbers.

    Light covers the surfaces of all scenes and starts from the same points: the common part of two scenes is traced
    with the same rays in both.

    Parameters
    ----------
    scenes : iterable of mi.Scene
        Scenes, all read before the first run. Angles are measured from the axis of each scene's own source.
    field_deg, progress
        See `pst`.
    plan : Plan, optional
        `Pst.plan` of an earlier PST, of a scene much like these: it replaces the pilot, and rays start as they did. A
        plan that does not fit is not used.
    **arguments
        Other arguments of `pst`. With `relative_error`, `state` or `resume` one scene only.

    Yields
    ------
    Pst
        PST of each scene, in their order.

    Raises
    ------
    MistrayError, UnfinishedError
        See `pst`.
    """
    request = PstRequest.of(field_deg=field_deg, **arguments)
    # All scenes first: their light has to cover the surfaces of all of them
    prepared: list[tuple[mi.Scene, DirectionGrid, Settings]] = []
    traces: list[BackwardTrace] = []
    for scene in scenes:
        grid, chosen = request.grid(field_axes(scene)), request.settings_for(scene)
        if request.method != "forward":
            traces.append(BackwardTrace(scene, grid, chosen, request.light, int(request.map_pixels), request.paths))
        prepared.append((scene, grid, chosen))
    if request.method == "forward":
        # One scene after the other
        points = None  # a single scene computes its own hull
        if len(prepared) > 1:
            first = [spectrum_of(scene, request.wavelength_nm, request.weights)[0][0] for scene, *_ in prepared]
            tables = [
                SurfaceTable(scene, float(nm), request.detector)
                for (scene, *_), nm in zip(prepared, first, strict=True)
            ]
            points = hull_points(*tables)
        for scene, grid, chosen in prepared:
            found = forward_pst(scene, grid, request, settings=chosen, points=points, progress=progress)
            yield found.to(request.convention)
        return
    lit = hull_points(*(trace.table for trace in traces))
    place = Path(request.state) if request.state is not None else None
    runs = [BackwardRun(trace, lit, request.method, place, request.resume) for trace in traces]
    # A given plan, or that of a pilot of each scene, with common forward rays
    plans: list[Plan | None]
    if plan is not None and all(plan.fits(trace.unit.size, trace.table.count) for trace in traces):
        plans = [replace(plan, pilot_rays=np.zeros(2)) for _ in runs]
    else:
        plans = [run.plan(request.relative_error, request.error_up_to_deg) for run in runs]
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
