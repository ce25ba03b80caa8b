"""What a sensitivity analysis leaves behind in a folder."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from markupsafe import Markup

from mistray.optimize.tolerances.sensitivity import Sensitivity
from mistray.report.figures.plots import as_png
from mistray.report.figures.sensitivity import draws_figure, ranking_figure
from mistray.report.model import Figure, Folded, Note, Report, Section
from mistray.report.output import write_report
from mistray.report.parts import settings_section, terms
from mistray.report.tables.frames import flat, frame_table
from mistray.report.tables.sensitivity import (
    changes_table,
    draws_lines,
    notes,
    percent,
    ranking_table,
    sensitivity_record,
    spread_lines,
    together_lines,
)
from mistray.report.tables.text import with_error

RANKING = (
    "Change of the metric when a parameter changes by its manufacturing tolerance, and its share of the variance of "
    "all of them together."
)
PERTURBED = "Metrics of perturbed systems, all traced with the same rays, and what the linear model says."


def sensitivity_report(result: Sensitivity, title: str = "scene", command: str = "") -> Report:
    """The report; `title` is the name of the optical system, `command` the command line that made it."""
    pictures = {"ranking.png": as_png(ranking_figure(result, title))}
    csv = {"sensitivity.csv": result.to_pandas(), "propagation.csv": _contributions(result)}
    before, *after = together_lines(result)
    spread = spread_lines(result)
    sections = [
        Section("ranking", "Parameters by their change per tolerance",
                [Figure(pictures["ranking.png"], RANKING), ranking_table(result)]),
        Section("changes", f"What would lower it {result.factor:g} times",
                [Note(before), *map(Note, after), *([changes_table(result)] if result.together.changes else [])]),
        Section("propagation", "Tolerances together", [*map(Note, spread), frame_table("t-kinds", _kinds(result))]),
    ]  # fmt: skip
    if result.draws is not None:
        pictures["monte_carlo.png"] = as_png(draws_figure(result, title))
        columns = {"ratio": result.draws.ratios, "predicted_log_ratio": result.draws.predicted}
        csv["draws.csv"] = pd.DataFrame(columns)
        lines = map(Note, draws_lines(result.draws))
        drawn = Figure(pictures["monte_carlo.png"], PERTURBED)
        sections.append(Section("monte-carlo", "Perturbed systems", [*lines, drawn]))
    missing = result.without_derivative
    left = [Folded(f"{len(missing)} numbers without a derivative", [Note(", ".join(missing))])]
    value = f"{with_error(result.value)} {result.unit}".strip()
    return Report(
        "Sensitivity",
        title,
        [*sections, settings_section(result.facts, command, terms("sensitivity"), after=left if missing else ())],
        lead=[Note(Markup("{}: <b>{}</b>").format(result.name, value)), Note(f"{spread[0]}.")],
        warnings=notes(result),
        csv=csv,
        json={"sensitivity.json": sensitivity_record(result)},
        files=pictures,
    )


def write_sensitivity(
    result: Sensitivity, directory: str | Path, title: str = "scene", command: str = ""
) -> list[Path]:
    """
    Write sensitivity.csv, propagation.csv, sensitivity.json, ranking.png and report.html, each whole or not at all.

    With perturbed systems there are draws.csv and monte_carlo.png as well.

    Parameters
    ----------
    result : Sensitivity
    directory : str or Path
        Made if it is missing.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written; report.html is the last.
    """
    return write_report(sensitivity_report(result, title, command), directory)


def _kinds(result: Sensitivity) -> pd.DataFrame:
    """Share of the variance by kind of parameter."""
    kind_of = {row.label: row.kind for row in result.rows}
    kinds: dict[str, float] = {}
    for item in result.spread.contributions:
        kind = kind_of[item.members[0]]
        kinds[kind] = kinds.get(kind, 0.0) + 100 * item.share.value
    ranked = sorted(kinds.items(), key=lambda pair: -pair[1])
    return pd.DataFrame(ranked, columns=["kind", "share_of_variance_percent"])


def _contributions(result: Sensitivity) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {"name": item.name, "members": " ".join(item.members)}
            | flat({"change_percent": percent(item.change), "share": item.share})
            for item in result.spread.contributions
        ]
    )
