"""What can be moved, blocked, painted and coated, ranked: as text, as values for JSON and as a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mistray.analysis.estimate import Estimate
from mistray.files.json_values import plain
from mistray.report.output import csv_text, write_files
from mistray.report.tables.text import number, text_table, with_error
from mistray.sweeps import EditRanking

CSV = "edit_ranking.csv"


def edit_ranking_text(found: EditRanking, count: int = 20) -> str:
    """
    A line for each edit with what a step of it does at each field angle.

    Parameters
    ----------
    found : EditRanking
    count : int
        Lines at most.
    """
    columns = [("edit", ""), ("parameter", ""), ("value", ""), ("step", ""), ("unit", "")]
    columns += [(f"at {angle:g} deg", "% per step") for angle in found.field_deg]
    matter = [edit for edit in found.edits if any(change.value for change in edit.change)]
    lines = [
        [edit.method, edit.label, number(edit.value), number(edit.step), edit.unit]
        + [with_error(Estimate(100 * change.value, 100 * change.se)) for change in edit.change]
        for edit in matter[:count]
    ]
    pst = ", ".join(f"{with_error(at)} at {angle:g} deg" for angle, at in zip(found.field_deg, found.pst, strict=True))
    parts = [f"PST of the {found.light} light: {pst}", "", text_table(columns, lines, left=(0, 1, 4))]
    if len(matter) > count:
        parts.append(f"… and {len(matter) - count} with less")
    if len(found.edits) > len(matter):
        parts.append(f"{len(found.edits) - len(matter)} more change nothing")
    return "\n".join([*parts, "", *(f"not in the derivatives: {text}" for text in found.left_out)])


def edit_ranking_record(found: EditRanking) -> dict[str, Any]:
    """All of a ranking as values that JSON knows."""
    rows = found.to_pandas().to_dict("records")
    return dict(plain({"light": found.light, "ranking": rows, "left_out": found.left_out}))


def write_edit_ranking(found: EditRanking, folder: Path, command: str) -> list[Path]:
    """Write the table as CSV; returns the file."""
    return write_files({CSV: f"# {command}\n{csv_text(found.to_pandas())}"}, folder)
