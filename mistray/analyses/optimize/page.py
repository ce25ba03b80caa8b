"""Report and files of an optimisation: scene, tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from markupsafe import Markup

from mistray.analyses.optimize.figures import reflectance_figure, search_figure, variables_figure
from mistray.analyses.optimize.study.comparison import ComparisonRow
from mistray.analyses.optimize.study.goals import holds
from mistray.analyses.optimize.study.optimization import Optimization
from mistray.analyses.optimize.study.terms import of_layers
from mistray.analyses.optimize.tables import (
    all_terms_table,
    edge_lines,
    goal_text,
    history_frame,
    layers_table,
    moved_table,
    opened_lines,
    seeds_text,
    variables_frame,
    worse_lines,
)
from mistray.estimate import Estimate
from mistray.scene.recoat import recoated
from mistray.scene.rewrite import rewritten
from mistray.scene.titles import title_of_file
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import FigurePart, Items, NotePart, PagePart, Report, Section
from mistray.toolkit.pages.output import writable_directory, write_report
from mistray.toolkit.pages.parts import settings_section
from mistray.toolkit.rows import frame
from mistray.toolkit.tables.text import with_error

CAPTIONS = {
    "reflectance.png": "R(λ) before and after.",
    "search.png": "Merit, terms and gradient during the search.",
    "variables.png": "Variables during the best search.",
}


def scene_text(result: Optimization, directory: Path) -> str:
    """Return the resulting scene as text for a file in `directory`; other parameters stay as they are."""
    note = f"study {Path(result.study.name).name}"
    # Values that belong to the new coatings have a place in the file once these are on it
    source = result.source
    text = recoated(source, result.coatings, source.parent, note) if result.placed else None
    return rewritten(source, result.parameters, directory, note, text)


def write_optimization(result: Optimization, directory: str | Path, command: str = "") -> list[Path]:
    """
    Write scene.xml, terms.csv, variables.csv, history.csv, pictures and report.html, all or none of them.

    Parameters
    ----------
    result : Optimization
        Optimisation to report on.
    directory : str or Path
        Created if it is missing.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        Files written, search.png and variables.png among them; also reflectance.png if the study has coatings.
    """
    target = writable_directory(directory)
    target.mkdir(parents=True, exist_ok=True)
    return write_report(optimization_report(result, command), target, scene_text(result, target))


def optimization_report(result: Optimization, command: str = "") -> Report:
    """Return the report of an optimisation; `command` is the command line quoted in it."""
    pictures = {"search.png": as_png(search_figure(result)), "variables.png": as_png(variables_figure(result))}
    sections = [
        Section("terms", "Terms before and after", [all_terms_table(result)]),
        Section("variables", "Variables", [moved_table(result), _picture(pictures, "variables.png")]),
    ]
    if result.placed:
        pictures["reflectance.png"] = as_png(reflectance_figure(result))
        first = [f"{item.group.name}: the first layer lies {item.group.start.first}." for item in result.placed]
        parts = [*map(NotePart, first), layers_table(result), _picture(pictures, "reflectance.png")]
        sections.append(Section("coatings", "Coatings", parts))
    sections.append(Section("search", "Search", [*_search(result), _picture(pictures, "search.png")]))
    study = result.study
    facts: dict[str, object] = {"scene": str(result.source), "study": study.name}
    for term in study.terms:
        values = {**vars(term), **term.own, **term.traced}
        facts |= {f"{term.name}.{key}": v for key, v in values.items() if key not in ("name", "own", "traced")}
    facts |= {f"optimizer.{key}": value for key, value in asdict(study.optimizer).items()}
    facts["seeds of the comparison"] = result.comparison.seeds
    seeds = f"Measured with {len(result.comparison.seeds)} seeds that the search has not used."
    unverified = [seeds_text(result).removeprefix("warning: ")] if result.unverified else []
    source = result.source.resolve()
    return Report(
        "Optimised",
        title_of_file(source),
        [*sections, settings_section(facts, command)],
        lead=[
            Items(_findings(result)),
            *([] if unverified else [NotePart(seeds)]),
            *(NotePart(order.sentence) for order in result.next_orders),
        ],
        warnings=[*unverified, *worse_lines(result), *opened_lines(result)],
        csv={
            "terms.csv": frame(ComparisonRow, result.comparison.rows),
            "variables.csv": variables_frame(result),
            "history.csv": history_frame(result),
        },
        files=pictures,
    )


def _findings(result: Optimization) -> list[str]:
    """Return a sentence on each term: its value before and after, and the ratio or whether it meets its limit."""
    texts: list[str] = []
    for term in result.study.terms:
        row = result.comparison.of(term.name)
        before, after, ratio = (
            with_error(Estimate(value, se))
            for value, se in ((row.before, row.before_se), (row.after, row.after_se), (row.ratio, row.ratio_se))
        )
        text = Markup("{}: from {} to {} {}").format(term.name, before, after, row.unit)
        change = f"{ratio} times smaller" if row.after else "nothing is left"
        if term.goal == "minimise" and result.comparison.spoiled and not of_layers(term):
            text += Markup(", {}, which is <b>no gain</b>: light enters elsewhere").format(change)
        elif term.goal == "minimise":
            text += Markup(", <b>{}</b>").format(change)
        else:
            kept = Markup("holds") if holds(term, row.after, row.before) else Markup("does <b>not</b> hold")
            text += Markup("; its limit ({}) {}").format(goal_text(term, row.before), kept)
        texts.append(text)
    return texts


def _search(result: Optimization) -> list[PagePart]:
    best = result.best
    text = (
        f"Result: start {best.start + 1} of {len(result.starts)} ({result.starts[best.start].name}), step "
        f"{best.step}, merit {best.merit:.5g}. {result.steps[-1].evaluations} evaluations in "
        f"{result.search_seconds:.0f} s. It is a local minimum at best."
    )
    ends = Items([f"start {k + 1}: {reason}" for k, reason in sorted(result.ended.items())])
    zones = [NotePart(f"{line[0].upper()}{line[1:]}.") for line in edge_lines(result)]
    return [NotePart(text), ends, *zones, *(NotePart(f"Not in the gradient: {what}.") for what in result.left_out)]


def _picture(pictures: Mapping[str, bytes], name: str) -> FigurePart:
    return FigurePart(pictures[name], CAPTIONS[name], name)
