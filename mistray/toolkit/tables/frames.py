"""DataFrames as tables of reports; headings and units come from the names of the columns.

Columns name their unit ("z_mm", "power_se_W"), so that a new column needs no new code.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from mistray.estimate import UNKNOWN, Estimate
from mistray.files.units import UNITS, unit_of
from mistray.ids import free_name
from mistray.toolkit.pages.model import Column, StyledCell, Table, Value, columns
from mistray.toolkit.pages.parts import thousands
from mistray.toolkit.tables.text import ABSENT, cell_text, number, with_error

ABBREVIATIONS = {"pst": "PST", "rms": "RMS", "bsdf": "BSDF", "gcf": "GCF", "tis": "TIS", "id": "surface"}
DIGITS = 5
ABSENT_BELOW_0 = ("space",)  # columns whose negative numbers say that there is none


def heading_of(column: str) -> tuple[str, str]:
    """
    Return the heading and the unit of a column from its name: "z_mm" → "z", "mm".

    The unit is empty without one. A name that is only a unit has the heading "share".
    """
    name, unit = unit_of(column)
    words = [ABBREVIATIONS.get(word, word) for word in name.split("_") if word]
    return " ".join(words) or "share", unit


def error_of(column: str, known: Sequence[str]) -> str | None:
    """
    Return the name of the column with a column's standard error: "pst" → "pst_se", "x_mm" → "x_se_mm" or "x_mm_se".

    It is None if the column names `known` include neither.
    """
    name, _ = unit_of(column)
    end = column[len(name) :]
    return next((other for other in (f"{name}_se{end}", f"{column}_se") if other in known), None)


def frame_table(name: str, frame: pd.DataFrame) -> Table:
    """
    Return a DataFrame as a table of a report, with standard errors in the cells of their values.

    Parameters
    ----------
    name : str
        Id of the table.
    frame : DataFrame
        Table whose column names end in units.
    """
    names = [str(column) for column in frame.columns]
    errors = {column: error_of(column, names) for column in names}
    shown = [column for column in names if column not in errors.values()]
    heads = [Column(*heading_of(column), "t" if _is_text(frame[column]) else "") for column in shown]
    rows = [
        [_value(record[column], column, record.get(errors[column])) for column in shown]
        for record in frame.to_dict("records")
    ]
    return Table(heads, rows, name)


def chosen(frame: pd.DataFrame, heads: Mapping[str, str], name: str = "") -> Table:
    """
    Return some columns of a DataFrame as a table with given headings, standard errors in the cells of their values.

    Parameters
    ----------
    frame : DataFrame
        Table whose column names end in units.
    heads : mapping of str to str
        Headings by column, see `Column.of`.
    name : str
        Id of the table.
    """
    rows = [[_cell(record, one) for one in heads] for record in frame.to_dict("records")]
    return Table(columns(*heads.values()), rows, name)


def _cell(record: Mapping[Any, Any], name: str) -> Value:
    value = record[name]
    if error_of(name, list(record)) is not None:
        return estimate_of(record, name)
    if value is None or isinstance(value, str):
        return value or ""
    return number(value, DIGITS + 1) if isinstance(value, float) else str(value)


def _is_text(column: pd.Series) -> bool:
    return not pd.api.types.is_numeric_dtype(column) or pd.api.types.is_bool_dtype(column)


def _value(value: Any, column: str, error: Any) -> Value:
    if error is not None:
        return Estimate(float(value), float(error))
    if isinstance(value, str):
        return StyledCell(value, "t")
    if isinstance(value, bool):
        return StyledCell(value_text(value), "t")
    return StyledCell(value_text(math.nan if column in ABSENT_BELOW_0 and value < 0 else value), "")


def value_text(value: Any) -> str:
    """
    Return a value of a table or of a setting as a report shows it.

    None and NaN are "–", True is "yes", False is empty. A whole number from 10 000 on has all its digits.
    """
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


def flat(values: Mapping[str, Any], before_unit: bool = False) -> dict[str, Any]:
    """
    Return values by column with each `Estimate` as two: "x_mm" and "x_mm_se".

    With `before_unit` the second is "x_se_mm".
    """
    row: dict[str, Any] = {}
    for name, value in values.items():
        begin = unit_of(name)[0] if before_unit else name
        error = f"{begin}_se{name[len(begin) :]}"
        row |= {name: value.value, error: value.se} if isinstance(value, Estimate) else {name: value}
    return row


def estimate_of(record: Mapping[str, Any] | pd.Series, name: str) -> Estimate:
    """
    Return the number in a named column of a row, with its standard error.

    Raise `KeyError` if either column is missing.
    """
    return Estimate(float(record[name]), float(record[str(error_of(name, list(record.keys())))]))


def row_of(item: Any, *names: str) -> dict[str, Any]:
    """Return attributes of an object by name, as a row of a DataFrame, see `flat`."""
    return flat({name: getattr(item, name) for name in names})


def table_frame(table: Table) -> pd.DataFrame:
    """
    Return a table as a DataFrame with a column for each heading, named after it and its unit: "power_W".

    The second of equal headings has a 2 after its name. A column with an `Estimate` becomes two, value and standard
    error; its other cells are NaN. In other columns with a unit, text is read as a number, or is NaN if it is none.
    """
    ends = {unit: end for end, unit in UNITS}
    found: dict[str, list[Any]] = {}
    for k, column in enumerate(table.columns):
        name = re.sub(r"\W+", "_", column.head).strip("_")
        unit = ends.get(column.unit, re.sub(r"\W+", "_", column.unit))
        end = f"_{unit}" if unit else ""
        name = free_name(name, end, found).removesuffix(end)
        values = [row[k] for row in table.rows]
        if any(isinstance(value, Estimate) for value in values):
            pairs = [value if isinstance(value, Estimate) else UNKNOWN for value in values]
            found[f"{name}{end}"] = [pair.value for pair in pairs]
            found[f"{name}_se{end}"] = [pair.se for pair in pairs]
        elif unit:
            texts = [str(value) if isinstance(value, int) else cell_text(value) for value in values]
            found[f"{name}{end}"] = pd.to_numeric(pd.Series(texts, dtype=object), errors="coerce").tolist()
        else:
            found[f"{name}{end}"] = [value if isinstance(value, int) else cell_text(value) for value in values]
    return pd.DataFrame(found)
