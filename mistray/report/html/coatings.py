"""Coatings and scatter models of a scene in the HTML report."""

from __future__ import annotations

from mistray.analysis.ghosts import GhostReport
from mistray.analysis.study.surfaces import coatings_and_scatter
from mistray.report.tables.study import table_html
from mistray.sampling.design_path import find_design_path

TEXT = (
    "R, T and A of every kind of surface and what it scatters, for unpolarised light at normal incidence: "
    "R + T + TIS + A = 100 %. R and T are those of the specular beams, after scatter has taken its share. Optics of "
    "the design path are seen from where the light comes, other surfaces from either side."
)


def coatings(report: GhostReport) -> str:
    """What the surfaces do to light at each wavelength, surfaces alike together; each of them folded below."""
    parts = [f"<p>{TEXT}</p>"]
    several = len(report.nominal_trace.tables) > 1
    for number, table in enumerate(report.nominal_trace.tables):
        step = coatings_and_scatter(table, find_design_path(table, report.scene))
        every = step.tables["surface_budget"]
        if several:
            parts.append(f"<h3>{table.wavelength_nm:g} nm</h3>")
        parts += [
            table_html(f"t-coatings-{number}", step.tables["treatments"]),
            f"<details><summary>Every surface ({len(every)} rows)</summary>"
            f"{table_html(f't-surface-budget-{number}', every)}</details>",
        ]
    return "".join(parts)
