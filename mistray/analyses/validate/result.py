"""Result of a validation: rows with the published number, mistray's and the verdict, and a summary of each source."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mistray.estimate import Estimate
from mistray.notes import Note
from mistray.result import KeyNumber, Result
from mistray.toolkit.rows import column, derived

AGREES, KNOWN, DIFFERS = "agrees", "known to differ", "differs"
FAILED, NOT_ASKED, TOO_FEW = "peer failed", "peer not installed", "too few rays"
VERDICTS = (AGREES, KNOWN, DIFFERS, FAILED, NOT_ASKED, TOO_FEW)
UNJUDGED = (NOT_ASKED, TOO_FEW)  # neither an agreement nor a difference


@dataclass(frozen=True)
class ComparedRow:
    """Published number beside mistray's, both in `unit`, with the largest difference allowed and the verdict."""

    pack: str = column("pack that the row belongs to")
    name: str = column("number that is compared", head="number")
    unit: str = column("its unit")
    published: Estimate = column("published number, or that of the other program, with its standard error")
    ours: Estimate = column("our number, with its standard error")
    allowed: float = column(
        "largest difference that agrees: four standard errors of both, and what the source leaves open"
    )
    verdict: str = column("whether the numbers agree")
    why: str = column("reason why they differ, error of the other program, or the command that installs it", "")

    @derived.column("ours less the published number")
    def difference(self) -> float:
        """Mistray's number minus the published one, in their unit."""
        return self.ours.value - self.published.value

    @property
    def of_allowed(self) -> float:
        """Difference over `allowed`; infinite if that is 0 and the numbers differ, NaN if either is unknown."""
        if math.isnan(self.difference) or self.difference == 0:
            return self.difference
        return self.difference / self.allowed if self.allowed != 0 else math.copysign(math.inf, self.difference)


@dataclass(frozen=True)
class PackSummary:
    """Count of rows from one source of numbers, by verdict."""

    pack: str = column("pack")
    title: str = column("system, or subject")
    count: int = column("rows that were compared or left out", head="rows")
    agree: int = column("rows that agree")
    known: int = column("rows that are known to differ", head="known to differ")
    differ: int = column("rows that differ and should agree, or whose program failed")
    left_out: int = column("rows without a verdict: their program is not installed, or the rays are too few")
    seconds: float = column("time that the pack took, s", head="seconds", digits=".1f")
    source: str = column("source of its numbers")
    licence: str = column("their licence", "")
    note: str = column("what differs between the source and this program, and why", "")


@dataclass(frozen=True, repr=False)
class Validation(Result, table=".page:rows_table", figure=".figures:differences_figure"):
    """
    Mistray's numbers compared with published ones and with those of other programs.

    Attributes
    ----------
    rows : tuple of ComparedRow
        Rows in the order of their packs.
    packs : tuple of PackSummary
        Packs with their sources.
    facts : dict
        Versions and settings.
    notes : tuple of Note
        Warnings of the traces of the packs, such as of light that was cut.
    """

    rows: Sequence[ComparedRow]
    packs: Sequence[PackSummary]
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: Sequence[Note] = ()

    def count(self, verdict: str) -> int:
        """Return the number of rows with a verdict."""
        return sum(row.verdict == verdict for row in self.rows)

    @property
    def refuted(self) -> bool:
        """True if the verdict on a row is that it differs and should agree, or that another program failed."""
        return bool(self.count(DIFFERS) or self.count(FAILED))

    @property
    def holds(self) -> bool:
        """
        True if a row agrees or is known to differ, and none differs, has a program that failed, or has too few rays.

        Rows whose program is not installed do not count.
        """
        judged = len(self.rows) - self.count(NOT_ASKED)
        return not self.refuted and judged > 0 and not self.count(TOO_FEW)

    def of(self, pack: str) -> list[ComparedRow]:
        """Return the rows of the named source of numbers (pack)."""
        return [row for row in self.rows if row.pack == pack]

    def key_numbers(self) -> Mapping[str, KeyNumber]:
        """Return the count of rows, and the count of rows for each verdict that occurs."""
        found = {verdict: self.count(verdict) for verdict in VERDICTS}
        return {"rows": len(self.rows), **{verdict: str(count) for verdict, count in found.items() if count}}
