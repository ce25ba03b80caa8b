"""Printed tables of a ghost analysis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from mistray.analyses.ghosts.notes import fields_text
from mistray.analyses.ghosts.page.optional import optional_sections
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.tables.ghosts_csv import snake, summary_rows
from mistray.analyses.ghosts.tables.path_columns import (
    CONTESTED,
    FEW,
    NUMBERS,
    WAVELENGTH,
    PathColumns,
    mark_of,
    number_cells,
)
from mistray.analyses.ghosts.tables.scatter import scatter_text
from mistray.estimate import Estimate
from mistray.metrics.ghost_ranking import SURE
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.toolkit.pages.model import Table, Value, columns
from mistray.toolkit.pages.own_sections import section_texts
from mistray.toolkit.pages.parts import thousands
from mistray.toolkit.rows import table
from mistray.toolkit.tables.frames import chosen
from mistray.toolkit.tables.text import number, table_text, with_error
from mistray.trace.host.polarization_choice import words_of

RANKED_BY = {
    "rms": f"RMS irradiance P/(π r_rms²) less {SURE:g} standard errors",
    "power": "power",
    "peak": "irradiance of the brightest pixel",
}
ABSORBING = 1e-6  # share of the light that a detector reflects, below which it absorbs all
STRONGEST = "†"  # beside the number of the strongest stray path by power
FEW_TEXT = "few rays: its numbers have no errors, and it is ranked last"
CONTESTED_TEXT = f"within {SURE:g} standard errors it may be as bright as the first; more rays decide"
AIRY_TEXT = (
    "Airy radius: 1.22 λN of the path's own cone of light, where the RMS radius is below it. At Airy radius: power "
    "over π times its square"
)
KINDS = {f"{snake(kind)}_W": f"of which {kind} [W absorbed]" for kind in STRAY_KINDS}
INCIDENT = {"direct_incident_W": "direct_power_W", "stray_incident_W": "stray_W"}
# Heads of the main table by column of summary.csv
SUMMARY = {
    "field_deg": "field [deg]",
    "wavelength_nm": WAVELENGTH,
    "paths": "paths",
    "direct_power_W": "direct image [W absorbed]",
    "stray_W": "stray light [W absorbed]",
    "direct_incident_W": "direct image [W incident]",
    "stray_incident_W": "stray light [W incident]",
    **KINDS,
    "ghost_to_signal": "stray/direct",
    "stray_to_nominal": "stray/nominal",
    "peak_to_nominal": "peak stray/peak nominal",
    "worst_normalised_rms_irradiance": "worst ghost [norm. RMS irradiance]",
}
IN_TEXT = [column for column in SUMMARY if column not in KINDS]
TEXT_NUMBERS = ("power_W", *NUMBERS[6:11])
ALL = "all"
WORST_SHOWN = 4  # paths of each field


def summary_table(rows: Sequence[Mapping[str, Any]], only: Sequence[str] = tuple(SUMMARY), name: str = "") -> Table:
    """
    Return the main table: a row for each field, or for each field and wavelength if rows name wavelengths.

    Parameters
    ----------
    rows : sequence of mapping
        Rows made by `summary_rows`.
    only : sequence of str
        Columns to show; those without information are left out.
    name : str
        HTML id of the table.
    """
    frame = pd.DataFrame(rows)
    empty = {name: frame[name] == 0 for name in ("direct_power_W", "direct_incident_W")}
    empty |= {column: frame[f"paths_{column.removesuffix('_W')}"] == 0 for column in KINDS}
    frame = frame.assign(**{column: frame[column].mask(none) for column, none in empty.items()})
    left_out = {column for column in KINDS if frame[column].isna().all()}
    if not any((frame[incident] > (1 + ABSORBING) * frame[power]).any() for incident, power in INCIDENT.items()):
        left_out |= {*INCIDENT}
    shown = {column: SUMMARY[column] for column in only if column in frame and column not in left_out}
    return chosen(frame, shown, name)


def field_table(report: GhostReport) -> Table:
    """Return the main table with a row for each field, and the columns that it has in text."""
    return (
        summary_table(summary_rows(report, [None]), IN_TEXT) if report else Table((), (), empty="no field was traced")
    )


def is_partly_reflected(paths: pd.DataFrame) -> bool:
    """True if the detector reflects more than 1e-6 of the light of any path."""
    return bool((paths.incident_W > (1 + ABSORBING) * paths.power_W).any())


def ghost_table(report: GhostReport, count: int = WORST_SHOWN, per_wavelength: bool = False) -> str:
    """
    Return the `count` worst stray paths of every field, and the strongest, as a text table: W, mm and W/mm².

    With `per_wavelength` each is followed by its values at each of its wavelengths.
    """
    numbers = [*TEXT_NUMBERS, *(["peak_W_mm2"] if report.rank == "peak" else [])]
    if listed_paths(report, count).airy_radius_mm.isna().all():
        numbers = [name for name in numbers if not name.startswith("airy")]
    rows: list[list[Value]] = []
    for field in report:
        listed = report.with_airy(field, report.listed(field, count))
        for row, cells in zip(listed.itertuples(), number_cells(listed, numbers), strict=True):
            marks = f"{STRONGEST if row.rank_power == 1 else ' '}{mark_of(row) or ' '}"
            name = [f"{field:g}", f"{row.path_id}{marks}", str(row.label), str(row.kind)]
            rows.append([*name, ALL, *cells])
            spectrum = report.spectrum(field, row.path_id) if per_wavelength else listed.head(0)
            for line, cells in zip(spectrum.itertuples(), number_cells(spectrum, numbers), strict=True):
                rows.append(["", mark_of(line), "", "", f"{line.wavelength_nm:g}", *cells])
        rest = beyond(report, field, count)
        if len(rest):
            text = f"… and {len(rest)} more paths: {rest.percent_of_stray.sum():.3g} % of the stray light"
            rows.append([f"{field:g}", "", text, "", ALL, report.power_of(field, rest), *[""] * (len(numbers) - 1)])
    only = ["path_id", "label", "kind", "wavelength_nm", *numbers]
    heads = [*columns("field [deg]"), *table(PathColumns, (), only=only).columns]
    found = Table(heads, rows, empty="no stray path reaches the detector")
    return table_text(found if per_wavelength else found.without("λ"))


def listed_paths(report: GhostReport, count: int) -> pd.DataFrame:
    """Return the rows of `GhostReport.listed` of all fields, `count` as there, with the columns of `with_airy`."""
    return pd.concat([report.with_airy(field, report.listed(field, count)) for field in report])


def beyond(report: GhostReport, field_deg: float, count: int) -> pd.DataFrame:
    """
    Return the rows of a field's stray paths that `GhostReport.listed` leaves out for this `count`.

    Columns are those of `GhostReport.table`.
    """
    paths = report.table(field_deg)
    return paths[(paths.kind != DIRECT) & ~paths.path_id.isin(report.listed(field_deg, count).path_id)]


def ledger_table(report: GhostReport) -> str:
    """Return the energy ledger of every field as text, W, for all light and at every wavelength."""
    heads = columns("field [deg]", WAVELENGTH, "launched [W]", "detected [W]", "absorbed by surfaces [W]",
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
    r"""
    Return the text that `mistray ghosts` prints: main table, worst stray paths of each field, energy closure, notes.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    count : int
        Number of worst paths listed for each field.
    per_wavelength : bool
        Add rows for each wavelength, and the energy ledger at each of them.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> print(mistray.report.main_table(report, count=1).partition("\n\n")[0])
    field  paths  direct image      stray light         stray/direct      stray/nominal             worst ghost
    [deg]         [W absorbed]     [W absorbed]                                          [norm. RMS irradiance]
    -----  -----  ------------  ---------------  -------------------  -----------------  ----------------------
        0     16  81.60 ± 0.56    1.557 ± 0.013    0.01908 ± 0.00018  0.01908 ± 0.00018     3.505e-09 ± 1.6e-11
       10     16  80.28 ± 0.15  1.4118 ± 0.0024  0.017586 ± 0.000035  0.01730 ± 0.00012     3.505e-09 ± 2.7e-11
    """
    nominal = report.nominal.rms_irradiance_W_mm2
    closure = max((report[field].energy.closure for field in report), key=abs)
    rows = summary_rows(report, [None, *(report.wavelengths_nm if per_wavelength else [])])
    if per_wavelength:
        rows = [row | {"wavelength_nm": f"{row['wavelength_nm']:g}" if "wavelength_nm" in row else ALL} for row in rows]
    parts = [
        table_text(summary_table(rows, IN_TEXT)),
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
    for text in section_texts(optional_sections(report)):
        parts += ["", text, ""]
    parts += [f"warning: {text}" for text in report.notes]
    return "\n".join(parts)


def more_rays(report: GhostReport) -> list[str]:
    """Return a line on fields that were traced again with more rays; empty if there are none."""
    if not report.traced_again:
        return []
    rays = thousands(report.settings["contested_rays"])
    return [
        f"{fields_text(report.traced_again)}: traced again with {rays} start rays, for the worst path was contested"
    ]
