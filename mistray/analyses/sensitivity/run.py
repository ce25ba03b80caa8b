"""Sensitivity of a metric to every parameter of a scene within its manufacturing tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi

from mistray._mitsuba_compat import holds_numbers, peek
from mistray.analyses.sensitivity.draws import LEAST_SYSTEMS, draw_systems
from mistray.analyses.sensitivity.finished import Finished, signature_of
from mistray.analyses.sensitivity.in_time import gradient_in_time
from mistray.analyses.sensitivity.propagation import propagate
from mistray.analyses.sensitivity.proposals import SEEDS, free_keys, traced_change
from mistray.analyses.sensitivity.request import SensitivityRequest
from mistray.analyses.sensitivity.result import Sensitivity, Together
from mistray.analyses.sensitivity.rows import Line, LineNumbers, lines_of, shifted_values, whole_values
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.execute.workers import refuse_workers_in_time
from mistray.kernel.scatter_tables import ScatterTables
from mistray.metrics.gradient import Gradient, gradient_request
from mistray.metrics.metric import Metric
from mistray.metrics.parameters import Parameter, chosen_keys, match, parameters
from mistray.metrics.steps import Progress, Steps
from mistray.metrics.views import seen_unpolarized
from mistray.sampling.sources import spectrum_of
from mistray.surfaces.surfaces import SurfaceTable
from mistray.toolkit.analysis import analysis

SHARE_OF_GRADIENT = 0.5  # of the time, with the check; perturbed systems have the rest
CHECKED = ("traced", "image", "gaps", "entering")  # what a check adds to a proposal


def run(
    metric: Metric,
    request: SensitivityRequest,
    *,
    params: Mapping[str, Any] | None = None,
    state: str | Path | None = None,
    resume: bool = False,
    seconds: float | None = None,
    progress: Progress | None = None,
) -> Sensitivity:
    """
    Rank the parameters of a scene by the change of ln(metric) per manufacturing tolerance, by one reverse run.

    Changes are proposed within `reach`, because the linear model fails farther away. R and T alone, in which powers of
    paths are polynomials, may go to the ends of their range. Perturbed systems are traced with the seed of the metric.

    Parameters
    ----------
    metric : Metric
        Metric from `mistray.optimize`; its value must be greater than 0.
    request : SensitivityRequest
    params : mi.SceneParameters, optional
        Parameters of the scene; by default ``mi.traverse(metric.scene)``.
    state : str or Path, optional
        File (.npz) for the finished parts: the gradient, the check, and the perturbed systems.
    resume : bool
        Continue from `state`, perhaps with more perturbed systems. The result is that of one uninterrupted run.
    seconds : float, optional
        Time for the whole run, s. A gradient that would take longer, or more than half of it if perturbed systems are
        requested, uses fewer rays of the metric. All that is compared is traced with the same rays.
        `Sensitivity.not_traced` lists what is left out. Not available with workers.
    progress : callable, optional
        Called with the work done so far and the total work.

    Returns
    -------
    Sensitivity

    Raises
    ------
    MistrayError
        If a key is unknown, no parameter has a derivative, an argument is out of range, the state is of another run, or
        the metric is 0, negative or not finite. Also if a beam just fills a rim that one of `keys` or of `together`
        moves; without `keys` such parameters are left out.

    Examples
    --------
    >>> ghosts = mistray.optimize.path_power(mistray.load("lens_and_window"), "ghost", rays=5000)
    >>> found = mistray.sensitivity(ghosts, keys=["detector.bsdf.R", "*.n_back_shift"], check=False)
    >>> for row in found.rows[:2]:
    ...     print(f"{row.label}: {row.change.value:+.1%} for a tolerance of {row.tolerance:.2g}")
    detector.bsdf.R: +9.2% for a tolerance of 0.04
    index of N-BK7: -0.1% for a tolerance of 0.0005
    """
    if seconds is not None:
        refuse_workers_in_time()
    if resume and state is None:
        raise MistrayError("resume needs a state; name the file of the run to go on from")
    looks, systems = 2 * SEEDS * request.check, request.monte_carlo
    advance = Steps(progress, 1 + looks + systems, seconds)
    given = mi.traverse(metric.scene) if params is None else params
    known = parameters(metric.scene, given)
    chosen = chosen_keys(metric.scene, known, request.keys)
    lines = lines_of(metric.scene, given, known, chosen)
    limits = _tolerances(known, lines, request.tolerances or {})
    _groups(known, lines, request.together)  # before the trace: what is wrong with them costs no time
    free = set(free_keys(metric.scene, known))
    if request.change is not None:
        free = {key for line in _of_keys(lines, match(known, request.change)) for key in line.keys}
    active = {key: known[key] for line in lines for key in line.moved}
    gathered = gradient_request(active.values(), request.edges, request.edge_width)
    arguments: dict[str, Any] = {"tolerances": dict(request.tolerances or {}), "together": list(request.together)}
    arguments |= {name: getattr(request, name) for name in ("reach", "edges", "edge_width")}
    arguments["seed of the draws"] = request.seed
    asked = {"factor": request.factor, "parameters": sorted(active), "changed": sorted(free)}
    finished = Finished(state, signature_of(metric, given, arguments | asked))
    if resume and state is not None:
        finished.read(state, metric)
    looks += min(systems, LEAST_SYSTEMS)
    part = SHARE_OF_GRADIENT if systems else 1.0
    taken = gradient_in_time(metric, active, gathered, advance, part, looks, finished.taken)
    finished.take(taken)
    metric, found = taken.metric, taken.found
    advance()
    _require_light(found)
    found.require(active if request.keys is not None else match(known, request.together))
    lines, without = _with_derivative(found, lines)
    groups = _groups(known, lines, request.together)
    not_traced = [] if taken.times == 1 else [f"{1 - taken.times:.3%} of the rays".replace("%", " %")]
    table = LineNumbers.of(found, lines, [limits[line.label] for line in lines])
    wavelengths = {float(nm) for view in metric.views for nm in spectrum_of(metric.scene, **view.light)[0]}

    def traceable() -> None:
        """
        Set up surfaces and scatter models of the scene as a trace would, so that invalid values raise `MistrayError`.

        Do nothing if no parameter is a share of light or one of a scatter model.
        """
        for wavelength in wavelengths if {"share", "scatter"} & {one.kind for one in known.values()} else ():
            ScatterTables(SurfaceTable(metric.scene, wavelength), {})

    reachable = table.accepted(given, table.reachable(free, request.reach), traceable)
    rows = table.rows(free, reachable, request.factor)
    spread = propagate([row.label for row in rows], table.change_batches, groups)
    shares = {item.members[0]: item.share for item in spread.contributions if len(item.members) == 1}
    rows = [replace(row, share=shares.get(row.label)) for row in rows]
    best = table.together(given, reachable, request.factor, traceable)
    changes = tuple((rows[change.number], change) for change in best)
    proposal = Together(changes, math.prod(change.factor for change in best), any(change.reached for change in best))
    if request.check and changes:
        proposal, seeds = _checked(proposal, metric, given, advance, finished)
        not_traced += [f"{SEEDS - seeds} of {SEEDS} seeds of the changes"] if seeds < SEEDS else []
    draws = None
    if systems:
        draws = draw_systems(metric, given, rows, groups, systems, request.seed, advance, finished)
        traced = 0 if draws is None else len(draws.ratios)
        if traced < systems:
            not_traced.append(f"{systems - traced} of {systems} perturbed systems")
    return Sensitivity(
        name=metric.name,
        unit=metric.unit,
        value=Estimate(found.value, found.value_se),
        rows=tuple(sorted(rows, key=lambda row: -abs(row.change.value))),
        spread=spread,
        factor=request.factor,
        together=proposal,
        draws=draws,
        not_traced=tuple(not_traced),
        left_out=(*found.left_out, *without, *seen_unpolarized(metric.scene, metric.views)),
        edge_width=found.edge_width,
        without_derivative=tuple(_without_derivative(given, known)),
        seconds=found.seconds,
        facts={
            "field_deg": metric.field_deg,
            "wavelength_nm": metric.wavelength_nm,
            **(metric.settings or {}),
            **arguments,
            **({} if taken.times == 1 else {"share of the rays": taken.times}),
        },
    )


sensitivity = analysis("sensitivity", SensitivityRequest, run, ("params", "keys"))


def _checked(
    proposal: Together, metric: Metric, params: Mapping[str, Any], advance: Steps, finished: Finished
) -> tuple[Together, int]:
    """
    Return proposed changes with their traced effect, and the number of seeds on which it was traced.

    Without time for two seeds they are returned as they are, with 0 seeds. A check in `finished` is not traced again.
    """
    lines = [row.line for row, _ in proposal.changes]
    values = shifted_values(whole_values(params, lines), lines, [change.value for _, change in proposal.changes])
    found = finished.check or traced_change(metric, params, values, advance)
    if found is None:
        return proposal, 0
    if found.seeds == SEEDS:
        finished.check = found
        finished.save()
    return replace(proposal, **{name: getattr(found, name) for name in CHECKED}), found.seeds


def _with_derivative(found: Gradient, lines: list[Line]) -> tuple[list[Line], list[str]]:
    """
    Return the table lines whose parameters have a derivative, and notes on the others.

    Raises
    ------
    MistrayError
        If none has a derivative.
    """
    without = [line for line in lines if found.full.keys() & set(line.moved)]
    if len(without) == len(lines):
        found.require(found.full)
    if not without:
        return lines, []
    names = ", ".join(line.label for line in without)
    return [line for line in lines if line not in without], [
        f"parameters that move a rim which a beam just fills; widen the source to have them: {names}"
    ]


def _require_light(found: Gradient) -> None:
    if not math.isfinite(found.value) or found.value <= 0:
        raise MistrayError(
            f"the metric is {found.value:g}, so that it has no relative change; choose another metric, other fields or "
            "more rays"
        )


def _of_keys(lines: Sequence[Line], keys: Iterable[str]) -> list[Line]:
    """Return the lines that hold one of some keys: what several keys share can be named by any of them."""
    return [line for line in lines if not set(line.keys).isdisjoint(keys)]


def _tolerances(known: Mapping[str, Parameter], lines: Sequence[Line], given: Mapping[str, float]) -> dict[str, float]:
    """Return the tolerance of each line, in its unit, by label: the usual one, or that `given` for one of its keys."""
    limits = {line.label: line.parameter.tolerance for line in lines}
    for pattern, value in given.items():
        limits |= {line.label: float(value) for line in _of_keys(lines, match(known, [pattern]))}
    return limits


def _groups(
    known: Mapping[str, Parameter], lines: Sequence[Line], patterns: Sequence[str]
) -> list[tuple[str, list[int]]]:
    """
    Return the name and line indices of each group of parameters that vary together, from patterns of keys.

    Raises
    ------
    MistrayError
        If a group is empty or holds parameters of several kinds, or a parameter is in two groups.
    """
    taken: dict[int, str] = {}
    groups = []
    for pattern in patterns:
        keys = set(match(known, [pattern]))
        numbers = [k for k, line in enumerate(lines) if keys & set(line.keys)]
        if not numbers:
            raise MistrayError(f"group '{pattern}' holds none of the parameters that were chosen; widen the choice")
        for k in numbers:
            if k in taken:
                raise MistrayError(
                    f"'{lines[k].label}' is in the groups '{taken[k]}' and '{pattern}'; put it into one of them"
                )
            taken[k] = pattern
        kinds = dict.fromkeys(lines[k].parameter.kind for k in numbers)
        if len(kinds) > 1:
            raise MistrayError(
                f"group '{pattern}' holds parameters of several kinds ({', '.join(kinds)}); make a group of each"
            )
        groups.append((pattern, numbers))
    return groups


def _without_derivative(params: Any, known: Mapping[str, Parameter]) -> list[str]:
    """Return the keys of numeric scene parameters that cannot be differentiated."""
    return [
        key
        for key in params.keys()  # noqa: SIM118  SceneParameters iterates over pairs
        # What plugins in Python hold has no address: buffers of meshes and the like do
        if key not in known and params.properties[key][1] is None and holds_numbers(peek(params, key))
    ]
