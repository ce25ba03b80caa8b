"""Text tables of stray light by level and critical surface, and of paths filtered, renamed or sorted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.stray_levels import LEVELS
from mistray.estimate import Estimate
from mistray.toolkit.pages.model import Column, Table, Value, columns
from mistray.toolkit.tables.text import ABSENT, number, table_text, with_error

SURFACES_SHOWN = 8
MOST_LEVELS = 6  # that have a column each
PATHS_SHOWN = 8
TITLES = {
    "scatter": "Stray light by the number of scatter events and by critical surface",
    "split": "Stray light by the number of reflections (split level) and by critical surface",
}


def level_rows(report: GhostReport, field_deg: float, by: str) -> tuple[list[str], list[list[str]]]:
    """
    Return the stray power absorbed in one field by critical surface and level, W, as text.

    Returns
    -------
    levels : list of str
        Levels with light; those beyond `MOST_LEVELS` share the last.
    rows : list of list of str
        Name, power at each level and total power: the strongest surfaces, the others together, and all surfaces.
    """
    table = report.stray_levels(field_deg, by)
    known = sorted(set(table.level))
    levels = known[:MOST_LEVELS]
    column = table.level.clip(upper=levels[-1] if levels else 0)
    names = [f"{n}+" if n == levels[-1] and len(known) > len(levels) else f"{n}" for n in levels]
    powers = table.groupby("surface").power_W.sum().sort_values(ascending=False)
    shown = list(powers.index[:SURFACES_SHOWN])
    groups = [(name, table[table.surface == name]) for name in shown]
    if len(powers) > len(shown):
        groups.append((f"… and {len(powers) - len(shown)} more", table[~table.surface.isin(shown)]))
    groups.append(("all stray light", table))
    rows = []
    for name, own in groups:
        cells = [*(own[column[own.index] == n] for n in levels), own]
        rows.append([name, *(with_error(report.power_of(field_deg, cell)) if len(cell) else ABSENT for cell in cells)])
    return names, rows


def level_table(report: GhostReport, field_deg: float, by: str, name: str = "") -> Table:
    """Return the rows of `level_rows`, W, as a table of a page."""
    levels, rows = level_rows(report, field_deg, by)
    heads = columns("<critical surface", *(f"{by} {level} [W absorbed]" for level in levels), "all [W absorbed]")
    return Table(heads, rows, name, sortable=False)


def level_text(report: GhostReport) -> str:
    """Return the tables of all fields by scatter level and by split level, W absorbed, as text."""
    parts = []
    for by in LEVELS:
        parts.append(
            f"{TITLES[by]}, W absorbed; the surface is the last that scatters or reflects the light out of its way"
        )
        for field in report:
            table = level_table(report, field, by)
            heads = [Column(f"field {field:g}°", style="t"), *(Column(one.head) for one in table.columns[1:])]
            parts += [table_text(replace(table, columns=heads)), ""]
    return "\n".join(parts[:-1])


def filter_text(report: GhostReport, selection: str) -> str:
    """Return the power that passes a filter at each field, W, and its strongest paths, as a text table."""
    heads = columns("field [deg]", "path", "<kind", "<name", "λ [nm]", "rays", "power [W absorbed]",
                    "share [% of stray light]")  # fmt: skip
    rows: list[list[Value]] = []
    for field in report:
        found = report.filtered(field, selection)
        count = f"{len(found.table)} paths" if len(found.table) != 1 else "1 path"
        share = number(found.percent_of_stray, 4)
        rows.append([f"{field:g}", "all", count, "", "", str(found.table.rays.sum()), found.power_W, share])
        for row in found.table.head(PATHS_SHOWN).itertuples(index=False):
            power = Estimate(row.power_W, row.power_se_W)
            rows.append(["", str(row.path_id), row.kind, row.label, f"{row.wavelength_nm:g}", str(row.rays), power, ""])
    return f"Paths that pass the filter {selection}\n{table_text(Table(heads, rows))}"


def alias_text(report: GhostReport, aliases: Mapping[str, str] | str) -> str:
    """Return the strongest paths of each field, W absorbed, with surfaces renamed by aliases, as a text table."""
    rows: list[list[Value]] = []
    for field in report:
        table = report.aliased(field, aliases)
        for row in table.head(PATHS_SHOWN).itertuples(index=False):
            power = Estimate(row.power_W, row.power_se_W)
            rows.append([f"{field:g}", len(row.path_ids), row.events, row.kind, str(row.rays), power])
        rest = table.iloc[PATHS_SHOWN:]
        if len(rest):
            count, power = sum(map(len, rest.path_ids)), report.power_of(field, rest)
            rows.append([f"{field:g}", count, f"… and {len(rest)} more", "", "", power])
    heads = columns("field [deg]", "paths", "<events", "<kind", "rays", "power [W absorbed]")
    return f"Paths under other names; paths: how many are one row\n{table_text(Table(heads, rows))}"


def analysis_text(report: GhostReport, sort: str, least_share: float) -> str:
    """Return the path analysis as a text table: the first paths of each field and the uncategorised light."""
    heads = columns("field [deg]", "path", "<name", "<kind", "power [W absorbed]", "branches", "objects",
                    "unique [objects]", "<last object", "diffractions", "mean OPL [mm]")  # fmt: skip
    rows: list[list[Value]] = []
    for field in report:
        own = report.path_analysis(field, sort, least_share)
        first = own[own.path_id >= 0].head(PATHS_SHOWN)
        for row in pd.concat([first, own[own.path_id < 0]]).itertuples(index=False):
            counts = (row.objects, row.unique_objects, row.last_object, row.diffractions)
            known = [*map(str, counts), Estimate(row.opl_mm, row.opl_se_mm)] if row.path_id >= 0 else [ABSENT] * 5
            name = str(row.path_id) if row.path_id >= 0 else ""
            power = Estimate(row.power_W, row.power_se_W)
            rows.append([f"{field:g}", name, row.label, row.kind, power, str(row.branches), *known])
        if len(own[own.path_id >= 0]) > len(first):
            rows.append([f"{field:g}", "", f"… and {(own.path_id >= 0).sum() - len(first)} more", *[""] * 8])
    return f"Path analysis by {sort}\n{table_text(Table(heads, rows))}"
