"""Ghost analysis as printed text and as JSON values."""

from __future__ import annotations

from typing import Any

import pandas as pd

from mistray.analyses.ghosts.filtered import Filtered
from mistray.analyses.ghosts.page.answer import verdict_record
from mistray.analyses.ghosts.page.optional import optional_sections
from mistray.analyses.ghosts.request import MAIN_TABLES, GhostTables
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.stray_levels import LEVELS
from mistray.analyses.ghosts.tables.ghosts_csv import summary_frame, with_text_ids
from mistray.analyses.ghosts.tables.levels import alias_text, analysis_text, filter_text, level_text
from mistray.analyses.ghosts.tables.printed import WORST_SHOWN, main_table
from mistray.files.json_values import plain
from mistray.toolkit.pages.own_sections import section_record
from mistray.trace import Energy
from mistray.trace.reliability import sampling_check


def text(report: GhostReport, shown: GhostTables = MAIN_TABLES) -> str:
    """Return the text that `mistray ghosts` prints, with the tables that `shown` asks for."""
    parts = [main_table(report, WORST_SHOWN, shown.per_wavelength)]
    if shown.levels:
        parts.append(level_text(report))
    if shown.aliases is not None:
        parts.append(alias_text(report, shown.aliases))
    if shown.path_analysis:
        parts.append(analysis_text(report, *shown.sorted_by))
    if shown.filter:
        parts.append(filter_text(report, shown.filter))
    return "\n\n".join(parts)


def record(report: GhostReport, shown: GhostTables = MAIN_TABLES) -> dict[str, Any]:
    """
    Return the whole analysis as JSON-serialisable values.

    The members of `shown` decide what the fields also hold, such as values at each wavelength.
    """
    rows = _rows(summary_frame(report))
    found = {
        "verdict": verdict_record(report),
        "settings": report.settings,
        "ranked_by": report.rank,
        "fields": [row | _field(report, row["field_deg"], shown) for row in rows],
        "warnings": report.notes,
    }
    return dict(plain(found)) | section_record(optional_sections(report))


def _field(report: GhostReport, field_deg: float, shown: GhostTables) -> dict[str, Any]:
    """Return additional values of a field for its JSON object; empty for a field that is not traced."""
    if field_deg not in report:
        return {}
    levels = {by: report.stray_levels(field_deg, by).drop(columns="path_ids") for by in LEVELS}
    row: dict[str, Any] = {
        "energy": _energy(report[field_deg].energy),
        "worst_paths": _rows(report.with_airy(field_deg, report.listed(field_deg, WORST_SHOWN))),
        "scattered_by": _rows(report.scatter_surfaces(field_deg)),
        "sampling": sampling_check(report[field_deg]),
        "stray_levels": {by: _rows(table) for by, table in levels.items()},
    }
    if shown.filter:
        row["filtered"] = _filtered(report.filtered(field_deg, shown.filter))
    if shown.aliases is not None:
        row["aliased_paths"] = _rows(with_text_ids(report.aliased(field_deg, shown.aliases)))
    if shown.path_analysis:
        row["path_analysis"] = _rows(report.path_analysis(field_deg, *shown.sorted_by))
    if shown.per_wavelength:
        row["per_wavelength"] = _lines(report, field_deg)
    return row


def _rows(table: pd.DataFrame) -> list[dict[Any, Any]]:
    return table.to_dict("records")


def _filtered(found: Filtered) -> dict[str, Any]:
    """Return power (W), share of the stray light (percent) and paths that pass a filter, as a JSON object."""
    return {
        "filter": found.selection,
        "power_W": found.power_W.value,
        "power_se_W": found.power_W.se,
        "percent_of_stray": found.percent_of_stray,
        "paths": _rows(found.table),
    }


def _lines(report: GhostReport, field_deg: float) -> list[dict[str, Any]]:
    """Return the record of a field at each wavelength, one dict each, with the paths that are worst in all light."""
    lines = []
    worst = [report.spectrum(field_deg, path_id) for path_id in report.listed(field_deg, WORST_SHOWN).path_id]
    frame = summary_frame(report, per_wavelength=True)
    for row in frame[frame.field_deg == field_deg].to_dict("records"):
        wavelength = row["wavelength_nm"]
        row["share_of_flux"] = report.weight(wavelength)
        row["energy"] = _energy(report[field_deg].energy_at(wavelength))
        spectra = [spectrum[spectrum.wavelength_nm == wavelength] for spectrum in worst]
        row["worst_paths"] = [path for spectrum in spectra for path in spectrum.to_dict("records")]
        lines.append(row)
    return lines


def _energy(energy: Energy) -> dict[str, Any]:
    names = ("launched_W", "detected_W", "detected_se_W", "escaped_W", "escaped_se_W", "closure")
    by_name = {"absorbed_W": energy.absorbed, "absorbed_in_W": energy.absorbed_in}
    return {
        **{name: getattr(energy, name) for name in names},
        **{key: {name: {"value": w, "se": se} for name, (w, se) in own.items()} for key, own in by_name.items()},
        "cut_W": dict(energy.cut),
    }
