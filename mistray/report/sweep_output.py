"""What a sweep leaves behind in a folder."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from mistray.report.figures.plots import as_png
from mistray.report.figures.sweep import sweep_figure
from mistray.report.model import Figure, Note, Report, Section, Table, columns
from mistray.report.output import write_report
from mistray.report.parts import settings_section, terms, version_settings
from mistray.report.tables.sweep import cache_line, rows_table, sweep_record, values_text
from mistray.sweeps import Sweep

CAPTION = "Stray light and direct image over the launched power, with standard errors."


def sweep_tables(result: Sweep) -> dict[str, pd.DataFrame]:
    """The tables of a sweep, by the names of their files."""
    return {"sweep.csv": result.to_pandas(), "configurations.csv": result.values()}


def sweep_report(result: Sweep, title: str = "scene", command: str = "") -> Report:
    """The report of a sweep; `title` is the name of the optical system, `command` the command line that made it."""
    picture = as_png(sweep_figure(result, title))
    counts = (len(result.configurations), len(result.field_deg), len(result.wavelengths_nm))
    size = "{} configurations, {} fields, {} wavelengths".format(*counts)
    named = [[one.name, values_text(result, one.name, most=len(one.values))] for one in result.configurations]
    configurations = Table(columns("<name", "<what it sets"), named, "t-configurations", sortable=False)
    return Report(
        "Sweep",
        title,
        [
            Section("rows", "Fields, wavelengths and configurations", [Figure(picture, CAPTION), rows_table(result)]),
            Section("configurations", "Configurations", [configurations]),
            settings_section({**result.arguments, **version_settings()}, command, terms("sweep")),
        ],
        lead=[Note(f"{size}: {cache_line(result)}.")],
        warnings=result.warnings,
        csv=sweep_tables(result),
        json={"sweep.json": sweep_record(result)},
        files={"sweep.png": picture},
    )


def write_sweep(result: Sweep, directory: str | Path, title: str = "scene", command: str = "") -> list[Path]:
    """Write sweep.csv, configurations.csv, sweep.json, sweep.png and report.html, each whole or not at all.

    `sweep_report` says what `title` and `command` are. Returns the files written, of which report.html is the last.
    """
    return write_report(sweep_report(result, title, command), directory)
