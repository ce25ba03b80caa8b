"""Sweep as printed text, JSON values, tables and a report page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mistray.analyses.sweep.result import CELL, Sweep
from mistray.files.json_values import plain
from mistray.toolkit.pages.model import FigurePart, NotePart, Report, Section, Table, columns
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section, terms, version_settings
from mistray.toolkit.tables.frames import chosen
from mistray.toolkit.tables.text import ABSENT, number, table_text
from mistray.trace.host.polarization_choice import words_of

SHOWN = {
    "configuration": "<configuration",
    "field_deg": "field [deg]",
    "wavelength_nm": "wavelength [nm]",
    "direct_W": "direct [W absorbed]",
    "stray_W": "stray [W absorbed]",
    "ghost_to_signal": "stray/direct",
    "direct_rms_radius_mm": "RMS radius [mm]",
    "worst_path": "<brightest stray path",
    "worst_rms_irradiance_W_mm2": "its RMS irradiance [W/mm²]",
}
CAPTION = "Stray light and direct image over the launched power, with standard errors."


def rows_table(result: Sweep) -> Table:
    """Return a table with a row for each configuration, wavelength (nm) and field angle (degrees)."""
    found = chosen(pd.DataFrame(result.rows).fillna({"worst_path": ABSENT}), SHOWN, "t-rows")
    return replace(found, filter=("filter rows", "filter rows"))


def text(result: Sweep) -> str:
    """Return the text that `mistray sweep` prints: a row for each configuration, wavelength and field, and notes."""
    opened = [f"warning: {text}" for text in result.opened]
    return "\n".join([table_text(rows_table(result)), "", *polarization_lines(result), *opened, cache_line(result)])


def polarization_lines(result: Sweep) -> list[str]:
    """Return a line for each polarisation mode: its number of rows, and the reason for it in the most affected row."""
    found = []
    for mode in dict.fromkeys(row["polarization"] for row in result.rows):
        rows = [row for row in result.rows if row["polarization"] == mode]
        worst = max(rows, key=lambda row: np.nan_to_num(abs(row["polarization_change"])))
        many = "" if len(rows) == len(result.rows) else f"{len(rows)} of {len(result.rows)} rows: "
        found.append(f"{many}{words_of(worst)}")
    return found


def cache_line(result: Sweep) -> str:
    """Return a line of text on the number of rows and how many of them came from the cache."""
    if result.cache_folder is None:
        return f"{len(result)} rows, all traced"
    return f"{len(result)} rows, {result.reused} of them from the cache in {result.cache_folder}"


def values_text(result: Sweep, configuration: str, most: int = 4) -> str:
    """Return the values that a configuration sets as one line; for more than `most` parameters only their number."""
    (one,) = (one for one in result.configurations if one.name == configuration)
    if not one.values:
        return "the scene as it is"
    shown = [
        f"{key} = {', '.join(number(value) for value in numbers)} {one.units.get(key, '').removesuffix('1')}".rstrip()
        for key, numbers in list(one.values.items())[:most]
    ]
    return "; ".join(shown) + (f"; and {len(one.values) - most} more" if len(one.values) > most else "")


def record(result: Sweep) -> dict[str, Any]:
    """Return the complete result of a sweep as JSON-serialisable values; rows that were not traced have no numbers."""
    rows = [{**result.shown(row), "entering": result.entering(*(row[key] for key in CELL))} for row in result.rows]
    rows += [dict.fromkeys(rows[0]) | dict(zip(CELL, cell, strict=True)) for cell in result.not_traced]
    record = {
        "configurations": [
            {
                "name": one.name,
                "values": [
                    {"key": key, "unit": one.units.get(key), "value": float(value)}
                    for key, numbers in one.values.items()
                    for value in numbers
                ],
            }
            for one in result.configurations
        ],
        "rows": rows,
        "gaps": {name: gaps for name, gaps in result.gaps.items() if gaps},
        "settings": result.arguments,
        "cache": None if result.cache_folder is None else str(result.cache_folder),
        "rows_from_cache": result.reused,
        "warnings": [*result.opened, *result.warnings],
    }
    return dict(plain(record))


def sweep_tables(result: Sweep) -> dict[str, pd.DataFrame]:
    """Return the tables of a sweep by file name."""
    return {"sweep.csv": result.to_pandas(), "configurations.csv": result.values()}


def page(result: Sweep, title: str = "scene", command: str = "") -> Report:
    """
    Return the report of a sweep.

    `title` is the name of the optical system, `command` the command line that made it.
    """
    from mistray.analyses.sweep.figures import sweep_figure
    from mistray.toolkit.figures.plots import as_png

    picture = as_png(sweep_figure(result, title))
    counts = (len(result.configurations), len(result.field_deg), len(result.wavelengths_nm))
    size = "{} configurations, {} fields, {} wavelengths".format(*counts)
    named = [[one.name, values_text(result, one.name, most=len(one.values))] for one in result.configurations]
    configurations = Table(columns("<name", "<what it sets"), named, "t-configurations", sortable=False)
    return Report(
        "Sweep",
        title,
        [
            Section(
                "rows", "Fields, wavelengths and configurations", [FigurePart(picture, CAPTION), rows_table(result)]
            ),
            Section("configurations", "Configurations", [configurations]),
            settings_section({**result.arguments, **version_settings()}, command, terms("sweep")),
        ],
        lead=[NotePart(f"{size}: {cache_line(result)}."), *map(NotePart, polarization_lines(result))],
        warnings=[*result.opened, *result.warnings],
        csv=sweep_tables(result),
        json={"sweep.json": record(result)},
        result=result,
        files={"sweep.png": picture},
    )


def write_sweep(result: Sweep, directory: str | Path, title: str = "scene", command: str = "") -> list[Path]:
    """
    Write sweep.csv, configurations.csv, sweep.json, sweep.png and report.html, all or none of them.

    `page` documents `title` and `command`. Returns the files written; report.html is the last.
    """
    return write_report(page(result, title, command), directory)
