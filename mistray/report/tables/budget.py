"""A contamination and roughness budget as text, as values for JSON and as tables."""

from __future__ import annotations

from typing import Any

import pandas as pd

from mistray.files.json_values import plain
from mistray.optimize.tolerances.budget import Budget, Chosen, Met
from mistray.report.model import Column, Table, Value, columns
from mistray.report.tables.frames import row_of
from mistray.report.tables.text import number, table_text, text_table

MOST_DISTANCE = 99.0  # standard errors, in text


def requirements_table(result: Budget) -> Table:
    """The requirements before and after."""
    rows: list[list[Value]] = [
        [item.name, number(item.limit), item.before, item.after, item.unit, verdict(item)]
        for item in result.requirements
    ]
    heads = columns("<requirement", "limit", "before", "after", "<unit", "<")
    return Table(heads, rows, "t-requirements", sortable=False)


def budget_text(result: Budget) -> str:
    """What `mistray budget` prints: the requirements before and after, the numbers, the costs."""
    before, after = result.cost
    parts = [
        table_text(requirements_table(result)),
        f"measured on {result.study.seeds} seeds that the search has not used",
        "",
        numbers_text(result),
        "",
        f"cost: {number(before, 4)} before, {number(after, 4)} after; {result.gradients} gradients of each metric, "
        f"{result.seconds:.0f} s",
        *(f"not in the derivatives: {text}" for text in result.left_out),
    ]
    return "\n".join(parts)


def verdict(item: Met) -> str:
    """Whether a requirement is met, and how surely."""
    far = min(abs(item.distance), MOST_DISTANCE)
    if item.holds:
        return f"met by {number(far, 2)} standard errors"
    return f"NOT met: {item.after.value / item.limit:.3g} times the limit, {number(far, 2)} standard errors above"


def numbers_text(result: Budget) -> str:
    """One row for each number that was chosen."""
    columns = [("surface", ""), ("number", ""), ("unit", ""), ("before", ""), ("after", ""), ("cost", "before"),
               ("cost", "after")]  # fmt: skip
    for k, item in enumerate(result.requirements):
        title = item.name if len(result.requirements) > 1 else "metric"
        columns += [(f"% of the {title}" if k == 0 else f"% of {title}", "before"), ("", "after")]
    rows = []
    for chosen in result.chosen:
        mark = "*" if at_bound(chosen) else " "
        line = [surfaces_text(chosen), chosen.parameter, chosen.unit, number(chosen.before, 4)]
        line += [f"{number(chosen.after, 4)}{mark}", number(chosen.cost_before, 3), number(chosen.cost_after, 3)]
        for pair in zip(chosen.shares_before, chosen.shares_after, strict=True):
            line += [number(100 * share, 2) for share in pair]
        rows.append(line)
    table = text_table(columns, rows, left=(0, 1, 2))
    return f"{table}\n* at the end of its range" if any(map(at_bound, result.chosen)) else table


def numbers_table(result: Budget) -> Table:
    """The same for a page, with the range of each number."""
    rows = []
    for chosen in result.chosen:
        held = " at its bound" if at_bound(chosen) else ""
        shares = zip(chosen.shares_before, chosen.shares_after, strict=True)
        rows.append(
            [
                *(surfaces_text(chosen), chosen.parameter, chosen.unit),
                *(number(chosen.before, 4), number(chosen.after, 4) + held),
                f"{number(chosen.best, 4)} … {number(chosen.worst, 4)}",
                *(number(chosen.cost_before, 3), number(chosen.cost_after, 3)),
                *(f"{number(100 * b, 2)} → {number(100 * a, 2)}" for b, a in shares),
            ]
        )
    heads = columns("<surface", "<number", "<unit", "before", "after", "range", "cost [before]", "cost [after]")
    heads += [Column(f"share of {item.name}", "%, before → after") for item in result.requirements]
    return Table(heads, rows, "t-numbers")


def surfaces_text(chosen: Chosen) -> str:
    """The surfaces that a number is about."""
    return ", ".join(chosen.surfaces)


def at_bound(chosen: Chosen) -> bool:
    """Whether the number is the best or the worst that could be chosen."""
    return min(abs(chosen.after / bound - 1) for bound in (chosen.best, chosen.worst)) < 1e-4


def budget_frame(result: Budget) -> pd.DataFrame:
    """One row for each number; shares of each requirement as ``share_1_before_percent`` and so on."""
    rows = []
    for chosen in result.chosen:
        row = {"surfaces": surfaces_text(chosen)} | row_of(
            chosen, "key", "parameter", "unit", "before", "after", "best", "worst", "cost_before", "cost_after"
        )
        for k, (b, a) in enumerate(zip(chosen.shares_before, chosen.shares_after, strict=True), start=1):
            row |= {f"share_{k}_before_percent": 100 * b, f"share_{k}_after_percent": 100 * a}
        rows.append(row)
    return pd.DataFrame(rows)


def requirements_frame(result: Budget) -> pd.DataFrame:
    """One row for each requirement."""
    return pd.DataFrame(
        [
            {"requirement": item.name, **row_of(item, "unit", "limit", "before", "after"), "met": item.holds}
            for item in result.requirements
        ]
    )


def budget_record(result: Budget) -> dict[str, Any]:
    """All of a result as values that JSON knows."""
    before, after = result.cost
    record = {
        "requirements": requirements_frame(result).to_dict("records"),
        "met": result.holds,
        "numbers": budget_frame(result).to_dict("records"),
        "cost_before": before,
        "cost_after": after,
        "gradients": result.gradients,
        "left_out": result.left_out,
        "seconds": result.seconds,
        "study": result.study.name,
        "scene": str(result.source),
    }
    return dict(plain(record))
