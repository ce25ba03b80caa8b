"""The scattered light of the HTML report: which surfaces it comes from, and how well it was sampled."""

from __future__ import annotations

from collections.abc import Mapping

from mistray.analysis.aiming_check import LEAST_LANDED, SamplingCheck, sampling_check
from mistray.analysis.estimate import Estimate
from mistray.analysis.ghosts import GhostReport
from mistray.report.html.markup import cell, data_table, number_cell, thousands
from mistray.report.tables.scatter import SAMPLING, sampling_numbers
from mistray.report.tables.text import ABSENT, number


def scatter_ledger(report: GhostReport) -> str:
    """Scattered light by the first surface that scatters it, and the sampling of each field."""
    text = (
        "Light on the detector by the first surface that scatters it, ghosts that scatter included; in brackets the "
        "share of the stray light of that field."
    )
    sampling = (
        "Hits are those of the detector by rays that were scattered. As many hits of equal flux as “effective hits” "
        "says would be as good. About one hit per start ray is a good sample; a single hit that holds a large share is "
        "a hot spot."
    )
    checks = {field: sampling_check(t) for field, t in report.items()}
    parts = [f"<p>{text}</p>", _surfaces(report), "<h3>Sampling</h3>", f"<p>{sampling}</p>", _sampling(checks)]
    if any(check.rows for check in checks.values()):
        parts.append(
            "<p>Rays that each surface aimed at the detector or at targets, and the share of them that reached the "
            f"detector without a further reflection. !: below {LEAST_LANDED:g}.</p>"
        )
        parts.append(_aiming(checks))
    return "".join(parts)


def _surfaces(report: GhostReport) -> str:
    tables = {field: report.scatter_surfaces(field).set_index("surface") for field in report}
    strongest: dict[str, float] = {}
    for table in tables.values():
        for surface, power in table.power_W.items():
            strongest[surface] = max(power, strongest.get(surface, 0.0))
    part = {surface: table.part[surface] for table in tables.values() for surface in table.index}
    rows = []
    for surface in sorted(strongest, key=lambda name: -strongest[name]):
        cells = []
        for table in tables.values():
            if surface not in table.index:
                cells.append(cell(ABSENT))
                continue
            row = table.loc[surface]
            share = f"({number(row.percent_of_stray, 3)} %)"
            cells.append(number_cell(Estimate(row.power_W, row.power_se_W), share))
        rows.append([cell(surface, "t"), cell(part[surface], "t"), *cells])
    header = [("first scatter at", "", "t"), ("part", "", "t"), *((f"{field:g}°", "W") for field in tables)]
    return data_table("t-scatter", header, rows)


def _sampling(checks: Mapping[float, SamplingCheck]) -> str:
    rows = [[cell(f"{field:g}"), *map(cell, sampling_numbers(check))] for field, check in checks.items()]
    return data_table("t-sampling", [("field", "deg"), *SAMPLING], rows, sortable=False)


def _aiming(checks: Mapping[float, SamplingCheck]) -> str:
    surfaces = {field: {row.surface: row for row in check.rows} for field, check in checks.items()}
    lines = []
    for name in dict.fromkeys(name for rows in surfaces.values() for name in rows):
        cells = [cell(name, "t")]
        for rows in surfaces.values():
            row = rows.get(name)
            share = ABSENT if row is None else f"{number(row.share_landed, 3)}{'!' if row.low else ''}"
            cells += [cell(thousands(row.aimed if row else None)), cell(share)]
        lines.append(cells)
    header: list[tuple[str, ...]] = [("surface", "", "t")]
    for field in surfaces:
        header += [(f"{field:g}°", "aimed"), (f"{field:g}°", "share that lands")]
    return data_table("t-aiming", header, lines)
