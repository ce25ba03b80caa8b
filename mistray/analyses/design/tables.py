"""The tables of an optimisation: terms and variables before and after, steps; as text, frames and JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import pandas as pd

from mistray.analyses.design.study.comparison import Comparison, ComparisonRow, worse
from mistray.analyses.design.study.goals import holds, limit_of
from mistray.analyses.design.study.model import Term
from mistray.analyses.design.study.optimization import Optimization
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.metrics.changes.first_surfaces import entering_lines
from mistray.metrics.changes.gaps import gaps_text
from mistray.toolkit.pages.model import Table, Value, columns
from mistray.toolkit.tables.frames import row_of
from mistray.toolkit.tables.text import number, table_text, with_error

TERM_COLUMNS = (
    "term", "unit", "field_deg", "wavelength_nm", "before", "before_se", "after", "after_se", "ratio", "ratio_se",
)  # fmt: skip
PLACES_NAMED = 3  # in a warning
AT_BOUND = 1e-6  # of the way from bound to bound


def goal_text(term: Term, start: float) -> str:
    """Return the goal of a term whose value at the start is known."""
    if term.goal == "keep":
        return f"keep ± {100 * term.tolerance:g} %"
    limit = limit_of(term, start)
    if limit is None:
        return "minimise"
    return f"{'≥' if term.goal == 'at_least' else '≤'} {number(limit, 4)}"


def kept_text(term: Term, row: ComparisonRow) -> str:
    """Whether the result keeps to the goal of a term; "–" if it is only to be small."""
    if term.goal == "minimise":
        return "–"
    return "yes" if holds(term, row.after, row.before) else "no"


def before_after(row: ComparisonRow) -> tuple[Estimate, Estimate, Estimate]:
    """The value before and after, and how many times it was larger before."""
    return Estimate(row.before, row.before_se), Estimate(row.after, row.after_se), Estimate(row.ratio, row.ratio_se)


def terms_table(result: Optimization) -> str:
    """The terms before and after, and whether their limits hold."""
    rows: list[list[Value]] = []
    for term in result.study.terms:
        row = result.comparison.of(term.name)
        rows.append([term.name, row.unit, *before_after(row), goal_text(term, row.before), kept_text(term, row)])
    heads = columns("<term", "<unit", "before", "after", "before / after", "<goal", "holds")
    return table_text(Table(heads, rows))


def worse_lines(result: Optimization) -> list[str]:
    """Where terms have become worse, a line for each term."""
    found: dict[str, list[str]] = {}
    for row in worse(result.comparison, result.study.terms):
        places = [f"{row.field_deg:g}°"] if row.field_deg is not None else []
        places += [f"{row.wavelength_nm:g} nm"] if row.wavelength_nm is not None else []
        times = Estimate(1 / row.ratio, row.ratio_se / row.ratio**2) if row.ratio else None
        much = "from 0" if times is None else f"{with_error(times)} times"
        found.setdefault(row.term, []).append(f"{' and '.join(places)} ({much})")
    return [
        f"{term} is worse than before at {', '.join(places[:PLACES_NAMED])}"
        + (f" and {len(places) - PLACES_NAMED} more" if len(places) > PLACES_NAMED else "")
        for term, places in found.items()
    ]


def seeds_text(result: Optimization) -> str:
    """On what the terms before and after were measured."""
    if result.unverified:
        return f"warning: measured with the seed of the search only; the comparison failed: {result.unverified}"
    return f"{len(result.comparison.seeds)} seeds not used in the search"


def opened_lines(result: Optimization) -> list[str]:
    """Return the side effects of the result: gaps, and light that enters by other surfaces."""
    return [*([gaps_text(result.gaps)] if result.gaps else []), *entering_lines(result.comparison.entering)]


def comparison_table(comparison: Comparison) -> str:
    """Before and after: every term, each field and each wavelength of it."""
    rows: list[list[Value]] = []
    for row in comparison.marginals():
        where = "all"
        if row.field_deg is not None:
            where = f"field {row.field_deg:g}°"
        elif row.wavelength_nm is not None:
            where = f"{row.wavelength_nm:g} nm"
        rows.append([row.term if row.whole else "", where, row.unit, *before_after(row)])
    return table_text(Table(columns("<term", "<", "<unit", "before", "after", "before / after"), rows))


def all_terms_table(result: Optimization) -> Table:
    """Every term, at each field and wavelength."""
    goals = {term.name: term for term in result.study.terms}
    rows: list[list[Value]] = []
    for row in result.comparison.rows:
        place = ("all" if value is None else f"{value:g}" for value in (row.field_deg, row.wavelength_nm))
        goal = goal_text(goals[row.term], row.before) if row.whole else ""
        rows.append([row.term, *place, row.unit, *before_after(row), goal])
    heads = columns("term", "field [deg]", "wavelength [nm]", "unit", "before", "after", "before / after", "goal")
    return Table(heads, rows, "t-terms")


def moved_table(result: Optimization) -> Table:
    """The variables before and after, and what they move."""
    rows = []
    for v, x in zip(result.variables.variables, result.best.x, strict=True):
        moved = [f"{p.label} × {p.factor:g}" if p.factor != 1 else p.label for p in v.targets]
        rows.append([v.name, v.unit, *map(number, (v.start, x, v.low, v.high)), ", ".join(moved)])
    return Table(columns("variable", "unit", "before", "after", "low", "high", "parameters"), rows, "t-variables")


def layers_table(result: Optimization) -> Table:
    """The coatings, layer by layer."""
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
    """The variables before and after."""
    rows = []
    for variable, x in zip(result.variables.variables, result.best.x, strict=True):
        held = "*" if min(variable.share(x), 1 - variable.share(x)) < AT_BOUND else " "
        targets = variable.targets
        moved = targets[0].label if len(targets) == 1 else f"{len(targets)} parameters"
        bounds = f"{number(variable.low)} … {number(variable.high)}"
        rows.append([variable.name, variable.unit, number(variable.start), f"{number(x)}{held}", bounds, moved])
    table = table_text(Table(columns("<variable", "<unit", "before", "after", "bounds", "<moves"), rows))
    return f"{table}\n* at its bound" if any("*" in row[3] for row in rows) else table


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


def edge_lines(result: Optimization) -> list[str]:
    """The width of the zones at rims, where they count."""
    if not result.edge_widths:
        return []
    how = "chosen at the start" if result.study.optimizer.edge_width is None else "given"
    each = ", ".join(f"{width:g} ({name})" for name, width in result.edge_widths.items())
    return [f"width of the zones at rims, over their radii, {how}: {each}"]


def optimization_record(result: Optimization) -> dict[str, Any]:
    """The result as values that JSON knows."""
    rows = [vars(row) for row in result.comparison.rows]
    variables = [
        row_of(v, "name", "unit", "low", "high") | {"before": v.start, "after": x}
        for v, x in zip(result.variables.variables, result.best.x, strict=True)
    ]
    kept = {t.name: holds(t, (row := result.comparison.of(t.name)).after, row.before) for t in result.study.terms}
    return dict(
        plain(
            {
                "scene": str(result.source),
                "study": result.study.name,
                "terms": rows,
                "holds": kept,
                "gaps": [asdict(gap) for gap in result.gaps],
                "entering": {
                    place: [asdict(one) for one in some] for place, some in result.comparison.entering.items()
                },
                "next_orders": [order.record() for order in result.next_orders],
                "unverified": result.unverified,
                "worse": [vars(row) for row in worse(result.comparison, result.study.terms)],
                "variables": variables,
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


def terms_frame(result: Optimization) -> pd.DataFrame:
    """The terms, each whole, at every field and at every wavelength."""
    return pd.DataFrame([vars(row) for row in result.comparison.rows])[list(TERM_COLUMNS)]


def variables_frame(result: Optimization) -> pd.DataFrame:
    """The variables, one row for each parameter that they move."""
    rows = []
    for variable, x in zip(result.variables.variables, result.best.x, strict=True):
        for place, after, _ in variable.moved(x):
            named = {"variable": variable.name, "parameter": place.label}
            rows.append({**named, **row_of(variable, "unit", "low", "high"), "before": place.start, "after": after})
        for motion in variable.motions:
            named = {"variable": variable.name, "parameter": motion.label}
            after = motion.factor * (x - variable.start)
            rows.append({**named, **row_of(variable, "unit", "low", "high"), "before": 0.0, "after": after})
    return pd.DataFrame(rows)


def history_frame(result: Optimization) -> pd.DataFrame:
    """Every step of every search."""
    rows = []
    for step in result.steps:
        numbers = ("start", "step", "evaluations", "merit", "merit_se", "gradient_norm", "seconds")
        values = dict(zip(result.variables.names, step.x, strict=True))
        rows.append({**row_of(step, *numbers), **step.terms, **values})
    return pd.DataFrame(rows)
