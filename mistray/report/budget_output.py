"""What a contamination and roughness budget leaves behind: scene, tables, a picture and report.html."""

from __future__ import annotations

import json
from dataclasses import asdict
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from mistray.optimize.tolerances.budget import Budget
from mistray.report.figures.figure import Figure
from mistray.report.figures.plots import BLUE, GREY, VERMILION, as_png
from mistray.report.html.markup import cell, data_table, figure, image, number_cell, section, setting_text
from mistray.report.html.page import page
from mistray.report.output import csv_text, write_files
from mistray.report.tables.budget import (
    at_bound,
    budget_frame,
    budget_record,
    requirements_frame,
    surfaces_text,
    verdict,
)
from mistray.report.tables.text import number, with_error

CAPTION = "The numbers before and after, and what part of the metric each stands for."


def budget_figure(result: Budget, title: str = "") -> Figure:
    """Every number before and after on a logarithmic scale, one panel for each kind, and its share of the metric."""
    kinds = list(dict.fromkeys(chosen.parameter for chosen in result.chosen))
    counts = [sum(chosen.parameter == kind for chosen in result.chosen) for kind in kinds]
    figure_ = Figure(figsize=(10.4, 1.4 + 0.6 * len(kinds) + 0.24 * sum(counts)), dpi=120, layout="constrained")
    grid = figure_.subplots(len(kinds), 2, squeeze=False, height_ratios=[count + 2 for count in counts],
                            width_ratios=(2, 1), sharey="row")  # fmt: skip
    for (left, right), kind in zip(grid, kinds, strict=True):
        shown = [chosen for chosen in result.chosen if chosen.parameter == kind]
        places = np.arange(len(shown))[::-1]
        for place, chosen in zip(places, shown, strict=True):
            left.plot(
                [chosen.best, chosen.worst], [place, place], color="#e3e3e3", lw=4, solid_capstyle="butt", zorder=1
            )
            left.plot([chosen.before, chosen.after], [place, place], color=GREY, lw=1, zorder=2)
            left.plot(chosen.before, place, ls="", marker="o", mfc="white", color=GREY, ms=5, zorder=3)
            left.plot(
                chosen.after, place, ls="", marker="D" if at_bound(chosen) else "o", color=VERMILION, ms=5, zorder=4
            )
            worst = [max(shares) for shares in (chosen.shares_before, chosen.shares_after)]
            right.barh(place + 0.2, 100 * worst[0], height=0.36, color="#c9ced4")
            right.barh(place - 0.2, 100 * worst[1], height=0.36, color=BLUE)
        left.set_xscale("log")
        left.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        left.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        left.xaxis.set_minor_formatter(NullFormatter())
        left.set_yticks(places, [surfaces_text(chosen) for chosen in shown], fontsize=8)
        unit = shown[0].unit
        left.set_xlabel(f"{kind}{f' [{unit}]' if unit not in ('', '1') else ''}")
        right.set_xlabel("share of the metric [%]")
        for axes in (left, right):
            axes.set_ylim(-0.8, len(shown) - 0.2)
            axes.grid(True, axis="x", color="#e3e3e3", lw=0.6)
            axes.set_axisbelow(True)
            axes.spines[["top", "right", "left"]].set_visible(False)
            axes.tick_params(axis="y", length=0)
    handles = [
        Line2D([], [], ls="", ms=5, marker="o", mfc="white", color=GREY, label="before"),
        Line2D([], [], ls="", ms=5, marker="o", color=VERMILION, label="after"),
        Line2D([], [], ls="", ms=5, marker="D", color=VERMILION, label="after, at the end of its range"),
    ]
    figure_.legend(handles=handles, loc="outside upper right", ncols=3, fontsize=8, frameon=False)
    before, after = result.cost
    figure_.suptitle(
        f"{title}{': ' if title else ''}cost {number(before, 3)} → {number(after, 3)}", fontsize=10, x=0.02, ha="left"
    )
    return figure_


def budget_html(result: Budget, picture: bytes, title: str = "scene", command: str = "") -> str:
    """
    The report as HTML text.

    Parameters
    ----------
    result : Budget
    picture : bytes
        `budget_figure` as PNG.
    title : str
        Name of the optical system.
    command : str
        The command line that made it.
    """
    before, after = result.cost
    lines = "".join(f"<li>{escape(item.name)}: <b>{escape(verdict(item))}</b></li>" for item in result.requirements)
    left = "".join(f"<p>Not in the derivatives: {escape(text)}.</p>" for text in result.left_out)
    sections = [
        f"<header><h1>Scatter budget: {escape(title)}</h1><ul>{lines}</ul>"
        f"<p>Cost {number(before, 4)} before, {number(after, 4)} after.</p></header>",
        section("requirements", "Requirements", _requirements(result)),
        section("numbers", "Numbers", figure(image(picture, CAPTION), CAPTION) + _numbers(result)),
        section("settings", "How, and settings", left + _settings(result, command)),
    ]
    return page(f"Scatter budget: {title}", sections)


def write_budget(result: Budget, directory: str | Path, title: str = "scene", command: str = "") -> list[Path]:
    """
    Write scene.xml, budget.csv, requirements.csv, budget.json, budget.png and report.html, each whole or not at all.

    Parameters
    ----------
    result : Budget
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
    picture = as_png(budget_figure(result, title))
    files: dict[str, str | bytes] = {
        "scene.xml": result.scene_text(directory),
        "budget.csv": csv_text(budget_frame(result)),
        "requirements.csv": csv_text(requirements_frame(result)),
        "budget.json": json.dumps(budget_record(result), indent=2, allow_nan=False) + "\n",
        "budget.png": picture,
        "report.html": budget_html(result, picture, title, command),
    }
    return write_files(files, directory)


def _requirements(result: Budget) -> str:
    rows = [
        [cell(item.name, "t"), cell(number(item.limit)), number_cell(item.before), number_cell(item.after),
         cell(item.unit, "t"), cell(verdict(item), "t")]
        for item in result.requirements
    ]  # fmt: skip
    header = [("requirement", "", "t"), ("limit", ""), ("before", ""), ("after", ""), ("unit", "", "t"), ("", "", "t")]
    note = f"<p>Measured on {result.study.seeds} seeds that the search has not used.</p>"
    return note + data_table("t-requirements", header, rows, sortable=False)


def _numbers(result: Budget) -> str:
    rows = []
    for chosen in result.chosen:
        shares = [
            cell(f"{number(100 * b, 2)} → {number(100 * a, 2)}")
            for b, a in zip(chosen.shares_before, chosen.shares_after, strict=True)
        ]
        rows.append(
            [
                cell(surfaces_text(chosen), "t"),
                cell(chosen.parameter, "t"),
                cell(chosen.unit, "t"),
                cell(number(chosen.before, 4)),
                cell(number(chosen.after, 4) + (" at its bound" if at_bound(chosen) else "")),
                cell(f"{number(chosen.best, 4)} … {number(chosen.worst, 4)}"),
                cell(number(chosen.cost_before, 3)),
                cell(number(chosen.cost_after, 3)),
                *shares,
            ]
        )
    header = [("surface", "", "t"), ("number", "", "t"), ("unit", "", "t"), ("before", ""), ("after", ""),
              ("range", ""), ("cost", "before"), ("cost", "after")]  # fmt: skip
    header += [(f"share of {item.name}", "%, before → after") for item in result.requirements]
    return data_table("t-numbers", header, rows)


def _settings(result: Budget, command: str) -> str:
    study = result.study
    shown = {"scene": str(result.source), "budget": study.name, "gradients of each metric": result.gradients}
    shown |= {key: getattr(study, key) for key in ("iterations", "sigmas", "seeds", "shared")}
    for number_, (requirement, item) in enumerate(zip(study.requirements, result.requirements, strict=True), start=1):
        shown |= {f"require[{number_}].{key}": value for key, value in requirement.arguments.items()}
        shown[f"require[{number_}]"] = f"{item.name} at most {item.limit:g}, was {with_error(item.before)}"
    for number_, grades in enumerate(study.choices, start=1):
        shown |= {f"choose[{number_}].{key}": value for key, value in asdict(grades).items()}
    items = "".join(f"<dt>{escape(key)}</dt><dd>{escape(setting_text(value))}</dd>" for key, value in shown.items())
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return f'<dl class="settings">{items}</dl>{ran}'
