"""Tables of a ghost analysis with all digits, as DataFrames, and their CSV files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from mistray.analyses.ghosts.field_summary import FieldSummary
from mistray.analyses.ghosts.page.optional import optional_sections
from mistray.analyses.ghosts.request import GhostTables
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.stray_levels import LEVELS
from mistray.recorders.path_events import DIRECT, STRAY_KINDS
from mistray.toolkit.pages.output import csv_text, write_files
from mistray.toolkit.pages.own_sections import section_tables
from mistray.toolkit.tables.frames import flat, row_of
from mistray.trace import Trace


def path_table(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """
    Return a DataFrame of the paths of all fields, a row for each path, with ``path_ids`` as text.

    Columns are those of `GhostReport.with_airy`, with powers in W and irradiances in W/mm². With `per_wavelength` each
    path has a row for each of its wavelengths.
    """
    return _of_fields(report, lambda field: report.with_airy(field, report.table(field, per_wavelength)))


def energy_table(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """
    Return the energy ledger of all fields as a DataFrame: entry, name, power_W, power_se_W, share of the launch.

    The launched power is exact, with an error of 0; NaN stands for unknown errors, of cut light and of the closure.
    With `per_wavelength` each wavelength (column wavelength_nm) has a ledger.
    """
    ledgers = _by_wavelength(report, per_wavelength, lambda t: t.energy, lambda t, line: t.energy_at(line))
    rows = []
    for where, energy in ledgers:
        entries = [
            ("launched", "source", energy.launched_W, 0.0),
            ("detected", "detector", energy.detected_W, energy.detected_se_W),
        ]
        entries += [("absorbed", name, power, se) for name, (power, se) in energy.absorbed.items()]
        entries += [("absorbed in", name, power, se) for name, (power, se) in energy.absorbed_in.items()]
        entries += [("escaped", "scene", energy.escaped_W, energy.escaped_se_W)]
        entries += [("cut", reason, power, math.nan) for reason, power in energy.cut.items()]
        entries += [("unaccounted", "closure", energy.closure * energy.launched_W, math.nan)]
        rows += [
            where
            | {"entry": entry, "name": name, "power_W": power, "power_se_W": se, "share": power / energy.launched_W}
            for entry, name, power, se in entries
        ]
    return pd.DataFrame(rows)


def surface_table(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """
    Return a DataFrame of the flux at all surfaces, W, in all fields: columns of ``Trace.surfaces``.

    With `per_wavelength` it has rows for each wavelength (column wavelength_nm).
    """
    parts = _by_wavelength(report, per_wavelength, lambda t: t.surfaces, lambda t, line: t.surfaces_at(line))
    tables = [surfaces.to_pandas().assign(**where) for where, surfaces in parts]
    return _first(pd.concat(tables, ignore_index=True), *parts[0][0])


def scatter_table(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """
    Return a DataFrame of the scattered light of all fields, power in W, by the first surface that scatters it.

    Columns are field_deg and those of `GhostReport.scatter_surfaces`. With `per_wavelength` it has rows for each
    wavelength (column wavelength_nm).
    """
    lines = report.wavelengths_nm if per_wavelength else [None]
    parts = []
    for field in report:
        for line in lines:
            where = {"field_deg": field} | ({} if line is None else {"wavelength_nm": line})
            parts.append(report.scatter_surfaces(field, line).assign(**where))
    return _first(pd.concat(parts, ignore_index=True), "field_deg", *(["wavelength_nm"] if per_wavelength else []))


def aiming_table(report: GhostReport) -> pd.DataFrame:
    """Return a DataFrame of the aimed rays by field and surface: number aimed, number landed, and landed / aimed."""
    aimed = [(field, row) for field, t in report.items() for row in t.aiming]
    rows = [{"field_deg": field, "surface": row.id, **row_of(row, "aimed", "landed")} for field, row in aimed]
    return pd.DataFrame([row | {"landed_share": row["landed"] / row["aimed"]} for row in rows])


def level_frame(report: GhostReport) -> pd.DataFrame:
    """
    Return a DataFrame of the stray light of all fields, W, by scatter and by split level (column ``by``).

    Columns are those of `GhostReport.stray_levels`, without path ids.
    """
    parts = [report.stray_levels(field, by).assign(field_deg=field, by=by) for field in report for by in LEVELS]
    return _first(pd.concat(parts, ignore_index=True).drop(columns="path_ids"), "field_deg", "by")


def summary_frame(report: GhostReport, per_wavelength: bool = False) -> pd.DataFrame:
    """
    Return the main table with all digits as a DataFrame, a row per field; NaN for untraced fields.

    With `per_wavelength` it has a row for each field and wavelength. Powers are in W.
    """
    lines = report.wavelengths_nm if per_wavelength else [None]
    rows = summary_rows(report, lines)
    missing = [{"field_deg": field} | ({} if line is None else {"wavelength_nm": line})
               for field in report.not_traced for line in lines]  # fmt: skip
    return pd.DataFrame([*rows, *missing])


def summary_rows(report: GhostReport, wavelengths_nm: Sequence[float | None]) -> list[dict[str, Any]]:
    """Return rows of the main table, for each field one per given wavelength in nm; None stands for all light."""
    return [_summary_row(report.summary(field, wavelength)) for field in report for wavelength in wavelengths_nm]


def csv_tables(report: GhostReport, per_wavelength: bool = False) -> dict[str, pd.DataFrame]:
    """
    Return the tables that `write_csv` writes, as DataFrames by file name.

    With `per_wavelength` also those of wavelengths.
    """
    makers: dict[str, Callable[..., pd.DataFrame]] = {
        "summary": summary_frame,
        "paths": path_table,
        "energy": energy_table,
        "surfaces": surface_table,
    }
    if report.scatters:
        makers["scatter"] = scatter_table
    tables = {f"{name}.csv": make(report) for name, make in makers.items()}
    if per_wavelength:
        tables |= {f"{name}_per_wavelength.csv": make(report, True) for name, make in makers.items()}
    tables["stray_levels.csv"] = level_frame(report)
    if any(t.aiming for t in report.values()):
        tables["aiming.csv"] = aiming_table(report)
    return tables | section_tables(optional_sections(report), tables)


def further_tables(report: GhostReport, shown: GhostTables) -> dict[str, pd.DataFrame]:
    """Return the tables requested besides those of `csv_tables`, as DataFrames by file name; some trace rays again."""
    makers: dict[str, Callable[[float], pd.DataFrame]] = {}
    if (aliases := shown.aliases) is not None:
        makers["aliased_paths"] = lambda field: report.aliased(field, aliases)
    if shown.path_analysis:
        makers["path_analysis"] = lambda field: report.path_analysis(field, *shown.sorted_by)
    if selection := shown.filter or "":
        makers["filtered_paths"] = lambda field: report.filtered(field, selection).table
        makers["filtered_rays"] = lambda field: report[field].rays(selection)
    if places := shown.rays_at:
        makers["rays_at"] = lambda field: report[field].rays_at(places, selection, n=shown.most_rays or None)
    return {f"{name}.csv": _of_fields(report, make) for name, make in makers.items()}


def write_csv(report: GhostReport, directory: str | Path, per_wavelength: bool = False) -> list[Path]:
    """
    Write summary.csv, paths.csv, energy.csv, surfaces.csv and stray_levels.csv, each over all fields.

    If light is scattered to the detector, scatter.csv is written too, and aiming.csv if rays were aimed. Optional
    sections of the report have tables of their own.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    directory : str or Path
        Created if it is missing.
    per_wavelength : bool
        Write the same tables at each wavelength too, as summary_per_wavelength.csv and so on.

    Returns
    -------
    list of Path
        The files written.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> [file.name for file in mistray.report.write_csv(report, "tables")]
    ['summary.csv', 'paths.csv', 'energy.csv', 'surfaces.csv', 'stray_levels.csv']
    """
    tables = csv_tables(report, per_wavelength)
    return write_files({name: csv_text(table, in_full=True) for name, table in tables.items()}, directory)


def _by_wavelength(
    report: GhostReport, per_wavelength: bool, of_all: Callable[[Trace], Any], of_one: Callable[[Trace, float], Any]
) -> list[tuple[dict[str, float], Any]]:
    """
    Return pairs of identifying columns and a result, made from a trace by `of_all` or `of_one`.

    There is one for each field (degrees), made by `of_all`; or, with `per_wavelength`, one for each field and
    wavelength (nm), made by `of_one`.
    """
    if not per_wavelength:
        return [({"field_deg": field}, of_all(t)) for field, t in report.items()]
    return [
        ({"field_deg": field, "wavelength_nm": wavelength}, of_one(t, wavelength))
        for field, t in report.items()
        for wavelength in report.wavelengths_nm
    ]


def _summary_row(s: FieldSummary) -> dict[str, Any]:
    row: dict[str, Any] = {"field_deg": s.field_deg}
    if s.wavelength_nm is not None:
        row["wavelength_nm"] = s.wavelength_nm
    row["paths"] = s.paths
    row |= {f"paths_{snake(kind)}": s.paths_of_kind[kind] for kind in (DIRECT, *STRAY_KINDS)}
    estimates = {
        "direct_power_W": s.direct.power_W,
        "direct_rms_radius_mm": s.direct.rms_radius_mm,
        "direct_rms_irradiance_W_mm2": s.direct.rms_irradiance_W_mm2,
        "stray_W": s.stray_W,
        "direct_incident_W": s.direct_incident_W,
        "stray_incident_W": s.stray_incident_W,
        **{f"{snake(kind)}_W": s.stray_of_kind_W[kind] for kind in STRAY_KINDS},
        "ghost_to_signal": s.ghost_to_signal,
        "stray_to_nominal": s.stray_to_nominal,
        "worst_normalised_rms_irradiance": s.brightest_normalised,
    }
    row |= flat(estimates) | {"worst_path_id": s.brightest}
    row |= {f"map_{name}_W_mm2": getattr(s.map, name) for name in ("minimum", "maximum", "mean", "rms")}
    row |= {f"map_{name}": getattr(s.map, name) for name in ("flux_W", "incident_rays")}
    return row | {"asymmetry": s.asymmetry, "asymmetry_expected": s.asymmetry_expected, "rays": s.rays}


def _of_fields(report: GhostReport, table_of: Callable[[float], pd.DataFrame]) -> pd.DataFrame:
    """Return the tables that `table_of` makes for each field as one, with ``field_deg`` first, ``path_ids`` as text."""
    tables = [table_of(field).assign(field_deg=field) for field in report]
    return with_text_ids(_first(pd.concat(tables, ignore_index=True), "field_deg"))


def with_text_ids(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of paths in which any ``path_ids`` are text, separated by spaces."""
    if "path_ids" not in table:
        return table
    return table.assign(path_ids=[" ".join(map(str, path_ids)) for path_ids in table.path_ids])


def _first(table: pd.DataFrame, *names: str) -> pd.DataFrame:
    return table[[*names, *[name for name in table.columns if name not in names]]]


def snake(kind: str) -> str:
    """Return a kind of paths, such as "scatter + ghost", in the form of column names, with underscores."""
    return re.sub(r"\W+", "_", kind)
