"""Output of a budget of roughness and cleanliness: text, JSON values, tables and a report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from mistray.analyses.budget.result import Budget, Chosen, Met
from mistray.files.json_values import plain
from mistray.toolkit.pages.model import Column, FigurePart, Items, NotePart, Report, Section, Table, columns
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section
from mistray.toolkit.rows import frame, table
from mistray.toolkit.tables.text import number, table_text, with_error

MOST_DISTANCE = 99.0  # standard errors, in text
CAPTION = "The numbers before and after, and what part of the metric each stands for."


def requirements_table(result: Budget) -> Table:
    """Return the table of the requirements: limit, metric before and after, and whether it is met."""
    shown = ("requirement", "limit", "before", "after", "unit")
    found = table(Met, result.requirements, "t-requirements", shown, sortable=False)
    return found.beside(Table(columns("<"), [[verdict(item)] for item in result.requirements]))


def text(result: Budget) -> str:
    """Return the text that `mistray budget` prints: requirements before and after, chosen values and costs."""
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
    """
    Return a phrase on a requirement: that it is met, or how many times the limit the metric is.

    Either gives the distance from the limit in standard errors, at most 99.
    """
    far = min(abs(item.distance), MOST_DISTANCE)
    if item.met:
        return f"met by {number(far, 2)} standard errors"
    return f"NOT met: {item.after.value / item.limit:.3g} times the limit, {number(far, 2)} standard errors above"


def numbers_text(result: Budget) -> str:
    """Return the table of the chosen values as text, a row each, with their share of each metric in percent."""
    heads = []
    for k, item in enumerate(result.requirements):
        title = item.requirement if len(result.requirements) > 1 else "metric"
        heads += [Column(f"% of the {title}" if k == 0 else f"% of {title}", "before"), Column("", "after")]
    after = [[f"{number(chosen.after, 4)}{'*' if chosen.at_bound else ' '}"] for chosen in result.chosen]
    shares = [[number(100 * share, 2) for pair in _shares(chosen) for share in pair] for chosen in result.chosen]
    found = table_text(_numbers(result, Table(columns("after"), after), Table(heads, shares)))
    return f"{found}\n* at the end of its range" if any(chosen.at_bound for chosen in result.chosen) else found


def numbers_table(result: Budget) -> Table:
    """Return the table of the chosen values for a page, with the range of each."""
    heads = [Column(f"share of {item.requirement}", "%, before → after") for item in result.requirements]
    after = [
        [
            f"{number(chosen.after, 4)}{' at its bound' if chosen.at_bound else ''}",
            f"{number(chosen.best, 4)} … {number(chosen.worst, 4)}",
        ]
        for chosen in result.chosen
    ]
    shares = [[" → ".join(number(100 * share, 2) for share in pair) for pair in _shares(c)] for c in result.chosen]
    return _numbers(result, Table(columns("after", "range"), after), Table(heads, shares))


def _shares(chosen: Chosen) -> Iterable[tuple[float, float]]:
    """Return pairs, before and after, of the fraction of each metric that comes from the surface of a chosen value."""
    return zip(chosen.shares_before, chosen.shares_after, strict=True)


def _numbers(result: Budget, after: Table, shares: Table) -> Table:
    found = table(Chosen, result.chosen, "t-numbers", ("surfaces", "parameter", "unit", "before"))
    return found.beside(after, table(Chosen, result.chosen, only=("cost_before", "cost_after")), shares)


def budget_frame(result: Budget) -> pd.DataFrame:
    """
    Return a DataFrame of the chosen values.

    The percentages of metric k that depend on each value are ``share_k_before_percent`` and ``share_k_after_percent``.
    """
    shares = {
        f"share_{k}_{when}_percent": [100 * getattr(chosen, f"shares_{when}")[k - 1] for chosen in result.chosen]
        for k in range(1, len(result.requirements) + 1)
        for when in ("before", "after")
    }
    return frame(Chosen, result.chosen).assign(**shares)


def record(result: Budget) -> dict[str, Any]:
    """Return the budget as JSON-serialisable values."""
    before, after = result.cost
    found = {
        "requirements": frame(Met, result.requirements).to_dict("records"),
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
    return dict(plain(found))


def page(result: Budget, title: str = "scene", command: str = "") -> Report:
    """
    Return the report of a budget.

    `title` is the name of the optical system, `command` the command line quoted there.
    """
    from mistray.analyses.budget.figures import budget_figure
    from mistray.toolkit.figures.plots import as_png

    before, after = result.cost
    found = [Markup("{}: <b>{}</b>").format(item.requirement, verdict(item)) for item in result.requirements]
    picture = as_png(budget_figure(result, title))
    seeds = f"Measured on {result.study.seeds} seeds that the search has not used."
    left = [NotePart(f"Not in the derivatives: {text}.") for text in result.left_out]
    how = settings_section(_facts(result), command, before=left)
    return Report(
        "Scatter budget",
        title,
        [
            Section("requirements", "Requirements", [NotePart(seeds), requirements_table(result)]),
            Section("numbers", "Numbers", [FigurePart(picture, CAPTION), numbers_table(result)]),
            Section("settings", "How, and settings", how.parts),
        ],
        lead=[Items(found), NotePart(f"Cost {number(before, 4)} before, {number(after, 4)} after.")],
        csv={"budget.csv": budget_frame(result), "requirements.csv": frame(Met, result.requirements)},
        json={"budget.json": record(result)},
        result=result,
        files={"budget.png": picture},
    )


def write_budget(result: Budget, directory: str | Path, title: str = "scene", command: str = "") -> list[Path]:
    """
    Write scene.xml, budget.csv, requirements.csv, budget.json, budget.png and report.html, all or none of them.

    `write_report` documents how the directory is made and replaced. `title`, the name of the optical system, and
    `command`, the command line, appear in the report.

    Returns the paths of the files written; the page is the last.
    """
    return write_report(page(result, title, command), directory, result.scene_text(directory))


def _facts(result: Budget) -> dict[str, object]:
    study = result.study
    shown = {"scene": str(result.source), "budget": study.name, "gradients of each metric": result.gradients}
    shown |= {key: getattr(study, key) for key in ("iterations", "sigmas", "seeds", "shared")}
    for k, (requirement, item) in enumerate(zip(study.requirements, result.requirements, strict=True), start=1):
        shown |= {f"require[{k}].{key}": value for key, value in requirement.arguments.items()}
        shown[f"require[{k}]"] = f"{item.requirement} at most {item.limit:g}, was {with_error(item.before)}"
    for k, grades in enumerate(study.choices, start=1):
        shown |= {f"choose[{k}].{key}": value for key, value in asdict(grades).items()}
    return shown
