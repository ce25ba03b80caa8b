"""Printed tables of the surfaces that scatter light to the detector, and of the sampling of this light."""

from __future__ import annotations

from collections.abc import Mapping

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.scatter_surfaces import ScatteredBy
from mistray.analyses.ghosts.tables.path_columns import of_fields
from mistray.toolkit.pages.model import Table, columns
from mistray.toolkit.rows import table
from mistray.toolkit.tables.text import ABSENT, number, table_text
from mistray.trace.reliability import LEAST_LANDED, AimedRow, SamplingCheck, sampling_check

SURFACES_SHOWN = 10


def scatter_text(report: GhostReport) -> str:
    """Return scattered light by surface, W, and the quality of its sampling, as text."""
    checks = {field: sampling_check(t) for field, t in report.items()}
    parts = [
        "Scattered light by the first surface that scatters it",
        surface_text(report),
        "",
        "Sampling of the scattered light; hits: of the detector, by rays that were scattered",
        table_text(sampling_table(checks)),
    ]
    if any(check.rows for check in checks.values()):
        parts += ["", "Share of the aimed rays of each surface that reach the detector", aiming_text(checks)]
        if any(row.low for check in checks.values() for row in check.rows):
            parts.append(f"!: below {LEAST_LANDED:g}")
    return "\n".join(parts)


def surface_text(report: GhostReport) -> str:
    """Return scattered light by its first scattering surface, W, as text; weak surfaces of a field are combined."""

    def of_field(field: float) -> Table:
        found = report.scatter_surfaces(field)
        left = found.iloc[SURFACES_SHOWN:]
        sums = [int(left.paths.sum()), int(left.rays.sum()), number(left.power_W.sum(), 3)]
        rest = [f"… and {len(left)} more", "", *sums, number(left.percent_of_stray.sum(), 4)]
        return table(ScatteredBy, found, most=SURFACES_SHOWN, rest=rest)

    return table_text(of_fields(report, of_field))


def sampling_table(checks: Mapping[float, SamplingCheck]) -> Table:
    """Return the table of hits per start ray, effective hits, and largest hit (% of scattered light), by field."""
    heads = columns("field [deg]", "hits [per start ray]", "effective hits [(Σ flux)²/Σ flux²]",
                    "largest hit [% of scattered light]")  # fmt: skip
    rows = [
        [f"{field:g}", number(check.hits_per_start, 3), number(check.effective_hits, 4),
         number(100 * check.largest_share, 3)]
        for field, check in checks.items()
    ]  # fmt: skip
    return Table(heads, rows, "t-sampling", sortable=False)


def aiming_text(checks: Mapping[float, SamplingCheck]) -> str:
    """Return the share of aimed rays that reach the detector, by surface and field, as text."""
    landed = {field: {row.surface: row for row in check.rows} for field, check in checks.items()}
    aimed: dict[str, int] = {}
    for row in (row for check in checks.values() for row in check.rows):
        aimed[row.surface] = aimed.get(row.surface, 0) + row.aimed
    names = sorted(aimed, key=lambda name: -aimed[name])
    heads = columns("<surface", *(f"{field:g} [deg]" for field in landed))
    lines = []
    for name in names[:SURFACES_SHOWN]:
        cells = [rows.get(name) for rows in landed.values()]
        lines.append([name, *(_share(row) if row else ABSENT for row in cells)])
    if len(names) > SURFACES_SHOWN:
        lines.append([f"… and {len(names) - SURFACES_SHOWN} more", *("" for _ in landed)])
    return table_text(Table(heads, lines))


def _share(row: AimedRow) -> str:
    return f"{number(row.share_landed, 3)}{'!' if row.low else ' '}"
