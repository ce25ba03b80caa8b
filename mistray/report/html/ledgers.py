"""The ledgers of the HTML report: where the flux went, and what every surface received."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from mistray.analysis.estimate import Estimate
from mistray.analysis.ghosts import GhostReport
from mistray.report.html.markup import cell, data_table, filter_box, number_cell
from mistray.report.tables.ghosts_csv import surface_table
from mistray.report.tables.text import ABSENT, number
from mistray.trace import Energy


def energy_ledger(report: GhostReport, per_wavelength: bool) -> str:
    """Energy ledger of all fields; on request one more for each wavelength."""
    text = (
        "launched = detected + absorbed + escaped + cut. The closure is what is missing, relative to the launched "
        "flux. Cut: light that a limit of the trace left out."
    )
    fields = list(report)
    parts = [f"<p>{text}</p>", _energy_table("t-energy", fields, [report[field].energy for field in fields])]
    if per_wavelength:
        for wavelength in report.wavelengths_nm:
            energies = [report[field].energy_at(wavelength) for field in fields]
            parts.append(f"<h3>{wavelength:g} nm, {100 * report.weight(wavelength):.4g} % of the launched flux</h3>")
            parts.append(_energy_table(f"t-energy-{wavelength:g}".replace(".", "_"), fields, energies))
    return "".join(parts)


def _energy_table(name: str, fields: Sequence[float], energies: Sequence[Energy]) -> str:
    header = [("entry", "", "t"), ("where", "", "t"), *((f"{field:g}°", "W") for field in fields)]

    def row(entry: str, where: str, cells: Iterable[str]) -> list[str]:
        return [cell(entry, "t"), cell(where, "t"), *cells]

    rows = [
        row("launched", "source", (cell(number(e.launched_W, 7)) for e in energies)),
        row("detected", "detector", (number_cell(Estimate(e.detected_W, e.detected_se_W)) for e in energies)),
    ]
    for entry, ledgers in (
        ("absorbed by", [e.absorbed for e in energies]),
        ("absorbed in", [e.absorbed_in for e in energies]),
    ):
        names = dict.fromkeys(name for ledger in ledgers for name in ledger)
        strongest = {name: max(ledger.get(name, (0.0, 0.0))[0] for ledger in ledgers) for name in names}
        for where in sorted(names, key=lambda name: -strongest[name]):
            if strongest[where] > 0:
                pairs = [Estimate(*ledger.get(where, (0.0, 0.0))) for ledger in ledgers]
                rows.append(row(entry, where, (number_cell(pair) for pair in pairs)))
    escaped = [Estimate(e.escaped_W, e.escaped_se_W) for e in energies]
    rows.append(row("escaped", "out of the scene", (number_cell(pair) for pair in escaped)))
    for reason in dict.fromkeys(reason for e in energies for reason in e.cut):
        rows.append(row("cut", reason, (cell(number(e.cut.get(reason, 0.0), 3)) for e in energies)))
    rows.append(row("closure", "relative", (cell(f"{e.closure:.1e}") for e in energies)))
    return data_table(name, header, rows, sortable=False)


def surface_ledger(report: GhostReport, per_wavelength: bool) -> str:
    """Flux at every surface; on request at each wavelength too."""
    text = (
        "Flux that arrives at and stays in each surface, all paths together; light that comes back is counted again. "
        "Surfaces that no ray met are left out."
    )
    parts = [f"<p>{text}</p>", _surfaces("t-surfaces", report, False)]
    if per_wavelength:
        parts += ["<h3>At each wavelength</h3>", _surfaces("t-surfaces-wavelengths", report, True)]
    return "".join(parts)


def _surfaces(name: str, report: GhostReport, per_wavelength: bool) -> str:
    header = [
        ("field", "deg"), *([("λ", "nm")] if per_wavelength else []), ("surface", "", "t"), ("part", "", "t"),
        ("space", ""), ("hits", ""), ("incident", "W"), ("absorbed", "W"),
    ]  # fmt: skip
    table = surface_table(report, per_wavelength)
    rows = [
        [
            cell(f"{s.field_deg:g}"),
            *([cell(f"{s.wavelength_nm:g}")] if per_wavelength else []),
            cell(str(s.id), "t"),
            cell(str(s.part), "t"),
            cell(str(s.space) if s.space >= 0 else ABSENT),
            cell(str(int(s.hits))),
            number_cell(Estimate(s.incident_W, s.incident_se_W)),
            number_cell(Estimate(s.absorbed_W, s.absorbed_se_W)),
        ]
        for s in table[table.hits > 0].itertuples(index=False)
    ]
    return (
        f"<details><summary>{len(rows)} rows</summary>{filter_box(name, 'filter rows', 'filter the surfaces')}"
        f"{data_table(name, header, rows)}</details>"
    )
