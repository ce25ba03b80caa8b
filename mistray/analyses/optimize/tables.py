"""Tables of an optimisation: terms, variables and steps, as text, DataFrames and JSON values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import pandas as pd

from mistray.analyses.optimize.study.comparison import Comparison, ComparisonRow, Levels, worse
from mistray.analyses.optimize.study.goals import holds, limit_of
from mistray.analyses.optimize.study.model import Term
from mistray.analyses.optimize.study.optimization import Optimization
from mistray.analyses.optimize.study.state import Start, Step
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.metrics.changes.first_surfaces import entering_lines
from mistray.metrics.changes.gaps import gaps_text
from mistray.toolkit.pages.model import Table, Value, columns
from mistray.toolkit.rows import column, records, table
from mistray.toolkit.tables.frames import row_of
from mistray.toolkit.tables.text import first_of, number, table_text, with_error

VALUES = ("before", "after", "ratio")
PLACES_NAMED = 3  # in a warning
AT_BOUND = 1e-6  # of the way from bound to bound


def goal_text(term: Term, start: float) -> str:
    """Return the goal of a term in words, such as "≥ 2", given its value at the start."""
    if term.goal == "keep":
        return f"keep ± {100 * term.tolerance:g} %"
    limit = limit_of(term, start)
    if limit is None:
        return "minimise"
    return f"{'≥' if term.goal == 'at_least' else '≤'} {number(limit, 4)}"


def kept_text(term: Term, row: ComparisonRow) -> str:
    """Return "yes" or "no" for whether a term meets its goal; "–" for the goal "minimise"."""
    if term.goal == "minimise":
        return "–"
    return "yes" if holds(term, row.after, row.before) else "no"


@dataclass(frozen=True)
class VariableRow:
    """Bounds of a variable and its values before and after, in its unit."""

    name: str = column("name of the variable", head="variable")
    unit: str = column("its unit")
    low: float = column("least value", digits=".5g")
    high: float = column("greatest value", digits=".5g")
    before: float = column("value in the given design", digits=".5g")
    after: float = column("value in the result", digits=".5g")


def variable_rows(result: Optimization) -> list[VariableRow]:
    """Return a row for each variable: bounds, value in the given design and value in the result."""
    moved = zip(result.variables.variables, result.best.x, strict=True)
    return [VariableRow(v.name, v.unit, v.low, v.high, v.start, x) for v, x in moved]


def terms_table(result: Optimization) -> str:
    """Return the table of terms before and after, with their goals and whether these are met, as text."""
    rows = [result.comparison.of(term.name) for term in result.study.terms]
    goals = [
        [goal_text(term, row.before), kept_text(term, row)] for term, row in zip(result.study.terms, rows, strict=True)
    ]
    shown = table(ComparisonRow, rows, only=("term", "unit", *VALUES))
    return table_text(shown.beside(Table(columns("<goal", "holds"), goals)))


def worse_lines(result: Optimization) -> list[str]:
    """Return a line for each term that has become worse, with the fields and wavelengths at which it did."""
    found: dict[str, list[str]] = {}
    for row in worse(result.comparison, result.study.terms):
        places = [f"{row.field_deg:g}°"] if row.field_deg is not None else []
        places += [f"{row.wavelength_nm:g} nm"] if row.wavelength_nm is not None else []
        if math.isnan(row.after):
            much = "no value"
        elif row.after and row.ratio:
            much = f"{with_error(Estimate(1 / row.ratio, row.ratio_se / row.ratio**2))} times"
        else:
            much = "from 0" if row.after else "now 0"
        found.setdefault(row.term, []).append(f"{' and '.join(places)} ({much})")
    return [f"{term} is worse than before at {first_of(places, PLACES_NAMED)}" for term, places in found.items()]


def seeds_text(result: Optimization) -> str:
    """Return a line on the seeds on which the terms were compared: a warning if it was that of the search only."""
    if result.unverified:
        return f"warning: measured with the seed of the search only; the comparison failed: {result.unverified}"
    return f"{len(result.comparison.seeds)} seeds not used in the search"


def opened_lines(result: Optimization) -> list[str]:
    """Return lines on side effects of the result: gaps between surfaces, and light that newly meets a surface first."""
    return [*([gaps_text(result.gaps)] if result.gaps else []), *entering_lines(result.comparison.entering)]


def comparison_table(comparison: Comparison) -> str:
    """Return the table, as text, of every term before and after, as a whole, by field and by wavelength."""
    rows, places = list(comparison.marginals()), []
    for row in rows:
        field = "all" if row.field_deg is None else f"field {row.field_deg:g}°"
        places.append([row.term if row.whole else "", f"{row.wavelength_nm:g} nm" if row.wavelength_nm else field])
    shown = table(ComparisonRow, rows, only=("unit", *VALUES))
    return table_text(Table(columns("<term", "<"), places).beside(shown))


def rows_table(comparison: Comparison) -> Table:
    """Return the table of every term before and after, at each field, wavelength and pair of both, without goals."""
    return table(ComparisonRow, comparison.rows, only=("term", "field_deg", "wavelength_nm", "unit", *VALUES))


def levels_table(levels: Levels) -> Table:
    """Return the table of the mean of each term over the seeds, in its unit."""
    rows: list[list[Value]] = [[name, value, levels.units.get(name, "1")] for name, value in levels.means.items()]
    return Table(columns("<term", "mean", "<unit"), rows, empty="no term")


def all_terms_table(result: Optimization) -> Table:
    """Return the table of every term before and after, at each field, wavelength and pair of both, for a page."""
    terms, rows = {term.name: term for term in result.study.terms}, result.comparison.rows
    goals = [[goal_text(terms[row.term], row.before) if row.whole else ""] for row in rows]
    shown = table(ComparisonRow, rows, "t-terms", only=("term", "field_deg", "wavelength_nm", "unit", *VALUES))
    return shown.beside(Table(columns("goal"), goals))


def moved_table(result: Optimization) -> Table:
    """Return the table of the variables before and after with the parameters that they move, for a page."""
    targets = [v.targets for v in result.variables.variables]
    moved = [[", ".join(f"{p.label} × {p.factor:g}" if p.factor != 1 else p.label for p in own)] for own in targets]
    only = ("name", "unit", "before", "after", "low", "high")
    shown = table(VariableRow, variable_rows(result), "t-variables", only=only)
    return shown.beside(Table(columns("parameters"), moved))


def layers_table(result: Optimization) -> Table:
    """Return the table of the coatings by layer: material, and thickness in nm before and after."""
    rows: list[list[Value]] = []
    for item in result.placed:
        name = item.group.name
        before, after = result.thickness_nm(name, result.steps[0]), result.thickness_nm(name)
        for k, layer in enumerate(item.group.start.layers):
            thickness = [f"{d[k]:.2f}" for d in (before, after)]
            rows.append([name, ", ".join(item.surfaces), k + 1, layer.material, *thickness])
    heads = columns("coating", "surfaces", "layer", "material", "before [nm]", "after [nm]")
    return Table(heads, rows, "t-coatings", sortable=False)


def variables_table(result: Optimization) -> str:
    """Return the table, as text, of the variables before and after; an asterisk marks a value at its bound."""
    rows, moves = variable_rows(result), []
    for v, row in zip(result.variables.variables, rows, strict=True):
        held = "*" if min(v.share(row.after), 1 - v.share(row.after)) < AT_BOUND else " "
        moved = v.targets[0].label if len(v.targets) == 1 else f"{len(v.targets)} parameters"
        moves.append([f"{number(row.after)}{held}", f"{number(row.low)} … {number(row.high)}", moved])
    shown = table(VariableRow, rows, only=("name", "unit", "before"))
    text = table_text(shown.beside(Table(columns("after", "bounds", "<moves"), moves)))
    return f"{text}\n* at its bound" if "*" in "".join(after for after, *_ in moves) else text


def report_text(result: Optimization) -> str:
    """Return the text that `mistray optimize` prints at the end."""
    lines = [seeds_text(result), terms_table(result), ""]
    if any(not row.whole for row in result.comparison.rows):
        lines += [comparison_table(result.comparison), ""]
    lines += [order.sentence for order in result.next_orders]
    lines += [f"warning: {line}" for line in (*worse_lines(result), *opened_lines(result))]
    lines += [variables_table(result), ""]
    for item in result.placed:
        layers = ", ".join(layer.material for layer in item.group.start.layers)
        lines.append(
            f"coating '{item.group.name}' on {', '.join(item.surfaces)}: {layers}; first layer {item.group.start.first}"
        )
    best = result.best
    lines.append(
        f"result: start {best.start + 1} of {len(result.starts)} ({result.starts[best.start].name}), step {best.step}, "
        f"merit {best.merit:.5g}"
    )
    lines += [f"search from start {number + 1}: {reason}" for number, reason in sorted(result.ended.items())]
    lines.append(
        f"{result.steps[-1].evaluations} evaluations, {result.search_seconds:.1f} s ({result.traced_seconds:.1f} s for "
        f"traces and derivatives); verification {result.verification_seconds:.1f} s"
    )
    lines += edge_lines(result)
    lines += [f"not in the gradient: {text}" for text in result.left_out]
    return "\n".join(lines)


def step_text(step: Step, start: Start) -> str:
    """Return a step as one line: merit, terms with "(!)" after those in `Step.broken`, gradient norm and time in s."""
    terms = ", ".join(
        f"{name} {value:.4g}{' (!)' if name in step.broken else ''}" for name, value in step.terms.items()
    )
    return (
        f"start {step.start + 1} ({start.name}), step {step.step}: merit {step.merit:.4f} ± {step.merit_se:.1e}; "
        f"{terms}; |gradient| {step.gradient_norm:.1e}, {step.seconds:.0f} s"
    )


def edge_lines(result: Optimization) -> list[str]:
    """
    Return a list with one line on the widths of smoothing zones at rims, as fractions of their radii.

    It is empty if light met no rim.
    """
    if not result.edge_widths:
        return []
    how = "chosen at the start" if result.study.optimizer.edge_width is None else "given"
    each = ", ".join(f"{width:g} ({name})" for name, width in result.edge_widths.items())
    return [f"width of the zones at rims, over their radii, {how}: {each}"]


def optimization_record(result: Optimization) -> dict[str, Any]:
    """Return the result of an optimisation as JSON-serialisable values."""
    kept = {t.name: holds(t, (row := result.comparison.of(t.name)).after, row.before) for t in result.study.terms}
    return dict(
        plain(
            {
                "scene": str(result.source),
                "study": result.study.name,
                "terms": records(ComparisonRow, result.comparison.rows),
                "holds": kept,
                "gaps": result.gaps,
                "entering": result.comparison.entering,
                "next_orders": [order.record() for order in result.next_orders],
                "unverified": result.unverified,
                "worse": records(ComparisonRow, worse(result.comparison, result.study.terms)),
                "variables": records(VariableRow, variable_rows(result)),
                "start": result.starts[result.best.start].name,
                "step": result.best.step,
                "merit": result.best.merit,
                "ended": result.ended,
                "evaluations": result.steps[-1].evaluations,
                "left_out": result.left_out,
                "edge_widths": result.edge_widths,
            }
        )
    )


def variables_frame(result: Optimization) -> pd.DataFrame:
    """
    Return a DataFrame with a row for each parameter that a variable moves: its value before and after.

    Columns variable, parameter, unit (of both), low and high (bounds of the variable), before and after (values of the
    parameter; a displacement or tilt is 0 before).
    """
    rows = []
    for v, x in zip(result.variables.variables, result.best.x, strict=True):
        moved = [(place.label, place.start, after) for place, after, _ in v.moved(x)]
        moved += [(motion.label, 0.0, motion.factor * (x - v.start)) for motion in v.motions]
        for parameter, before, after in moved:
            named = {"variable": v.name, "parameter": parameter, **row_of(v, "unit", "low", "high")}
            rows.append({**named, "before": before, "after": after})
    return pd.DataFrame(rows)


def history_frame(result: Optimization) -> pd.DataFrame:
    """
    Return a DataFrame with a row for each step of each search.

    Columns: start, step, evaluations, merit with error and gradient norm (dimensionless), seconds (s), and each term
    and variable in its unit.
    """
    rows = []
    for step in result.steps:
        numbers = ("start", "step", "evaluations", "merit", "merit_se", "gradient_norm", "seconds")
        values = dict(zip(result.variables.names, step.x, strict=True))
        rows.append({**row_of(step, *numbers), **step.terms, **values})
    return pd.DataFrame(rows)
