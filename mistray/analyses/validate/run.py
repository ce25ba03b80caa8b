"""Run of a validation: choose rows, compute mistray's numbers, get those of other programs, and judge them."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from mistray.analyses.validate.declared import UNITS, DeclaredRow, ReferenceFile, read_reference, require_own
from mistray.analyses.validate.pack import Pack
from mistray.analyses.validate.packs.known import PACKS
from mistray.analyses.validate.request import ValidateRequest
from mistray.analyses.validate.result import (
    AGREES,
    DIFFERS,
    KNOWN,
    NOT_ASKED,
    TOO_FEW,
    ComparedRow,
    PackSummary,
    Validation,
)
from mistray.analyses.validate.scene_numbers import SceneNumbers
from mistray.errors import MistrayError, nearest
from mistray.estimate import UNKNOWN, Estimate
from mistray.notes import quiet
from mistray.trace.forward import versions

Progress = Callable[[str, int, int], None]
"""Called with the title of the pack that begins, the number of packs before it and that of all."""


@dataclass(frozen=True)
class OwnPack(Pack):
    """File of reference numbers that a user wrote, in the form of a built-in pack."""

    path: str = ""

    @property
    def file(self) -> ReferenceFile:
        """Reference numbers of the user's file."""
        found = read_reference(self.path)
        require_own(found, self.path)
        return found


def run_validation(request: ValidateRequest, progress: Progress | None = None) -> Validation:
    """
    Compare mistray's numbers with published ones and with those of other programs.

    Parameters
    ----------
    request : ValidateRequest
    progress : callable, optional
        See `Progress`.

    Returns
    -------
    Validation
        One row for each number, and one for each number of a program that is not installed.

    Raises
    ------
    MistrayError
        If a pattern fits no row, or a file of one's own is wrong.
    """
    own = [OwnPack(Path(path).stem, SceneNumbers, path=path) for path in request.own or ()]
    chosen = _chosen(own or PACKS, request.only)
    rows: list[ComparedRow] = []
    packs = []
    for number, (pack, file, declared) in enumerate(chosen):
        if progress is not None:
            progress(file.title, number, len(chosen))
        began = time.monotonic()
        with quiet():  # what traces cut is no concern of a row
            found = _compared(pack, file, declared, request)
        rows += found
        packs.append(_summary(pack, file, found, time.monotonic() - began))
    facts = {"rays": request.rays or "as each pack says", "seed": request.seed}
    return Validation(tuple(rows), tuple(packs), {**facts, **versions()})


Chosen = list[tuple[Pack, ReferenceFile, Sequence[DeclaredRow]]]


def _chosen(packs: Sequence[Pack], patterns: Sequence[str] | None) -> Chosen:
    """Return packs of reference numbers, each with the rows whose names fit the patterns; all without patterns."""
    found: Chosen = []
    used = set()
    for pack in packs:
        file = pack.file
        rows = []
        for row in file.rows:
            fits = [one for one in patterns or () if _fits(pack.name, row.name, one)]
            used.update(fits)
            if fits or not patterns:
                rows.append(row)
        if rows:
            found.append((pack, file, rows))
    for one in patterns or ():
        if one not in used:
            raise MistrayError(f"only: no row fits '{one}'; {nearest(one, [pack.name for pack in packs])}")
    return found


def _fits(pack: str, row: str, pattern: str) -> bool:
    return fnmatchcase(pack, pattern) or fnmatchcase(f"{pack}/{row}", pattern)


def _compared(
    pack: Pack, file: ReferenceFile, declared: Sequence[DeclaredRow], request: ValidateRequest
) -> list[ComparedRow]:
    """Return a pack's rows with both numbers, or with the reason why the other program gave none."""
    ours = pack.numbers(file, request.rays, request.seed)
    theirs = _asked(pack, file, [row for row in declared if row.published is None], request)
    rows = []
    for row in declared:
        unit = row.unit or UNITS.get(row.quantity, "")
        if row.published is not None:
            published = Estimate(row.published, row.uncertainty)
        elif isinstance(theirs, str):
            rows.append(ComparedRow(pack.name, row.name, unit, UNKNOWN, UNKNOWN, math.nan, NOT_ASKED, theirs))
            continue
        else:
            published = theirs[row.name] or UNKNOWN
        rows.append(judged(pack.name, row, unit, published, ours(row)))
    return rows


def _asked(
    pack: Pack, file: ReferenceFile, rows: Sequence[DeclaredRow], request: ValidateRequest
) -> dict[str, Estimate | None] | str:
    """Return the other program's numbers by row name or, if it cannot run, why and how to install it."""
    if pack.peer is None or not rows:
        return {}
    if not pack.peer.installed:
        return pack.peer.install
    try:
        ask = pack.peer.ask(file, request.rays, request.seed)
        return {row.name: ask(row) for row in rows}
    except MistrayError:
        raise
    except Exception as error:  # code of others: a broken installation, or another release
        return f"{pack.peer.module} cannot be asked: {type(error).__name__}: {error}; {pack.peer.install}"


def judged(pack: str, row: DeclaredRow, unit: str, published: Estimate, found: Estimate | None) -> ComparedRow:
    """Return a row with its verdict: None (no light) differs, and a number without standard error gets none."""
    ours = found or UNKNOWN
    allowed = row.allowed(ours.se, published.value, published.se)
    if found is None:
        way = " → ".join(row.path) or "of the image"
        verdict, why = DIFFERS, f"no light takes the path {way}; check its surfaces, the field and the rays"
    elif not all(map(math.isfinite, (*ours, published.value))):
        verdict, why = TOO_FEW, "too few rays for a number with an error; give more rays"
    elif abs(ours.value - published.value) <= allowed:
        verdict, why = AGREES, ""
    else:
        verdict, why = KNOWN if row.differs else DIFFERS, row.differs
    return ComparedRow(pack, row.name, unit, published, ours, allowed, verdict, why)


def _summary(pack: Pack, file: ReferenceFile, rows: Sequence[ComparedRow], seconds: float) -> PackSummary:
    verdicts = Counter(row.verdict for row in rows)
    return PackSummary(
        pack=pack.name,
        title=file.title,
        count=len(rows),
        agree=verdicts[AGREES],
        known=verdicts[KNOWN],
        differ=verdicts[DIFFERS],
        left_out=verdicts[NOT_ASKED] + verdicts[TOO_FEW],
        seconds=seconds,
        source=file.source,
        licence=file.licence,
        note=" ".join(file.note.split()),
    )
