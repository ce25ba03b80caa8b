"""A sweep as one self-contained report.html."""

from __future__ import annotations

from html import escape

from mistray.report.html.markup import (
    cell,
    data_table,
    figure,
    filter_box,
    image,
    number_cell,
    section,
    setting_text,
    version_settings,
)
from mistray.report.html.page import page
from mistray.report.tables.sweep import SHOWN, cache_line, values_text
from mistray.report.tables.text import ABSENT
from mistray.sweeps import Sweep
from mistray.sweeps.result import estimate_of

CAPTION = "Stray light and direct image over the launched power, with standard errors."
DEFINITIONS = (
    ("direct, stray", "power that the detector absorbs from the direct image, and from all other paths"),
    ("stray/direct", "at the same field; – where no direct light arrives"),
    ("RMS radius", "of the direct image about its centroid"),
    ("brightest stray path", "that of the highest RMS irradiance P/(π r²)"),
)


def sweep_html(result: Sweep, picture: bytes, title: str = "scene", command: str = "") -> str:
    """
    The report as HTML text.

    Parameters
    ----------
    result : Sweep
    picture : bytes
        PNG of `mistray.report.figures.sweep.sweep_figure`.
    title : str
        Name of the optical system.
    command : str
        The command line that made it.
    """
    warnings = "".join(f"<li>{escape(text)}</li>" for text in result.warnings)
    box = f'<div class="warnings"><b>Mind</b><ul>{warnings}</ul></div>' if warnings else ""
    size = f"{len(result.configurations)} configurations, {len(result.field_deg)} fields, "
    size += f"{len(result.wavelengths_nm)} wavelengths"
    drawn = figure(image(picture, CAPTION), CAPTION)
    sections = [
        f"<header><h1>Sweep: {escape(title)}</h1><p>{size}: {escape(cache_line(result))}.</p>{box}</header>",
        section("rows", "Fields, wavelengths and configurations", drawn + _rows(result)),
        section("configurations", "Configurations", _configurations(result)),
        section("settings", "Definitions and settings", _settings(result, command)),
    ]
    return page(f"Sweep: {title}", sections)


def _rows(result: Sweep) -> str:
    header = [("configuration", "", "t"), ("field", "deg"), ("wavelength", "nm")]
    header += [(head, unit) for _, head, unit in SHOWN]
    header.insert(-1, ("brightest stray path", "", "t"))
    rows = []
    for row in result.rows:
        cells = [cell(row["configuration"], "t"), cell(f"{row['field_deg']:g}"), cell(f"{row['wavelength_nm']:g}")]
        cells += [number_cell(estimate_of(row, name)) for name, _, _ in SHOWN]
        cells.insert(-1, cell(row["worst_path"] or ABSENT, "t"))
        rows.append(cells)
    return filter_box("t-rows", "filter rows", "filter rows") + data_table("t-rows", header, rows)


def _configurations(result: Sweep) -> str:
    rows = [
        [cell(one.name, "t"), cell(values_text(result, one.name, most=len(one.values)), "t")]
        for one in result.configurations
    ]
    return data_table("t-configurations", [("name", "", "t"), ("what it sets", "", "t")], rows, sortable=False)


def _settings(result: Sweep, command: str) -> str:
    terms = "".join(f"<dt>{escape(term)}</dt><dd>{escape(text)}</dd>" for term, text in DEFINITIONS)
    facts = {**result.arguments, **version_settings()}
    items = "".join(f"<dt>{escape(key)}</dt><dd>{escape(setting_text(value))}</dd>" for key, value in facts.items())
    ran = f"<h3>Command</h3><pre>{escape(command)}</pre>" if command else ""
    return (
        f'<h3>Definitions</h3><dl class="settings">{terms}</dl><h3>Settings</h3><dl class="settings">{items}</dl>{ran}'
    )
