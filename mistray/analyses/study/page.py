"""Stray-light study as printed text, JSON values, tables and a report page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from markupsafe import Markup

from mistray.analyses.ghosts.page.answer import answer, field_anchor, verdict_record, worst_table
from mistray.analyses.ghosts.page.fields import explored_paths
from mistray.analyses.ghosts.page.ledgers import energy_ledger
from mistray.analyses.ghosts.page.path_explorer import page_data
from mistray.analyses.ghosts.page.report import ASSUMPTIONS, SCATTERED, polarization_words
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.verdict import brightest_field
from mistray.analyses.pst.page import causes_figure, curve_figure, pst_verdict, pst_verdict_record
from mistray.analyses.study.result import Study, step_warnings
from mistray.analyses.study.step import Fact, StudyStep
from mistray.analyses.transfer.page import transfer_parts
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.time_budget import can_draw
from mistray.toolkit.pages.model import (
    Column,
    FigurePart,
    Folded,
    Items,
    NotePart,
    PagePart,
    Report,
    Section,
    Table,
    Terms,
    columns,
)
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section, terms, thousands
from mistray.toolkit.tables.frames import frame_table, row_of, value_text
from mistray.toolkit.tables.text import ABSENT

if TYPE_CHECKING:
    from mistray.toolkit.figures.figure import Figure as Drawing

ROWS_OPEN = 30  # tables with more rows are folded
ROWS_FILTERED = 15  # tables with more rows have a filter
CAPTIONS = {
    "layout.png": "Section of the system with rays of the direct image on axis.",
    "objects.png": "What the detector sees, what light from outside reaches, and what is both.",
    "ghost_images.png": "Stray light on the detector at the fields of the ghosts, each map on its own log10 scale.",
    "ghost_levels.png": "Power by kind of light, and the ten worst stray paths at every field.",
    "worst_ghosts.png": "Rays of the worst ghosts, at the field where they are brightest.",
}
"""Pictures of a study by file name."""
VERDICTS = {"pst": "Light from all angles", "ghosts": "Ghosts, without scatter"}
FIGURES = {
    "optical_model": ("layout.png",),
    "common_objects": ("objects.png",),
    "analysis": ("ghost_images.png", "ghost_levels.png", "worst_ghosts.png"),
}


SOURCES = (
    "Ghosts: one collimated beam for each field angle, of the size and irradiance that the scene states. PST: a plane "
    "wave over the whole scene from all azimuths, averaged over a cell of angles."
)
_GHOST_TERMS = ("RMS radius", "RMS irradiance", "normalised", "stray light", "stray/nominal", "± ")


def fact_text(fact: Fact) -> str:
    """Return the value of a fact as text, followed by its unit if it has both."""
    text = value_text(fact.value)
    apart = "" if fact.unit == "°" else " "
    return f"{text}{apart}{fact.unit}" if fact.unit and text != ABSENT else text


def study_text(study: Study) -> str:
    """
    Return the text that `mistray study` prints: the verdict, findings of every step, then warnings.

    Examples
    --------
    >>> found = mistray.study(mistray.load("newtonian_scatter"), [10, 30], [0], rays=2000)
    >>> print(mistray.report.study_text(found).splitlines()[0])
    Stray-light study of 'scene'
    """
    lines = [f"Stray-light study of '{study.name}'", "", "Verdict"]
    for name, part in verdict_records(study).items():
        lines += [f"  {VERDICTS[name]}", *(f"    {text}" for text in part["sentences"])]
    for step in study.steps:
        lines += ["", f"{step.number} {step.title}"]
        lines += [f"  {text}" for text in step.findings or ("nothing to report",)]
    if study.warnings:
        lines += ["", *(f"warning: {text}" for text in study.warnings)]
    return "\n".join(lines)


def record(study: Study) -> dict[str, Any]:
    """Return a study as JSON-serialisable values: name, verdict, settings and steps."""
    steps = [
        row_of(step, "number", "key", "title", "text")
        | {
            "facts": [_fact_record(fact) for fact in step.facts],
            "tables": {name: frame.to_dict("records") for name, frame in step.tables.items()},
            "findings": step.findings,
            "warnings": step_warnings(study, step),
            "seconds": step.seconds,
        }
        for step in study.steps
    ]
    known = {"name": study.name, "verdict": verdict_records(study), "settings": study.settings, "steps": steps}
    return dict(plain(known))


def _fact_record(fact: Fact) -> dict[str, Any]:
    value, se = fact.value if isinstance(fact.value, Estimate) else (fact.value, None)
    return {"name": fact.name, "value": value, "se": se, "unit": fact.unit}


def verdict_records(study: Study) -> dict[str, dict[str, Any]]:
    """Return the verdicts on the PST and on the ghosts as JSON-serialisable values, with the first change to make."""
    return {"pst": pst_verdict_record(study.pst), "ghosts": verdict_record(study.ghosts)}


def findings_table(study: Study) -> Table:
    """Return the table of the findings of all steps."""
    rows = [[f"{step.number} {step.title}", text] for step in study.steps for text in step.findings]
    return Table(columns("<step", Column("finding", style="t long")), rows, empty="nothing to report")


def curve_of_study(study: Study, title: str = "") -> Drawing:
    """Draw the PST of a study against field angle."""
    from mistray.analyses.pst.figures import pst_curve

    return pst_curve(study.pst, title)


def draw_study(study: Study) -> dict[str, bytes]:
    """Return a study's pictures as PNG bytes by file name, see `CAPTIONS`; within a time budget as many as possible."""
    from mistray.analyses.ghosts.figures.ghost_images import levels_against_field, montage
    from mistray.analyses.objects.figures import objects_layout
    from mistray.toolkit.drawings.section_layout import layout
    from mistray.toolkit.figures.plots import as_png

    report = study.ghosts
    on_axis = min(report, key=abs)
    worst = brightest_field(report)
    wanted: dict[str, Callable[[], Drawing]] = {"ghost_levels.png": lambda: levels_against_field(report)}
    if worst is not None:
        wanted["worst_ghosts.png"] = lambda: layout(report, worst)
    wanted |= {
        "objects.png": lambda: objects_layout(study.objects),
        "layout.png": lambda: layout(report, on_axis, ghosts=0),
        "ghost_images.png": lambda: montage(report),
    }
    maps = "ghost_images.png"
    return {name: as_png(figure(), of_maps=name == maps) for name, figure in wanted.items() if can_draw()}


def csv_tables(study: Study) -> dict[str, pd.DataFrame]:
    """Return every table of every step as a DataFrame, by file name made of step number and table name."""
    return {f"{step.number}_{name}.csv": frame for step in study.steps for name, frame in step.tables.items()}


def write_study(study: Study, directory: str | Path, command: str = "") -> list[Path]:
    """
    Write report.html and every table of every step as CSV, named by step and table.

    All files are made before the first is written. Files of the same names are replaced, others are left alone.

    Parameters
    ----------
    study : Study
        Study to write.
    directory : str or Path
        Created if it is missing, with its parents.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        Files written; report.html is the last.

    Examples
    --------
    >>> found = mistray.study(mistray.load("newtonian_scatter"), [10, 30], [0], rays=2000)
    >>> files = mistray.report.write_study(found, "study")
    >>> files[-1].name
    'report.html'
    """
    return write_report(page(study, command), directory)


def page(study: Study, command: str = "") -> Report:
    """Return the report of a study; `command` is the command line that made it."""
    settings = study.settings
    angles, fields = settings["pst_field_deg"], settings["field_deg"]
    lines = ", ".join(f"{line:g}" for line in settings["wavelength_nm"])
    text = (
        f"PST at {len(angles)} angles from {angles[0]:g} to {angles[-1]:g}° ({settings['convention']}), ghosts at "
        f"{', '.join(f'{field:g}' for field in fields)}°, {lines} nm, {thousands(settings['rays'])} start rays."
    )
    pictures = draw_study(study)
    findings: list[PagePart] = []
    for step in study.steps:
        if step.findings:
            heading = Markup('<a href="#{}">{} {}</a>').format(step.key, step.number, step.title)
            findings += [NotePart(heading, "h3"), Items(step.findings)]
    return Report(
        "Stray-light study",
        study.name,
        [
            Section("worst", "The worst ghosts of all fields", worst_table(study.ghosts, study.ghosts), "Worst ghosts"),
            Section("findings", "Findings", findings, "Findings"),
            *(_step(study, step, pictures) for step in study.steps),
            _settings(study, command),
        ],
        lead=[
            NotePart(text, "sub"),
            NotePart(VERDICTS["pst"], "h3"),
            Items(pst_verdict(study.pst), "verdict"),
            NotePart(VERDICTS["ghosts"], "h3"),
            *answer(study.ghosts, study.ghosts),
        ],
        warnings=study.warnings,
        contents=True,
        scripts=("report", "hover", "drawing", "explorer"),
        csv=csv_tables(study),
    )


def _step(study: Study, step: StudyStep, pictures: Mapping[str, bytes]) -> Section:
    warnings = step_warnings(study, step)
    parts: list[PagePart] = [NotePart(step.text)]
    parts += [Items(warnings, "warnings")] if warnings else []
    parts += [Terms([(fact.name, fact_text(fact)) for fact in step.facts])] if step.facts else []
    if step.key == "analysis":
        parts.append(curve_figure(study.pst, study.name))
        parts += [] if study.pst.is_dark else [causes_figure(study.pst, study.name)]
    parts += [FigurePart(pictures[name], CAPTIONS[name]) for name in FIGURES.get(step.key, ()) if name in pictures]
    for name, frame in step.tables.items():
        parts += _table(name, frame)
    if step.key == "analysis":
        parts += [] if study.images is None else transfer_parts(study.images, study.name)
        parts += _ghosts(study.ghosts)
    title = f"{step.number} {step.title}"
    return Section(step.key, title, [*parts, NotePart(f"{step.seconds:.1f} s", "note")], title)


def _ghosts(report: GhostReport) -> list[PagePart]:
    """
    Return page parts for the ghosts: the path explorer of every field, and the energy ledger.

    If the time is up, a note stands in place of the explorer of a field.
    """
    parts: list[PagePart] = [page_data(report)]
    for number, field in enumerate(report):
        parts.append(NotePart(f"Paths of the ghosts, field {field:g}°", "h3", field_anchor(field)))
        if can_draw():
            parts += explored_paths(report, field, f"t-field-{number}")
        else:
            parts.append(
                NotePart("Not mapped, for the time was up; its paths stand in the table of the ghosts.", "note")
            )
    return [*parts, NotePart("Energy ledger of the ghosts", "h3"), *energy_ledger(report, False)]


def _table(name: str, frame: pd.DataFrame) -> list[PagePart]:
    title = NotePart(terms("study_tables").get(name, name), "h3")
    if frame.empty:
        return [title, NotePart("none", "note")]
    table = frame_table(f"t-{name}", frame)
    if len(frame) > ROWS_FILTERED:
        table = replace(table, filter=("filter rows", f"filter {name}"))
    if len(frame) > ROWS_OPEN:
        return [title, Folded(f"{len(frame)} rows", [table])]
    return [title, table]


def _settings(study: Study, command: str) -> Section:
    traced = study.pst.facts.get("settings", {})
    ghosts = study.ghosts.settings
    words = {
        "polarization": polarization_words(ghosts),
        "scatter": SCATTERED.format(max_scatters=traced.get("max_scatters", ghosts["max_scatters"])),
    }
    assumptions = [*(text.format(**words) for text in ASSUMPTIONS[:-1]), SOURCES]
    definitions = terms("study") | {term: terms("ghosts")[term] for term in _GHOST_TERMS}
    shown = study.settings | {f"PST {key}": study.pst.facts[key] for key in ("rays", "seconds")}
    shown |= {f"version of {name}": version for name, version in dict(ghosts.get("versions") or {}).items()}
    return settings_section(shown, command, definitions, assumptions, link="Settings")


text = study_text  # names in a `page`
write = write_study
