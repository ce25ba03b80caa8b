"""One field angle in the HTML report: its pictures, its map and its paths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any

import pandas as pd

from mistray.analysis.estimate import Estimate
from mistray.analysis.ghosts import MAPPED_PATHS, FieldSummary, GhostReport
from mistray.analysis.ranking import FEWEST_RAYS
from mistray.report.layout import layout
from mistray.report.markup import cell, data_table, figure, filter_box, image, number_cell, thousands
from mistray.report.plots import as_png, as_svg, common_range, ghost_image, thumbnail
from mistray.report.text import ABSENT, number

ROWS_SHOWN = 60  # the worst paths by RMS irradiance
STRONGEST_SHOWN = 10  # and by power
AT_WAVELENGTHS = (
    "Normalised to the on-axis image at the same wavelength. Of all light: at all wavelengths; of stray light: at this "
    "one."
)
PATH_NUMBERS = (
    ("power", "W", "power_W", "power_se_W"),
    ("of all light", "%", "percent", "percent_se"),
    ("of stray light", "%", "percent_of_stray", "percent_of_stray_se"),
    ("x", "mm", "x_mm", "x_se_mm"),
    ("y", "mm", "y_mm", "y_se_mm"),
    ("RMS radius", "mm", "rms_radius_mm", "rms_radius_se_mm"),
    ("RMS irradiance", "W/mm²", "rms_irradiance_W_mm2", "rms_irradiance_se_W_mm2"),
    ("normalised", "", "normalised_rms_irradiance", "normalised_rms_irradiance_se"),
)


def field_section(report: GhostReport, s: FieldSummary, pictures: Mapping[str, bytes], per_wavelength: bool) -> str:
    """
    Pictures, statistics block and path table of one field.

    Parameters
    ----------
    report : GhostReport
    s : FieldSummary
        Of all light of this field.
    pictures : mapping of str to bytes
        PNG files by name, as from `mistray.report.output.draw`; what is missing is drawn, but for colour pictures.
    per_wavelength : bool
        Add the paths at each wavelength.
    """
    t = report[s.field_deg]
    m, stray = s.map, report.stray_statistics(s.field_deg)
    header = [
        ("map", "", "t"), ("min", "W/mm²"), ("max", "W/mm²"), ("average", "W/mm²"), ("RMS", "W/mm²"),
        ("total flux", "W"), ("incident rays", ""),
    ]  # fmt: skip
    block = [
        [
            cell(name, "t"),
            cell(number(v.minimum)),
            number_cell(Estimate(v.maximum, v.maximum_se)),
            cell(number(v.mean)),
            cell(number(v.rms)),
            cell(number(v.flux_W)),
            cell(f"{v.incident_rays}"),
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
        f"{thousands(t.segments)} segments traced in {t.seconds:.2f} s.{asymmetry}"
    )
    ghost_map = pictures.get(f"ghosts_{s.field_deg:g}deg.png") or as_png(
        ghost_image(report, s.field_deg, common_range(report))
    )
    colour = pictures.get(f"colour_{s.field_deg:g}deg.png")
    anchor = f"field-{s.field_deg:g}".replace(".", "_")
    return (
        f'<h3 id="{anchor}">Field {s.field_deg:g}°</h3><p>{text}</p>'
        + figure(image(ghost_map, f"irradiance on the detector, field {s.field_deg:g}°"))
        + (figure(image(colour, f"the detector in colour, field {s.field_deg:g}°")) if colour else "")
        + data_table(f"t-map-{anchor}", header, block, sortable=False)
        + figure(as_svg(layout(report, s.field_deg)))
        + _paths(report, s.field_deg, f"t-{anchor}")
        + (_paths_at_wavelengths(report, s.field_deg, f"t-waves-{anchor}") if per_wavelength else "")
    )


def _paths(report: GhostReport, field_deg: float, name: str) -> str:
    table = report.table(field_deg).sort_values("rank_rms_irradiance")
    shown = _shown(table)
    ranks = [("rank", "RMS irr."), ("rank", "power")]
    header = [("image", ""), *_header(shown, False), *ranks, ("path", "T R I t r A", "t")]
    pictured = set(report.top(field_deg, MAPPED_PATHS).path_id)
    rows = [
        [
            f"<td>{_thumbnail(report, field_deg, row) if row.path_id in pictured else ''}</td>",
            *_cells(row, shown, False),
            *(cell(str(rank) if rank else ABSENT) for rank in (row.rank_rms_irradiance, row.rank_power)),
            f'<td class="path m"><details><summary>{row.path}</summary>{escape(row.events)}</details></td>',
        ]
        for row in shown.itertuples(index=False)
    ]
    left_out = table[~table.path_id.isin(shown.path_id)]
    notes = []
    if len(left_out):
        share = f"{left_out.percent_of_stray.sum():.3g} % of the stray light"
        notes.append(f"{len(left_out)} more paths are in paths.csv; together they hold {share}.")
    if not shown.well_sampled.all():
        notes.append(f"* fewer than {FEWEST_RAYS} rays: RMS radius and irradiance are unreliable, ranked last.")
    return (
        filter_box(name, "filter rows, for example: detector window", f"filter the paths of field {field_deg:g}°")
        + data_table(name, header, rows)
        + (f'<p class="note">{" ".join(notes)}</p>' if notes else "")
    )


def _paths_at_wavelengths(report: GhostReport, field_deg: float, name: str) -> str:
    """The paths that `_paths` shows, at each of their wavelengths."""
    shown = _shown(report.table(field_deg).sort_values("rank_rms_irradiance"))
    rows = []
    for path_id in shown.path_id:
        spectrum = report.spectrum(field_deg, path_id)
        rows += [[cell(str(path_id)), *_cells(row, shown, True)[1:]] for row in spectrum.itertuples(index=False)]
    return (
        f"<details><summary>The same paths at each wavelength ({len(rows)} rows)</summary>"
        + filter_box(name, "filter rows, for example: detector window", f"filter the paths of field {field_deg:g}°")
        + data_table(name, _header(shown, True), rows)
        + f'<p class="note">{AT_WAVELENGTHS}</p></details>'
    )


def _shown(table: pd.DataFrame) -> pd.DataFrame:
    return table[(table.rank_rms_irradiance <= ROWS_SHOWN) | (table.rank_power <= STRONGEST_SHOWN)]


def _numbers(table: pd.DataFrame) -> list[tuple[str, str, str, str]]:
    """The numbers that a table of paths shows: text, unit, column and column of the error."""
    polarised = table.polarization.notna().any()
    return [*PATH_NUMBERS, *([("polarisation", "degree", "polarization", "polarization_se")] if polarised else [])]


def _header(table: pd.DataFrame, wavelength: bool) -> list[tuple[str, ...]]:
    return [
        ("path", "no."), ("1st → 2nd ghost surface, scatter", "", "t"), ("kind", "", "t"),
        *([("λ", "nm")] if wavelength else []), ("rays", ""), *((text, unit) for text, unit, _, _ in _numbers(table)),
    ]  # fmt: skip


def _cells(row: Any, table: pd.DataFrame, wavelength: bool) -> list[str]:
    return [
        cell(str(row.path_id)),
        cell(str(row.label) + ("" if row.well_sampled else " *"), "t"),
        cell(str(row.kind), "t"),
        *([cell(f"{row.wavelength_nm:g}")] if wavelength else []),
        cell(str(row.rays)),
        *(number_cell(Estimate(getattr(row, value), getattr(row, se))) for _, _, value, se in _numbers(table)),
    ]


def _thumbnail(report: GhostReport, field_deg: float, row: Any) -> str:
    irradiance, _ = report.map(field_deg, row.path_id)
    picture, width, limits = thumbnail(irradiance, report[field_deg].extent, (row.x_mm, row.y_mm), row.rms_radius_mm)
    scale = f"log10 scale 1e{limits[0]:g} to 1e{limits[1]:g} W/mm²" if limits else "dark"
    return f"{image(as_png(picture), f'irradiance of path {row.path_id}', scale)}<small>{width:.2g} mm wide</small>"
