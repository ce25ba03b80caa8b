"""Everything that `mistray objects` writes, into one directory, each file complete or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from mistray.analysis.objects.search import Objects
from mistray.report.figures.objects import objects_layout
from mistray.report.figures.plots import as_png
from mistray.report.html.objects import html_text
from mistray.report.output import csv_text, write_files
from mistray.report.tables.objects import csv_tables, objects_record


def write_objects(
    found: Objects, estimates: pd.DataFrame, directory: str | Path, title: str = "scene", command: str = ""
) -> list[Path]:
    """
    Write the tables of `csv_tables`, objects.png, objects.json and objects.html.

    Parameters
    ----------
    found : Objects
    estimates : DataFrame
        ``found.estimates()``.
    directory : str or Path
        Made if it is missing, with the directories above it; other files in it are left alone.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written.
    """
    png = as_png(objects_layout(found, title))
    record = {"title": title, "command": command} | objects_record(found, estimates)
    files: dict[str, str | bytes] = {name: csv_text(table) for name, table in csv_tables(found, estimates).items()}
    files["objects.png"] = png
    files["objects.json"] = json.dumps(record, indent=1, allow_nan=False)
    files["objects.html"] = html_text(found, estimates, png, title, command)
    return write_files(files, directory)
