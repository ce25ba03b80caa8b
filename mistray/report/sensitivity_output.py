"""What a sensitivity analysis leaves behind in a folder."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from mistray.optimize.tolerances.sensitivity import Sensitivity
from mistray.report.figures.plots import as_png
from mistray.report.figures.sensitivity import draws_figure, ranking_figure
from mistray.report.html.sensitivity import sensitivity_html
from mistray.report.output import csv_text, write_files
from mistray.report.tables.sensitivity import sensitivity_record


def write_sensitivity(
    result: Sensitivity, directory: str | Path, title: str = "scene", command: str = ""
) -> list[Path]:
    """
    Write sensitivity.csv, propagation.csv, sensitivity.json, ranking.png and report.html, each whole or not at all.

    With perturbed systems there are draws.csv and monte_carlo.png as well.

    Parameters
    ----------
    result : Sensitivity
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
    pictures = {"ranking.png": as_png(ranking_figure(result, title))}
    files: dict[str, str | bytes] = {
        "sensitivity.csv": csv_text(result.to_pandas()),
        "propagation.csv": csv_text(_contributions(result)),
        "sensitivity.json": json.dumps(sensitivity_record(result), indent=2, allow_nan=False) + "\n",
    }
    if result.draws is not None:
        pictures["monte_carlo.png"] = as_png(draws_figure(result, title))
        columns = {"ratio": result.draws.ratios, "predicted_log_ratio": result.draws.predicted}
        files["draws.csv"] = csv_text(pd.DataFrame(columns))
    files |= pictures
    files["report.html"] = sensitivity_html(result, pictures, title, command)
    return write_files(files, directory)


def _contributions(result: Sensitivity) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "name": item.name,
                "members": " ".join(item.members),
                "change_percent": 100 * item.change.value,
                "change_percent_se": 100 * item.change.se,
                "share": item.share.value,
                "share_se": item.share.se,
            }
            for item in result.spread.contributions
        ]
    )
