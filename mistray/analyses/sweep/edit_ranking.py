"""Ranking of possible edits by derivatives of the PST: moves, blocks, paint and coatings in one table."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi

from mistray.analyses.pst.metrics.pst_metrics import pst_bin
from mistray.analyses.sensitivity.proposals import structure
from mistray.analyses.sensitivity.rows import (
    Line,
    LineNumbers,
    lines_of,
    motion_lines,
    shifted_values,
    whole_values,
)
from mistray.analyses.sweep.numbers import widest
from mistray.analyses.sweep.request import RankingRequest
from mistray.errors import MistrayError, errors_of
from mistray.estimate import Estimate
from mistray.metrics.bodies import bodies
from mistray.metrics.changes.gaps import Contacts, Gap
from mistray.metrics.gradient import gradient_request, gradient_seen
from mistray.metrics.parameters import Parameter, match, parameters
from mistray.metrics.scene_values import changed
from mistray.metrics.views import seen_unpolarized
from mistray.result import KeyNumber, Result
from mistray.scene import find, load
from mistray.toolkit.analysis import analysis
from mistray.toolkit.tables.frames import flat, row_of

if TYPE_CHECKING:
    import pandas as pd

    from mistray.analyses.pst.result import Pst

METHODS = ("move", "block", "paint", "coat")
STEPS: dict[str, float | str] = {
    "position": 0.1,
    "tilt": 0.1,
    "rim": 0.1,
    "scatter": "1 %",
    "share": "1 %",
    "coating": 1.0,
}
"""Usual steps by kind of parameter: mm, degrees, mm, per cent of the value, per cent of the value, nm."""
CERTAIN = 2.0  # standard errors that are taken off a change for its place in the ranking

Progress = Callable[[float, float], None]


@dataclass(frozen=True)
class Edit:
    """
    Parameter of the scene that can be edited, and the effect of one step on the PST.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    line : Line
        Parameter, or parameters that change together, of the edit.
    label, kind, unit : str
        Label, kind and unit of the line, see `mistray.analyses.sensitivity.rows.SensitivityRow`.
    value : float
        Value in the scene, in `unit`.
    step : float
        Step, in `unit`, greater than 0.
    derivative : tuple of Estimate
        d PST / d value at each of the n field angles, per `unit`; the PST is dimensionless.
    change : tuple of Estimate
        First-order change of ln(PST) by one step, dimensionless, at each field angle.
    gaps : tuple of Gap
        Gaps that one step opens, in the direction that lowers the PST at the angle of the largest change; see
        `mistray.metrics.changes.gaps`. The derivatives do not include the light that enters there.
    """

    method: str
    line: Line
    label: str
    kind: str
    unit: str
    value: float
    step: float
    derivative: tuple[Estimate, ...]
    change: tuple[Estimate, ...]
    gaps: tuple[Gap, ...] = ()


@dataclass(frozen=True, repr=False)
class EditRanking(Result, table=".edit_tables:edit_ranking_table", figure=".edit_figures:edit_ranking_figure"):
    """
    Result of `rank_edits`: edits with their effect on the PST, and the PST by field angle.

    Attributes
    ----------
    field_deg : tuple of float
        Field angles, degrees.
    light : str
        Classes of light that are counted.
    pst : tuple of Estimate
        PST of the original scene, dimensionless, at each field angle.
    edits : tuple of Edit
        Edits, the largest change at any field angle, less two standard errors, first. Of the edits with such a change,
        those that open a gap come after the others; then follow edits whose change is within two standard errors.
    left_out : tuple of str
        Effects that the derivatives do not contain, and changes of more than 1 % that Stokes vectors would make.
    edge_width : tuple of float or None
        Relative width of the zones at rims at each field angle, see `mistray.optimize.Gradient`; None where no ray near
        a rim counts.
    traced : Pst or None
        PST that is differentiated, with the facts of its trace; None if it is not kept.

    Examples
    --------
    >>> found = mistray.sweeps.rank_edits("plate_and_wall", 30, rays=10_000, keys="polish.*")
    >>> found.edits[0].label
    'polish.g'
    >>> print(f"PST {found.pst[0].value:.1e}, ranked by steps such as {found['polish.A'].step:.1e} of A")
    PST 2.9e-03, ranked by steps such as 2.5e-06 of A
    """

    field_deg: tuple[float, ...]
    light: str
    pst: tuple[Estimate, ...]
    edits: tuple[Edit, ...]
    left_out: tuple[str, ...] = field(default=())
    edge_width: tuple[float | None, ...] = ()
    traced: Pst | None = None

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of edits, the PST at the first angle, and the label of the top edit."""
        found: dict[str, KeyNumber] = {"edits": len(self.edits)}
        found |= {f"PST at {angle:g}° [1]": pst for angle, pst in zip(self.field_deg[:1], self.pst, strict=False)}
        return found | ({"first": self.edits[0].label} if self.edits else {})

    def __getitem__(self, label: str) -> Edit:
        """Return the edit with a given label; raise `MistrayError` if there is none."""
        for edit in self.edits:
            if edit.label == label:
                return edit
        raise MistrayError(f"the ranking has no edit '{label}'; see [edit.label for edit in result.edits]")

    def to_pandas(self) -> pd.DataFrame:
        """
        Return a row for each edit and field angle, in the order of `edits`, as a frame.

        Returns
        -------
        DataFrame
            Columns method, label, kind, value, unit, step (in the unit), angle_deg, pst, pst_se, derivative,
            derivative_se (of the PST, per unit), change, change_se (of the PST by one step), change_percent,
            change_percent_se (of that over the PST), gap_mm (the widest of `Edit.gaps`; NaN without any).
        """
        import pandas as pd

        rows = []
        for edit in self.edits:
            own = row_of(edit, "method", "label", "kind", "value", "unit", "step")
            for angle, pst, slope, change in zip(self.field_deg, self.pst, edit.derivative, edit.change, strict=True):
                numbers = {"pst": pst, "derivative": slope, "change": slope.times(edit.step)}
                numbers["change_percent"] = change.times(100)
                rows.append({**own, "angle_deg": angle, **flat(numbers), "gap_mm": widest(edit.gaps)})
        return pd.DataFrame(rows)

    def __str__(self) -> str:
        return self.to_pandas().to_string(index=False)


def run(scene: str | Path | mi.Scene, request: RankingRequest, *, progress: Progress | None = None) -> EditRanking:
    """
    Rank possible edits (moves, blocks, paint, coatings) by the first-order effect of one step of each on the PST.

    It takes one PST and, for each field angle, one reverse-mode run that gives the derivatives with respect to all
    parameters.

    ====== ========================================================================================================
    move   places and tilts of parts as a whole
    block  radii and ends of opaque surfaces that are not part of a lens
    paint  values of scatter models: of paint, polish, dust; the ideal R of opaque surfaces
    coat   thicknesses of layers, the ideal R of lenses, mirrors and detectors
    ====== ========================================================================================================

    Steps are in the unit of the parameter, or text in percent of its value, ``"2 %"``; of a list, such as the layers of
    a coating, each entry in percent of its own value. A step by key overrides one by kind, and a later one an earlier
    one.

    Parameters
    ----------
    scene : str, Path or mi.Scene
        Scene XML file, name of a shipped scene, or a loaded scene.
    request : RankingRequest
    progress : callable, optional
        Called with (runs done, runs to do).

    Returns
    -------
    EditRanking

    Raises
    ------
    MistrayError
        If there is nothing to edit, a key or step is unknown or out of range, a step in per cent is one of 0, or the
        PST at an angle is 0.

    Examples
    --------
    >>> steps = {"polish.A": "10 %"}
    >>> found = mistray.sweeps.rank_edits("plate_and_wall", 30, rays=10_000, keys="polish.*", steps=steps)
    >>> [edit.label for edit in found.edits]
    ['polish.A', 'polish.g', 'polish.B']
    >>> print(f"{found.to_pandas().change_percent[0]:.1f} % by a tenth more scatter")
    1.9 % by a tenth more scatter
    """
    angles, keys = request.field_deg, request.keys
    loaded = scene if isinstance(scene, mi.Scene) else load(find(scene))
    params = mi.traverse(loaded)
    known = parameters(loaded, params)
    method = _methods(loaded, known)
    chosen = list(method) if keys is None else match({key: known[key] for key in method}, keys)
    if not chosen:
        raise MistrayError("rank_edits: the scene has nothing with a derivative to move, block, paint or coat")
    lines = _lines(loaded, params, known, chosen)
    steps = _steps(known, lines, request.steps or {})
    how = {"azimuth_deg": request.azimuth_deg, **request.spectrum, **request.pst, **request.settings}
    metrics = [pst_bin(loaded, angle, request.light, pst_field_deg=angles, **how) for angle in angles]
    active = {key: known[key] for line in lines for key in line.moved}
    wanted = gradient_request(active.values(), True, request.edge_width)
    observations = metrics[0].observe()
    tables, values, widths, left_out = [], [], [], dict[str, None]()
    for number, (angle, metric) in enumerate(zip(angles, metrics, strict=True)):
        if progress is not None:
            progress(number + 1, len(metrics) + 1)
        found = gradient_seen(metric, observations, active, wanted)
        if not found.value > 0:
            raise MistrayError(
                f"rank_edits: the PST at {angle:g}° is {found.value:g}, which has no relative change; give other "
                "angles or more rays"
            )
        tables.append(LineNumbers.of(found, lines, steps))
        values.append(Estimate(found.value, found.value_se))
        widths.append(found.edge_width)
        left_out |= dict.fromkeys(found.left_out)
    left_out |= dict.fromkeys(seen_unpolarized(loaded, metrics[0].views))
    if progress is not None:
        progress(len(metrics) + 1, len(metrics) + 1)
    edits = [
        Edit(
            method[line.keys[0]],
            line,
            line.label,
            line.parameter.kind,
            line.parameter.unit,
            line.value,
            steps[k],
            tuple(Estimate(float(t.derivative[k]), float(t.derivative_se[k])) for t in tables),
            tuple(
                Estimate(*(float(x[k] * t.ranges.tolerance[k]) for x in (t.ranges.slope, t.ranges.slope_se)))
                for t in tables
            ),
        )
        for k, line in enumerate(lines)
    ]
    edits = _with_gaps(loaded, params, known, edits)
    edits.sort(key=_order)
    named, seen = ", ".join(request.light), observations[0].pst
    return EditRanking(angles, named, tuple(values), tuple(edits), tuple(left_out), tuple(widths), seen)


rank_edits = analysis("rank_edits", RankingRequest, run)


def _certain(change: Estimate) -> float:
    """Return by how much the size of a change exceeds `CERTAIN` standard errors, in the unit of the change; else 0."""
    return max(abs(change.value) - CERTAIN * change.se, 0.0)


def _order(edit: Edit) -> tuple[bool, bool, float, float]:
    """Return the key to sort edits by, in the order of `EditRanking.edits`; of equals the larger change comes first."""
    certain = max(map(_certain, edit.change))
    return certain == 0, bool(edit.gaps), -certain, -max(abs(change.value) for change in edit.change)


def _with_gaps(scene: Any, params: Any, known: Mapping[str, Parameter], edits: Sequence[Edit]) -> list[Edit]:
    """
    Return the edits with the gaps between surfaces that one step of each opens.

    The step is taken in the direction that lowers the PST at the angle of the largest change. Only moves and blocks can
    open a gap. A step that is impossible has none.
    """
    contacts = Contacts(scene)
    found = []
    for edit in edits:
        moved = {name for key in edit.line.moved for name in known[key].shapes}
        largest = max(edit.change, key=lambda change: (_certain(change), abs(change.value)))
        if edit.method in ("move", "block") and largest.value and not contacts.surfaces.isdisjoint(moved):
            values = whole_values(params, [edit.line])
            values = shifted_values(values, [edit.line], [edit.value - math.copysign(edit.step, largest.value)])
            with contextlib.suppress(MistrayError), changed(params, values):  # a step that is too large for it
                edit = replace(edit, gaps=contacts.opened(scene, moved))
        found.append(edit)
    return found


def _methods(scene: Any, known: Mapping[str, Parameter]) -> dict[str, str]:
    """Return the kind of edit, one of `METHODS`, for each parameter by key; parameters without one are left out."""
    rigid = structure(scene)
    parts: dict[str, list[str]] = {}
    for shape in scene.shapes():
        parts.setdefault(getattr(shape, "part", "") or shape.id(), []).append(shape.id())
    together = {name: set(ids) for ids in parts.values() for name in ids}
    found = {}
    for key, p in known.items():
        fellows = together[p.shapes[0]] if p.shapes else set()
        if p.kind in ("position", "tilt"):
            found[key] = "move"
        elif p.kind == "rim" and fellows <= rigid:
            found[key] = "block"
        elif p.kind == "scatter" or (p.kind == "share" and p.name == "R" and set(p.shapes) <= rigid):
            found[key] = "paint"
        elif (p.kind == "share" and p.name == "R") or p.name == "thickness_nm":
            found[key] = "coat"
    return found


def _lines(scene: Any, params: Any, known: Mapping[str, Parameter], chosen: Sequence[str]) -> list[Line]:
    """Return the lines of a sensitivity table for the chosen parameters; `bodies`, optics too, move as a whole."""
    whole = {key: line for body in bodies(known).values() for line in motion_lines(body, known) for key in line.keys}
    moved = {whole[key].label: whole[key] for key in chosen if key in whole}
    return [*moved.values(), *lines_of(scene, params, known, [key for key in chosen if key not in whole])]


def _steps(known: Mapping[str, Parameter], lines: Sequence[Line], given: Mapping[str, float | str]) -> list[float]:
    """Return the step of each line, in its unit; `given` overrides default steps by kind or key."""
    by_kind = {**STEPS, **{name: step for name, step in given.items() if name in STEPS}}
    wanted = {line.label: by_kind[line.parameter.kind] for line in lines}
    for name, step in given.items():
        if name not in STEPS:
            with errors_of("steps"):
                keys = set(match(known, [name]))
            touched = [line.label for line in lines if keys & set(line.keys)]
            if not touched:
                raise MistrayError(f"step of '{name}': none of the edits is about it; leave it out")
            wanted |= dict.fromkeys(touched, step)
    return [_step(line, wanted[line.label]) for line in lines]


def _step(line: Line, step: float | str) -> float:
    """
    Return a step in the unit of a line, from a number or a percentage of its value such as "5 %".

    Raises
    ------
    MistrayError
        If the step is not a number above 0, or is a percentage of 0.
    """
    what, unit = f"step of '{line.label}'", line.parameter.unit
    text = str(step).strip()
    try:
        number = float(text.removesuffix("%"))
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise MistrayError(f"{what} is {text}; give a number greater than 0 in {unit}, or per cent, '2 %'")
    if not text.endswith("%"):
        return number
    size = abs(line.value)
    if size == 0:
        raise MistrayError(f"{what} is {text} of 0; give it in {unit}")
    return number / 100 * size
