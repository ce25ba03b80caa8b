"""`mistray.trace`: forward traces of the ray tree of a scene, from its sources to its detector."""

from __future__ import annotations

import importlib.metadata
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import lru_cache, partial
from typing import Any, NoReturn

import mitsuba as mi

from mistray.errors import Interrupted, MistrayError, UnfinishedError
from mistray.execute.by_parts import TracedRuns, execute_by_parts
from mistray.execute.forecast import Forecast
from mistray.execute.scene_task import SceneTask
from mistray.execute.tracer import MOST_PATHS_KEPT, PASS_LANES, Run, prepare
from mistray.execute.wavelength_choice import WavelengthChoice, chosen_wavelengths
from mistray.execute.workers import current_workers, refuse_workers_in_time
from mistray.interrupts import later, requested
from mistray.known_arguments import known_arguments
from mistray.light import Light
from mistray.messages import Message
from mistray.notes import warns
from mistray.ranges import WAVELENGTHS_NM, WEIGHTS, OfType, Several, several
from mistray.recorders.recorder import Recorder
from mistray.recorders.tallies import FIRST_MISS, Tallies
from mistray.sampling.sources import field_of, source_emitters
from mistray.scene.check import require_scene
from mistray.scene.titles import scene_name
from mistray.settings import Settings
from mistray.time_budget import is_limited, share, within
from mistray.trace.host.polarization_choice import PolarizationChoice, chosen_polarization
from mistray.trace.result import Trace


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Return the versions of mistray, Mitsuba, Dr.Jit and NumPy, by package name, for the record of a result."""
    return {name: importlib.metadata.version(name) for name in ("mistray", "mitsuba", "drjit", "numpy")}


RECORDERS = Several(OfType(Recorder, "must be a recorder, such as mistray.recorders.Probe, or several"), least=0)


# More than 8 parameters: the keywords of a call, each with a default and used one by one
@known_arguments
@warns
def trace(
    scene: mi.Scene,
    rays: float | None = None,
    field_deg: float | None = None,
    azimuth_deg: float | None = None,
    wavelength_nm: float | Sequence[float] | WavelengthChoice | None = None,
    weights: float | Sequence[float] | None = None,
    max_reflections: int | None = None,
    max_scatters: int | None = None,
    max_optical_scatters: int | None = None,
    max_random_scatters: int | None = None,
    max_generations: int | None = None,
    max_events: int | None = None,
    max_consecutive: int | None = None,
    max_segments: int | None = None,
    scatter_rays: int | None = None,
    aimed_rays: int | None = None,
    aim: str | None = None,
    flux_threshold: float | None = None,
    cut_below: Any = None,
    cut_below_W: Any = None,
    scatter_threshold: float | None = None,
    splitting: str | None = None,
    below_threshold: str | None = None,
    seed: int | None = None,
    ray_control: str | None = None,
    polarization: str | PolarizationChoice | None = None,
    detector: str | Sequence[str] | None = None,
    ledger: bool = True,
    progress: Callable[[int, int], None] | None = None,
    seconds: float | None = None,
    recorders: Recorder | Sequence[Recorder] = (),
    field_mm: float | None = None,
) -> Trace:
    """
    Trace the ray trees of a scene from its sources to its detectors; return flux, paths and energy ledger.

    An argument that is None takes the value of the scene's ``straylight`` integrator or source, or else the default of
    `mistray.trace.Settings`.

    Parameters
    ----------
    scene : mi.Scene
        From `mistray.load`, or any Mitsuba scene with ``interface`` BSDFs, a source and a detector.
    rays : int
        Number of start rays.
    field_deg, azimuth_deg : float
        Field angle of the light and azimuth, from +y towards -x of the source's frame, degrees. A near source moves in
        its object plane to the point whose light comes to the origin of its frame at that angle.
    field_mm : float
        Place of a near source along y in its object plane, mm, instead of `field_deg`.
    wavelength_nm : float or sequence of float
        Vacuum wavelengths, nm; or a `mistray.execute.wavelength_choice.WavelengthChoice` that was made before.
    weights : float or sequence of float
        Shares of the flux, one for each wavelength; normalised, equal by default.
    max_reflections, max_scatters, max_optical_scatters, max_random_scatters
        Limits of reflections and scatter events along a path, see `mistray.trace.Settings`.
    max_generations, max_events, max_consecutive, max_segments
        Limits of a path and of a tree, see `mistray.trace.Settings`.
    scatter_rays, aimed_rays, aim
        Numbers of scattered rays at every hit, and their targets, see `mistray.trace.Settings`.
    flux_threshold, cut_below, cut_below_W, scatter_threshold, below_threshold
        Thresholds below which branches end or play Russian roulette, see `mistray.trace.Settings`.
    splitting, seed, ray_control, polarization
        Splitting, seed, allowed events, and polarisation or a `mistray.trace.PolarizationChoice`, see `Settings`.
    detector : str or sequence of str
        Ids of the detectors, by default all; light on the others is absorbed. `Trace.on` returns the result of one.
    ledger : bool
        Whether to keep the path table; without it a trace is a little faster.
    progress : callable
        Called about every second with (rays done, rays in all).
    seconds : float
        Time, s, after which the trace ends with the rays that it has, `Trace.rays_traced`, a sample of all. It includes
        the kernel's compilation, and the last launch may take a second longer. Where there is not time for all
        wavelengths some are traced, spread over all, and stand for their neighbours; a note names the rest.
    recorders : Recorder or sequence of Recorder
        Probes and far fields, see docs/detectors.md, or recorders of your own, see docs/extending.md; not where workers
        trace. The recorders of the scene's sensors come before these.

    Returns
    -------
    Trace
        Flux, paths, energy ledger and notes of the trace.

    Raises
    ------
    MistrayError
        If the scene lacks a source, a detector or an ``interface``, or an argument is out of range. Also if arguments
        exclude each other, two recorders have the same name, or all rays of an emitter miss every surface.
    Interrupted
        On Ctrl-C after rays of all sources and wavelengths; ``partial`` is their `Trace`. KeyboardInterrupt before.
    UnfinishedError
        If workers end too early; ``partial`` is a `Trace` of the rays that are traced, or None if they are too few.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> print(f"{t.energy.detected_W:.0f} ± {t.energy.detected_se_W:.1f} W of {t.energy.launched_W:.0f} W are detected")
    83 ± 0.6 W of 380 W are detected
    >>> [path.label for path in t.paths[:3]]
    ['direct image', 'L2_front → L1_rear', 'L3_front → L2_rear']
    """
    require_scene(scene, "trace")
    made = polarization if isinstance(polarization, PolarizationChoice) else None
    settings = Settings.unresolved(
        scene,
        rays=rays,
        max_reflections=max_reflections,
        max_scatters=max_scatters,
        max_optical_scatters=max_optical_scatters,
        max_random_scatters=max_random_scatters,
        max_generations=max_generations,
        max_events=max_events,
        max_consecutive=max_consecutive,
        max_segments=max_segments,
        scatter_rays=scatter_rays,
        aimed_rays=aimed_rays,
        aim=aim,
        flux_threshold=flux_threshold,
        cut_below=cut_below,
        cut_below_W=cut_below_W,
        scatter_threshold=scatter_threshold,
        splitting=splitting,
        below_threshold=below_threshold,
        seed=seed,
        ray_control=ray_control,
        polarization=made.mode if made else polarization,
    )
    field_deg = _field(scene, field_deg, field_mm)
    field = {"field_deg": field_deg, "azimuth_deg": azimuth_deg}
    if not isinstance(wavelength_nm, WavelengthChoice | None):
        wavelength_nm = WAVELENGTHS_NM.check("wavelength_nm", wavelength_nm)
    weights = None if weights is None else WEIGHTS.check("weights", weights)
    detector = detector if isinstance(detector, str | None) else several(detector)
    light = Light(field_deg, azimuth_deg, wavelength_nm, weights, detector)
    all_recorders = _with_own(scene, RECORDERS.check("recorders", recorders))
    with within(seconds):  # pilots of few rays choose wavelengths and polarisation, within the budget as well
        if is_limited():
            refuse_workers_in_time()
        runs_of = _preparing(scene)
        light, lines, choice = _spectral_choices(scene, settings, light, made, seconds is not None, runs_of)
        settings = replace(settings, polarization=choice.mode)
        planned = TracedRuns(scene, settings, light, ledger, runs_of)
        facts = asdict(settings) | choice.facts | (lines.facts if lines else {})
        result = partial(_result, scene, settings=facts, field=field, ledger=ledger)
        _check_budget(planned.runs)
        found = _traced(planned, ledger, progress, all_recorders, result)
    found.recorders = {recorder.name: recorder for recorder in all_recorders if recorder.name}
    found.own_notes += lines.notes() if lines else []
    return found


def _traced(
    planned: TracedRuns,
    ledger: bool,
    progress: Callable[[int, int], None] | None,
    recorders: Sequence[Recorder],
    result: Callable[..., Trace],
) -> Trace:
    """
    Return the result of the planned runs, traced in this process or on workers.

    `result` makes the `Trace` of traced runs; other parameters are those of `trace`. An interrupt here raises
    `Interrupted` with a partial result, or KeyboardInterrupt without one. Workers that do not finish raise
    `UnfinishedError`, with a partial result if there is one. With workers, recorders raise `MistrayError`.
    """
    workers = current_workers()
    if workers is None:
        with later():
            runs = _execute(planned.runs, ledger, progress, recorders)
            if requested():
                _keep(planned.runs, runs, partial(result, task=None))
        return result(runs, task=None)
    _refuse_recorders(recorders)
    task = planned.task
    try:
        runs = execute_by_parts(workers, task, planned.runs, progress)
    except UnfinishedError as error:
        _explain(error, partial(result, task=task))
        raise
    _require_hits(runs)
    return result(runs, task=task)


def _preparing(scene: mi.Scene) -> Callable[[Settings, Light], list[Run]]:
    """Return a function that prepares runs for settings and light, and remembers them for repeated calls."""
    known: dict[str, list[Run]] = {}

    def runs_of(settings: Settings, light: Light) -> list[Run]:
        key = repr((settings, light))
        if key not in known:
            known[key] = prepare(scene, settings, light)
        return known[key]

    return runs_of


def _spectral_choices(
    scene: mi.Scene,
    settings: Settings,
    light: Light,
    made: PolarizationChoice | None,
    limited: bool,
    runs_of: Callable[[Settings, Light], list[Run]],
) -> tuple[Light, WavelengthChoice | None, PolarizationChoice]:
    """
    Return the light to trace, the choice of its wavelengths (None if all are traced), and the polarisation.

    `made` is a choice of polarisation that was made before; None: "auto" is resolved here. Wavelengths are chosen if
    the time is `limited` and the light has no choice yet. `runs_of` prepares runs, see `_preparing`.
    """
    lines = light.wavelength_nm if isinstance(light.wavelength_nm, WavelengthChoice) else None
    light = replace(light, **lines.arguments) if lines else light
    choice = made or chosen_polarization(scene, settings, [light], runs_of)
    # The pilot has to trace in the mode of the trace, whose time it measures
    if limited and lines is None:
        settings = replace(settings, polarization=choice.mode)
        lines = chosen_wavelengths(scene, light, partial(_timed, scene, settings, light))
        light = replace(light, **lines.arguments) if lines else light
    return light, lines, choice


def _timed(scene: mi.Scene, settings: Settings, light: Light, rays: int, **lines: Any) -> None:
    """
    Trace `rays` start rays and discard the result, so that the caller can time a trace at the given wavelengths.

    Raise as `trace` does.
    """
    _execute(prepare(scene, replace(settings, rays=rays), replace(light, **lines)), True, None, ())


def _field(scene: mi.Scene, field_deg: float | None, field_mm: float | None) -> float | None:
    """
    Return the field angle, degrees, given as an angle or as the object height `field_mm`, mm; None: that of the source.

    Both at once raise `MistrayError`.
    """
    if field_mm is None:
        return field_deg
    if field_deg is not None:
        raise MistrayError("field_deg and field_mm are given; give one of them")
    return field_of(scene, field_mm)


def _refuse_recorders(recorders: Sequence[Recorder]) -> None:
    """Raise `MistrayError` if there are recorders, given or of the scene; for traces on workers, which have none."""
    if recorders:
        names = ", ".join(f"'{recorder.name}'" for recorder in recorders if recorder.name)
        raise MistrayError(
            f"recorders{names and ' '}{names} are given, or in the scene, and workers trace, which have no recorders; "
            "leave out one of them"
        )


def _with_own(scene: mi.Scene, given: Sequence[Recorder]) -> list[Recorder]:
    """Return the recorders of the scene's sensors followed by the given ones; raise `MistrayError` if names repeat."""
    recorders = [*(sensor.recorder() for sensor in scene.sensors() if hasattr(sensor, "recorder")), *given]
    names = [recorder.name for recorder in recorders if recorder.name]
    for name in names:
        if names.count(name) > 1:
            raise MistrayError(f"{names.count(name)} recorders have the name '{name}'; give each a name of its own")
    return recorders


def _execute(
    runs: Sequence[Run],
    ledger: bool,
    progress: Callable[[int, int], None] | None,
    recorders: Sequence[Recorder],
) -> list[Run]:
    """
    Trace runs in this process one by one and return those traced, with their paths if `ledger`.

    An interrupt ends the trace; a run cut short is scaled to its full flux. An emitter whose rays all miss the scene
    raises `MistrayError`. For `progress` and `recorders` see `trace`.
    """
    planned = sum(run.rays for run in runs)
    forecast = Forecast(planned, not is_limited())
    before = 0
    done: list[Run] = []
    for run in runs:

        def report(traced: int, tallies: Tallies, before: int = before, run: Run = run) -> None:
            forecast.look(run, before + traced, tallies)
            if progress:
                progress(before + traced, planned)

        with share(run.rays / (planned - before)):
            done.append(run.execute(ledger, report, recorders))
        before += run.rays
        # After the last run of an emitter: a single wavelength or side of it may well miss the scene
        if len(done) == len(runs) or _emitter(runs[len(done)]) is not _emitter(run):
            _require_hits(done)
        if requested():
            break
    return done


def _check_budget(runs: Sequence[Run]) -> None:
    """
    Raise `MistrayError` if a time limit is set and start rays on a grid take several passes.

    The first rows of a grid are not a fair sample.
    """
    for run in runs:
        # A grid comes row by row if it takes several passes
        if is_limited() and run.source.pattern == "grid" and run.passes > 1:
            raise MistrayError(
                f"seconds is given and source '{run.source.name}' starts a grid of {run.rays} rays: "
                f"its first rows are not a sample; give at most {PASS_LANES} rays, or the pattern 'random'"
            )


def _emitter(run: Run) -> Any:
    """Return the emitter of a run, or its source where it has none, to group runs by; warm surfaces share one."""
    return getattr(run.source, "emitter", run.source)


def _require_hits(runs: Sequence[Run]) -> None:
    """Raise `MistrayError` if none of the rays of an emitter meets a surface."""
    for _, found in itertools.groupby(runs, _emitter):
        own = list(found)
        if all(run.sums.channels[FIRST_MISS].sum() == run.started.sum() for run in own):
            source = own[0].source
            raise MistrayError(
                f"source '{source.name}': no ray of its light {source.towards} hits a surface; "
                "check field_deg, the source's position and its size"
            )


def _keep(planned_runs: Sequence[Run], runs: list[Run], result: Callable[[list[Run]], Trace]) -> NoReturn:
    """
    Raise `Interrupted` with the result of the rays traced so far.

    If they are not a fair sample of all light, raise KeyboardInterrupt.
    """
    if len(runs) < len(planned_runs) or not all(run.is_sample for run in runs):
        raise KeyboardInterrupt
    # Reading the ledger would take too long after an interrupt: more than `MOST_PATHS_KEPT` paths are left out
    table = ""
    if any(run.ledger is not None and run.sums.paths is None for run in runs):
        table = f", without a table of their more than {MOST_PATHS_KEPT} paths"
        runs = [replace(run, executed=replace(run.sums, paths=None)) for run in runs]
    partial = result(runs)
    raise Interrupted(f"{partial.rays_traced:.4g} of {partial.rays_planned:.4g} rays are finished{table}", partial)


def _explain(error: UnfinishedError, result: Callable[[list[Run]], Trace]) -> None:
    """
    Replace the runs in `error.partial` by a `Trace` of them, or by None.

    It is None if their rays are too few for a fair sample of all light. The message says how many rays are finished.
    """
    runs, error.partial = error.partial, None
    planned = sum(run.rays for run in runs)
    if not all(run.is_sample for run in runs):
        error.args = (f"{error}; too few of the {planned:.4g} rays are finished for a result",)
        return
    error.partial = result(runs)
    error.args = (f"{error}; {error.partial.rays_traced:.4g} of {planned:.4g} rays are finished and kept",)


def _result(
    scene: mi.Scene,
    runs: list[Run],
    settings: dict[str, Any],
    field: dict[str, float | None],
    ledger: bool,
    task: SceneTask | None,
) -> Trace:
    """
    Return the `Trace` of finished runs, with all settings needed to repeat it.

    `field` holds the angles of the field in degrees by keyword of `trace`; None: the source's own. `ledger` is True if
    the runs hold paths, and `task` is what workers traced, or None. If no light is detected at the source's own field,
    a note says where it went.
    """
    emitter = source_emitters(scene)[0]
    # Everything that determines the result, so that it can be repeated
    wavelengths = sorted({run.source.wavelength_nm for run in runs})
    power = sum(run.source.power for run in runs)
    states = {run.source.name: run.source.stokes for run in runs if run.source.polarized}
    found = Trace(
        runs,
        {
            **settings,
            "rays": sum(run.rays if run.parts is None else round(float(run.started.sum())) for run in runs),
            **{name: getattr(emitter, name) if value is None else float(value) for name, value in field.items()},
            "wavelength_nm": wavelengths,
            "weights": [
                sum(run.source.power for run in runs if run.source.wavelength_nm == w) / power for w in wavelengths
            ],
            "detector": runs[0].table.detector_names,
            "ledger": ledger,
            **({"source_stokes": states} if states else {}),
            "variant": mi.variant(),
            "versions": dict(versions()),
            "date": time.strftime("%Y-%m-%d %H:%M:%S"),
        },
        task,
    ).of_scene(scene_name(scene))

    # At a field of the user's own choice no light on the detector is a result like others
    if not any(value is not None for value in field.values()) and found.rays_traced and found.energy.detected_W == 0:
        found.own_notes.append(Message.DARK.note(loss=found.energy.greatest_loss))
    return found
