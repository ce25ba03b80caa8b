"""A whole stray-light study as one self-contained report.html."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from mistray.analysis.ghosts import GhostReport
from mistray.analysis.study.run import Study
from mistray.analysis.study.step import StudyStep
from mistray.report.html.explorer import page_data
from mistray.report.html.fields import explored_paths
from mistray.report.html.ghosts import ASSUMPTIONS, DEFINITIONS, POLARIZATION, SCATTERED
from mistray.report.html.ledgers import energy_ledger
from mistray.report.html.markup import figure, filter_box, image, section, setting_text, thousands
from mistray.report.html.page import page
from mistray.report.html.pst import causes_figure, curve_figure
from mistray.report.tables.study import fact_text, step_warnings, study_warnings, table_html

ROWS_OPEN = 30  # tables with more rows are folded
ROWS_FILTERED = 15  # tables with more rows have a filter
CAPTIONS = {
    "layout.png": "Section of the system with rays of the direct image on axis.",
    "objects.png": "What the detector sees, what light from outside reaches, and what is both.",
    "ghost_images.png": "Irradiance on the detector at the fields of the ghost analysis, one log10 scale.",
    "ghost_levels.png": "Power by kind of light, and the ten worst stray paths at every field.",
    "worst_ghosts.png": "Rays of the worst ghosts, at the field where they are brightest.",
}
"""Pictures of a study by file name."""
FIGURES = {
    "optical_model": ("layout.png",),
    "common_objects": ("objects.png",),
    "analysis": ("ghost_images.png", "ghost_levels.png", "worst_ghosts.png"),
}
TABLES = {
    "optical_surfaces": "Surfaces in the order of the light",
    "structure": "Surfaces that are not optics of the design path",
    "critical": "Critical objects, the strongest first",
    "straight_shots": "Views of the outside past the optics",
    "illuminated": "Illuminated objects, the strongest first",
    "common": "Common objects, in the order of the light",
    "optics": "Optics: common by design",
    "apart": "Objects that are lit in one place and seen in another, and so are not common",
    "product_estimate": "Estimate of the first-order scatter of every object at every source angle",
    "treatments": "What surfaces do to light, surfaces alike together",
    "surface_budget": "R + T + TIS + A of every surface",
    "scatter_models": "TIS of every scatter model alone",
    "targets": "Targets of every surface that scatters",
    "paraxial_targets": "Paraxial images of the detector behind the surfaces of the path, beside the targets traced",
    "aimed_rays": "Aimed rays in the check, and their share that reaches the detector without a further reflection",
    "pst": "PST by class of the light, and the main cause of the stray light",
    "pst_top_paths": "The strongest stray paths of every angle",
    "pst_breaks": "Breaks of the curve of stray light, in decades of PST per degree",
    "first_level_scatter": "First-level scatter (scattered once, not reflected) by angle and surface",
    "zero_order_paths": "Zero-order paths: neither scattered nor reflected, and no image",
    "ghosts": "Ghosts: summary of the fields",
    "worst_ghosts": "The worst ghosts of every field by RMS irradiance, and the strongest by power",
}
"""Titles of the tables by name; one that is not here has its name as title."""


def study_html(study: Study, pictures: Mapping[str, bytes], command: str = "") -> str:
    """
    The report as HTML text.

    Parameters
    ----------
    study : Study
    pictures : mapping of str to bytes
        PNG files by name, those of `CAPTIONS` that there are.
    command : str
        The command line that made it.
    """
    sections = [
        _head(study),
        _findings(study),
        *(_step(study, step, pictures) for step in study.steps),
        section("settings", "Assumptions, definitions and settings", _settings(study, command)),
    ]
    return page(f"Stray-light study: {study.name}", sections, ("report", "hover", "explorer"))


def _head(study: Study) -> str:
    settings = study.settings
    angles, fields = settings["pst_field_deg"], settings["field_deg"]
    lines = ", ".join(f"{line:g}" for line in settings["wavelength_nm"])
    text = (
        f"PST at {len(angles)} angles from {angles[0]:g} to {angles[-1]:g}° ({settings['convention']}), ghosts at "
        f"{', '.join(f'{field:g}' for field in fields)}°, {lines} nm, {thousands(settings['rays'])} start rays."
    )
    warnings = study_warnings(study)
    box = ""
    if warnings:
        items = "".join(f"<li>{escape(line)}</li>" for line in warnings)
        box = f'<div class="warnings"><b>Mind</b><ul>{items}</ul></div>'
    links = [("findings", "Findings"), *((step.key, f"{step.number} {step.title}") for step in study.steps),
             ("settings", "Settings")]  # fmt: skip
    contents = "".join(f'<li><a href="#{target}">{escape(title)}</a></li>' for target, title in links)
    return (
        f'<header><h1>Stray-light study: {escape(study.name)}</h1><p class="sub">{escape(text)}</p>'
        f'<nav aria-label="Contents"><ul class="contents">{contents}</ul></nav>{box}</header>'
    )


def _findings(study: Study) -> str:
    parts = []
    for step in study.steps:
        items = "".join(f"<li>{escape(text)}</li>" for text in step.findings)
        if items:
            parts.append(f'<h3><a href="#{step.key}">{step.number} {escape(step.title)}</a></h3><ul>{items}</ul>')
    return section("findings", "Findings", "".join(parts))


def _step(study: Study, step: StudyStep, pictures: Mapping[str, bytes]) -> str:
    facts = "".join(f"<dt>{escape(fact.name)}</dt><dd>{escape(fact_text(fact))}</dd>" for fact in step.facts)
    warnings = "".join(f"<li>{escape(text)}</li>" for text in step_warnings(study, step))
    shown = [(name, CAPTIONS[name]) for name in FIGURES.get(step.key, ()) if name in pictures]
    body = [
        f"<p>{escape(step.text)}</p>",
        f'<div class="warnings"><ul>{warnings}</ul></div>' if warnings else "",
        f'<dl class="settings">{facts}</dl>' if facts else "",
        *(_pst_figures(study) if step.key == "analysis" else ()),
        *(figure(image(pictures[name], caption), caption) for name, caption in shown),
        *(_table(name, frame) for name, frame in step.tables.items()),
        *(_ghosts(study.ghosts) if step.key == "analysis" else ()),
        f'<p class="note">{step.seconds:.1f} s</p>',
    ]
    return section(step.key, f"{step.number} {escape(step.title)}", "".join(body))


def _pst_figures(study: Study) -> list[str]:
    return [curve_figure(study.pst, study.name), *([] if study.pst.is_dark else [causes_figure(study.pst, study.name)])]


def _ghosts(report: GhostReport) -> list[str]:
    """The paths of every field to explore, and the energy ledger of the fields."""
    fields = [
        f"<h3>Paths of the ghosts, field {field:g}°</h3>{explored_paths(report, field, f't-field-{number}')}"
        for number, field in enumerate(report)
    ]
    return [page_data(report.scene), *fields, "<h3>Energy ledger of the ghosts</h3>", energy_ledger(report, False)]


def _table(name: str, frame: object) -> str:
    import pandas as pd

    assert isinstance(frame, pd.DataFrame)
    title = f"<h3>{escape(TABLES.get(name, name))}</h3>"
    if frame.empty:
        return f'{title}<p class="note">none</p>'
    box = filter_box(f"t-{name}", "filter rows", f"filter {name}") if len(frame) > ROWS_FILTERED else ""
    table = f"{box}{table_html(f't-{name}', frame)}"
    if len(frame) > ROWS_OPEN:
        return f"{title}<details><summary>{len(frame)} rows</summary>{table}</details>"
    return f"{title}{table}"


def _settings(study: Study, command: str) -> str:
    traced = study.pst.facts.get("settings", {})
    ghosts = next(iter(study.ghosts.values())).settings
    words = {
        "polarization": POLARIZATION[ghosts["polarization"]],
        "scatter": SCATTERED.format(max_scatters=traced.get("max_scatters", ghosts["max_scatters"])),
    }
    assumptions = "".join(f"<li>{escape(text.format(**words))}</li>" for text in ASSUMPTIONS[:-1])
    assumptions += (
        "<li>Ghosts: one collimated beam for each field angle, of the size and irradiance that the scene states. PST: "
        "a plane wave over the whole scene from all azimuths, averaged over a cell of angles.</li>"
    )
    definitions = "".join(
        f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>"
        for term, text in (*_PST_TERMS, *(pair for pair in DEFINITIONS if pair[0] in _GHOST_TERMS))
    )
    shown = study.settings | {f"PST {key}": study.pst.facts[key] for key in ("rays", "seconds")}
    shown |= {f"version of {name}": version for name, version in dict(ghosts.get("versions") or {}).items()}
    items = "".join(f"<dt>{escape(key)}</dt><dd>{escape(setting_text(value))}</dd>" for key, value in shown.items())
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return (
        f'<h3>Assumptions</h3><ul>{assumptions}</ul><h3>Definitions</h3><dl class="settings">{definitions}</dl>'
        f'<h3>Settings</h3><dl class="settings">{items}</dl>{ran}'
    )


_GHOST_TERMS = ("RMS radius", "RMS irradiance", "normalised", "stray light", "stray/nominal", "± ")
_PST_TERMS = (
    ("PST, normal", "irradiance on the detector, averaged over its area, over that of the beam on a plane across it"),
    ("PST, projected", "the same over the irradiance on the plane of the aperture: PST normal / cos θ"),
    ("critical object", "what the detector sees through the optics"),
    ("illuminated object", "what light from outside reaches"),
    ("common object", "both critical and illuminated: one scatter event there sends light to the detector"),
    ("TIS", "total integrated scatter: what a surface scatters into one hemisphere, share of the incident light"),
    ("first-level scatter", "light that is scattered once and never reflected, mirrors apart"),
    ("zero-order path", "a way to the detector without scatter and without reflection, mirrors apart, that is not the "
     "image"),
    ("break", "angle at which the slope of log10 PST of the stray light changes abruptly"),
    ("main cause", "first surface that scatters the light, structure that reflects it, ghosts, or straight shots"),
)  # fmt: skip
