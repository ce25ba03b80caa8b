"""Everything that a stray-light study writes, into one directory, each file complete or not at all."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd

from mistray.analysis.study.run import Study
from mistray.report.figures.layout import layout
from mistray.report.figures.objects import objects_layout
from mistray.report.figures.plots import as_png, levels_against_field, montage
from mistray.report.html.study import study_html
from mistray.report.output import csv_text, write_files


def draw_study(study: Study) -> dict[str, bytes]:
    """The pictures of a study as PNG by file name; see `mistray.report.html.study.CAPTIONS`."""
    report = study.ghosts
    on_axis = min(report, key=abs)
    pictures = {
        "layout.png": as_png(layout(report, on_axis, ghosts=0)),
        "objects.png": as_png(objects_layout(study.objects)),
        "ghost_images.png": as_png(montage(report)),
        "ghost_levels.png": as_png(levels_against_field(report)),
    }
    rated = {field: report.summary(field).brightest_normalised.value for field in report}
    rated = {field: value for field, value in rated.items() if math.isfinite(value)}
    if rated:
        pictures["worst_ghosts.png"] = as_png(layout(report, max(rated, key=lambda field: rated[field])))
    return pictures


def csv_tables(study: Study) -> dict[str, pd.DataFrame]:
    """Every table of every step by file name: the number of the step, and the name of the table."""
    return {f"{step.number}_{name}.csv": frame for step in study.steps for name, frame in step.tables.items()}


def write_study(study: Study, directory: str | Path, command: str = "") -> list[Path]:
    """
    Write report.html and every table of every step as CSV, named by step and table.

    All of them are made before the first is written. Files of the same names are replaced, others are left alone.

    Parameters
    ----------
    study : Study
    directory : str or Path
        Made if it is missing, with the directories above it.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written; report.html is the last.
    """
    files: dict[str, str | bytes] = {name: csv_text(frame) for name, frame in csv_tables(study).items()}
    files["report.html"] = study_html(study, draw_study(study), command)
    return write_files(files, directory)
