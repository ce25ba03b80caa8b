"""Rendering of a report as one HTML page with embedded styles, scripts and pictures, without network access."""

from __future__ import annotations

import base64
import functools
import itertools
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from mistray.estimate import Estimate
from mistray.time_budget import can_draw
from mistray.toolkit.figures.figure import Figure
from mistray.toolkit.figures.plots import DECADES, as_svg, draw_map
from mistray.toolkit.irradiance import log_range
from mistray.toolkit.pages import model
from mistray.toolkit.pages.cures import cures
from mistray.toolkit.pages.hover import hover_figure
from mistray.toolkit.pages.markup import cell, number_cell
from mistray.toolkit.typeset import typeset_html


def html_page(report: model.Report) -> str:
    """Return a report as a complete HTML document."""
    code = Markup("\n".join(_resource("assets", f"{name}.js") for name in report.scripts))
    css = Markup(stylesheet("colours") + stylesheet("report"))
    return _environment().get_template("page.html").render(report=report, code=code, css=css) + "\n"


def stylesheet(name: str) -> str:
    """Return the text of one of the package's CSS files by name."""
    return _resource("assets", f"{name}.css")


def template(name: str, **values: Any) -> str:
    """Return one of the package's HTML templates filled with values."""
    return _environment().get_template(name).render(values).strip()


def html_parts(parts: Sequence[model.PagePart]) -> str:
    """Return parts of a report as HTML."""
    part = _environment().get_template("parts.html").module.part  # type: ignore[attr-defined]
    return "".join(part(one) for one in parts)


def value_cell(value: model.Value, column: model.Column) -> Markup:
    """Return the HTML of a table cell, in the style of its column."""
    return Markup(_cell(value, column))


def _cell(value: model.Value, column: model.Column) -> str:
    if isinstance(value, Estimate):
        return number_cell(value)
    if isinstance(value, model.Noted):
        return number_cell(value.number, value.note)
    if isinstance(value, model.StyledCell):
        return cell(value.text, value.style)
    if isinstance(value, model.Link):
        link = f'<a href="#{escape(value.anchor)}">{escape(value.text)}</a>'
        return f'<td class="{column.style}">{link}</td>' if column.style else f"<td>{link}</td>"
    if isinstance(value, model.HtmlCell):
        return value.html
    if isinstance(value, model.Fold):
        summary = runs(value.summary) if value.of_letters else value.summary
        below = f"<details><summary>{escape(summary)}</summary>{escape(value.text)}</details>"
        return f'<td class="{value.style}">{below}</td>'
    return cell(str(value), column.style)


def runs(letters: str) -> str:
    """Return letters with the length of each run of two or more equal ones: "TTTRA" becomes "T×3 R A"."""
    groups = ((letter, len(list(same))) for letter, same in itertools.groupby(letters))
    return " ".join(letter if count == 1 else f"{letter}×{count}" for letter, count in groups)


def _hovering(figure: model.FigurePart) -> Markup:
    assert callable(figure.picture)
    assert figure.hover is not None
    drawn, hover = figure.picture(), figure.hover
    places = (hover.x, hover.titles, hover.values)
    return Markup(hover_figure(hover.name, drawn, drawn.axes[0], *places, figure.caption, figure.text))


def drawn_map(given: model.Map) -> model.FigurePart:
    """Return the part of a report that shows a map as a drawn figure, on a log10 scale."""
    return model.FigurePart(functools.partial(_map_figure, given), given.title)


def _map_figure(given: model.Map) -> Figure:
    drawn, axes = Figure.of_panels(5.6, 4.4, dpi=110)
    picture = draw_map(axes, given.values, given.extent_mm, log_range([given.values], DECADES))
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    if picture is not None:
        drawn.colorbar(picture, ax=axes, extend="min").set_label(f"log₁₀ [{given.unit}]")
    return drawn


@functools.cache
def _environment() -> Environment:
    made = Environment(loader=FunctionLoader(lambda name: _resource("templates", name)), autoescape=True,
                       trim_blocks=True, undefined=StrictUndefined)  # fmt: skip
    made.filters |= {
        "base64": lambda png: base64.b64encode(png).decode("ascii"),
        "cell": value_cell,
        "cures": cures,
        "drawn_map": drawn_map,
        "hovering": _hovering,
        "typeset": typeset_html,
        "svg": lambda drawn, text: Markup(as_svg(drawn, text)),
    }
    made.globals["can_draw"] = can_draw
    return made


def _resource(folder: str, name: str) -> str:
    return files("mistray.toolkit.pages").joinpath(folder, name).read_text(encoding="utf-8")
