"""A ghost analysis as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from mistray.analyses.ghosts.filtered import Filtered
    from mistray.analyses.ghosts.result import GhostReport
    from mistray.trace import Energy

WORST_SHOWN = 4


def as_json(
    report: GhostReport,
    per_wavelength: bool = False,
    selection: str | None = None,
    more: Mapping[str, pd.DataFrame] | None = None,
) -> dict[str, Any]:
    """Return the values of `mistray ghosts --json`; per wavelength, fields hold the same numbers at each wavelength."""
    from mistray.analyses.ghosts.page.answer import verdict_record
    from mistray.analyses.ghosts.page.own_sections import own_record
    from mistray.analyses.ghosts.stray_levels import LEVELS
    from mistray.analyses.ghosts.tables.ghosts_csv import summary_frame
    from mistray.files.json_values import plain

    fields = []
    for row in summary_frame(report).to_dict("records"):
        if row["field_deg"] in report.not_traced:
            fields.append(row)
            continue
        row["energy"] = _energy(report[row["field_deg"]].energy)
        field = row["field_deg"]
        row["worst_paths"] = report.with_airy(field, report.listed(field, WORST_SHOWN)).to_dict("records")
        row |= _scatter(report, row["field_deg"])
        row["stray_levels"] = {
            by: report.stray_levels(row["field_deg"], by).drop(columns="path_ids").to_dict("records") for by in LEVELS
        }
        if selection:
            row["filtered"] = _filtered(report.filtered(row["field_deg"], selection))
        for name, table in (more or {}).items():
            row[name] = table[table.field_deg == row["field_deg"]].drop(columns="field_deg").to_dict("records")
        if per_wavelength:
            row["per_wavelength"] = _lines(report, row["field_deg"])
        fields.append(row)
    found = {
        "verdict": verdict_record(report),
        "settings": report.settings,
        "ranked_by": report.rank,
        "fields": fields,
        "warnings": report.notes,
    }
    sections = own_record(report)
    return dict(plain(found)) | ({"sections": sections} if sections else {})


def _filtered(found: Filtered) -> dict[str, Any]:
    """Return the light and the paths that pass a filter at a field."""
    return {
        "filter": found.selection,
        "power_W": found.power_W.value,
        "power_se_W": found.power_W.se,
        "percent_of_stray": found.percent_of_stray,
        "paths": found.table.to_dict("records"),
    }


def _lines(report: GhostReport, field_deg: float) -> list[dict[str, Any]]:
    """A field at each wavelength; the worst paths are those of all light."""
    from mistray.analyses.ghosts.tables.ghosts_csv import summary_frame

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


def _scatter(report: GhostReport, field_deg: float) -> dict[str, Any]:
    """Where the scattered light of a field comes from, and how well it was sampled."""
    from mistray.trace.reliability import sampling_check

    return {
        "scattered_by": report.scatter_surfaces(field_deg).to_dict("records"),
        "sampling": asdict(sampling_check(report[field_deg])),
    }


def _energy(energy: Energy) -> dict[str, Any]:
    names = ("launched_W", "detected_W", "detected_se_W", "escaped_W", "escaped_se_W", "closure")
    by_name = {"absorbed_W": energy.absorbed, "absorbed_in_W": energy.absorbed_in}
    return {
        **{name: getattr(energy, name) for name in names},
        **{key: {name: {"value": w, "se": se} for name, (w, se) in own.items()} for key, own in by_name.items()},
        "cut_W": dict(energy.cut),
    }
