"""The files of an optimisation: scene, tables, pictures and report."""

from __future__ import annotations

import secrets
from pathlib import Path

import pandas as pd

from mistray.optimize import Optimization
from mistray.report.figures.optimization import reflectance_figure, search_figure, variables_figure
from mistray.report.figures.plots import as_png
from mistray.report.html.optimization import optimization_html
from mistray.report.optimization_tables import history_frame, variables_frame
from mistray.report.output import csv_text, writable_directory, write_files
from mistray.scene.recoat import recoated, write_recoated
from mistray.scene.rewrite import rewritten


def scene_text(result: Optimization, directory: Path) -> str:
    """The scene file with the result, for a file in a directory that exists; what does not move is unchanged."""
    note = f"study {Path(result.study.name).name}"
    if not result.placed:
        return rewritten(result.source, result.parameters, directory, note)
    if not result.parameters:
        return recoated(result.source, result.coatings, directory, note)
    # Values that belong to the new coatings have a place in the file once these are on it. What stands in between lies
    # in the same directory, relative to which it names files
    draft = directory / f".coated-{secrets.token_hex(4)}.xml"
    try:
        coated = write_recoated(result.source, result.coatings, draft, note)
        return rewritten(coated, result.parameters, directory, note)
    finally:
        draft.unlink(missing_ok=True)


def write_optimization(result: Optimization, directory: str | Path, command: str = "") -> list[Path]:
    """
    Write scene.xml, terms.csv, variables.csv, history.csv, pictures and report.html, each whole or not at all.

    Parameters
    ----------
    result : Optimization
    directory : str or Path
        Made if it is missing.
    command : str
        Command line, quoted in the report.

    Returns
    -------
    list of Path
        The files written; search.png, variables.png, and reflectance.png if the study has coatings, are among them.
    """
    target = writable_directory(directory)
    target.mkdir(parents=True, exist_ok=True)
    pictures = {"search.png": as_png(search_figure(result)), "variables.png": as_png(variables_figure(result))}
    if result.placed:
        pictures["reflectance.png"] = as_png(reflectance_figure(result))
    source = result.source.resolve()
    title = source.parent.name if source.name == "scene.xml" else source.stem
    files: dict[str, str | bytes] = {
        "scene.xml": scene_text(result, target),
        "terms.csv": csv_text(pd.DataFrame([vars(row) for row in result.comparison.rows])),
        "variables.csv": csv_text(variables_frame(result)),
        "history.csv": csv_text(history_frame(result)),
        **pictures,
        "report.html": optimization_html(result, pictures, title, command),
    }
    return write_files(files, target)
