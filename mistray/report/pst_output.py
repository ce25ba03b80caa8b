"""Everything that `mistray pst` writes, into one directory, each file complete or not at all."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from mistray.analysis.pst.result import Pst
from mistray.report.figures.plots import as_png
from mistray.report.figures.pst import pst_causes, pst_curve, pst_irradiance, pst_map
from mistray.report.html.pst import html_text
from mistray.report.output import csv_text, write_files
from mistray.report.tables.pst import cell_frame, curve_frame, path_frame, pst_record


def draw(pst: Pst, title: str = "", maps_at: Sequence[tuple[float, float]] = ()) -> dict[str, bytes]:
    """
    All pictures as PNG, by file name.

    Parameters
    ----------
    pst : Pst
    title : str
        Name of the optical system.
    maps_at : sequence of (float, float)
        Field angles and azimuths of the maps of the detector, degrees.

    Returns
    -------
    dict
        pst.png; pst_causes.png with a table of paths; pst_map.png with several azimuths; irradiance_<angle>deg.png, or
        irradiance_<angle>deg_<azimuth>deg.png with several azimuths, on one scale.
    """
    pictures = {"pst.png": as_png(pst_curve(pst, title))}
    if pst.path_rows is not None:
        pictures["pst_causes.png"] = as_png(pst_causes(pst, title))
    if pst.grid.shape[1] > 1:
        pictures["pst_map.png"] = as_png(pst_map(pst, title))
    for angle, azimuth in maps_at:
        pictures[f"{map_name(pst, angle, azimuth)}.png"] = as_png(pst_irradiance(pst, angle, azimuth))
    return pictures


def map_name(pst: Pst, field_deg: float, azimuth_deg: float) -> str:
    """File name without ending of the map of the detector for a source at some field angle and azimuth."""
    return f"irradiance_{field_deg:g}deg{f'_{azimuth_deg:g}deg' if pst.grid.shape[1] > 1 else ''}"


def csv_tables(pst: Pst) -> dict[str, pd.DataFrame]:
    """
    The tables by file name.

    pst.csv has a row for each field angle, pst_cells.csv one for each angle and azimuth where there are several
    azimuths, pst_paths.csv one for each path of each cell.
    """
    tables = {"pst.csv": curve_frame(pst)}
    if pst.grid.shape[1] > 1:
        tables["pst_cells.csv"] = cell_frame(pst)
    if pst.path_rows is not None:
        tables["pst_paths.csv"] = path_frame(pst)
    return tables


def write_pst(
    pst: Pst,
    directory: str | Path,
    title: str = "scene",
    command: str = "",
    paths_shown: int = 4,
    maps_at: Sequence[tuple[float, float]] = (),
) -> list[Path]:
    """
    Write the tables of `csv_tables`, the pictures of `draw`, pst.json and report.html.

    Parameters
    ----------
    pst : Pst
    directory : str or Path
        Made if it is missing, with the directories above it; other files in it are left alone.
    title : str
        Name of the optical system.
    command : str
        Command line, quoted in the report.
    paths_shown : int
        Strongest stray paths of each angle in the report and in pst.json.
    maps_at : sequence of (float, float)
        See `draw`.

    Returns
    -------
    list of Path
        The files written.
    """
    pictures = draw(pst, title, maps_at)
    record = {"title": title, "command": command} | pst_record(pst, paths_shown)
    files: dict[str, str | bytes] = {name: csv_text(table) for name, table in csv_tables(pst).items()}
    files |= pictures
    files["pst.json"] = json.dumps(record, indent=1, allow_nan=False)
    files["report.html"] = html_text(pst, title, command, pictures, paths_shown)
    return write_files(files, directory)
