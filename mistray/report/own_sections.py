"""Sections that a user adds to the reports of mistray."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import pandas as pd

from mistray.files.json_values import plain
from mistray.report.model import Section, Table
from mistray.report.tables.frames import table_frame
from mistray.report.tables.text import parts_text

SectionMaker = Callable[[Any], Section]
Made = TypeVar("Made", bound=SectionMaker)
_MAKERS: list[SectionMaker] = []


def report_section(make: Made) -> Made:
    """
    Add a section to the report of every ghost analysis: to its page, its printed text, its JSON and its CSV files.

    Parameters
    ----------
    make : callable
        Takes the `mistray.analysis.GhostReport` and returns a `mistray.report.model.Section`. Each table of it has a
        name of its own, by which its CSV file is called.

    Returns
    -------
    callable
        `make` itself, so that this can stand above it as a decorator.
    """
    if make not in _MAKERS:
        _MAKERS.append(make)
    return make


def remove_section(make: SectionMaker) -> None:
    """Leave a section out of the reports again."""
    _MAKERS.remove(make)


def own_sections(result: Any) -> list[Section]:
    """The sections that were added, of one result."""
    return [make(result) for make in _MAKERS]


def own_text(result: Any) -> list[str]:
    """The sections as printed text."""
    return [f"{section.title}\n{parts_text(section.parts)}" for section in own_sections(result)]


def own_tables(result: Any) -> dict[str, pd.DataFrame]:
    """The tables of the sections by file name."""
    parts = [part for section in own_sections(result) for part in section.parts]
    return {f"{part.name}.csv": table_frame(part) for part in parts if isinstance(part, Table)}


def own_record(result: Any) -> dict[str, Any]:
    """The sections as values for JSON, by anchor: title and the rows of each table by its name."""
    return {
        section.anchor: {
            "title": section.title,
            **{
                part.name: plain(table_frame(part).to_dict("records"))
                for part in section.parts
                if isinstance(part, Table)
            },
        }
        for section in own_sections(result)
    }
