"""An optimisation as one self-contained report.html."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from html import escape

from mistray.analysis.estimate import Estimate
from mistray.optimize import Optimization
from mistray.optimize.study.goals import holds
from mistray.report.html.markup import cell, data_table, figure, image, number_cell, section, setting_text
from mistray.report.html.page import page
from mistray.report.optimization_tables import goal_text
from mistray.report.tables.text import number, with_error

CAPTIONS = {
    "reflectance.png": "R(λ) before and after.",
    "search.png": "Merit, terms and gradient during the search.",
    "variables.png": "Variables during the best search.",
}


def optimization_html(
    result: Optimization, pictures: Mapping[str, bytes], title: str = "scene", command: str = ""
) -> str:
    """
    The report as HTML text.

    Parameters
    ----------
    result : Optimization
    pictures : mapping of str to bytes
        search.png, variables.png, and perhaps reflectance.png.
    title : str
        Name of the optical system.
    command : str
        The command line that made it.
    """
    sections = [
        f"<header><h1>Optimised: {escape(title)}</h1>{_finding(result)}</header>",
        section("terms", "Terms before and after", _terms(result)),
        section("variables", "Variables", _variables(result) + _picture(pictures, "variables.png")),
    ]
    if result.placed:
        sections.append(section("coatings", "Coatings", _coatings(result) + _picture(pictures, "reflectance.png")))
    sections += [
        section("search", "Search", _search(result) + _picture(pictures, "search.png")),
        section("settings", "Settings", _settings(result, command)),
    ]
    return page(f"Optimised: {title}", sections)


def _finding(result: Optimization) -> str:
    """What became of the terms, in a sentence for each."""
    items = []
    for term in result.study.terms:
        row = result.comparison.of(term.name)
        pairs = ((row.before, row.before_se), (row.after, row.after_se), (row.ratio, row.ratio_se))
        before, after, ratio = (with_error(Estimate(*pair)) for pair in pairs)
        text = f"{escape(term.name)}: from {before} to {after} {escape(row.unit)}"
        if term.goal == "minimise":
            text += f", <b>{ratio} times smaller</b>"
        else:
            kept = "holds" if holds(term, row.after, row.before) else "does <b>not</b> hold"
            text += f"; its limit ({escape(goal_text(term, row.before))}) {kept}"
        items.append(f"<li>{text}</li>")
    seeds = len(result.comparison.seeds)
    return f"<ul>{''.join(items)}</ul><p>Measured with {seeds} seeds that the search has not used.</p>"


def _terms(result: Optimization) -> str:
    goals = {term.name: term for term in result.study.terms}
    rows = []
    for row in result.comparison.rows:
        place = ("all" if value is None else f"{value:g}" for value in (row.field_deg, row.wavelength_nm))
        pairs = ((row.before, row.before_se), (row.after, row.after_se), (row.ratio, row.ratio_se))
        goal = goal_text(goals[row.term], row.before) if row.whole else ""
        numbers = (number_cell(Estimate(*pair)) for pair in pairs)
        rows.append([cell(row.term), *map(cell, place), cell(row.unit), *numbers, cell(goal)])
    header = [("term", ""), ("field", "deg"), ("wavelength", "nm"), ("unit", ""), ("before", ""), ("after", ""),
              ("before / after", ""), ("goal", "")]  # fmt: skip
    return data_table("t-terms", header, rows)


def _variables(result: Optimization) -> str:
    rows = []
    for variable, x in zip(result.variables.variables, result.best.x, strict=True):
        moved = ", ".join(
            f"{place.label} × {place.factor:g}" if place.factor != 1 else place.label for place in variable.places
        )
        numbers = (variable.start, x, variable.low, variable.high)
        rows.append(
            [cell(variable.name), cell(variable.unit), *(cell(number(value)) for value in numbers), cell(moved)]
        )
    header = [("variable", ""), ("unit", ""), ("before", ""), ("after", ""), ("low", ""), ("high", ""),
              ("parameters", "")]  # fmt: skip
    return data_table("t-variables", header, rows)


def _coatings(result: Optimization) -> str:
    rows = []
    for item in result.placed:
        name = item.group.name
        before, after = result.thickness_nm(name, result.steps[0]), result.thickness_nm(name)
        for k, layer in enumerate(item.group.start.layers):
            thickness = [cell(f"{d[k]:.2f}") for d in (before, after)]
            surfaces = cell(", ".join(item.surfaces))
            rows.append([cell(name), surfaces, cell(str(k + 1)), cell(layer.material), *thickness])
    header = [("coating", ""), ("surfaces", ""), ("layer", ""), ("material", ""), ("before", "nm"), ("after", "nm")]
    order = "".join(
        f"<p>{escape(item.group.name)}: the first layer lies {escape(item.group.start.first)}.</p>"
        for item in result.placed
    )
    return order + data_table("t-coatings", header, rows, sortable=False)


def _search(result: Optimization) -> str:
    best = result.best
    ends = "".join(f"<li>start {k + 1}: {escape(reason)}</li>" for k, reason in sorted(result.ended.items()))
    text = (
        f"<p>Result: start {best.start + 1} of {len(result.starts)} ({escape(result.starts[best.start].name)}), step "
        f"{best.step}, merit {best.merit:.5g}. {result.steps[-1].evaluations} evaluations in "
        f"{result.search_seconds:.0f} s. It is a local minimum at best.</p><ul>{ends}</ul>"
    )
    return text + "".join(f"<p>Not in the gradient: {escape(what)}.</p>" for what in result.left_out)


def _picture(pictures: Mapping[str, bytes], name: str) -> str:
    return figure(image(pictures[name], name), CAPTIONS[name])


def _settings(result: Optimization, command: str) -> str:
    study = result.study
    shown: dict[str, object] = {"scene": str(result.source), "study": study.name}
    for term in study.terms:
        values = {**vars(term), **term.own, **term.traced}
        shown |= {f"{term.name}.{key}": v for key, v in values.items() if key not in ("name", "own", "traced")}
    shown |= {f"optimizer.{key}": value for key, value in asdict(study.optimizer).items()}
    shown["seeds of the comparison"] = result.comparison.seeds
    items = "".join(f"<dt>{escape(key)}</dt><dd>{escape(setting_text(value))}</dd>" for key, value in shown.items())
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return f'<dl class="settings">{items}</dl>{ran}'
