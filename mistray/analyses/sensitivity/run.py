"""`mistray.sensitivity`: how much every parameter of a scene changes a metric within its manufacturing tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi

from mistray._mitsuba_compat import holds_numbers, peek
from mistray.analyses.sensitivity.changes import ParameterChange, best_together
from mistray.analyses.sensitivity.draws import LEAST_SYSTEMS, Draws, draw_systems
from mistray.analyses.sensitivity.finished import Finished, signature_of
from mistray.analyses.sensitivity.in_time import gradient_in_time
from mistray.analyses.sensitivity.propagation import MetricSpread, propagate
from mistray.analyses.sensitivity.proposals import SEEDS, free_keys, traced_change
from mistray.analyses.sensitivity.rows import Line, LineNumbers, SensitivityRow, lines_of, shifted_values, whole_values
from mistray.analyses.sensitivity.steps import Progress, Steps
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.execute.workers import refuse_workers_in_time
from mistray.kernel.scatter_tables import ScatterTables
from mistray.known_arguments import known_arguments
from mistray.metrics.changes.first_surfaces import Entering, spoils
from mistray.metrics.changes.gaps import Gap
from mistray.metrics.gradient import Gradient, gradient_request
from mistray.metrics.metric import Metric
from mistray.metrics.parameters import Parameter, match, parameters
from mistray.metrics.views import seen_unpolarized
from mistray.notes import warns
from mistray.ranges import FACTOR, POSITIVE
from mistray.sampling.sources import spectrum_of
from mistray.surfaces.surfaces import SurfaceTable

if TYPE_CHECKING:
    import pandas as pd


SHARE_OF_GRADIENT = 0.5  # of the time, with the check; perturbed systems have the rest
CHECKED = ("traced", "image", "gaps", "entering")  # what a check adds to a proposal


@dataclass(frozen=True)
class Together:
    """
    A few changes at once.

    Attributes
    ----------
    changes : tuple of (SensitivityRow, ParameterChange)
        The largest part first; none where no derivative is known well enough.
    factor : float
        Times that the metric is smaller, by the model.
    reached : bool
        Whether that is the factor requested.
    traced : Estimate or None
        The same from traces of the changed scene with other seeds; None where they were not requested, or there was no
        time for them.
    image : Estimate or None
        Power of the direct image over that before, at the sources' own field, from traces as well.
    gaps : tuple of Gap
        Surfaces that meet before and are apart after, see `mistray.metrics.changes.gaps`.
    entering : mapping of str to tuple of Entering
        By field angle in words: first surfaces of light after the changes that were none before.
    """

    changes: tuple[tuple[SensitivityRow, ParameterChange], ...]
    factor: float
    reached: bool
    traced: Estimate | None = None
    image: Estimate | None = None
    gaps: tuple[Gap, ...] = ()
    entering: Mapping[str, tuple[Entering, ...]] = field(default_factory=dict)

    @property
    def spoiled(self) -> bool:
        """Whether so much light enters by new surfaces that a smaller metric is no gain."""
        return any(spoils(entering) for entering in self.entering.values())


@dataclass(frozen=True)
class Sensitivity:
    """
    Result of `sensitivity`.

    Attributes
    ----------
    name, unit : str
        Of the metric.
    value : Estimate
        The metric.
    rows : tuple of SensitivityRow
        The largest change per tolerance first.
    spread : MetricSpread
        Linear propagation of all tolerances.
    factor : float
        What the changes shall lower the metric by.
    together : Together
        The best three changes.
    draws : Draws or None
        Monte Carlo of perturbed systems; None too where there was no time for two of them.
    not_traced : tuple of str
        What was requested and for which there was no time, in words.
    left_out : tuple of str
        What the derivatives do not contain.
    edge_width : float or None
        Width of the zones at rims, over their radii; None where no ray near a rim counts.
    without_derivative : tuple of str
        Keys of numbers of the scene that have no derivative.
    seconds : tuple of float
        Of the primal and of the reverse run of the gradient.
    facts : dict
        How it was computed, plain values.
    """

    name: str
    unit: str
    value: Estimate
    rows: tuple[SensitivityRow, ...]
    spread: MetricSpread
    factor: float
    together: Together
    draws: Draws | None = None
    not_traced: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    edge_width: float | None = None
    without_derivative: tuple[str, ...] = ()
    seconds: tuple[float, float] = (0.0, 0.0)
    facts: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, label: str) -> SensitivityRow:
        """The row of a label."""
        for row in self.rows:
            if row.label == label:
                return row
        raise MistrayError(f"the table has no parameter '{label}'; see [row.label for row in result.rows]")

    def to_pandas(self) -> pd.DataFrame:
        """
        One row for each number, in the order of `rows`.

        Returns
        -------
        DataFrame
            Columns label, keys (several of a material), entry, kind, unit, value, low, high, derivative,
            derivative_se, tolerance, change_percent, change_percent_se (of the metric per tolerance),
            edge_check_percent, edge_check_percent_se, free, to_value, to_factor, reached (see `ParameterChange`),
            share, share_se (of the variance; NaN for members of a group).
        """
        import pandas as pd

        shares = {item.members[0]: item.share for item in self.spread.contributions if len(item.members) == 1}
        unknown = Estimate(math.nan, math.nan)
        return pd.DataFrame(
            [
                {
                    "label": row.label,
                    "keys": " ".join(row.line.keys),
                    "entry": row.line.entry,
                    "kind": row.kind,
                    "unit": row.unit,
                    "value": row.value,
                    "low": row.low,
                    "high": row.high,
                    "derivative": row.derivative.value,
                    "derivative_se": row.derivative.se,
                    "tolerance": row.tolerance,
                    "change_percent": 100 * row.change.value,
                    "change_percent_se": 100 * row.change.se,
                    "edge_check_percent": 100 * row.edge_check.value,
                    "edge_check_percent_se": 100 * row.edge_check.se,
                    "free": row.free,
                    "to_value": row.alone.value,
                    "to_factor": row.alone.factor,
                    "reached": row.alone.reached,
                    "share": shares.get(row.label, unknown).value,
                    "share_se": shares.get(row.label, unknown).se,
                }
                for row in self.rows
            ]
        )

    def __str__(self) -> str:
        return self.to_pandas().to_string(index=False)


# The arguments are the options of `mistray sensitivity`, all but the metric by keyword
# More than 8 parameters: the keywords of a call, each with a default and used one by one
@known_arguments
@warns
def sensitivity(
    metric: Metric,
    params: Mapping[str, Any] | None = None,
    keys: Iterable[str] | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
    together: Sequence[str] = (),
    factor: float = 10.0,
    change: Iterable[str] | None = None,
    reach: float = 10.0,
    check: bool = True,
    monte_carlo: int = 0,
    seed: int = 0,
    edges: bool = True,
    edge_width: float | None = None,
    state: str | Path | None = None,
    resume: bool = False,
    seconds: float | None = None,
    progress: Progress | None = None,
) -> Sensitivity:
    """
    Rank the parameters of a scene by the change of ln(metric) per manufacturing tolerance, by one reverse run.

    Parameters
    ----------
    metric : Metric
        From `mistray.optimize`; its value must be greater than 0.
    params : mi.SceneParameters, optional
        ``mi.traverse(metric.scene)``, which is the default.
    keys : iterable of str, optional
        Keys or patterns such as ``"vane_*.r0"``; by default all that have a derivative.
    tolerances : mapping of str to float, optional
        Key or pattern → tolerance in the unit of the parameter, instead of the usual one; later ones win.
    together : sequence of str
        Patterns of parameters that vary together, all by one tolerance in the same sense: a symmetric group, or a
        property of one batch. Each counts as one in the propagation and in the Monte Carlo.
    factor : float
        What the changes that are looked for shall lower the metric by, greater than 1.
    change : iterable of str, optional
        Keys or patterns of the parameters that may be changed for that; by default those of
        `mistray.analyses.sensitivity.proposals.free_keys`: not the optics themselves.
    reach : float
        Largest change that is proposed, in tolerances: farther away the linear model means little. R and T alone, in
        which powers of paths are polynomials, may go to the ends of their range.
    check : bool
        Trace the scene with the best three changes, on other seeds.
    monte_carlo : int
        Number of perturbed systems to trace with the seed of the metric; 0: none.
    seed : int
        Of the perturbations.
    edges, edge_width
        As for `mistray.gradient`.
    state : str or Path, optional
        File (.npz) for what is finished: the gradient, the check, and the perturbed systems.
    resume : bool
        Go on from `state`, perhaps with more perturbed systems. The result is that of one uninterrupted run.
    seconds : float, optional
        Time for all of it. A gradient that would take longer, or half of that with perturbed systems, has fewer of the
        rays of the metric. Everything that is compared is traced with the same rays. `Sensitivity.not_traced` says what
        is left out; not where workers trace.
    progress : callable, optional
        Called with what is done and what there is to do.

    Returns
    -------
    Sensitivity

    Raises
    ------
    MistrayError
        If a key is unknown, nothing is left to differentiate by, an argument is out of range, or the metric is 0 or not
        finite; if a beam just fills a rim that one of `keys` or of `together` moves. Without `keys` such parameters are
        left out. If the state is of another run.
    """
    _check(factor, reach, monte_carlo, seconds, resume and state is None)
    advance = Steps(progress, 1 + (2 * SEEDS if check else 0) + monte_carlo, seconds)
    given = mi.traverse(metric.scene) if params is None else params
    known = parameters(metric.scene, given)
    chosen = list(known) if keys is None else match(known, keys)
    if not chosen:
        raise MistrayError("there is no parameter to differentiate by; the scene has none, or no key is given")
    lines = lines_of(metric.scene, given, known, chosen)
    limits = _tolerances(known, tolerances or {})
    _groups(known, lines, together)  # before the trace: what is wrong with them costs no time
    free = set(free_keys(metric.scene, known) if change is None else match(known, change))
    active = {key: known[key] for line in lines for key in line.moved}
    request = gradient_request(active.values(), edges, edge_width)
    arguments = {"tolerances": dict(tolerances or {}), "together": list(together), "reach": reach, "edges": edges}
    arguments |= {"edge_width": edge_width, "seed of the draws": seed}
    asked = {"factor": factor, "parameters": sorted(active), "changed": sorted(free)}
    finished = Finished(state, signature_of(metric, given, arguments | asked))
    if resume and state is not None:
        finished.read(state, metric)
    looks = (2 * SEEDS if check else 0) + min(monte_carlo, LEAST_SYSTEMS)
    part = SHARE_OF_GRADIENT if monte_carlo else 1.0
    taken = gradient_in_time(metric, active, request, advance, part, looks, finished.taken)
    finished.take(taken)
    metric, found = taken.metric, taken.found
    advance()
    _require_light(found)
    found.require(active if keys is not None else match(known, together))
    lines, without = _with_derivative(found, lines)
    groups = _groups(known, lines, together)
    not_traced = [] if taken.times == 1 else [f"{1 - taken.times:.3%} of the rays".replace("%", " %")]
    table = LineNumbers.of(found, lines, limits)
    wavelengths, _ = spectrum_of(metric.scene, metric.wavelength_nm, metric.weights)

    def scatters() -> None:
        """Ask every scatter model for its lobes, as a trace does."""
        for wavelength in wavelengths if any(one.kind == "scatter" for one in known.values()) else ():
            ScatterTables(SurfaceTable(metric.scene, float(wavelength)), {})

    reachable = table.accepted(given, table.reachable(free, reach), scatters)
    rows = table.rows(free, reachable, factor)
    spread = propagate([row.label for row in rows], table.change_batches, groups)
    best = best_together(reachable, factor)
    changes = tuple((rows[change.number], change) for change in best)
    proposal = Together(changes, math.prod(change.factor for change in best), any(change.reached for change in best))
    if check and changes:
        proposal, seeds = _checked(proposal, metric, given, advance, finished)
        not_traced += [f"{SEEDS - seeds} of {SEEDS} seeds of the changes"] if seeds < SEEDS else []
    draws = None
    if monte_carlo:
        draws = draw_systems(metric, given, rows, groups, int(monte_carlo), seed, advance, finished)
        traced = 0 if draws is None else len(draws.ratios)
        if traced < monte_carlo:
            not_traced.append(f"{monte_carlo - traced} of {monte_carlo} perturbed systems")
    return Sensitivity(
        name=metric.name,
        unit=metric.unit,
        value=Estimate(found.value, found.value_se),
        rows=tuple(sorted(rows, key=lambda row: -abs(row.change.value))),
        spread=spread,
        factor=factor,
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


def _check(factor: float, reach: float, monte_carlo: int, seconds: float | None, stateless: bool) -> None:
    """Refuse arguments that are out of range; `stateless`: to resume without a state."""
    if seconds is not None:
        refuse_workers_in_time()
    if stateless:
        raise MistrayError("resume needs a state; name the file of the run to go on from")
    FACTOR.check("factor", factor)
    POSITIVE.check("reach", reach)
    if monte_carlo != int(monte_carlo) or monte_carlo < 0 or monte_carlo == 1:
        raise MistrayError(f"monte_carlo is {monte_carlo}; give the number of perturbed systems, at least 2, or 0")


def _checked(
    proposal: Together, metric: Metric, params: Mapping[str, Any], advance: Steps, finished: Finished
) -> tuple[Together, int]:
    """Changes with what comes of them by traces, as far as there is time, and the seeds that were traced."""
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
    """The lines that have a derivative; what is to be said of the others, which no sum can hold."""
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


def _tolerances(known: Mapping[str, Parameter], given: Mapping[str, float]) -> dict[str, float]:
    """Tolerance of every parameter."""
    limits = {key: parameter.tolerance for key, parameter in known.items()}
    for pattern, value in given.items():
        POSITIVE.check(f"tolerance of '{pattern}'", value)
        limits |= dict.fromkeys(match(known, [pattern]), float(value))
    return limits


def _groups(
    known: Mapping[str, Parameter], lines: Sequence[Line], patterns: Sequence[str]
) -> list[tuple[str, list[int]]]:
    """Names and numbers of the lines that vary together."""
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
    """Keys of the numbers of a scene that are no parameters with a derivative."""
    return [
        key
        for key in params.keys()  # noqa: SIM118  SceneParameters iterates over pairs
        # What plugins in Python hold has no address: buffers of meshes and the like do
        if key not in known and params.properties[key][1] is None and holds_numbers(peek(params, key))
    ]
