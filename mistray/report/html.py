"""One self-contained report.html: style, script and pictures inside, nothing from the network."""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from mistray.analysis.estimate import Estimate
from mistray.analysis.ghosts import FEWEST_RAYS, KINDS, MAPPED_PATHS, FieldSummary, GhostReport
from mistray.report.layout import layout
from mistray.report.plots import as_png, as_svg, common_range, ghost_image, levels_against_field, montage, thumbnail
from mistray.report.tables import ABSENT, number, warnings, with_error

ROWS_SHOWN = 60  # the worst paths by RMS irradiance
STRONGEST_SHOWN = 10  # and by power
PATH_NUMBERS = (
    ("power", "W", "power_W", "power_se_W"),
    ("of detected", "%", "percent", "percent_se"),
    ("x", "mm", "x_mm", "x_se_mm"),
    ("y", "mm", "y_mm", "y_se_mm"),
    ("RMS radius", "mm", "rms_radius_mm", "rms_radius_se_mm"),
    ("RMS irradiance", "W/mm²", "rms_irradiance_W_mm2", "rms_irradiance_se_W_mm2"),
    ("normalised", "", "normalised_rms_irradiance", "normalised_rms_irradiance_se"),
)

ASSUMPTIONS = (
    "Geometric optics: rays are straight lines between surfaces; no diffraction, and paths add without interference.",
    "Specular light only: reflection and refraction at ideal surfaces, no scatter. Structure reflects specularly with "
    "the reflectance that the scene gives it.",
    "Unpolarised light at every surface; the coatings are those of the scene, bare surfaces follow Fresnel.",
    "A source at infinity: one collimated beam for each field angle, with the irradiance that the scene states.",
)
DEFINITIONS = (
    ("power", "flux that the detector absorbs; the incident flux is in paths.csv"),
    ("RMS radius", "root of the mean square distance of a path's rays from their centroid, weighted by flux"),
    ("RMS irradiance", "P / (π r_rms²): power of the path over the disc of its RMS radius"),
    ("normalised", "RMS irradiance of the path over that of the direct image on axis (field 0°)"),
    ("stray light", "everything that reaches the detector and is not the direct image"),
    ("stray/direct", "stray power over the power of the direct image at the same field; – where there is none"),
    ("stray/nominal", "stray power over the power of the direct image on axis"),
    ("peak stray/peak nominal", "brightest pixel of the stray light over that of the on-axis image; depends on the "
     "pixel size"),
    ("ghost surfaces", "surfaces where the path was reflected, in the order of the light; structure counts, the "
     "mirrors of the design path do not"),
    ("path", "T transmitted, R reflected, I totally internally reflected, A absorbed; open it for the surfaces"),
    ("± ", "one standard error; errors of sums are upper bounds, because the paths of one run share their start rays"),
)  # fmt: skip


def write_html(
    report: GhostReport,
    path: str | Path,
    title: str = "scene",
    command: str = "",
    pictures: Mapping[str, bytes] | None = None,
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
        PNG files that were drawn already, by name, as from `mistray.report.output.draw`.

    Returns
    -------
    Path
        The file written.
    """
    path = Path(path)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        draft.write_text(html_text(report, title, command, pictures), encoding="utf-8")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path


def html_text(
    report: GhostReport, title: str = "scene", command: str = "", pictures: Mapping[str, bytes] | None = None
) -> str:
    """The report as HTML text; see `write_html`."""
    pictures = pictures or {}
    settings = next(iter(report.values())).settings
    summaries = [report.summary(field) for field in report]
    sections = [
        _head(report, title, settings, summaries),
        _summary(report, summaries),
        _pictures(report, pictures),
        _section("fields", "Field by field", "".join(_field(report, s, pictures) for s in summaries)),
        _section("energy", "Energy ledger", _energy(report)),
        _section("surfaces", "Flux at every surface", _surfaces(report)),
        _section("settings", "Assumptions, definitions and settings", _settings(settings, report, command)),
    ]
    resources = files("mistray.report")
    css = resources.joinpath("report.css").read_text(encoding="utf-8")
    script = resources.joinpath("report.js").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Ghost analysis: {escape(title)}</title><style>\n{css}</style></head>\n<body>\n"
        + "\n".join(sections)
        + f"\n<script>\n{script}</script></body></html>\n"
    )


def _head(report: GhostReport, title: str, settings: dict[str, Any], summaries: Sequence[FieldSummary]) -> str:
    fields = ", ".join(f"{field:g}" for field in report)
    traced = (
        f"Fields {fields}° at azimuth {_value(settings['azimuth_deg'])}°, {_value(settings['wavelength_nm'])} nm, "
        f"{_count(settings['rays'])} start rays at each field, up to {settings['max_reflections']} reflections."
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
             ("surfaces", "Surfaces"), ("settings", "Settings"))  # fmt: skip
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
    row = report.top(worst.field_deg, 1).iloc[0]
    most = max(summaries, key=lambda s: s.stray_W.value)
    return (
        f"<p>Worst path by RMS irradiance: <b>{escape(row.label)}</b> ({escape(row.kind)}) at {worst.field_deg:g}°, "
        f"{with_error(worst.brightest_normalised)} of the on-axis image. "
        f"Most stray light: {with_error(most.stray_W)} W at {most.field_deg:g}°, "
        f"{with_error(most.stray_to_nominal)} of the power of the on-axis image.</p>"
    )


def _summary(report: GhostReport, summaries: Sequence[FieldSummary]) -> str:
    kinds = [kind for kind in KINDS if any(s.paths_of_kind[kind] for s in summaries)]
    header = [
        ("field", "deg"), ("paths", ""), ("direct image", "W"), ("stray light", "W"),
        *((f"of it {kind}", "W") for kind in kinds),
        ("stray/direct", ""), ("stray/nominal", ""), ("peak stray/peak nominal", ""), ("worst path", "normalised"),
    ]  # fmt: skip
    rows = [
        [
            _cell(f"{s.field_deg:g}"),
            _cell(str(s.paths)),
            _estimate(s.direct.power_W if s.direct.power_W.value > 0 else Estimate(math.nan, math.nan)),
            _estimate(s.stray_W),
            *(_estimate(s.stray_of_kind_W[kind]) if s.paths_of_kind[kind] else _cell(ABSENT) for kind in kinds),
            _estimate(s.ghost_to_signal),
            _estimate(s.stray_to_nominal),
            _estimate(report.peak_to_nominal(s.field_deg)),
            _estimate(s.brightest_normalised),
        ]
        for s in summaries
    ]
    nominal = report.nominal
    text = (
        f"Nominal image (on axis, direct): {with_error(nominal.power_W)} W, "
        f"RMS radius {with_error(nominal.rms_radius_mm)} mm, "
        f"RMS irradiance {with_error(nominal.rms_irradiance_W_mm2)} W/mm²."
    )
    return _section("summary", "Summary", f"<p>{text}</p>{_table('t-summary', header, rows)}")


def _pictures(report: GhostReport, pictures: Mapping[str, bytes]) -> str:
    overview = pictures.get("overview.png") or as_png(montage(report))
    levels = as_svg(levels_against_field(report))
    parts = [
        _figure(
            _image(overview, "ghost images of all fields"),
            "Irradiance on the detector at every field, all light, one log10 scale.",
        ),
        _figure(levels, "Power by kind of light, and the ten worst stray paths at every field."),
    ]
    return _section("pictures", "Pictures", "".join(parts))


def _field(report: GhostReport, s: FieldSummary, pictures: Mapping[str, bytes]) -> str:
    t = report[s.field_deg]
    m, stray = s.map, report.stray_statistics(s.field_deg)
    header = [
        ("map", "", "t"), ("min", "W/mm²"), ("max", "W/mm²"), ("average", "W/mm²"), ("RMS", "W/mm²"),
        ("total flux", "W"), ("incident rays", ""),
    ]  # fmt: skip
    block = [
        [
            _cell(name, "t"),
            _cell(number(v.minimum)),
            _estimate(Estimate(v.maximum, v.maximum_se)),
            _cell(number(v.mean)),
            _cell(number(v.rms)),
            _cell(number(v.flux_W)),
            _cell(f"{v.incident_rays}"),
        ]
        for name, v in (("all light", m), ("without the direct image", stray))
    ]
    kinds = ", ".join(f"{count} {kind}" for kind, count in s.paths_of_kind.items() if count)
    asymmetry = ""
    if math.isfinite(s.asymmetry) and float(t.settings.get("azimuth_deg") or 0.0) % 180 == 0:
        asymmetry = (
            f" Left-right asymmetry of the map {s.asymmetry:.2g}; noise alone gives {s.asymmetry_expected:.2g} "
            "in a system that is symmetric about the y-z plane."
        )
    text = (
        f"{s.paths} paths ({kinds}). Pixels {m.pixel_mm[0] * 1e3:.4g} × {m.pixel_mm[1] * 1e3:.4g} µm. "
        f"{_count(t.segments)} segments traced in {t.seconds:.2f} s.{asymmetry}"
    )
    image = pictures.get(f"ghosts_{s.field_deg:g}deg.png") or as_png(
        ghost_image(report, s.field_deg, common_range(report))
    )
    anchor = f"field-{s.field_deg:g}".replace(".", "_")
    return (
        f'<h3 id="{anchor}">Field {s.field_deg:g}°</h3><p>{text}</p>'
        + _figure(_image(image, f"irradiance on the detector, field {s.field_deg:g}°"))
        + _table(f"t-map-{anchor}", header, block, sortable=False)
        + _figure(as_svg(layout(report, s.field_deg)))
        + _ghosts(report, s.field_deg, anchor)
    )


def _ghosts(report: GhostReport, field_deg: float, anchor: str) -> str:
    table = report.table(field_deg).sort_values("rank_rms_irradiance")
    shown = table[(table.rank_rms_irradiance <= ROWS_SHOWN) | (table.rank_power <= STRONGEST_SHOWN)]
    colours = table.wavelength_nm.nunique() > 1
    header = [
        ("image", ""), ("path", "no."), ("1st → 2nd ghost surface", "", "t"), ("kind", "", "t"),
        *([("λ", "nm")] if colours else []), ("rays", ""),
        *((text, unit) for text, unit, _, _ in PATH_NUMBERS),
        ("rank", "RMS irr."), ("rank", "power"), ("path", "T R I A", "t"),
    ]  # fmt: skip
    pictured = set(report.top(field_deg, MAPPED_PATHS).path_id)
    rows = []
    for row in shown.itertuples(index=False):
        ranks = (row.rank_rms_irradiance, row.rank_power)
        rows.append(
            [
                f"<td>{_thumbnail(report, field_deg, row) if row.path_id in pictured else ''}</td>",
                _cell(str(row.path_id)),
                _cell(str(row.label) + ("" if row.well_sampled else " *"), "t"),
                _cell(str(row.kind), "t"),
                *([_cell(f"{row.wavelength_nm:g}")] if colours else []),
                _cell(str(row.rays)),
                *(_estimate(Estimate(getattr(row, value), getattr(row, se))) for _, _, value, se in PATH_NUMBERS),
                *(_cell(str(rank) if rank else ABSENT) for rank in ranks),
                f'<td class="path m"><details><summary>{row.path}</summary>{escape(row.events)}</details></td>',
            ]
        )
    left_out = len(table) - len(rows)
    notes = []
    if left_out > 0:
        notes.append(f"{left_out} more paths are in paths.csv.")
    if not shown.well_sampled.all():
        notes.append(f"* fewer than {FEWEST_RAYS} rays: RMS radius and irradiance are unreliable, ranked last.")
    name = f"t-{anchor}"
    return (
        f'<p><input class="filter" data-table="{name}" placeholder="filter rows, for example: detector window" '
        f'aria-label="filter the paths of field {field_deg:g}°"></p>'
        + _table(name, header, rows)
        + (f'<p class="note">{" ".join(notes)}</p>' if notes else "")
    )


def _thumbnail(report: GhostReport, field_deg: float, row: Any) -> str:
    image, _ = report.map(field_deg, row.path_id)
    figure, width, limits = thumbnail(image, report[field_deg].extent, (row.x_mm, row.y_mm), row.rms_radius_mm)
    scale = f"log10 scale 1e{limits[0]:g} to 1e{limits[1]:g} W/mm²" if limits else "dark"
    return f"{_image(as_png(figure), f'irradiance of path {row.path_id}', scale)}<small>{width:.2g} mm wide</small>"


def _energy(report: GhostReport) -> str:
    fields = list(report)
    energies = [report[field].energy for field in fields]
    header = [("entry", "", "t"), ("where", "", "t"), *((f"{field:g}°", "W") for field in fields)]

    def row(entry: str, where: str, cells: Iterable[str]) -> list[str]:
        return [_cell(entry, "t"), _cell(where, "t"), *cells]

    rows = [
        row("launched", "source", (_cell(number(e.launched_W, 7)) for e in energies)),
        row("detected", "detector", (_estimate(Estimate(e.detected_W, e.detected_se_W)) for e in energies)),
    ]
    names = dict.fromkeys(name for e in energies for name in e.absorbed)
    strongest = sorted(names, key=lambda name: -max(e.absorbed.get(name, (0.0, 0.0))[0] for e in energies))
    for name in strongest:
        pairs = [e.absorbed.get(name, (0.0, 0.0)) for e in energies]
        if any(power > 0 for power, _ in pairs):
            rows.append(row("absorbed", name, (_estimate(Estimate(*pair)) for pair in pairs)))
    rows.append(
        row("escaped", "out of the scene", (_estimate(Estimate(e.escaped_W, e.escaped_se_W)) for e in energies))
    )
    for reason in dict.fromkeys(reason for e in energies for reason in e.cut):
        rows.append(row("cut", reason, (_cell(number(e.cut.get(reason, 0.0), 3)) for e in energies)))
    rows.append(row("closure", "relative", (_cell(f"{e.closure:.1e}") for e in energies)))
    text = (
        "launched = detected + absorbed + escaped + cut. The closure is what is missing, relative to the launched "
        "flux. Cut: light that a limit of the trace left out."
    )
    return f"<p>{text}</p>{_table('t-energy', header, rows, sortable=False)}"


def _surfaces(report: GhostReport) -> str:
    header = [
        ("field", "deg"), ("surface", "", "t"), ("part", "", "t"), ("space", ""), ("hits", ""), ("incident", "W"),
        ("absorbed", "W"),
    ]  # fmt: skip
    rows = []
    for field in report:
        for s in report[field].surfaces.to_pandas().itertuples(index=False):
            if s.hits > 0:
                rows.append(
                    [
                        _cell(f"{field:g}"),
                        _cell(str(s.id), "t"),
                        _cell(str(s.part), "t"),
                        _cell(str(s.space) if s.space >= 0 else ABSENT),
                        _cell(str(int(s.hits))),
                        _estimate(Estimate(s.incident_W, s.incident_se_W)),
                        _estimate(Estimate(s.absorbed_W, s.absorbed_se_W)),
                    ]
                )
    name = "t-surfaces"
    return (
        "<p>Flux that arrives at and stays in each surface, all paths together; light that comes back is counted "
        "again. Surfaces that no ray met are left out.</p>"
        f'<details><summary>{len(rows)} rows</summary><p><input class="filter" data-table="{name}" '
        f'placeholder="filter rows" aria-label="filter the surfaces"></p>{_table(name, header, rows)}</details>'
    )


def _settings(settings: dict[str, Any], report: GhostReport, command: str) -> str:
    assumptions = "".join(f"<li>{escape(text)}</li>" for text in ASSUMPTIONS)
    definitions = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in DEFINITIONS)
    shown = {key: value for key, value in settings.items() if key not in ("field_deg", "versions")}
    shown["fields_deg"] = ", ".join(f"{field:g}" for field in report)
    shown |= {f"version of {name}": version for name, version in dict(settings.get("versions") or {}).items()}
    items = "".join(f"<dt>{escape(str(key))}</dt><dd>{escape(_value(value))}</dd>" for key, value in shown.items())
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return (
        f'<h3>Assumptions</h3><ul>{assumptions}</ul><h3>Definitions</h3><dl class="settings">{definitions}</dl>'
        f'<h3>Settings</h3><dl class="settings">{items}</dl>{ran}'
    )


def _section(anchor: str, title: str, body: str) -> str:
    return f'<section><h2 id="{anchor}">{title}</h2>{body}</section>'


def _table(name: str, header: Sequence[tuple[str, ...]], rows: Sequence[Sequence[str]], sortable: bool = True) -> str:
    """Table from header entries (text, unit[, class]) and rows of finished cells."""
    heads = []
    for text, unit, *kind in header:
        style = f' class="{kind[0]}"' if kind else ""
        below = f"<small>{escape(unit)}</small>" if unit else ""
        heads.append(f'<th scope="col"{style}>{escape(text)}{below}</th>')
    body = "".join(f"<tr>{''.join(row)}</tr>\n" for row in rows)
    kind_of_table = ' class="sortable"' if sortable else ""
    return (
        f'<div class="wide"><table id="{name}"{kind_of_table}><thead><tr>{"".join(heads)}</tr></thead>'
        f"<tbody>\n{body}</tbody></table></div>"
    )


def _cell(text: str, kind: str = "") -> str:
    return f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>"


def _estimate(estimate: Estimate) -> str:
    """A cell that shows the value, below it the error, and sorts by the value."""
    if not math.isfinite(estimate.value):
        return _cell(ABSENT)
    value, _, error = with_error(estimate).partition(" ± ")
    return f'<td data-v="{estimate.value:.9g}">{value}<small>± {error}</small></td>'


def _figure(content: str, caption: str = "") -> str:
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{content}{below}</figure>"


def _image(png: bytes, text: str, title: str = "") -> str:
    """An <img> that holds the picture itself."""
    hover = f' title="{escape(title)}"' if title else ""
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}" alt="{escape(text)}"{hover}>'


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return ", ".join(_value(item) for item in value)
    return "–" if value is None else str(value)


def _count(value: Any) -> str:
    return f"{int(value):,}".replace(",", " ") if value is not None else ABSENT
