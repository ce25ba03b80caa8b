"""Section on the split of flux at surfaces in the report of a ghost analysis, if the scene records it."""

from __future__ import annotations

from mistray.analyses.ghosts.result import GhostReport
from mistray.estimate import Estimate
from mistray.recorders.flux_maps.flux_split import SHARES, FluxSplit
from mistray.toolkit.pages.model import NotePart, Section, Table, Value, columns

ROWS_PRINTED = 16
NOTE = (
    "What surfaces do with the light that meets them, the most light first; what comes back counts again. The shares "
    "are those of the surface, whether the trace follows the light or not, and add up to what is incident."
)


def flux_split_section(report: GhostReport) -> Section | None:
    """Return the section on recorded flux splits at surfaces, W, by field; None if nothing is recorded."""
    rows: list[list[Value]] = []
    for field, recorder in report.recorded(FluxSplit):
        for row in sorted(recorder.rows, key=lambda one: -one.incident[0]):
            rows.append([f"{field:g}", row.surface, *(Estimate(*getattr(row, name)) for name in SHARES)])
    if not rows:
        return None
    heads = columns("field [deg]", "<surface", *(f"{name.replace('_', ' ')} [W]" for name in SHARES))
    rest = ["", f"{len(rows)} rows in all", *[""] * len(SHARES)]
    table = Table(heads, rows, "flux_split", most=ROWS_PRINTED, rest=rest)
    return Section("split", "What surfaces do with the light", [NotePart(NOTE), table], "Split")
