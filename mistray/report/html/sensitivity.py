"""A sensitivity analysis as one self-contained report.html."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from mistray.optimize.tolerances.sensitivity import Sensitivity
from mistray.report.html.markup import cell, data_table, figure, filter_box, image, number_cell, section, setting_text
from mistray.report.html.page import page
from mistray.report.tables.sensitivity import change_text, draws_lines, notes, spread_lines, together_lines
from mistray.report.tables.study import table_html
from mistray.report.tables.text import number, with_error

CAPTIONS = {
    "ranking.png": "Change of the metric when a parameter changes by its manufacturing tolerance, and its share of the "
    "variance of all of them together.",
    "monte_carlo.png": "Metrics of perturbed systems, all traced with the same rays, and what the linear model says.",
}
"""Pictures by file name."""
DEFINITIONS = (
    ("derivative", "of the metric by the parameter, from one reverse run of the trace, with its standard error"),
    ("tolerance", "usual manufacturing tolerance, taken for one standard deviation"),
    ("change per tolerance", "derivative · tolerance / metric: to first order the change of ln(metric)"),
    ("share of variance", "(s·tol)² over the sum of all of them, the variance of their noise taken off"),
    ("for n × less", "value at which the metric is n times lower by the linear model of its logarithm, or the factor "
     "at the bound of the physical range; held: would change the optics themselves"),
)  # fmt: skip


def sensitivity_html(
    result: Sensitivity, pictures: Mapping[str, bytes], title: str = "scene", command: str = ""
) -> str:
    """
    The report as HTML text.

    Parameters
    ----------
    result : Sensitivity
    pictures : mapping of str to bytes
        PNG files by name, those of `CAPTIONS` that there are.
    title : str
        Name of the optical system.
    command : str
        The command line that made it.
    """
    value = f"{with_error(result.value)} {result.unit}".strip()
    warnings = "".join(f"<li>{escape(text)}</li>" for text in notes(result))
    box = f'<div class="warnings"><b>Mind</b><ul>{warnings}</ul></div>' if warnings else ""
    head = f"<p>{escape(result.name)}: <b>{escape(value)}</b></p><p>{escape(spread_lines(result)[0])}.</p>"
    drawn = {name: figure(image(png, CAPTIONS[name]), CAPTIONS[name]) for name, png in pictures.items()}
    sections = [
        f"<header><h1>Sensitivity: {escape(title)}</h1>{head}{box}</header>",
        section("ranking", "Parameters by their change per tolerance", drawn["ranking.png"] + _ranking(result)),
        section("changes", f"What would lower it {result.factor:g} times", _together(result)),
        section("propagation", "Tolerances together", _propagation(result)),
    ]
    if result.draws is not None:
        lines = "".join(f"<p>{escape(text)}</p>" for text in draws_lines(result.draws))
        sections.append(section("monte-carlo", "Perturbed systems", lines + drawn["monte_carlo.png"]))
    sections.append(section("settings", "Definitions and settings", _settings(result, command)))
    return page(f"Sensitivity: {title}", sections)


def _ranking(result: Sensitivity) -> str:
    shares = {item.members[0]: item.share for item in result.spread.contributions if len(item.members) == 1}
    rows = []
    for row in result.rows:
        percent = row.change._replace(value=100 * row.change.value, se=100 * row.change.se)
        share = shares.get(row.label)
        rows.append(
            [
                cell(row.label, "t"),
                cell(row.kind, "t"),
                cell(number(row.value)),
                cell(row.unit, "t"),
                number_cell(row.derivative),
                cell(number(row.tolerance)),
                number_cell(percent),
                cell("in a group")
                if share is None
                else number_cell(share._replace(value=100 * share.value, se=100 * share.se)),
                cell(number(100 * row.edge_check, 2)),
                cell(change_text(row), "t"),
            ]
        )
    header = [("parameter", "", "t"), ("kind", "", "t"), ("value", ""), ("unit", "", "t"), ("derivative", ""),
              ("tolerance", "in the unit"), ("change", "% per tolerance"), ("share of variance", "%"),
              ("with half the edge width", "% per tolerance"), (f"for {result.factor:g} × less", "", "t")]  # fmt: skip
    return filter_box("t-ranking", "filter parameters", "filter parameters") + data_table("t-ranking", header, rows)


def _together(result: Sensitivity) -> str:
    found = result.together
    lines = together_lines(result)
    text = "".join(f"<p>{escape(line)}</p>" for line in [lines[0], *lines[2:]])
    rows = [
        [cell(row.label, "t"), cell(number(row.value)), cell(number(change.value)), cell(row.unit, "t"),
         cell(number(change.factor, 3))]
        for row, change in found.changes
    ]  # fmt: skip
    header = [("parameter", "", "t"), ("from", ""), ("to", ""), ("unit", "", "t"), ("its part", "×")]
    return text + (data_table("t-together", header, rows, sortable=False) if rows else "")


def _propagation(result: Sensitivity) -> str:
    lines = "".join(f"<p>{escape(line)}</p>" for line in spread_lines(result))
    kinds: dict[str, float] = {}
    of = {row.label: row.kind for row in result.rows}
    for item in result.spread.contributions:
        kinds[of[item.members[0]]] = kinds.get(of[item.members[0]], 0.0) + 100 * item.share.value
    import pandas as pd

    frame = pd.DataFrame(
        sorted(kinds.items(), key=lambda pair: -pair[1]), columns=["kind", "share_of_variance_percent"]
    )
    return lines + table_html("t-kinds", frame)


def _settings(result: Sensitivity, command: str) -> str:
    terms = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in DEFINITIONS)
    items = "".join(
        f"<dt>{escape(key)}</dt><dd>{escape(setting_text(value))}</dd>" for key, value in result.facts.items()
    )
    missing = ", ".join(result.without_derivative)
    left = f"<details><summary>{len(result.without_derivative)} numbers without a derivative</summary>{escape(missing)}"
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return (
        f'<h3>Definitions</h3><dl class="settings">{terms}</dl><h3>Settings</h3><dl class="settings">{items}</dl>'
        f"{f'{left}</details>' if missing else ''}{ran}"
    )
