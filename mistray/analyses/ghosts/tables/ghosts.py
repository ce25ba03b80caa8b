"""The printed tables of a ghost analysis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from mistray.analyses.ghosts.field_summary import FieldSummary
from mistray.analyses.ghosts.notes import fields_text
from mistray.analyses.ghosts.ranking import SURE
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.tables.scatter import scatter_text
from mistray.estimate import Estimate
from mistray.recorders.path_events import DIRECT
from mistray.toolkit.pages.model import Table, Value, columns
from mistray.toolkit.pages.own_sections import own_sections, section_texts
from mistray.toolkit.pages.parts import thousands
from mistray.toolkit.tables.text import ABSENT, number, table_text, with_error
from mistray.trace.polarization_choice import words_of

RANKED_BY = {
    "rms": f"RMS irradiance P/(π r_rms²) less {SURE:g} standard errors",
    "power": "power",
    "peak": "irradiance of the brightest pixel",
}
ABSORBING = 1e-6  # share of the light that a detector reflects, below which it absorbs all
STRONGEST = "†"  # beside the number of the strongest stray path by power
FEW, CONTESTED = "*", "≈"  # beside that of a path of few rays, and of one that may be as bright as the first
FEW_TEXT = "few rays: its numbers have no errors, and it is ranked last"
CONTESTED_TEXT = f"within {SURE:g} standard errors it may be as bright as the first; more rays decide"
AIRY_TEXT = (
    "Airy radius: 1.22 λN of the path's own cone of light, where the RMS radius is below it. At Airy radius: power "
    "over π times its square"
)
ALL = "all"
WORST_SHOWN = 4  # paths of each field


def summary_table(summaries: Sequence[FieldSummary]) -> str:
    """Main table: one row for each field, and for each wavelength where there are summaries of one."""
    heads = columns("field [deg]", "λ [nm]", "paths", *summary_powers(summaries), "stray/direct", "stray/nominal",
                    "worst ghost [norm. RMS irradiance]")  # fmt: skip
    rows: list[list[Value]] = [
        [
            f"{s.field_deg:g}",
            ALL if s.wavelength_nm is None else f"{s.wavelength_nm:g}",
            s.paths,
            *summary_values(s, summaries, ABSENT),
            *(s.ghost_to_signal, s.stray_to_nominal, s.brightest_normalised),
        ]
        for s in summaries
    ]
    table = Table(heads, rows)
    return table_text(table.without("λ") if all(s.wavelength_nm is None for s in summaries) else table)


def summary_powers(summaries: Sequence[FieldSummary]) -> list[str]:
    """Heads of the powers of the main table: absorbed by the detector, and incident where it reflects some."""
    absorbed = ["direct image [W absorbed]", "stray light [W absorbed]"]
    return [*absorbed, "direct image [W incident]", "stray light [W incident]"] if _reflected(summaries) else absorbed


def summary_values(s: FieldSummary, summaries: Sequence[FieldSummary], unknown: Value) -> list[Value]:
    """The values of `summary_powers` in one row."""
    powers = [s.direct.power_W, s.stray_W]
    if _reflected(summaries):
        powers += [s.direct_incident_W, s.stray_incident_W]
    return [unknown if k % 2 == 0 and power.value == 0 else power for k, power in enumerate(powers)]


def _reflected(summaries: Sequence[FieldSummary]) -> bool:
    return any(
        incident.value > (1 + ABSORBING) * absorbed.value
        for s in summaries
        for incident, absorbed in ((s.direct_incident_W, s.direct.power_W), (s.stray_incident_W, s.stray_W))
    )


def is_partly_reflected(table: pd.DataFrame) -> bool:
    """Whether the detector reflects some of the light of paths."""
    return bool((table.incident_W > (1 + ABSORBING) * table.power_W).any())


def ghost_table(report: GhostReport, count: int = WORST_SHOWN, per_wavelength: bool = False) -> str:
    """The worst stray paths of every field and the strongest; per wavelength, each with its spectrum below it."""
    heads = columns(
        "field [deg]", "path", "<ghost and scatter surfaces [1st → 2nd]", "<kind", "λ [nm]", "power [W absorbed]",
        "RMS radius [mm]", "RMS irradiance [W/mm²]", "normalised [to on-axis image]",
        "Airy radius [mm]", "at Airy radius [W/mm²]", "peak [W/mm²]",
    )  # fmt: skip
    rows: list[list[Value]] = []
    floors = listed_paths(report, count).airy_radius_mm.notna().any()
    for field in report:
        for row in report.with_airy(field, report.listed(field, count)).itertuples(index=False):
            marks = f"{STRONGEST if row.rank_power == 1 else ' '}{mark_of(row) or ' '}"
            peak = Estimate(row.peak_W_mm2, row.peak_se_W_mm2) if report.rank == "peak" else ""
            name = [f"{field:g}", f"{row.path_id}{marks}", str(row.label), str(row.kind)]
            rows.append([*name, ALL, *_path_numbers(row), *_at_airy_radius(row), peak])
            for line in report.spectrum(field, row.path_id).itertuples(index=False) if per_wavelength else ():
                rows.append(["", mark_of(line), "", "", f"{line.wavelength_nm:g}", *_path_numbers(line), *[""] * 3])
        rest = beyond(report, field, count)
        if len(rest):
            text = f"… and {len(rest)} more paths: {rest.percent_of_stray.sum():.3g} % of the stray light"
            rows.append([f"{field:g}", "", text, "", ALL, report.power_of(field, rest), *[""] * 6])
    left_out = [*([] if per_wavelength else ["λ"]), *([] if report.rank == "peak" else ["peak"])]
    left_out += [] if floors else ["Airy radius", "at Airy radius"]
    return table_text(Table(heads, rows, empty="no stray path reaches the detector").without(*left_out))


def listed_paths(report: GhostReport, count: int) -> pd.DataFrame:
    """The rows of `GhostReport.listed` of all fields, with the columns of `GhostReport.with_airy`."""
    return pd.concat([report.with_airy(field, report.listed(field, count)) for field in report])


def beyond(report: GhostReport, field_deg: float, count: int) -> pd.DataFrame:
    """The rows of the stray paths of a field that are not listed with its worst `count`."""
    table = report.table(field_deg)
    return table[(table.kind != DIRECT) & ~table.path_id.isin(report.listed(field_deg, count).path_id)]


def _path_numbers(row: Any) -> list[Value]:
    named = ("power{}_W", "rms_radius{}_mm", "rms_irradiance{}_W_mm2", "normalised_rms_irradiance{}")
    return [Estimate(*(getattr(row, name.format(kind)) for kind in ("", "_se"))) for name in named]


def _at_airy_radius(row: Any) -> list[Value]:
    if math.isnan(row.airy_radius_mm):
        return ["", ""]
    return [Estimate(row.airy_radius_mm, row.airy_radius_se_mm),
            Estimate(row.airy_irradiance_W_mm2, row.airy_irradiance_se_W_mm2)]  # fmt: skip


def ledger_table(report: GhostReport) -> str:
    """Energy ledger of every field at every wavelength, and of all light."""
    heads = columns("field [deg]", "λ [nm]", "launched [W]", "detected [W]", "absorbed by surfaces [W]",
                    "absorbed in media [W]", "escaped [W]", "cut [W]", "closure [relative]")  # fmt: skip
    rows: list[list[Value]] = []
    for field, t in report.items():
        ledgers = {ALL: t.energy} | {f"{line:g}": t.energy_at(line) for line in report.wavelengths_nm}
        for name, e in ledgers.items():
            absorbed = [sum(power for power, _ in part.values()) for part in (e.absorbed, e.absorbed_in)]
            rows.append(
                [f"{field:g}", name, number(e.launched_W, 6), Estimate(e.detected_W, e.detected_se_W),
                 *(number(power, 6) for power in absorbed), Estimate(e.escaped_W, e.escaped_se_W),
                 number(sum(e.cut.values()), 3), f"{e.closure:.1e}"]
            )  # fmt: skip
    return table_text(Table(heads, rows))


def main_table(report: GhostReport, count: int = WORST_SHOWN, per_wavelength: bool = False) -> str:
    """
    Return the text that `mistray ghosts` prints: the main table, the worst ghosts of each field and the energy closure.

    Parameters
    ----------
    report : GhostReport
    count : int
        Worst paths of each field.
    per_wavelength : bool
        Add rows for each wavelength, and the energy ledger at each of them.
    """
    nominal = report.nominal.rms_irradiance_W_mm2
    closure = max((report[field].energy.closure for field in report), key=abs)
    lines: list[float | None] = [None, *(report.wavelengths_nm if per_wavelength else [])]
    parts = [
        summary_table([report.summary(field, wavelength) for field in report for wavelength in lines]),
        "",
        f"Worst {count} stray paths of each field by {RANKED_BY[report.rank]}",
        ghost_table(report, count, per_wavelength),
        "",
    ]
    if report.scatters:
        parts += [scatter_text(report), ""]
    if per_wavelength:
        parts += ["Energy ledger", ledger_table(report), ""]
    parts += [
        f"normalised: over the RMS irradiance of the direct image on axis, {with_error(nominal)} W/mm²",
        "stray/nominal: over the power of the direct image on axis.  ±: one standard error",
        "absorbed: by the detector; incident: before it reflects its share",
    ]
    if per_wavelength:
        parts.append("rows of one wavelength: normalised to the direct image on axis at that wavelength")
    if any(len(report.top(field, 1)) for field in report):
        parts.append(f"{STRONGEST}: the strongest stray path of the field by power")
    listed = listed_paths(report, count)
    if listed.airy_radius_mm.notna().any():
        parts.append(AIRY_TEXT)
    if listed.few_rays.any():
        parts.append(f"{FEW}: {FEW_TEXT}")
    if listed.contested.any() and report.rank == "rms":
        parts.append(f"{CONTESTED}: {CONTESTED_TEXT}")
    parts.append(f"energy closure, worst field: {closure:.1e} of the launched flux")
    parts += more_rays(report)
    parts.append(words_of(report.settings))
    for text in section_texts(own_sections(report)):
        parts += ["", text, ""]
    parts += [f"warning: {text}" for text in report.notes]
    return "\n".join(parts)


def more_rays(report: GhostReport) -> list[str]:
    """Which fields were traced again, and with how many rays; empty if none was."""
    if not report.traced_again:
        return []
    rays = thousands(report.settings["contested_rays"])
    return [
        f"{fields_text(report.traced_again)}: traced again with {rays} start rays, for the worst path was contested"
    ]


def mark_of(row: Any) -> str:
    """The mark of a row of a path table: `FEW` rays, `CONTESTED`, or nothing."""
    return FEW if row.few_rays else CONTESTED if row.contested else ""
