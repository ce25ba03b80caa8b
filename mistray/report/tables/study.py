"""The steps of a stray-light study as text, as HTML tables and as values for JSON.

Tables of a step are DataFrames whose columns name their unit ("z_mm", "power_se_W"); what is shown is made from these
names, so that a new column needs no new code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from mistray.analysis.estimate import Estimate
from mistray.analysis.study.run import Study
from mistray.analysis.study.step import Fact, StudyStep
from mistray.files.json_values import plain
from mistray.files.units import unit_of
from mistray.report.html.markup import cell, data_table, number_cell, thousands
from mistray.report.tables import ghosts as tables
from mistray.report.tables import pst as pst_tables
from mistray.report.tables.text import ABSENT, number, with_error

ABBREVIATIONS = {"pst": "PST", "rms": "RMS", "bsdf": "BSDF", "gcf": "GCF", "tis": "TIS", "id": "surface"}
LONG_TEXT = 60  # characters from which on a cell may break its lines
DIGITS = 5
ABSENT_BELOW_0 = ("space",)  # columns whose negative numbers say that there is none


def heading_of(column: str) -> tuple[str, str]:
    """Heading and unit of a column."""
    name, unit = unit_of(column)
    words = [ABBREVIATIONS.get(word, word) for word in name.split("_") if word]
    return " ".join(words) or "share", unit


def error_of(column: str, columns: Sequence[str]) -> str | None:
    """The column with the standard error of a column, if there is one: "pst_se" of "pst", "x_se_mm" of "x_mm"."""
    name, _ = unit_of(column)
    end = column[len(name) :]
    return next((other for other in (f"{name}_se{end}", f"{column}_se") if other in columns), None)


def table_html(name: str, frame: pd.DataFrame) -> str:
    """
    A DataFrame as an HTML table that sorts; standard errors stand below their values.

    Parameters
    ----------
    name : str
        Id of the table.
    frame : DataFrame
    """
    names = [str(column) for column in frame.columns]
    errors = {column: error_of(column, names) for column in names}
    shown = [column for column in names if column not in errors.values()]
    header = [(*heading_of(column), *(["t"] if _is_text(frame[column]) else [])) for column in shown]
    rows = []
    for record in frame.to_dict("records"):
        cells = []
        for column in shown:
            error = errors[column]
            if error is not None:
                cells.append(number_cell(Estimate(float(record[column]), float(record[error]))))
            else:
                absent = column in ABSENT_BELOW_0 and record[column] < 0
                cells.append(_cell(math.nan if absent else record[column]))
        rows.append(cells)
    return data_table(name, header, rows)


def _is_text(column: pd.Series) -> bool:
    return not pd.api.types.is_numeric_dtype(column) or pd.api.types.is_bool_dtype(column)


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return cell(value, "t long" if len(value) > LONG_TEXT else "t")
    return cell(value_text(value), "t" if isinstance(value, bool) else "")


def value_text(value: Any) -> str:
    """A value of a table or of a fact as text."""
    if isinstance(value, str):
        return value
    if isinstance(value, Estimate):
        return with_error(value)
    if isinstance(value, bool):
        return "yes" if value else ""
    if value is None or math.isnan(value):
        return ABSENT
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    whole = float(value) == int(value) and abs(value) < 1e15
    return thousands(value) if whole and abs(value) >= 1e4 else number(float(value), DIGITS)


def fact_text(fact: Fact) -> str:
    """A fact's value with its unit."""
    text = value_text(fact.value)
    apart = "" if fact.unit == "°" else " "
    return f"{text}{apart}{fact.unit}" if fact.unit and text != ABSENT else text


def step_warnings(study: Study, step: StudyStep) -> list[str]:
    """What a reader must know before trusting a step, also what the reports of its parts say."""
    found = list(step.warnings)
    if step.key == "analysis":
        # That scatter is not followed is meant so in the ghost analysis
        found += [f"ghosts, {text}" for text in tables.warnings(study.ghosts) if "max_scatters" not in text]
        found += [f"PST, {text}" for text in pst_tables.warnings(study.pst) if text not in found]
    return found


def study_warnings(study: Study) -> list[str]:
    """All warnings of a study, each with its step."""
    return [f"step {step.number}: {text}" for step in study.steps for text in step_warnings(study, step)]


def study_text(study: Study) -> str:
    """What `mistray study` prints: findings of every step, then warnings."""
    lines = [f"Stray-light study of '{study.name}'"]
    for step in study.steps:
        lines += ["", f"{step.number} {step.title}"]
        lines += [f"  {text}" for text in step.findings or ("nothing to report",)]
    warnings = study_warnings(study)
    if warnings:
        lines += ["", *(f"warning: {text}" for text in warnings)]
    return "\n".join(lines)


def study_record(study: Study) -> dict[str, Any]:
    """All of a study as values that JSON knows: name, settings, steps (with facts, tables, findings) and warnings."""
    steps = [
        {
            "number": step.number,
            "key": step.key,
            "title": step.title,
            "text": step.text,
            "facts": [
                {
                    "name": fact.name,
                    "value": fact.value.value if isinstance(fact.value, Estimate) else fact.value,
                    "se": fact.value.se if isinstance(fact.value, Estimate) else None,
                    "unit": fact.unit,
                }
                for fact in step.facts
            ],
            "tables": {name: frame.to_dict("records") for name, frame in step.tables.items()},
            "findings": list(step.findings),
            "warnings": step_warnings(study, step),
            "seconds": step.seconds,
        }
        for step in study.steps
    ]
    return dict(plain({"name": study.name, "settings": study.settings, "steps": steps}))
