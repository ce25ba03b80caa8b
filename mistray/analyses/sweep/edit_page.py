"""Report on edits of a scene: effect of configurations on the PST, and ranking of single steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pandas as pd

from mistray.analyses.pst.page import pst_facts
from mistray.analyses.pst.tables import curve_table
from mistray.analyses.sweep.edit_figures import pst_sweep_figure
from mistray.analyses.sweep.edit_ranking import EditRanking
from mistray.analyses.sweep.edit_tables import (
    PAIRED,
    edit_ranking_record,
    edit_ranking_table,
    edit_ranking_text,
    pst_sweep_record,
    pst_sweep_table,
    pst_sweep_text,
    ranked_light,
    ranking_notes,
)
from mistray.analyses.sweep.pst_sweep import PstSweep
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import FigurePart, NotePart, Report, Section
from mistray.toolkit.pages.parts import settings_section, terms, version_settings

CAPTION = "Stray PST of each configuration, and over that of the scene as it is, with standard errors."


def text(found: PstSweep | None, ranking: EditRanking | None) -> str:
    """Return the printed text on configurations and on the ranking of single edits, as far as they are given."""
    texts = [] if found is None else [pst_sweep_text(found)]
    return "\n\n".join(texts if ranking is None else [*texts, edit_ranking_text(ranking)])


def record(found: PstSweep | None, ranking: EditRanking | None) -> dict[str, Any]:
    """Return configurations and ranking of single edits, as far as given, as JSON-serialisable values."""
    edits = {} if found is None else pst_sweep_record(found)
    return edits if ranking is None else edits | edit_ranking_record(ranking)


def page(
    found: PstSweep | None = None, ranking: EditRanking | None = None, title: str = "scene", command: str = ""
) -> Report:
    """
    Return the report on edits: PST of configurations, and ranking of single steps.

    Parameters
    ----------
    found : PstSweep, optional
        Stray PST of each configuration.
    ranking : EditRanking, optional
        Effect of each single step on the PST.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    Report
        Page, with pst_sweep.csv, pst_sweep.json and pst_sweep.png of configurations, and edit_ranking.csv and
        edit_ranking.json of a ranking.
    """
    sections: list[Section] = []
    facts: dict[str, Any] = {}
    files: dict[str, bytes] = {}
    csv: dict[str, pd.DataFrame] = {}
    json: dict[str, Mapping[str, Any]] = {}
    lead: list[NotePart] = []
    warnings: list[str] = []
    if found is not None:
        files["pst_sweep.png"] = as_png(pst_sweep_figure(found, title))
        drawn = FigurePart(files["pst_sweep.png"], CAPTION, "stray PST by configuration")
        first = found.pst[found.configurations[0]]
        table = pst_sweep_table(found)
        curves = [
            replace(curve_table(pst), name=f"t-curve-{k}", fold=name) for k, (name, pst) in enumerate(found.pst.items())
        ]
        sections += [
            Section("edits", "What each configuration does", [drawn, NotePart(f"{PAIRED}."), table], "Configurations"),
            Section("curves", "PST by class", curves, "PST by class"),
        ]
        warnings, facts = found.warnings, pst_facts(first)
        csv["pst_sweep.csv"], json["pst_sweep.json"] = found.to_pandas(), pst_sweep_record(found)
        lead.append(NotePart(f"{len(found.configurations) - 1} configurations, {len(found.field_deg)} field angles."))
    if ranking is not None:
        parts = [
            NotePart(f"{ranked_light(ranking)}."),
            edit_ranking_table(ranking),
            *map(NotePart, ranking_notes(ranking)),
        ]
        sections.append(Section("ranking", "Which edit would pay", parts, "Ranking"))
        csv["edit_ranking.csv"], json["edit_ranking.json"] = ranking.to_pandas(), edit_ranking_record(ranking)
        facts |= {"light": ranking.light, **(pst_facts(ranking.traced) if ranking.traced is not None else {})}
    facts |= version_settings()
    parts_of = {"configurations": found, "ranking": ranking}
    words = terms("edits") | {
        k: v for name, part in parts_of.items() if part is not None for k, v in terms(name).items()
    }
    return Report(
        "Edits",
        title,
        [*sections, settings_section(facts, command, words, link="Definitions and settings")],
        lead=lead,
        warnings=warnings,
        csv=csv,
        json=json,
        files=files,
    )
