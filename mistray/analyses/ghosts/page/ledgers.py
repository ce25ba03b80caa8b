"""Ledgers of the report: the energy balance, the flux at every surface, and the optical properties of surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.tables.ghosts_csv import surface_table
from mistray.estimate import Estimate
from mistray.sampling.design_path import find_design_path
from mistray.toolkit.pages.model import Folded, NotePart, PagePart, Table, Value, columns
from mistray.toolkit.tables.frames import frame_table
from mistray.toolkit.tables.surface_optics import surface_optics
from mistray.toolkit.tables.text import number
from mistray.trace import Energy

ENERGY = (
    "launched = detected + absorbed + escaped + cut. The closure is what is missing, relative to the launched flux. "
    "Cut: light that a limit of the trace left out."
)
SURFACES = (
    "Flux that arrives at and stays in each surface, all paths together; light that comes back is counted again. "
    "Surfaces that no ray met are left out."
)
COATINGS = (
    "R, T and A of every kind of surface and what it scatters, for unpolarised light at normal incidence: "
    "R + T + TIS + A = 100 %. R and T are those of the specular beams, after scatter has taken its share. Optics of "
    "the design path are seen from where the light comes, other surfaces from either side."
)


def energy_ledger(report: GhostReport, per_wavelength: bool) -> list[PagePart]:
    """Return the energy ledger of all fields, W, and with `per_wavelength` one more per wavelength, as page parts."""
    fields = list(report)
    parts: list[PagePart] = [
        NotePart(ENERGY),
        _energy_table("t-energy", fields, [report[field].energy for field in fields]),
    ]
    for wavelength in report.wavelengths_nm if per_wavelength else ():
        energies = [report[field].energy_at(wavelength) for field in fields]
        share = f"{wavelength:g} nm, {100 * report.weight(wavelength):.4g} % of the launched flux"
        name = f"t-energy-{wavelength:g}".replace(".", "_")
        parts += [NotePart(share, "h3"), _energy_table(name, fields, energies)]
    return parts


def _energy_table(name: str, fields: Sequence[float], energies: Sequence[Energy]) -> Table:
    rows: list[list[Value]] = [
        ["launched", "source", *(number(e.launched_W, 7) for e in energies)],
        ["detected", "detector", *(Estimate(e.detected_W, e.detected_se_W) for e in energies)],
    ]
    for entry, ledgers in (
        ("absorbed by", [e.absorbed for e in energies]),
        ("absorbed in", [e.absorbed_in for e in energies]),
    ):
        names = dict.fromkeys(name for ledger in ledgers for name in ledger)
        strongest = {name: max(ledger.get(name, (0.0, 0.0))[0] for ledger in ledgers) for name in names}
        for where in sorted(names, key=lambda name: -strongest[name]):
            if strongest[where] > 0:
                rows.append([entry, where, *(Estimate(*ledger.get(where, (0.0, 0.0))) for ledger in ledgers)])
    rows.append(["escaped", "out of the scene", *(Estimate(e.escaped_W, e.escaped_se_W) for e in energies)])
    for reason in dict.fromkeys(reason for e in energies for reason in e.cut):
        rows.append(["cut", reason, *(number(e.cut.get(reason, 0.0), 3) for e in energies)])
    rows.append(["closure", "relative", *(f"{e.closure:.1e}" for e in energies)])
    return Table(columns("<entry", "<where", *(f"{field:g}° [W]" for field in fields)), rows, name, sortable=False)


def surface_ledger(report: GhostReport, per_wavelength: bool) -> list[PagePart]:
    """
    Return the flux on every surface, incident and absorbed, W, as page parts.

    With `per_wavelength` there is another table of the flux at each wavelength.
    """
    parts: list[PagePart] = [NotePart(SURFACES), _surfaces("t-surfaces", report, False)]
    if per_wavelength:
        parts += [NotePart("At each wavelength", "h3"), _surfaces("t-surfaces-wavelengths", report, True)]
    return parts


def _surfaces(name: str, report: GhostReport, per_wavelength: bool) -> Table:
    surfaces = surface_table(report, per_wavelength)
    found = frame_table(name, surfaces[surfaces.hits > 0])
    return replace(found, filter=("filter rows", "filter the surfaces"), fold=f"{len(found.rows)} rows")


def coatings(report: GhostReport) -> list[PagePart]:
    """Return R, T, absorption and scatter of surfaces in percent, by wavelength, like ones together, as page parts."""
    parts: list[PagePart] = [NotePart(COATINGS)]
    for k, table in enumerate(report.nominal_trace.tables):
        surfaces, treatments, _ = surface_optics(table, find_design_path(table, report.scene))
        every = frame_table(f"t-surface-budget-{k}", surfaces)
        if len(report.nominal_trace.tables) > 1:
            parts.append(NotePart(f"{table.wavelength_nm:g} nm", "h3"))
        parts.append(frame_table(f"t-coatings-{k}", treatments))
        parts.append(Folded(f"Every surface ({len(every.rows)} rows)", [every]))
    return parts
