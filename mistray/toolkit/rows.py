"""Rows of results: dataclasses whose fields state how they are shown in DataFrames, tables, CSV and JSON.

A field of type `Estimate` becomes two columns of a frame, "x" and "x_se", and one of a page, with its error.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mistray.estimate import UNKNOWN, Estimate
from mistray.ranges import type_of
from mistray.toolkit.pages.model import Column, Table, Value
from mistray.toolkit.tables.frames import error_of, flat, heading_of
from mistray.toolkit.tables.text import ABSENT

if TYPE_CHECKING:
    import pandas as pd

_COLUMN = "column"


@dataclass(frozen=True)
class _Shown:
    """
    Display of a row's field in tables: heading, number format and unit.

    `kind` is the type of the field, as written. For the other attributes see `column`.
    """

    doc: str
    head: str = ""
    digits: str = ".4g"
    empty: str = ""
    absent: Any = None
    percent: bool | str = False
    between: str = " "
    kind: str = ""

    def name(self, field: str) -> str:
        """Return the column name of a field: the field's name, with ``_percent`` if it is shown in percent."""
        return f"{field}_percent" if self.percent is True else field

    def value(self, row: Any, field: str, in_table: bool = False) -> Any:
        """
        Return the value of a field as shown in a DataFrame or, if `in_table`, in a page's table.

        A tuple is joined to text, and a fraction shown in percent is multiplied by 100. None is NaN in a DataFrame
        where the field holds an `Estimate`.
        """
        value = getattr(row, field)
        if value is None:
            return UNKNOWN if "Estimate" in self.kind and not in_table else None
        if isinstance(value, tuple) and not isinstance(value, Estimate):
            return self.between.join(value)
        if not (self.percent if in_table else self.percent is True):
            return value
        return value.times(100) if isinstance(value, Estimate) else 100 * value


def column(doc: str, default: Any = dataclasses.MISSING, **how: Any) -> Any:
    """
    Return a dataclass field of a result's row, with the way it is shown in tables.

    Parameters
    ----------
    doc : str
        Meaning of the field, one sentence.
    default
        Default value of the field; without one the field is required.
    **how
        ``head``, heading of the column, such as "share [n²]"; by default it is made from the name: "temperature_K" is
        headed "temperature [K]". ``digits``, format of a number that has no error (".4g"). ``empty``, text in place of
        an empty string or None. ``absent``, value that is shown as missing. ``percent``, whether a fraction is shown in
        percent: the column of "change" is then "change_percent". With "shown" it is so in tables of pages only.
        ``between``, separator of several strings. The error of a number is part of an `Estimate`, or stands in a column
        of its own, "power_se_W"; a table shows the number with it.
    """
    return dataclasses.field(default=default, metadata={_COLUMN: _Shown(doc, **how)})


class derived(property):
    """Property that is also a column of its row: ``@derived.column("sentence", head=…)``."""

    shown: _Shown

    @classmethod
    def column(cls, doc: str, **how: Any) -> Callable[[Callable[[Any], Any]], derived]:
        """Return a decorator that makes a property a column; arguments as for the function `column`."""

        def decorate(function: Callable[[Any], Any]) -> derived:
            made = cls(function)
            made.shown = _Shown(doc, kind=type_of(function.__annotations__["return"]), **how)
            return made

        return decorate


def _declared(kind: type) -> dict[str, _Shown]:
    """Return the columns of a row class with their display, by name: dataclass fields first, then properties."""
    fields = {
        field.name: dataclasses.replace(field.metadata[_COLUMN], kind=type_of(field.type))
        for field in dataclasses.fields(kind)
        if _COLUMN in field.metadata
    }
    return fields | {name: value.shown for name, value in vars(kind).items() if isinstance(value, derived)}


def described(kind: type) -> dict[str, str]:
    """Return the meaning of each column of a row class, by the column names of `records`."""
    found: dict[str, str] = {}
    for name, shown in _declared(kind).items():
        value, *error = flat({shown.name(name): UNKNOWN if "Estimate" in shown.kind else None})
        found[value] = shown.doc
        found |= {one: f"standard error of {value}" for one in error}
    return found


def frame(kind: type, rows: Sequence[Any]) -> pd.DataFrame:
    """
    Return rows as a DataFrame with all columns of their class, also if there are no rows.

    Parameters
    ----------
    kind : type
        Dataclass of the rows.
    rows : sequence
        Rows, all of this class.
    """
    import pandas as pd

    declared = _declared(kind)
    none = {shown.name(name): UNKNOWN if "Estimate" in shown.kind else None for name, shown in declared.items()}
    return pd.DataFrame(records(kind, rows), columns=list(flat(none)))


def records(kind: type, rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Return rows as JSON-serialisable values by column, like `frame`; several strings are joined by `between`."""
    declared = _declared(kind).items()
    return [flat({shown.name(name): shown.value(row, name) for name, shown in declared}) for row in rows]


def table(
    kind: type, rows: Sequence[Any] | pd.DataFrame, name: str = "", only: Sequence[str] = (), **how: Any
) -> Table:
    """
    Return rows as a table of a page or of a terminal.

    Parameters
    ----------
    kind : type
        Dataclass of the rows.
    rows : sequence or DataFrame
        Rows, all of this class, or a DataFrame. This has the columns that are shown, by the names of the fields; for
        those with an error also "power_se_W" and the like.
    name : str
        Id of the table in the page.
    only : sequence of str
        Names of the fields that are shown, an error with its value; empty: all.
    **how
        Further attributes of `Table`.
    """
    declared = _declared(kind)
    known = list(declared)
    if not isinstance(rows, Sequence):
        known, rows = list(rows.columns), list(rows.itertuples(index=False))
    errors = {one: error_of(one, known) for one in declared}
    shown = {one: declared[one] for one in only or declared if one not in errors.values()}
    cells = [[_value(row, one, how_shown, errors[one]) for one, how_shown in shown.items()] for row in rows]
    return Table([_head(one, how_shown) for one, how_shown in shown.items()], cells, name, **how)


def _head(name: str, shown: _Shown) -> Column:
    """Return the heading of a column; columns of text and of yes or no are left-aligned."""
    found = Column.of(shown.head) if shown.head else Column(*heading_of(shown.name(name)))
    return dataclasses.replace(found, style="t" if shown.kind in ("str", "bool", "tuple[str, ...]") else "")


def _value(row: Any, name: str, shown: _Shown, error: str | None) -> Value:
    value = shown.value(row, name, in_table=True)
    if error is not None:
        return Estimate(value, getattr(row, error))
    if shown.absent is not None and value == shown.absent:
        return ABSENT
    if isinstance(value, bool):
        return "yes" if value else ""
    if value is None or isinstance(value, str):
        return value or shown.empty
    if isinstance(value, float):
        return ABSENT if math.isnan(value) else format(value, shown.digits)
    found: Value = value
    return found
