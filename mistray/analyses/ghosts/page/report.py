"""Report of a ghost analysis as a self-contained page, with style, script and pictures inside."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mistray.analyses.ghosts.figures.ghost_images import levels_against_field, montage
from mistray.analyses.ghosts.page.answer import answer, worst_table
from mistray.analyses.ghosts.page.fields import field_section, mapped_paths
from mistray.analyses.ghosts.page.ledgers import coatings, energy_ledger, surface_ledger
from mistray.analyses.ghosts.page.optional import optional_sections
from mistray.analyses.ghosts.page.path_explorer import page_data
from mistray.analyses.ghosts.page.scatter import scatter_ledger
from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.tables.ghosts_csv import summary_rows
from mistray.analyses.ghosts.tables.printed import more_rays, summary_table
from mistray.estimate import UNKNOWN, Estimate
from mistray.ranges import ByName, OfType
from mistray.recorders.path_events import STRAY_KINDS
from mistray.replace_file import replace_file
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import (
    FigurePart,
    Folded,
    Hover,
    NotePart,
    PagePart,
    Report,
    Section,
)
from mistray.toolkit.pages.parts import setting_text, settings_section, terms, thousands
from mistray.toolkit.pages.render import html_page
from mistray.toolkit.tables.frames import flat
from mistray.toolkit.tables.text import ABSENT, with_error

ASSUMPTIONS = (
    "Geometric optics: rays are straight lines between surfaces; no diffraction, and paths add without interference.",
    "{scatter}",
    "Structure reflects specularly with the reflectance that the scene gives it.",
    "{polarization}; the coatings are those of the scene, bare surfaces follow Fresnel.",
    "A source at infinity: one collimated beam for each field angle, with the irradiance that the scene states.",
)
UNPOLARIZED = "Unpolarised light at every surface, R and T are the means of s and p at every hit"
STOKES = "Polarisation is carried along every path as a Stokes vector; the light of the source is {state}"
SPECULAR = "Specular light only: reflection and refraction at smooth surfaces; no scattered light reaches the detector."
SCATTERED = (
    "Surfaces scatter by the models that the scene gives them, up to {max_scatters} times along a path. Scattered "
    "light is unpolarised. Aimed rays and random ones share the flux by weights, so that their sum is right on average."
)


OVERVIEW = "Stray light on the detector at every field, without the direct image. Each map has its own log10 scale."
UNDRAWN = "in the tables alone, for the time was up before they were drawn"
ON_ONE_SCALE = "The same on one scale"
FIELDS = "On a screen, open a field for its paths, their maps and rays, and for what lights a spot of the detector."
LEVELS = "Power by kind of light, and the ten worst stray paths at every field."
AT_WAVELENGTHS = "Nominal and normalised: against the on-axis image at the same wavelength."


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
        Ghost analysis.
    path : str or Path
        File to write; it appears complete or not at all.
    title : str
        Name of the optical system.
    command : str
        Command line that made the report, quoted so that it can be repeated.
    pictures : mapping of str to bytes, optional
        PNG bytes of pictures drawn earlier, by file name, as from `mistray.analyses.ghosts.page.output.draw`.
        Colour pictures appear in the report only if given here.
    per_wavelength : bool
        Add the paths and the ledgers at each wavelength.

    Returns
    -------
    Path
        File written.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> mistray.report.write_html(report, "report.html", title="Cooke triplet").name
    'report.html'
    """
    return replace_file(path, html_text(report, title, command, pictures, per_wavelength), "report")


def html_text(
    report: GhostReport,
    title: str = "scene",
    command: str = "",
    pictures: Mapping[str, bytes] | None = None,
    per_wavelength: bool = False,
) -> str:
    """
    Return the report as the text of an HTML file; for the arguments see `write_html`.

    Examples
    --------
    >>> report = mistray.ghosts(mistray.load("cooke_triplet"), [0, 10], rays=10_000)
    >>> text = mistray.report.html_text(report, title="Cooke triplet")
    >>> text[:15]
    '<!DOCTYPE html>'
    """
    ByName(OfType(bytes, "must be the bytes of a PNG"), "{'layout.png': b'…'}").check_all("", pictures=pictures)
    return html_page(ghosts_report(report, title, command, pictures or {}, per_wavelength))


def ghosts_report(
    report: GhostReport,
    title: str,
    command: str,
    pictures: Mapping[str, bytes],
    per_wavelength: bool,
    shown: GhostReport | None = None,
) -> Report:
    """
    Return the report, see `write_html`; fields in `shown`, by default all, get maps and a section.

    With `per_wavelength` tables at each wavelength are added.
    """
    shown = report if shown is None else shown
    for field in shown:
        mapped_paths(report, field)  # first of all: the maps of the summaries come from the same run of the rays
    summaries = [report.summary(field) for field in report]
    drawn = (s for s in summaries if s.field_deg in shown)
    fields = [NotePart(FIELDS), page_data(shown), *(field_section(report, s, pictures, per_wavelength) for s in drawn)]
    sections = [
        Section("worst", "The worst paths of all fields", worst_table(report, shown), "Worst paths"),
        Section("pictures", "Pictures", _pictures(report, shown, pictures), "Pictures"),
        Section("summary", "Every field", _summary(report, shown, per_wavelength), "Summary"),
        *([Section("fields", "Field by field", fields, "Fields")] if shown else []),
        Section("energy", "Energy ledger", energy_ledger(report, per_wavelength), "Energy", "always"),
    ]
    if report.scatters:
        sections.append(Section("scatter", "Scattered light", scatter_ledger(report), "Scatter", "always"))
    flux = surface_ledger(report, per_wavelength)
    sections.append(Section("surfaces", "Flux at every surface", flux, "Surfaces", "always"))
    if report.nominal_trace.tables:
        sections.append(Section("coatings", "Coatings and surfaces", coatings(report), "Coatings", "always"))
    return Report(
        "Ghost analysis",
        title,
        [*sections, *optional_sections(report), _settings(report, command)],
        lead=[NotePart(_traced(report), "sub"), *answer(report, shown)],
        warnings=[*_undrawn(report, shown), *report.notes],
        scripts=("report", "hover", "drawing", "explorer"),
    )


def _traced(report: GhostReport) -> str:
    """Return a sentence on the fields (degrees), wavelengths (nm), rays and limits of the trace."""
    settings = report.settings
    fields = ", ".join(f"{field:g}" for field in report)
    lines = f"{', '.join(f'{wavelength:g}' for wavelength in report.wavelengths_nm)} nm"
    shares = [f"{100 * report.weight(wavelength):.3g}" for wavelength in report.wavelengths_nm]
    if len(shares) > 1:
        lines += f" with {', '.join(shares)} % of the flux" if len(set(shares)) > 1 else " in equal shares"
    most = settings["max_scatters"]
    scatters = f" and {most} scatter event{'' if most == 1 else 's'}" if report.scatters else ""
    return (
        f"Fields {fields}° at azimuth {setting_text(settings['azimuth_deg'])}°, {lines}, "
        f"{thousands(settings['rays'])} start rays at each field, up to {settings['max_reflections']} reflections"
        f"{'. '.join([scatters, *map(str.capitalize, more_rays(report))])}."
    )


def _undrawn(report: GhostReport, shown: GhostReport) -> list[str]:
    """Return a list with a warning that names the fields without pictures; empty if all have them."""
    missing = [f"{field:g}" for field in report if field not in shown]
    if not missing:
        return []
    return [f"{UNDRAWN}: {len(missing)} of {len(report)} fields ({', '.join(missing)} deg)"]


def _summary(report: GhostReport, shown: GhostReport, per_wavelength: bool) -> list[PagePart]:
    """
    Return the statistics of every field as page parts; fields in `shown` also have their peak irradiance.

    With `per_wavelength` the statistics at each wavelength are added.
    """
    nominal = report.nominal
    text = (
        f"Nominal image (on axis, direct): {with_error(nominal.power_W)} W absorbed, "
        f"RMS radius {with_error(nominal.rms_radius_mm)} mm, "
        f"RMS irradiance {with_error(nominal.rms_irradiance_W_mm2)} W/mm²."
    )
    of_all = [row | flat({"peak_to_nominal": _peak(shown, row["field_deg"])}) for row in summary_rows(report, [None])]
    parts: list[PagePart] = [NotePart(text), summary_table(of_all, name="t-summary")]
    if per_wavelength:
        table = summary_table(summary_rows(report, report.wavelengths_nm), name="t-summary-waves")
        parts += [NotePart("At each wavelength", "h3"), NotePart(AT_WAVELENGTHS), table]
    return parts


def _peak(shown: GhostReport, field_deg: float) -> Estimate:
    return shown.peak_to_nominal(field_deg) if field_deg in shown else UNKNOWN


def _pictures(report: GhostReport, shown: GhostReport, pictures: Mapping[str, bytes]) -> list[PagePart]:
    """
    Return the pictures of the stray light of all fields and of the levels against field angle, as page parts.

    If no field was drawn, only the levels are there.
    """
    if not shown:
        return [_levels(report)]
    own = pictures.get("overview.png") or as_png(montage(shown), of_maps=True)
    drawn: list[PagePart] = [FigurePart(own, OVERVIEW, "stray light on the detector at every field")]
    if len(shown) > 1:
        common = pictures.get("overview_common.png") or as_png(montage(shown, common=True), of_maps=True)
        told = "stray light on the detector at every field, on one scale"
        drawn.append(Folded(ON_ONE_SCALE, [FigurePart(common, text=told)]))
    return [*drawn, _levels(report)]


def _levels(report: GhostReport) -> FigurePart:
    """Return the figure of power, W, against field angle; the pointer shows the values."""
    fields = sorted(report)
    values = []
    for s in (report.summary(field) for field in fields):
        powers = {"direct image": s.direct.power_W, "stray light": s.stray_W}
        powers |= {kind: s.stray_of_kind_W[kind] for kind in STRAY_KINDS if s.paths_of_kind[kind]}
        shown = [
            (name, f"{with_error(power)} W absorbed" if power.value > 0 else ABSENT) for name, power in powers.items()
        ]
        values.append([*shown, ("worst path, normalised", with_error(s.brightest_normalised))])
    hover = Hover("data-levels", fields, [f"field {field:g}°" for field in fields], values)
    return FigurePart(functools.partial(levels_against_field, report), LEVELS, hover=hover)


def polarization_words(settings: Mapping[str, Any]) -> str:
    """Return a phrase on the polarisation of a trace's light, from its settings."""
    if settings["polarization"] != "stokes":
        return f"{UNPOLARIZED}: {settings['polarization_reason']}"
    states = settings.get("source_stokes") or {}
    words = [f"s1, s2, s3 = {', '.join(f'{s:g}' for s in state)} ({name})" for name, state in states.items()]
    state = "polarised, " + " and ".join(words) if words else "unpolarised"
    return f"{STOKES.format(state=state)}: {settings['polarization_reason']}"


def _settings(report: GhostReport, command: str) -> Section:
    settings = report.settings
    words = {
        "polarization": polarization_words(settings),
        "scatter": SCATTERED.format(**settings) if report.scatters else SPECULAR,
    }
    shown: dict[str, Any] = {key: value for key, value in settings.items() if key != "versions"}
    shown["field_deg"] = ", ".join(f"{field:g}" for field in report)
    shown |= {f"version of {name}": version for name, version in dict(settings.get("versions") or {}).items()}
    return settings_section(
        shown,
        command,
        terms("ghosts"),
        [text.format(**words) for text in ASSUMPTIONS],
        link="Settings",
        folded="screen",
    )
