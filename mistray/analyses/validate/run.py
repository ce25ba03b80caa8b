"""Run of a validation: choose rows, compute mistray's numbers, get those of other programs, and judge them."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from mistray.analyses.validate.declared import ERRORS, UNITS, DeclaredRow, ReferenceFile, read_reference, require_own
from mistray.analyses.validate.pack import Finder, Pack, PeerError
from mistray.analyses.validate.packs.known import PACKS
from mistray.analyses.validate.request import ValidateRequest
from mistray.analyses.validate.result import (
    AGREES,
    DIFFERS,
    FAILED,
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
from mistray.ids import free_name
from mistray.notes import Code, Note, quiet
from mistray.trace.forward import versions

# Standard errors, and light that is missing, stand in the rows; how to trace better is no matter of a comparison
LEFT_OUT = (Code.ERROR, Code.AIMED, Code.SCATTERED_RAYS, Code.SILENT, Code.OUTSIDE_SEEN)
Progress = Callable[[str, int, int], None]
"""Called with the title of the pack that begins, the number of packs before it and that of all."""


@dataclass(frozen=True)
class OwnPack(Pack):
    """Reference numbers in a file that a user wrote, in the form of a built-in pack; `path` is that of the file."""

    path: str = ""

    @property
    def file(self) -> ReferenceFile:
        """
        Reference numbers of the user's file.

        Raises
        ------
        MistrayError
            If the file cannot be read, lacks a scene, a quantity or a published number, or has a table `given`.
        """
        found = read_reference(self.path)
        require_own(found, self.path)
        return found


def run_validation(request: ValidateRequest, progress: Progress | None = None) -> Validation:
    """
    Return mistray's numbers beside published ones and those of other programs, with a verdict on each.

    Parameters
    ----------
    request : ValidateRequest
    progress : callable, optional
        See `Progress`.

    Returns
    -------
    Validation
        One row for each chosen number, also if its program is not installed or fails.

    Raises
    ------
    MistrayError
        If a pattern fits no row, a file of the user's own is not valid, or its scene cannot be loaded or traced.
    """
    own: dict[str, Pack] = {}
    for path in request.own or ():
        name = free_name(Path(path).stem, "", own)
        own[name] = OwnPack(name, SceneNumbers, path=path)
    chosen = _chosen([*own.values()] or PACKS, request.only)
    rows: list[ComparedRow] = []
    packs, notes = [], list[Note]()
    for number, (pack, file, declared) in enumerate(chosen):
        if progress is not None:
            progress(file.title, number, len(chosen))
        began = time.monotonic()
        kept: list[Note] = []
        with quiet(kept):
            found = _compared(pack, file, declared, request)
        notes += [note.beside(pack.name) for note in dict.fromkeys(kept) if note.code not in LEFT_OUT]
        rows += found
        packs.append(_summary(pack, file, found, time.monotonic() - began))
    facts = {"rays": request.rays or "as each pack says", "seed": request.seed}
    return Validation(tuple(rows), tuple(packs), {**facts, **versions()}, tuple(notes))


Chosen = list[tuple[Pack, ReferenceFile, Sequence[DeclaredRow]]]


def _chosen(packs: Sequence[Pack], patterns: Sequence[str] | None) -> Chosen:
    """
    Return packs of reference numbers, each with the rows that a pattern chooses; without patterns with all rows.

    A pattern fits the name of a pack, for all its rows, or ``pack/row``. Packs without a chosen row are left out.

    Raises
    ------
    MistrayError
        If a pattern fits no row.
    """
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
    rows = []
    for row in declared:
        unit = row.unit or UNITS.get(row.quantity, "")
        published = Estimate(row.published, row.uncertainty) if row.published is not None else _asked(pack, row, ours)
        if isinstance(published, _NoAnswer):
            rows.append(
                ComparedRow(pack.name, row.name, unit, UNKNOWN, UNKNOWN, math.nan, published.verdict, published.why)
            )
        else:
            fewer = request.rays is not None and request.rays < file.rays
            rows.append(judged(pack.name, row, unit, published, ours(row), fewer=fewer))
    return rows


@dataclass(frozen=True)
class _NoAnswer:
    """Verdict and reason of a row whose program gives no number."""

    verdict: str
    why: str


def _asked(pack: Pack, row: DeclaredRow, ours: Finder) -> Estimate | _NoAnswer | None:
    """
    Return the number of the other program for a row; None if it has no such light.

    If the program is not installed, fails, or gives no finite number, return a `_NoAnswer`.
    """
    peer = pack.peer
    assert peer is not None  # a row without a published number has one
    if not peer.installed:
        return _NoAnswer(NOT_ASKED, peer.install)
    try:
        found = peer.ask(row, ours)
    except PeerError as error:
        return _NoAnswer(FAILED, f"{peer.module} failed: {error}; try another release, {peer.install}")
    if found is not None and not math.isfinite(found.value):
        return _NoAnswer(FAILED, f"{peer.module} gives {found.value:g}; try another release, {peer.install}")
    return found


def judged(
    pack: str, row: DeclaredRow, unit: str, published: Estimate | None, found: Estimate | None, *, fewer: bool = False
) -> ComparedRow:
    """
    Return a row with its verdict, from the number of the source and mistray's, `found`; None: it has no such light.

    A row without light on one side or both differs, whatever reason it gives. Only if mistray alone has none with
    `fewer` rays than the pack asks for, the rays are too few. They are also too few if mistray's number has no known
    error, or one so large that it would agree in any case, see `_vague`.
    """
    theirs, ours = published or UNKNOWN, found or UNKNOWN
    allowed = row.allowed(ours.se, theirs.value, theirs.se)
    if found is None and published is not None and fewer:
        verdict, why = TOO_FEW, "too few rays: none takes this way; give more rays"
    elif published is None or found is None:
        verdict, why = DIFFERS, _lost(row, published, found)
    elif not math.isfinite(ours.se):
        verdict, why = TOO_FEW, "too few rays for a number with an error; give more rays"
    elif abs(ours.value - theirs.value) <= allowed:
        why = _vague(row, theirs, ours)
        verdict = TOO_FEW if why else AGREES
    elif row.expected is None:
        verdict, why = DIFFERS, ""
    elif abs(ours.value - row.expected) <= row.allowed(ours.se, row.expected, row.expected_uncertainty):
        verdict, why = KNOWN, row.differs
    else:
        verdict, why = DIFFERS, f"ours was {row.expected:g} when this reason was found: {row.differs}"
    return ComparedRow(pack, row.name, unit, theirs, ours, allowed, verdict, why)


def _vague(row: DeclaredRow, theirs: Estimate, ours: Estimate) -> str:
    """Return the reason why the agreement of a number proves nothing, its error being too large; "" if it does."""
    if ERRORS * ours.se > max(abs(theirs.value), row.allowed(0.0, theirs.value, theirs.se)):
        return f"too few rays: {ERRORS:g} standard errors are more than the number; give more rays"
    if row.expected is None:
        return ""

    def agree(number: Estimate, other: Estimate) -> bool:
        return abs(number.value - other.value) <= row.allowed(number.se, other.value, other.se)

    expected = Estimate(row.expected, row.expected_uncertainty)
    if agree(ours, expected) and not agree(expected, theirs):
        return "too few rays to tell the number from the one that is known to differ; give more rays"
    return ""


def _lost(row: DeclaredRow, published: Estimate | None, found: Estimate | None) -> str:
    """Return a sentence that says on which side a row has no light: in mistray, in the other program, or in both."""
    way = f"by the path {' → '.join(row.path)}" if row.path else "of this kind"
    side = "on either side" if published is found else "in the other program" if published is None else "in ours"
    return f"there is no light {way} {side}; check its surfaces, the field and the rays"


def _summary(pack: Pack, file: ReferenceFile, rows: Sequence[ComparedRow], seconds: float) -> PackSummary:
    verdicts = Counter(row.verdict for row in rows)
    return PackSummary(
        pack=pack.name,
        title=file.title,
        count=len(rows),
        agree=verdicts[AGREES],
        known=verdicts[KNOWN],
        differ=verdicts[DIFFERS] + verdicts[FAILED],
        left_out=verdicts[NOT_ASKED] + verdicts[TOO_FEW],
        seconds=seconds,
        source=file.source,
        licence=file.licence,
        note=" ".join(file.note.split()),
    )
