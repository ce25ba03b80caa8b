"""Sections that a user adds to reports of results: on pages, in tables, in text and in JSON."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import pandas as pd

from mistray.errors import MistrayError
from mistray.files.json_values import plain
from mistray.toolkit.pages.model import Map, Report, Section, Table, without_groups
from mistray.toolkit.tables.frames import table_frame
from mistray.toolkit.tables.text import parts_text

SectionMaker = Callable[[Any], Section | None]
Made = TypeVar("Made", bound=SectionMaker)
_MAKERS: dict[SectionMaker, type] = {}  # with the kind of results that each is about


def add_section(make: Made, of: type) -> Made:
    """
    Add a section to the report of every result of a class, and return `make`.

    Parameters
    ----------
    make : callable
        Function that takes a result and returns a `mistray.toolkit.pages.model.Section`, or None to add nothing.
        Each of its tables has a unique name, which is also that of its CSV file.
    of : type
        Class of the results.
    """
    _MAKERS[make] = of
    return make


def remove_section(make: SectionMaker) -> None:
    """
    Remove a section, added by `add_section`, from future reports; raise `KeyError` if it was not added.

    Examples
    --------
    >>> def remarks(report):
    ...     return None
    >>> _ = mistray.report.report_section(remarks, of=mistray.ThermalReport)
    >>> mistray.report.remove_section(remarks)
    """
    del _MAKERS[make]


def own_sections(result: Any) -> list[Section]:
    """Return the user's sections for a result; empty if the result is None."""
    made = [make(result) for make, of in _MAKERS.items() if result is not None and isinstance(result, of)]
    return [section for section in made if section is not None]


def with_own_sections(report: Report) -> Report:
    """
    Return a report with the user's sections for its result before its last section.

    Their tables and values are added to its CSV and JSON files. A table without a name, or with a taken one, raises
    `MistrayError`.
    """
    own = own_sections(report.result)
    return replace(
        report,
        result=None,  # so that a second call adds none again
        sections=[*report.sections[:-1], *own, *report.sections[-1:]],
        csv={**report.csv, **section_tables(own, report.csv)},
        json={name: {**values, **section_record(own)} for name, values in report.json.items()},
    )


def section_texts(sections: Sequence[Section]) -> list[str]:
    """Return each section as printed text: its title and its parts."""
    return [f"{section.title}\n{parts_text(section.parts)}" for section in sections]


def section_tables(sections: Sequence[Section], taken: Container[str] = ()) -> dict[str, pd.DataFrame]:
    """
    Return the tables of user sections as DataFrames, by file name.

    Raises
    ------
    MistrayError
        If a table has no name, or has the name of a file in `taken` or of another table.
    """
    tables: dict[str, pd.DataFrame] = {}
    for section in sections:
        for part in without_groups(section.parts):
            if isinstance(part, Table):
                name = f"{part.name}.csv"
                if not part.name or name in taken or name in tables:
                    raise MistrayError(f"section '{section.title}': a table is named '{part.name}'; name it otherwise")
                tables[name] = table_frame(part)
    return tables


def section_record(sections: Sequence[Section]) -> dict[str, Any]:
    """
    Return sections as JSON-serialisable values: title, rows of each table and range of each map, by anchor.

    They are under the key "sections"; without sections the dictionary is empty.
    """
    record: dict[str, Any] = {}
    for section in sections:
        record[section.anchor] = own = {"title": section.title}
        for part in without_groups(section.parts):
            if isinstance(part, Table):
                own[part.name] = plain(table_frame(part).to_dict("records"))
            elif isinstance(part, Map):
                ends = {"smallest": part.values.min(), "largest": part.values.max()}
                own[part.name] = plain({"extent_mm": part.extent_mm, "unit": part.unit, **ends})
    return {"sections": record} if record else {}
