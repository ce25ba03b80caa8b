"""Scattered light in the report: the surfaces that it comes from, and the quality of its sampling."""

from __future__ import annotations

from collections.abc import Mapping

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.tables.scatter import sampling_table
from mistray.estimate import Estimate
from mistray.toolkit.pages.model import Noted, NotePart, PagePart, Table, Value, columns
from mistray.toolkit.pages.parts import thousands
from mistray.toolkit.tables.text import ABSENT, number
from mistray.trace.reliability import LEAST_LANDED, SamplingCheck, sampling_check

SCATTERED = (
    "Light on the detector by the first surface that scatters it, ghosts that scatter included; in brackets the share "
    "of the stray light of that field."
)
SAMPLING = (
    "Hits are those of the detector by rays that were scattered. As many hits of equal flux as “effective hits” says "
    "would be as good. About one hit per start ray is a good sample; a single hit that holds a large share is a hot "
    "spot."
)
AIMED = (
    "Rays that each surface aimed at the detector or at targets, and the share of them that reached the detector "
    f"without a further reflection. !: below {LEAST_LANDED:g}."
)


def scatter_ledger(report: GhostReport) -> list[PagePart]:
    """
    Return scattered light by the first surface that scatters it, W, and the sampling of fields, as page parts.

    A table of the aimed rays is added if there are any.
    """
    checks = {field: sampling_check(t) for field, t in report.items()}
    sampling = [NotePart("Sampling", "h3"), NotePart(SAMPLING), sampling_table(checks)]
    aimed = [NotePart(AIMED), _aiming(checks)] if any(check.rows for check in checks.values()) else []
    return [NotePart(SCATTERED), _surfaces(report), *sampling, *aimed]


def _surfaces(report: GhostReport) -> Table:
    tables = {field: report.scatter_surfaces(field).set_index("surface") for field in report}
    strongest: dict[str, float] = {}
    for table in tables.values():
        for surface, power in table.power_W.items():
            strongest[surface] = max(power, strongest.get(surface, 0.0))
    part = {surface: table.part[surface] for table in tables.values() for surface in table.index}
    rows: list[list[Value]] = []
    for surface in sorted(strongest, key=lambda name: -strongest[name]):
        found = [table.loc[surface] if surface in table.index else None for table in tables.values()]
        cells = [
            ABSENT
            if row is None
            else Noted(Estimate(row.power_W, row.power_se_W), f"({number(row.percent_of_stray, 3)} %)")
            for row in found
        ]
        rows.append([surface, part[surface], *cells])
    return Table(
        columns("<first scatter at", "<part", *(f"{field:g}° [W absorbed]" for field in tables)), rows, "t-scatter"
    )


def _aiming(checks: Mapping[float, SamplingCheck]) -> Table:
    surfaces = {field: {row.surface: row for row in check.rows} for field, check in checks.items()}
    lines: list[list[Value]] = []
    for name in dict.fromkeys(name for rows in surfaces.values() for name in rows):
        cells = []
        for rows in surfaces.values():
            row = rows.get(name)
            share = ABSENT if row is None else f"{number(row.share_landed, 3)}{'!' if row.low else ''}"
            cells += [thousands(row.aimed if row else None), share]
        lines.append([name, *cells])
    heads = [text for field in surfaces for text in (f"{field:g}° [aimed]", f"{field:g}° [share that lands]")]
    return Table(columns("<surface", *heads), lines, "t-aiming")
