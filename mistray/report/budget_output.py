"""What a contamination and roughness budget leaves behind: scene, tables, a picture and report.html."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from markupsafe import Markup

from mistray.optimize.tolerances.budget import Budget
from mistray.report.figures.budget import budget_figure
from mistray.report.figures.plots import as_png
from mistray.report.model import Figure, Items, Note, Report, Section
from mistray.report.output import write_report
from mistray.report.parts import settings_section
from mistray.report.tables.budget import (
    budget_frame,
    budget_record,
    numbers_table,
    requirements_frame,
    requirements_table,
    verdict,
)
from mistray.report.tables.text import number, with_error

CAPTION = "The numbers before and after, and what part of the metric each stands for."


def budget_report(result: Budget, title: str = "scene", command: str = "") -> Report:
    """The report, but for the scene; `title` names the optical system, `command` is the command line."""
    before, after = result.cost
    found = [Markup("{}: <b>{}</b>").format(item.name, verdict(item)) for item in result.requirements]
    picture = as_png(budget_figure(result, title))
    seeds = f"Measured on {result.study.seeds} seeds that the search has not used."
    left = [Note(f"Not in the derivatives: {text}.") for text in result.left_out]
    how = settings_section(_facts(result), command, before=left)
    return Report(
        "Scatter budget",
        title,
        [
            Section("requirements", "Requirements", [Note(seeds), requirements_table(result)]),
            Section("numbers", "Numbers", [Figure(picture, CAPTION), numbers_table(result)]),
            Section("settings", "How, and settings", how.parts),
        ],
        lead=[Items(found), Note(f"Cost {number(before, 4)} before, {number(after, 4)} after.")],
        csv={"budget.csv": budget_frame(result), "requirements.csv": requirements_frame(result)},
        json={"budget.json": budget_record(result)},
        files={"budget.png": picture},
    )


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
    return write_report(budget_report(result, title, command), directory, result.scene_text(directory))


def _facts(result: Budget) -> dict[str, object]:
    study = result.study
    shown = {"scene": str(result.source), "budget": study.name, "gradients of each metric": result.gradients}
    shown |= {key: getattr(study, key) for key in ("iterations", "sigmas", "seeds", "shared")}
    for k, (requirement, item) in enumerate(zip(study.requirements, result.requirements, strict=True), start=1):
        shown |= {f"require[{k}].{key}": value for key, value in requirement.arguments.items()}
        shown[f"require[{k}]"] = f"{item.name} at most {item.limit:g}, was {with_error(item.before)}"
    for k, grades in enumerate(study.choices, start=1):
        shown |= {f"choose[{k}].{key}": value for key, value in asdict(grades).items()}
    return shown
