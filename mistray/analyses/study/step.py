"""Result of one step of a stray-light study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import pandas as pd

from mistray.estimate import Estimate

STEPS = (
    ("optical_model", "Optical model"),
    ("mechanical_model", "Mechanical model"),
    ("critical_objects", "Critical objects"),
    ("illuminated_objects", "Illuminated objects"),
    ("common_objects", "Common objects"),
    ("coatings_and_scatter", "Coatings and scatter models"),
    ("importance_sampling", "Importance sampling"),
    ("analysis", "Stray-light analysis"),
)
"""Key and title of the steps, in the order of R. Pfisterer's list as "Stray Light Analysis of a Mobile Phone Camera" \
quotes it (Table 3)."""


def count_of(number: int, what: str) -> str:
    """Return a count with its noun, given in the singular, as text: "1 object", "2 objects"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def gathered(column: str, tables: Iterable[tuple[float, pd.DataFrame]]) -> pd.DataFrame:
    """
    Return one table from tables at several angles, degrees, with the angle in the first column `column`.

    Empty tables are left out; if all are empty, the first is returned with that column.
    """
    parts = [table.assign(**{column: float(angle)})[[column, *table]] for angle, table in tables]
    return pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)


class Fact(NamedTuple):
    """Single result of a step: its name, its value (number, number with error, or text) and its unit."""

    name: str
    value: float | str | Estimate
    unit: str = ""


@dataclass(frozen=True, eq=False)
class StudyStep:
    """
    Result of one step of a stray-light study.

    Attributes
    ----------
    number : int
        Number of the step, 1 … 8.
    key : str
        Name of the step in `STEPS`.
    text : str
        Account of what was done, in a sentence or two.
    facts : tuple of Fact
        Single results of the step.
    tables : dict
        DataFrames by name; the first is the main one. Columns end in their unit, standard errors in ``_se`` and the
        unit of their value.
    findings : tuple of str
        Statements of the step about the system, one sentence each.
    warnings : tuple of str
        Warnings to heed before trusting it; empty if all is well.
    result : object
        Source of the tables: a `FirstOrder`, a `GhostReport`, a `Pst` …; None if there is nothing beyond the
        tables.
    seconds : float
        Duration of the step, s.
    """

    number: int
    key: str
    text: str
    facts: tuple[Fact, ...] = ()
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    result: Any = None
    seconds: float = 0.0

    @classmethod
    def of(cls, key: str, text: str, **more: Any) -> StudyStep:
        """Return a step with a key of `STEPS`, which gives its number; `more` are its other attributes."""
        return cls([name for name, _ in STEPS].index(key) + 1, key, text, **more)

    @property
    def title(self) -> str:
        """Heading of the step in the report."""
        return dict(STEPS)[self.key]

    @property
    def table(self) -> pd.DataFrame:
        """Main table of the step, the first of `tables`; empty if there is none."""
        return next(iter(self.tables.values()), pd.DataFrame())

    def fact(self, name: str) -> float | str | Estimate:
        """
        Return the value of a fact by name.

        Raises
        ------
        KeyError
            If the step has no such fact.
        """
        return {fact.name: fact.value for fact in self.facts}[name]
