"""One self-contained report.html: style, script and pictures inside, nothing from the network."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from mistray.analysis.estimate import UNKNOWN, Estimate
from mistray.analysis.ghosts import FieldSummary, GhostReport
from mistray.recorders.path_events import STRAY_KINDS
from mistray.replace_file import replace_file
from mistray.report.figures.plots import as_png, levels_against_field, montage
from mistray.report.html.coatings import coatings
from mistray.report.html.explorer import page_data
from mistray.report.html.fields import field_section, mapped_paths
from mistray.report.html.hover import hover_figure
from mistray.report.html.ledgers import energy_ledger, surface_ledger
from mistray.report.html.markup import (
    cell,
    data_table,
    figure,
    image,
    number_cell,
    section,
    setting_text,
    thousands,
)
from mistray.report.html.page import page
from mistray.report.html.scatter import scatter_ledger
from mistray.report.tables.ghosts import warnings
from mistray.report.tables.text import ABSENT, with_error

ASSUMPTIONS = (
    "Geometric optics: rays are straight lines between surfaces; no diffraction, and paths add without interference.",
    "{scatter}",
    "Structure reflects specularly with the reflectance that the scene gives it.",
    "{polarization}; the coatings are those of the scene, bare surfaces follow Fresnel.",
    "A source at infinity: one collimated beam for each field angle, with the irradiance that the scene states.",
)
POLARIZATION = {
    "unpolarized": "Unpolarised light at every surface: R and T are the means of s and p at every hit",
    "stokes": "Polarisation is carried along every path as a Stokes vector; the light of the source is unpolarised",
}
SPECULAR = "Specular light only: reflection and refraction at smooth surfaces; no scattered light reaches the detector."
SCATTERED = (
    "Surfaces scatter by the models that the scene gives them, up to {max_scatters} times along a path. Scattered "
    "light is unpolarised. Aimed rays and random ones share the flux by weights, so that their sum is right on average."
)
DEFINITIONS = (
    ("power", "flux that the detector absorbs; the incident flux is in paths.csv"),
    ("RMS radius", "root of the mean square distance of a path's rays from their centroid, weighted by flux"),
    ("RMS irradiance", "P / (π r_rms²): power of the path over the disc of its RMS radius"),
    ("peak", "irradiance of the brightest pixel of the path; depends on the pixel size"),
    ("normalised", "RMS irradiance of the path over that of the direct image on axis (field 0°)"),
    ("stray light", "everything that reaches the detector and is not the direct image"),
    ("of all light", "share of everything that the detector absorbs at this field, the direct image included"),
    ("of stray light", "share of the stray light at this field"),
    ("stray/direct", "stray power over the power of the direct image at the same field; – where there is none"),
    ("stray/nominal", "stray power over the power of the direct image on axis"),
    ("peak stray/peak nominal", "brightest pixel of the stray light over that of the on-axis image; depends on the "
     "pixel size"),
    ("ghost surfaces", "surfaces where the path was reflected specularly, in the order of the light; structure counts, "
     "the mirrors of the design path do not"),
    ("single, multiple scatter", "one or several scatter events on the way; with specular reflections besides them "
     "ghost + scatter"),
    ("path", "T transmitted, R reflected, I totally internally reflected, t scattered in transmission, r scattered in "
     "reflection, A absorbed; open it for the surfaces"),
    ("polarisation", "degree of polarisation of all light of a path together, 0 … 1; of several wavelengths the mean, "
     "weighted by power"),
    ("wavelengths", "a path is a list of surfaces; its numbers are those of all wavelengths together"),
    ("± ", "one standard error; of a sum of paths from the spread of 32 batches of start rays"),
)  # fmt: skip


def write_html(
    report: GhostReport,
    path: str | Path,
    title: str = "scene",
    command: str = "",
    pictures: Mapping[str, bytes] | None = None,
    per_wavelength: bool = False,
) -> Path:
    """
    Write the report as one HTML file.

    Parameters
    ----------
    report : GhostReport
    path : str or Path
        File to write; it appears complete or not at all.
    title : str
        Name of the optical system.
    command : str
        The command line that made it, for the reader who wants to repeat it.
    pictures : mapping of str to bytes, optional
        PNG files that were drawn already, by name, as from `mistray.report.output.draw`; colour pictures stand in the
        report if they are among these.
    per_wavelength : bool
        Add the paths and the ledgers at each wavelength.

    Returns
    -------
    Path
        The file written.
    """
    return replace_file(path, html_text(report, title, command, pictures, per_wavelength), "report")


def html_text(
    report: GhostReport,
    title: str = "scene",
    command: str = "",
    pictures: Mapping[str, bytes] | None = None,
    per_wavelength: bool = False,
) -> str:
    """The report as HTML text; see `write_html`."""
    pictures = pictures or {}
    for field in report:
        mapped_paths(report, field)  # first of all: the maps of the summaries come from the same run of the rays
    settings = next(iter(report.values())).settings
    summaries = [report.summary(field) for field in report]
    fields = [page_data(report.scene), *(field_section(report, s, pictures, per_wavelength) for s in summaries)]
    with_coatings = bool(report.nominal_trace.tables)
    sections = [
        _head(report, title, settings, summaries),
        _summary(report, summaries, per_wavelength),
        _pictures(report, pictures),
        section("fields", "Field by field", "".join(fields)),
        section("energy", "Energy ledger", energy_ledger(report, per_wavelength)),
        *([section("scatter", "Scattered light", scatter_ledger(report))] if report.scatters else []),
        section("surfaces", "Flux at every surface", surface_ledger(report, per_wavelength)),
        *([section("coatings", "Coatings and surfaces", coatings(report))] if with_coatings else []),
        section("settings", "Assumptions, definitions and settings", _settings(settings, report, command)),
    ]
    return page(f"Ghost analysis: {title}", sections, ("report", "hover", "explorer"))


def _head(report: GhostReport, title: str, settings: dict[str, Any], summaries: Sequence[FieldSummary]) -> str:
    fields = ", ".join(f"{field:g}" for field in report)
    lines = f"{', '.join(f'{wavelength:g}' for wavelength in report.wavelengths_nm)} nm"
    shares = [f"{100 * report.weight(wavelength):.3g}" for wavelength in report.wavelengths_nm]
    if len(shares) > 1:
        lines += f" with {', '.join(shares)} % of the flux" if len(set(shares)) > 1 else " in equal shares"
    most = settings["max_scatters"]
    scatters = f" and {most} scatter event{'' if most == 1 else 's'}" if report.scatters else ""
    traced = (
        f"Fields {fields}° at azimuth {setting_text(settings['azimuth_deg'])}°, {lines}, "
        f"{thousands(settings['rays'])} start rays at each field, up to {settings['max_reflections']} reflections"
        f"{scatters}."
    )
    found = warnings(report)
    box = ""
    if found:
        box = (
            '<div class="warnings"><b>Mind</b><ul>'
            + "".join(f"<li>{escape(text)}</li>" for text in found)
            + "</ul></div>"
        )
    links = (("summary", "Summary"), ("pictures", "Pictures"), ("fields", "Fields"), ("energy", "Energy"),
             *([("scatter", "Scatter")] if report.scatters else []), ("surfaces", "Surfaces"),
             *([("coatings", "Coatings")] if report.nominal_trace.tables else []),
             ("settings", "Settings"))  # fmt: skip
    nav = "".join(f'<a href="#{target}">{text}</a>' for target, text in links)
    return (
        f'<header><h1>Ghost analysis: {escape(title)}</h1><p class="sub">{escape(traced)}</p>'
        f"{_finding(report, summaries)}{box}<nav>{nav}</nav></header>"
    )


def _finding(report: GhostReport, summaries: Sequence[FieldSummary]) -> str:
    rated = [s for s in summaries if s.brightest is not None and math.isfinite(s.brightest_normalised.value)]
    if not rated:
        return "<p>No stray path reaches the detector.</p>"
    worst = max(rated, key=lambda s: s.brightest_normalised.value)
    row = report.top(worst.field_deg, 1, "rms").iloc[0]
    most = max(summaries, key=lambda s: s.stray_W.value)
    strongest = {s.field_deg: report.top(s.field_deg, 1, "power").iloc[0] for s in rated}
    at, strong = max(strongest.items(), key=lambda item: item[1].power_W)
    return (
        f"<p>Worst path by RMS irradiance: <b>{escape(row.label)}</b> ({escape(row.kind)}) at {worst.field_deg:g}°, "
        f"{with_error(worst.brightest_normalised)} of the on-axis image. "
        f"Strongest path by power: <b>{escape(strong.label)}</b> ({escape(strong.kind)}) at {at:g}°, "
        f"{with_error(Estimate(strong.power_W, strong.power_se_W))} W. "
        f"Most stray light: {with_error(most.stray_W)} W at {most.field_deg:g}°, "
        f"{with_error(most.stray_to_nominal)} of the power of the on-axis image.</p>"
    )


def _summary(report: GhostReport, summaries: Sequence[FieldSummary], per_wavelength: bool) -> str:
    kinds = [kind for kind in STRAY_KINDS if any(s.paths_of_kind[kind] for s in summaries)]
    header = [
        ("field", "deg"), ("paths", ""), ("direct image", "W"), ("stray light", "W"),
        *((f"of it {kind}", "W") for kind in kinds),
        ("stray/direct", ""), ("stray/nominal", ""), ("peak stray/peak nominal", ""), ("worst path", "normalised"),
    ]  # fmt: skip
    rows = []
    for s in summaries:
        field, numbers, worst = _summary_cells(s, kinds)
        rows.append([field, *numbers, number_cell(report.peak_to_nominal(s.field_deg)), worst])
    at_wavelengths = ""
    if per_wavelength:
        table = []
        for s in (report.summary(s.field_deg, line) for s in summaries for line in report.wavelengths_nm):
            field, numbers, worst = _summary_cells(s, kinds)
            table.append([field, cell(f"{s.wavelength_nm:g}"), *numbers, worst])
        at_wavelengths = (
            "<h3>At each wavelength</h3><p>Nominal and normalised: against the on-axis image at the same wavelength."
            f"</p>{data_table('t-summary-waves', [header[0], ('λ', 'nm'), *header[1:-2], header[-1]], table)}"
        )
    nominal = report.nominal
    text = (
        f"Nominal image (on axis, direct): {with_error(nominal.power_W)} W, "
        f"RMS radius {with_error(nominal.rms_radius_mm)} mm, "
        f"RMS irradiance {with_error(nominal.rms_irradiance_W_mm2)} W/mm²."
    )
    return section("summary", "Summary", f"<p>{text}</p>{data_table('t-summary', header, rows)}{at_wavelengths}")


def _summary_cells(s: FieldSummary, kinds: Sequence[str]) -> tuple[str, list[str], str]:
    """Cells of one row of the summary: the field, the numbers, the worst path."""
    numbers = [
        cell(str(s.paths)),
        number_cell(s.direct.power_W if s.direct.power_W.value > 0 else UNKNOWN),
        number_cell(s.stray_W),
        *(number_cell(s.stray_of_kind_W[kind]) if s.paths_of_kind[kind] else cell(ABSENT) for kind in kinds),
        number_cell(s.ghost_to_signal),
        number_cell(s.stray_to_nominal),
    ]
    return cell(f"{s.field_deg:g}"), numbers, number_cell(s.brightest_normalised)


def _pictures(report: GhostReport, pictures: Mapping[str, bytes]) -> str:
    overview = pictures.get("overview.png") or as_png(montage(report))
    parts = [
        figure(
            image(overview, "ghost images of all fields"),
            "Irradiance on the detector at every field, all light, one log10 scale.",
        ),
        _levels(report),
    ]
    return section("pictures", "Pictures", "".join(parts))


def _levels(report: GhostReport) -> str:
    """Power against field angle, with its values for the pointer."""
    drawn, fields = levels_against_field(report), sorted(report)
    values = []
    for s in (report.summary(field) for field in fields):
        powers = {"direct image": s.direct.power_W, "stray light": s.stray_W}
        powers |= {kind: s.stray_of_kind_W[kind] for kind in STRAY_KINDS if s.paths_of_kind[kind]}
        shown = [(name, f"{with_error(power)} W" if power.value > 0 else ABSENT) for name, power in powers.items()]
        values.append([*shown, ("worst path, normalised", with_error(s.brightest_normalised))])
    titles = [f"field {field:g}°" for field in fields]
    caption = "Power by kind of light, and the ten worst stray paths at every field."
    return hover_figure("data-levels", drawn, drawn.axes[0], fields, titles, values, caption)


def _settings(settings: dict[str, Any], report: GhostReport, command: str) -> str:
    polarization = POLARIZATION[settings["polarization"]]
    scatter = SCATTERED.format(**settings) if report.scatters else SPECULAR
    texts = [text.format(polarization=polarization, scatter=scatter) for text in ASSUMPTIONS]
    assumptions = "".join(f"<li>{escape(text)}</li>" for text in texts)
    definitions = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in DEFINITIONS)
    shown = {key: value for key, value in settings.items() if key not in ("field_deg", "versions")}
    shown["field_deg"] = ", ".join(f"{field:g}" for field in report)
    shown |= {f"version of {name}": version for name, version in dict(settings.get("versions") or {}).items()}
    pairs = ((escape(str(key)), escape(setting_text(value))) for key, value in shown.items())
    items = "".join(f"<dt>{key}</dt><dd>{value}</dd>" for key, value in pairs)
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return (
        f'<h3>Assumptions</h3><ul>{assumptions}</ul><h3>Definitions</h3><dl class="settings">{definitions}</dl>'
        f'<h3>Settings</h3><dl class="settings">{items}</dl>{ran}'
    )
