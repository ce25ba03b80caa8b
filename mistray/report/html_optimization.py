"""An optimisation of coatings as one self-contained report.html."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from html import escape
from importlib.resources import files

from mistray.analysis.estimate import Estimate
from mistray.optimize import Optimization
from mistray.report.markup import cell, data_table, figure, image, number_cell, section, setting_text
from mistray.report.text import with_error


def optimization_html(
    result: Optimization, pictures: Mapping[str, bytes], unit: str, title: str = "scene", command: str = ""
) -> str:
    """
    The report as HTML text.

    Parameters
    ----------
    result : Optimization
    pictures : mapping of str to bytes
        convergence.png and reflectance.png.
    unit : str
        Of the metric.
    title : str
        Name of the optical system.
    command : str
        The command line that made it.
    """
    total = result.comparison.total
    metric = result.study.metric
    pairs = ((total.before, total.before_se), (total.after, total.after_se), (total.ratio, total.ratio_se))
    before, after, ratio = (with_error(Estimate(*pair)) for pair in pairs)
    finding = (
        f"<p>The metric ({escape(metric.kind)} of the paths '{escape(metric.paths)}') went from {before} to {after}: "
        f"<b>{ratio} times smaller</b>, measured with "
        f"{len(result.comparison.seeds)} seeds that the search has not used.</p>"
    )
    sections = [
        f"<header><h1>Coatings optimised: {escape(title)}</h1>{finding}</header>",
        section("comparison", "Before and after", _comparison(result, unit)),
        section("designs", "Designs", _designs(result)),
        section("search", "Search", _search(result, pictures)),
        section("settings", "Settings", _settings(result, command)),
    ]
    resources = files("mistray.report")
    css, script = (resources.joinpath(f"report.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Coatings optimised: {escape(title)}</title><style>\n{css}</style></head>\n<body>\n"
        + "\n".join(sections)
        + f"\n<script>\n{script}</script></body></html>\n"
    )


def _comparison(result: Optimization, unit: str) -> str:
    rows = []
    for row in result.comparison.rows:
        place = ("all" if value is None else f"{value:g}" for value in (row.field_deg, row.wavelength_nm))
        pairs = ((row.before, row.before_se), (row.after, row.after_se), (row.ratio, row.ratio_se))
        rows.append([*map(cell, place), *(number_cell(Estimate(*pair)) for pair in pairs)])
    header = [("field", "deg"), ("wavelength", "nm"), ("before", unit), ("after", unit), ("before / after", "")]
    return data_table("t-comparison", header, rows)


def _designs(result: Optimization) -> str:
    rows = []
    for item in result.placed:
        name = item.group.name
        layers = zip(item.group.start.layers, item.group.bounds_nm, strict=True)
        for k, (layer, (low, high)) in enumerate(layers):
            numbers = (result.designs[0].thickness_nm[name][k], result.best.thickness_nm[name][k])
            thickness = [cell(f"{d:.2f}") for d in numbers]
            surfaces = cell(", ".join(item.surfaces))
            rows.append(
                [cell(name), surfaces, cell(str(k + 1)), cell(layer.material), *thickness, cell(f"{low:g} … {high:g}")]
            )
    header = [("coating", ""), ("surfaces", ""), ("layer", ""), ("material", ""), ("before", "nm"), ("after", "nm"),
              ("bounds", "nm")]  # fmt: skip
    order = "".join(
        f"<p>{escape(item.group.name)}: the first layer lies {escape(item.group.start.first)}.</p>"
        for item in result.placed
    )
    return order + data_table("t-designs", header, rows, sortable=False)


def _search(result: Optimization, pictures: Mapping[str, bytes]) -> str:
    best = result.best_step
    ends = "".join(f"<li>start {k + 1}: {escape(reason)}</li>" for k, reason in sorted(result.ended.items()))
    text = (
        f"<p>Best design: from start {best.start + 1} of {len(result.designs)} ({escape(result.best.name)}), step "
        f"{best.step}. {result.steps[-1].evaluations} gradients in {result.search_seconds:.0f} s. The result is a "
        f"local minimum at best.</p><ul>{ends}</ul>"
    )
    left_out = "".join(f"<p>Not in the gradient: {escape(what)}.</p>" for what in result.left_out)
    captions = {
        "reflectance.png": "R(λ) before and after.",
        "convergence.png": "Metric and gradient during the search.",
    }
    return text + left_out + "".join(figure(image(pictures[key], key), caption) for key, caption in captions.items())


def _settings(result: Optimization, command: str) -> str:
    study = result.study
    shown = {
        "scene": str(result.source),
        "study": study.name,
        **{f"metric.{key}": value for key, value in asdict(study.metric).items()},
        **{f"optimizer.{key}": value for key, value in asdict(study.optimizer).items()},
        "seeds of the comparison": result.comparison.seeds,
    }
    items = "".join(f"<dt>{escape(key)}</dt><dd>{escape(setting_text(value))}</dd>" for key, value in shown.items())
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return f'<dl class="settings">{items}</dl>{ran}'
