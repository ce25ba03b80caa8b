"""Sensitivity analysis as printed text, JSON values, tables and a report page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from mistray.analyses.sensitivity.draws import PERCENTILES, Draws
from mistray.analyses.sensitivity.propagation import Contribution
from mistray.analyses.sensitivity.result import Sensitivity
from mistray.analyses.sensitivity.rows import SensitivityRow
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.metrics.changes.first_surfaces import entering_lines
from mistray.metrics.changes.gaps import gaps_text
from mistray.percent import percent_text
from mistray.toolkit.pages.model import FigurePart, Folded, NotePart, Report, Section, Table, columns
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section, terms
from mistray.toolkit.rows import frame, table
from mistray.toolkit.tables.frames import frame_table
from mistray.toolkit.tables.text import ABSENT, first_of, number, table_text, with_error

EDGES = "half edge width"
KEYS_NAMED = 8  # of those without a derivative, in text
NARROW_EDGE = 2.0  # of its own standard errors: from where on the width of the zone at rims matters
COUNTS = 0.01  # of the largest change: what is smaller is not worth a warning
RANKING = (
    "Change of the metric when a parameter changes by its manufacturing tolerance, and its share of the variance of "
    "all of them together."
)
NOTED = ("not_traced", "left_out", "edge_width", "without_derivative", "seconds")
PERTURBED = "Metrics of perturbed systems, all traced with the same rays, and what the linear model says."


def text(result: Sensitivity, count: int = 20) -> str:
    """
    Return the text that `mistray sensitivity` prints: ranking, best changes, propagation, perturbed systems and notes.

    Parameters
    ----------
    result : Sensitivity
        Sensitivity analysis.
    count : int
        Number of rows of the table.
    """
    rest = len(result.rows) - count
    edges = any(math.isfinite(row.edge_check.value) for row in result.rows[:count])
    ranking = ranking_table(result) if edges else ranking_table(result).without(EDGES)
    lines = together_lines(result)
    if result.together.changes:
        lines.insert(1, table_text(changes_table(result)))
    parts = [
        f"{result.name}: {with_error(result.value)} {result.unit}".rstrip(),
        "",
        table_text(ranking, count),
        *([f"… and {rest} with less"] if rest > 0 else []),
        "",
        *lines,
        "",
        *spread_lines(result),
        *(["", *draws_lines(result.draws)] if result.draws is not None else []),
        "",
        *notes(result),
    ]
    return "\n".join(parts)


def ranking_table(result: Sensitivity) -> Table:
    """Return the table of all parameters, ranked, with the value at which each would lower the metric as requested."""
    shown = ("label", "kind", "value", "unit", "derivative", "tolerance", "change", "share", "edge_check")
    found = table(SensitivityRow, result.rows, "t-ranking", shown, filter=("filter parameters", "filter parameters"))
    changes = [[change_text(row)] for row in result.rows]
    return found.beside(Table(columns(f"<for {result.factor:g} × less [value, or bound: factor]"), changes))


def change_text(row: SensitivityRow) -> str:
    """
    Return as text the value that lowers the metric by the requested factor, else the bound and its factor.

    Return "held" for a parameter that is not free, and a dash if no value lowers the metric.
    """
    if not row.free:
        return "held"
    if row.reached:
        return number(row.to_value)
    return f"{number(row.to_value)}: {row.to_factor:.3g} ×" if row.to_factor > 1 else ABSENT


def together_lines(result: Sensitivity) -> list[str]:
    """Return lines of text on the combined effect of the best few changes."""
    found = result.together
    if not found.changes:
        return ["no derivative is known well enough to propose a change; trace more rays"]
    title = f"{len(found.changes)} changes that lower it {number(found.factor, 3)} times by the linear model"
    if not found.reached:
        title += f", not {result.factor:g} times: all are at their bounds"
    lines = [title]
    if found.traced is not None:
        no_gain = ", which is no gain: light enters elsewhere" if found.spoiled else ""
        lines.append(f"traced on other seeds: {_times(found.traced)} lower{no_gain}")
    if found.image is not None:
        lines.append(f"direct image then: {number(100 * found.image.value, 4)} % of what it was")
    lines += [gaps_text(found.gaps)] if found.gaps else []
    return [*lines, *entering_lines(found.entering)]


def changes_table(result: Sensitivity) -> Table:
    """Return the table of the changes that together lower the metric, one parameter per row."""
    rows = [
        [row.label, number(row.value), number(change.value), row.unit, number(change.factor, 3)]
        for row, change in result.together.changes
    ]
    return Table(columns("<parameter", "from", "to", "<unit", "its part [×]"), rows, "t-together", sortable=False)


def spread_lines(result: Sensitivity) -> list[str]:
    """Return lines of text on the spread of the metric by tolerances, a standard deviation of ln(metric) in percent."""
    spread = result.spread
    deviation = with_error(spread.deviation.times(100))
    lines = [
        f"all tolerances together: standard deviation of ln(metric) {deviation} % to first order, from "
        f"{len(spread.contributions)} independent parameters"
    ]
    groups = [item for item in spread.contributions if len(item.members) > 1]
    lines += [
        f"together '{item.name}' ({len(item.members)} parameters): {with_error(item.change.times(100))} % per "
        f"tolerance, {with_error(item.share.times(100))} % of the variance"
        for item in groups
    ]
    if spread.noise > max(spread.variance.value, 0.0):
        lines.append("most of that is noise of the derivatives, which was taken off; trace more rays")
    return lines


def draws_lines(draws: Draws) -> list[str]:
    """Return lines of text on a Monte Carlo of perturbed systems: spread of ln(metric), %, and metric over nominal."""
    percentiles = ", ".join(f"{p:g} %: {with_error(draws.percentile(p))}" for p in PERCENTILES)
    return [
        f"{len(draws.ratios)} perturbed systems: standard deviation of ln(metric) "
        f"{with_error(draws.deviation.times(100))} %, by the linear model for the same systems "
        f"{percent_text(draws.predicted_deviation, 3)}",
        f"metric over the nominal one: mean {with_error(draws.mean)}; percentiles {percentiles}",
        f"not explained by the linear model: {percent_text(draws.unexplained)} of the variance",
        *([f"{draws.rejected} more were drawn again, because surfaces crossed"] if draws.rejected else []),
    ]


def notes(result: Sensitivity) -> list[str]:
    """Return remarks on the reliability of the results, and on parts that are missing."""
    found = [f"not traced, for the time was up: {', '.join(result.not_traced)}"] if result.not_traced else []
    found += [f"not in the derivatives: {text}" for text in result.left_out]
    if result.without_derivative:
        found.append(f"no derivative: {first_of(result.without_derivative, KEYS_NAMED)}")
    least = COUNTS * max(abs(row.change.value) for row in result.rows)
    doubtful = [
        row.label
        for row in result.rows
        if abs(row.edge_check.value) > max(NARROW_EDGE * row.edge_check.se, 0.1 * abs(row.change.value), least)
    ]
    chosen = result.facts["edge_width"] is None
    if result.edge_width is not None:
        how = "chosen" if chosen else "given"
        found.append(f"width of the zones at rims, {how}: {result.edge_width:g} of their radii; errors hold its bias")
    if doubtful:
        remedy = "trace more rays, which narrow it" if chosen else "lower edge_width, or leave it out"
        found.append(f"the width of the zone at rims matters for {', '.join(doubtful[:KEYS_NAMED])}; {remedy}")
    return found


def record(result: Sensitivity) -> dict[str, Any]:
    """Return the complete result of a sensitivity analysis as JSON-serialisable values."""
    spread, together, draws = result.spread, result.together, result.draws
    found: dict[str, Any] = {
        "metric": {"name": result.name, "unit": result.unit, **result.value._asdict()},
        "parameters": result.to_pandas().to_dict("records"),
        "factor": result.factor,
        "together": {
            "changes": [
                {"label": row.label, "from": row.value, "to": change.value, "unit": row.unit, "factor": change.factor}
                for row, change in together.changes
            ],
            **{name: getattr(together, name) for name in ("factor", "reached", "traced", "image", "gaps", "entering")},
        },
        "propagation": {
            **{name: getattr(spread, name) for name in ("deviation", "variance", "noise")},
            "contributions": [vars(item) for item in spread.contributions],
        },
        "monte_carlo": None
        if draws is None
        else {
            "systems": len(draws.ratios),
            **{name: getattr(draws, name) for name in ("requested", "deviation", "predicted_deviation", "mean")},
            "percentiles": {f"{p:g}": draws.percentile(p) for p in PERCENTILES},
            **{name: getattr(draws, name) for name in ("unexplained", "rejected")},
        },
        **{name: getattr(result, name) for name in NOTED},
        "settings": result.facts,
    }
    return dict(plain(_by_name(found)))


def _by_name(value: Any) -> Any:
    """Return a nested value with each `Estimate` replaced by a dict of value and standard error."""
    if isinstance(value, Estimate):
        return value._asdict()
    if isinstance(value, dict):
        return {key: _by_name(item) for key, item in value.items()}
    return [_by_name(item) for item in value] if isinstance(value, list) else value


def _times(value: Estimate) -> str:
    return f"{with_error(value)} ×" if math.isfinite(value.value) else "nothing is left of it, infinitely"


def page(result: Sensitivity, title: str = "scene", command: str = "") -> Report:
    """Return the report; `title` is the name of the optical system, `command` the command line that made it."""
    from mistray.analyses.sensitivity.figures import draws_figure, ranking_figure
    from mistray.toolkit.figures.plots import as_png

    pictures = {"ranking.png": as_png(ranking_figure(result, title))}
    csv = {"sensitivity.csv": result.to_pandas(), "propagation.csv": frame(Contribution, result.spread.contributions)}
    before, *after = together_lines(result)
    spread = spread_lines(result)
    drawn = FigurePart(pictures["ranking.png"], RANKING)
    changes = [changes_table(result)] if result.together.changes else []
    sections = [
        Section("ranking", "Parameters by their change per tolerance", [drawn, ranking_table(result)]),
        Section(
            "changes",
            f"What would lower it {result.factor:g} times",
            [NotePart(before), *map(NotePart, after), *changes],
        ),
        Section("propagation", "Tolerances together", [*map(NotePart, spread), frame_table("t-kinds", _kinds(result))]),
    ]
    if result.draws is not None:
        pictures["monte_carlo.png"] = as_png(draws_figure(result, title))
        columns = {"ratio": result.draws.ratios, "predicted_log_ratio": result.draws.predicted}
        csv["draws.csv"] = pd.DataFrame(columns)
        lines = map(NotePart, draws_lines(result.draws))
        drawn = FigurePart(pictures["monte_carlo.png"], PERTURBED)
        sections.append(Section("monte-carlo", "Perturbed systems", [*lines, drawn]))
    missing = result.without_derivative
    left = [Folded(f"{len(missing)} numbers without a derivative", [NotePart(", ".join(missing))])]
    value = f"{with_error(result.value)} {result.unit}".strip()
    return Report(
        "Sensitivity",
        title,
        [*sections, settings_section(result.facts, command, terms("sensitivity"), after=left if missing else ())],
        lead=[NotePart(Markup("{}: <b>{}</b>").format(result.name, value)), NotePart(f"{spread[0]}.")],
        warnings=notes(result),
        csv=csv,
        json={"sensitivity.json": record(result)},
        result=result,
        files=pictures,
    )


def write_sensitivity(
    result: Sensitivity, directory: str | Path, title: str = "scene", command: str = ""
) -> list[Path]:
    """
    Write sensitivity.csv, propagation.csv, sensitivity.json, ranking.png and report.html, all or none of them.

    With perturbed systems draws.csv and monte_carlo.png are written as well. `write_report` documents how the directory
    is made and replaced. `title`, the name of the optical system, and `command`, the command line, appear in the
    report.

    Returns the paths of the files written; the page is the last.
    """
    return write_report(page(result, title, command), directory)


def _kinds(result: Sensitivity) -> pd.DataFrame:
    """Return a DataFrame of the percentage of the variance due to each kind of parameter, largest first."""
    kind_of = {row.label: row.kind for row in result.rows}
    kinds: dict[str, float] = {}
    for item in result.spread.contributions:
        kind = kind_of[item.members[0]]
        kinds[kind] = kinds.get(kind, 0.0) + 100 * item.share.value
    ranked = sorted(kinds.items(), key=lambda pair: -pair[1])
    return pd.DataFrame(ranked, columns=["kind", "share_of_variance_percent"])
