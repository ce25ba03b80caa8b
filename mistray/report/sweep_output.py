"""What a sweep leaves behind in a folder."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from mistray.report.figures.plots import as_png
from mistray.report.figures.sweep import sweep_figure
from mistray.report.html.sweep import sweep_html
from mistray.report.output import csv_text, write_files
from mistray.report.tables.sweep import sweep_record
from mistray.sweeps import Sweep


def sweep_tables(result: Sweep) -> dict[str, pd.DataFrame]:
    """The tables of a sweep, by the names of their files."""
    return {"sweep.csv": result.to_pandas(), "configurations.csv": result.values()}


def write_sweep(result: Sweep, directory: str | Path, title: str = "scene", command: str = "") -> list[Path]:
    """
    Write sweep.csv, configurations.csv, sweep.json, sweep.png and report.html, each whole or not at all.

    Parameters
    ----------
    result : Sweep
    directory : str or Path
        Made if it is missing.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written; report.html is the last.
    """
    picture = as_png(sweep_figure(result, title))
    files: dict[str, str | bytes] = {name: csv_text(table) for name, table in sweep_tables(result).items()}
    files["sweep.json"] = json.dumps(sweep_record(result), indent=2, allow_nan=False) + "\n"
    files["sweep.png"] = picture
    files["report.html"] = sweep_html(result, picture, title, command)
    return write_files(files, directory)
