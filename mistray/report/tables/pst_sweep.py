"""The PST before and after edits as text, as values for JSON and as a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mistray.analysis.estimate import Estimate
from mistray.files.json_values import plain
from mistray.report.model import Table, columns
from mistray.report.output import csv_text, write_files
from mistray.report.tables.text import table_text
from mistray.sweeps import PstSweep

CSV = "pst_sweep.csv"


def pst_sweep_text(found: PstSweep) -> str:
    """A line for each configuration and field angle."""
    heads = columns("<configuration", "angle [deg]", "stray PST before", "after", "after/before")
    lines = []
    for row in found.to_pandas().itertuples():
        pairs = ((row.before, row.before_se), (row.after, row.after_se), (row.ratio, row.ratio_se))
        lines.append([row.configuration, f"{row.angle_deg:g}", *(Estimate(*pair) for pair in pairs)])
    text = table_text(Table(heads, lines))
    return f"{text}\n\nthe error of after/before is that of runs with the same random numbers"


def pst_sweep_record(found: PstSweep) -> dict[str, Any]:
    """All of a result as values that JSON knows."""
    rows = found.to_pandas().to_dict("records")
    return dict(plain({"configurations": list(found.configurations), "rows": rows}))


def write_pst_sweep(found: PstSweep, folder: Path, command: str) -> list[Path]:
    """Write the table as CSV; returns the file."""
    return write_files({CSV: f"# {command}\n{csv_text(found.to_pandas())}"}, folder)
