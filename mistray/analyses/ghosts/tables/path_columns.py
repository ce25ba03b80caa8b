"""Columns of the tables of paths, as texts and pages show them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import pandas as pd

from mistray.toolkit.pages.model import Column, Table, Value
from mistray.toolkit.rows import column, table

FEW, CONTESTED = "*", "≈"  # beside a path of few rays, and one that may be as bright as the first
WAVELENGTH = "λ [nm]"
OF_SOME = ("airy_radius_mm", "airy_irradiance_W_mm2", "peak_W_mm2")  # numbers that not every path has


@dataclass(frozen=True)
class PathColumns:
    """Columns that a table of paths from `GhostReport.with_airy` can show, with their units and formats."""

    path_id: int = column("number of the path", head="path")
    events: str = column("its events")
    kind: str = column("its kind")
    label: str = column("its name, where it is reflected or scattered", head="ghost and scatter surfaces [1st → 2nd]")
    wavelength_nm: float = column("its vacuum wavelength", head=WAVELENGTH, digits="g")
    rays: int = column("rays that came this way")
    power_W: float = column("its power", head="power [W absorbed]")
    incident_W: float = column("its power before the detector reflects its share")
    percent: float = column("its share of all light", head="of all light [%]", digits=".6g")
    percent_of_stray: float = column("its share of the stray light", head="of stray light [%]")
    x_mm: float = column("x of its centroid")
    y_mm: float = column("y of its centroid")
    rms_radius_mm: float = column("RMS distance of its rays from the centroid")
    rms_irradiance_W_mm2: float = column("its power over π times the square of that")
    normalised_rms_irradiance: float = column(
        "that over the RMS irradiance of the direct image on axis", head="normalised [to on-axis image]"
    )
    airy_radius_mm: float = column("Airy radius of its own cone of light", head="Airy radius [mm]")
    airy_irradiance_W_mm2: float = column("its power over π times the square of that", head="at Airy radius [W/mm²]")
    peak_W_mm2: float = column("irradiance of its brightest pixel")
    polarization: float = column("its degree of polarisation", head="polarisation [degree]", digits=".6g")
    s1: float = column("its Stokes parameter s1", digits=".6g")
    s2: float = column("its Stokes parameter s2", digits=".6g")
    s3: float = column("its Stokes parameter s3", digits=".6g")


NUMBERS = tuple(field.name for field in fields(PathColumns))[6:]
"""Columns that are numbers of the light of a path."""


def number_cells(rows: pd.DataFrame, numbers: Sequence[str]) -> list[list[Value]]:
    """Return table cells with the chosen numbers of path rows; a cell is empty where a path lacks the number."""
    rows = rows.reindex(columns=list(dict.fromkeys([*rows.columns, *numbers])))
    absent = [[name in OF_SOME and math.isnan(getattr(row, name)) for name in numbers] for row in rows.itertuples()]
    found = table(PathColumns, rows, only=numbers).rows
    return [
        ["" if none else cell for none, cell in zip(*pair, strict=True)] for pair in zip(absent, found, strict=True)
    ]


def mark_of(row: Any) -> str:
    """Return the mark of a path-table row with doubtful numbers: `FEW` rays or `CONTESTED`; else ""."""
    return FEW if row.few_rays else CONTESTED if row.contested else ""


def marked(rows: pd.DataFrame) -> pd.DataFrame:
    """Return rows of a path table; labels end with the mark of doubtful numbers, see `mark_of`."""
    return rows.assign(label=[f"{row.label} {mark_of(row)}".rstrip() for row in rows.itertuples()])


def of_fields(field_deg: Iterable[float], table_of: Callable[[float], Table]) -> Table:
    """
    Return tables of several fields, made by `table_of`, as one with the field angle, degrees, first.

    Each keeps its row limit for text.
    """
    tables = {field: table_of(field) for field in field_deg}
    rows = [[f"{field:g}", *row] for field, found in tables.items() for row in found.rows_in_text()]
    return Table([Column("field", "deg"), *next(iter(tables.values())).columns], rows)
