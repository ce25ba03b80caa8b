"""Text tables of stray light by level and critical surface, and of paths filtered, renamed or sorted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from mistray.analyses.ghosts.path_analysis import AnalysedPath
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.stray_levels import LEVELS
from mistray.analyses.ghosts.tables.path_columns import PathColumns, of_fields
from mistray.toolkit.pages.model import Column, Table, Value, columns
from mistray.toolkit.rows import table
from mistray.toolkit.tables.text import ABSENT, number, table_text, with_error

SURFACES_SHOWN = 8
MOST_LEVELS = 6  # that have a column each
PATHS_SHOWN = 8
FILTERED = ("path_id", "kind", "label", "wavelength_nm", "rays", "power_W")
ALIASED = ("events", "kind", "wavelength_nm", "rays", "power_W")
NOT_IN_TEXT = ("wavelength", "share", "events")  # of a path analysis
TITLES = {
    "scatter": "Stray light by the number of scatter events and by critical surface",
    "split": "Stray light by the number of reflections (split level) and by critical surface",
}


def level_rows(report: GhostReport, field_deg: float, by: str) -> tuple[list[str], list[list[str]]]:
    """
    Return the stray power absorbed in one field by critical surface and level, W, as text; for `by` see `stray_levels`.

    Returns
    -------
    levels : list of str
        Levels with light; those beyond `MOST_LEVELS` share the last.
    rows : list of list of str
        Name, power at each level and total power: the strongest surfaces, the others together, and all surfaces.
    """
    light = report.stray_levels(field_deg, by)
    known = sorted(set(light.level))
    levels = known[:MOST_LEVELS]
    column = light.level.clip(upper=levels[-1] if levels else 0)
    names = [f"{n}+" if n == levels[-1] and len(known) > len(levels) else f"{n}" for n in levels]
    powers = light.groupby("surface").power_W.sum().sort_values(ascending=False)
    shown = list(powers.index[:SURFACES_SHOWN])
    groups = [(name, light[light.surface == name]) for name in shown]
    if len(powers) > len(shown):
        groups.append((f"… and {len(powers) - len(shown)} more", light[~light.surface.isin(shown)]))
    groups.append(("all stray light", light))
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
            found = level_table(report, field, by)
            heads = [Column(f"field {field:g}°", style="t"), *(Column(one.head) for one in found.columns[1:])]
            parts += [table_text(replace(found, columns=heads)), ""]
    return "\n".join(parts[:-1])


def filter_text(report: GhostReport, selection: str) -> str:
    """Return the power that passes a filter at each field, W, and its strongest paths, as a text table."""
    heads: list[Column] = []
    rows: list[list[Value]] = []
    for field in report:
        found = report.filtered(field, selection)
        paths = table(PathColumns, found.table, only=FILTERED, most=PATHS_SHOWN)
        heads = columns("field [deg]", *paths.columns, "share [% of stray light]")
        count = f"{len(found.table)} paths" if len(found.table) != 1 else "1 path"
        sums: list[Value] = [int(found.table.rays.sum()), found.power_W, number(found.percent_of_stray, 4)]
        rows += [[f"{field:g}", "all", count, "", "", *sums], *(["", *row, ""] for row in paths.rows_in_text())]
    return f"Paths that pass the filter {selection}\n{table_text(Table(heads, rows))}"


def alias_text(report: GhostReport, aliases: Mapping[str, str] | str) -> str:
    """Return the strongest paths of each field, W absorbed, with surfaces renamed by aliases, as a text table."""

    def of_field(field: float) -> Table:
        found = report.aliased(field, aliases)
        counts = Table(columns("paths"), [[len(path_ids)] for path_ids in found.path_ids])
        left = found.iloc[PATHS_SHOWN:]
        count, power = sum(map(len, left.path_ids)), report.power_of(field, left)
        rest: list[Value] = [count, f"… and {len(left)} more", "", "", "", power]
        shown = counts.beside(table(PathColumns, found, only=ALIASED))
        return replace(shown, most=PATHS_SHOWN, rest=rest)

    return f"Paths under other names; paths: how many are one row\n{table_text(of_fields(report, of_field))}"


def analysis_text(report: GhostReport, sort: str, least_share: float) -> str:
    """Return the path analysis as a text table: the first paths of each field and the uncategorised light."""

    def of_field(field: float) -> Table:
        own = report.path_analysis(field, sort, least_share)
        first, left = own[own.path_id >= 0].head(PATHS_SHOWN), int((own.path_id >= 0).sum()) - PATHS_SHOWN
        found = table(AnalysedPath, pd.concat([first, own[own.path_id < 0]])).without(*NOT_IN_TEXT)
        rest = ["", f"… and {left} more", *[""] * (len(found.columns) - 2)]
        return replace(found, rows=[*found.rows, *([rest] if left > 0 else [])])

    return f"Path analysis by {sort}\n{table_text(of_fields(report, of_field))}"
