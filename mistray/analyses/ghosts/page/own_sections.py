"""Sections that a user adds to the reports of mistray, and those of its own that only some scenes have."""

from __future__ import annotations

from collections.abc import Callable, Container
from typing import Any, TypeVar

import pandas as pd

from mistray.analyses.ghosts.page.flux_split import flux_split_section
from mistray.analyses.ghosts.page.light_maps import light_maps_section
from mistray.analyses.ghosts.page.passing import passing_section
from mistray.analyses.ghosts.page.photometric import photometric_section
from mistray.analyses.ghosts.page.surface_maps import surface_maps_section
from mistray.errors import MistrayError
from mistray.files.json_values import plain
from mistray.toolkit.pages.model import Map, Section, Table
from mistray.toolkit.tables.frames import table_frame
from mistray.toolkit.tables.text import parts_text

SectionMaker = Callable[[Any], Section | None]
Made = TypeVar("Made", bound=SectionMaker)
_MAKERS: list[SectionMaker] = [
    light_maps_section, passing_section, surface_maps_section, flux_split_section, photometric_section,
]  # fmt: skip


def report_section(make: Made) -> Made:
    """
    Add a section to the report of every ghost analysis: to its page, its printed text, its JSON and its CSV files.

    Parameters
    ----------
    make : callable
        Takes the `mistray.analysis.GhostReport` and returns a `mistray.toolkit.pages.model.Section`, or None where
        there is nothing to show. Each table of it has a name of its own, by which its CSV file is called.

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
    return [section for make in _MAKERS if (section := make(result)) is not None]


def own_text(result: Any) -> list[str]:
    """The sections as printed text."""
    return [f"{section.title}\n{parts_text(section.parts)}" for section in own_sections(result)]


def own_tables(result: Any, taken: Container[str] = ()) -> dict[str, pd.DataFrame]:
    """
    The tables of the sections by file name.

    Raises
    ------
    MistrayError
        A table has no name, or that of a file in `taken` or of another table.
    """
    tables: dict[str, pd.DataFrame] = {}
    for section in own_sections(result):
        for part in section.parts:
            if isinstance(part, Table):
                name = f"{part.name}.csv"
                if not part.name or name in taken or name in tables:
                    raise MistrayError(f"section '{section.title}': a table is named '{part.name}'; name it otherwise")
                tables[name] = table_frame(part)
    return tables


def own_record(result: Any) -> dict[str, Any]:
    """The sections as values for JSON, by anchor: title, rows of each table and range of each map by its name."""
    record: dict[str, Any] = {}
    for section in own_sections(result):
        record[section.anchor] = own = {"title": section.title}
        for part in section.parts:
            if isinstance(part, Table):
                own[part.name] = plain(table_frame(part).to_dict("records"))
            elif isinstance(part, Map):
                ends = {"smallest": part.values.min(), "largest": part.values.max()}
                own[part.name] = plain({"extent_mm": part.extent_mm, "unit": part.unit, **ends})
    return record
