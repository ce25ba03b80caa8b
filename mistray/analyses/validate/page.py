"""Result of a validation against published numbers and other programs, as text, JSON values and an HTML report."""

from __future__ import annotations

import functools
import math
import platform
from collections.abc import Sequence
from typing import Any

from mistray.analyses.validate.declared import ERRORS
from mistray.analyses.validate.figures import differences_figure
from mistray.analyses.validate.result import (
    AGREES,
    DIFFERS,
    FAILED,
    KNOWN,
    NOT_ASKED,
    TOO_FEW,
    UNJUDGED,
    ComparedRow,
    PackSummary,
    Validation,
)
from mistray.estimate import Estimate
from mistray.files.json_values import plain
from mistray.toolkit.figures.plots import as_png
from mistray.toolkit.pages.model import FigurePart, Items, NotePart, Report, Section, Table, Value, columns
from mistray.toolkit.pages.parts import settings_section
from mistray.toolkit.rows import frame, records, table
from mistray.toolkit.tables.text import number, table_text

CRITERION = (
    f"A row agrees if the numbers differ by at most {ERRORS:g} standard errors of both, added in quadrature, plus what "
    "its source leaves open. Both are stated before the run."
)
WRONG = {DIFFERS: "differs and should agree", FAILED: "the other program failed"}
NAMES_TOLD = 4  # of the rows with one reason; all have it in the CSV file
LEAST_DIGITS, PRINTED, MOST_DIGITS = 4, 6, 10
HEADS = ("<number", "<verdict", "published", "ours", "difference", "allowed", "<unit")
COUNTS = ("pack", "title", "count", "agree", "known", "differ", "left_out", "seconds")


def _number(value: Estimate, allowed: float) -> Value:
    """
    Return a table cell of a number: with its standard error if it has one, else as its source prints it.

    A number without error that needs more than 6 digits has as many as the allowed difference asks for, 4 to 10.
    """
    if value.se > 0 and math.isfinite(value.se):
        return value
    if float(f"{value.value:.{PRINTED}g}") == value.value:
        return number(value.value, PRINTED)
    digits = math.log10(abs(value.value) / allowed) if allowed > 0 and value.value else 0.0
    return number(value.value, min(max(math.floor(digits) + 2, LEAST_DIGITS), MOST_DIGITS))


def _cells(row: ComparedRow) -> list[Value]:
    return [
        row.name,
        row.verdict,
        _number(row.published, row.allowed),
        _number(row.ours, row.allowed),
        number(row.difference, 2),
        number(row.allowed, 2),
        row.unit if row.unit != "1" else "",
    ]


def pack_table(rows: Sequence[ComparedRow], name: str = "") -> Table:
    """Return the table of compared rows from one source of numbers (a pack)."""
    return Table(columns(*HEADS), [_cells(row) for row in rows], name)


def rows_table(found: Validation) -> Table:
    """Return the table of all compared rows, with the source of each."""
    return Table(columns("<pack", *HEADS), [[row.pack, *_cells(row)] for row in found.rows])


def reasons(rows: Sequence[ComparedRow]) -> list[str]:
    """Return why rows differ or were left out, each reason once with its rows: their names, or their number if many."""
    by_reason: dict[str, list[str]] = {}
    for row in rows:
        if row.why:
            by_reason.setdefault(row.why, []).append(row.name)
        elif row.verdict == DIFFERS:
            by_reason.setdefault("no reason is known; please report it with this table", []).append(row.name)
    return [f"{_told(names)}: {why}" for why, names in by_reason.items()]


def _told(names: Sequence[str]) -> str:
    """Return the names, or of more than `NAMES_TOLD` the first ones with the number of all."""
    if len(names) <= NAMES_TOLD:
        return "; ".join(names)
    return f"{len(names)} numbers, such as {'; '.join(names[: NAMES_TOLD - 1])}"


def finding(found: Validation) -> str:
    """Return in one sentence how many rows of a validation agree and how many differ."""
    words = {AGREES: "agree", KNOWN: "known to differ", DIFFERS: "differ and should agree"}
    words |= {FAILED: "whose program failed", NOT_ASKED: "without the program that they ask"}
    words |= {TOO_FEW: "with too few rays"}
    told = {verdict: f"{found.count(verdict)} {text}" for verdict, text in words.items() if found.count(verdict)}
    judged = [text for verdict, text in told.items() if verdict not in UNJUDGED]
    unjudged = [text for verdict, text in told.items() if verdict in UNJUDGED]
    if unjudged:
        judged.append(f"{sum(map(found.count, UNJUDGED))} without a verdict ({', '.join(unjudged)})")
    numbers = "number" if len(found.rows) == 1 else "numbers"
    return f"{len(found.rows)} {numbers} beside ours: {', '.join(judged)}"


def text(found: Validation) -> str:
    """Return all tables, with sources, reasons of differences and notes of traces, and the finding in a sentence."""
    parts = []
    for pack in found.packs:
        rows = found.of(pack.pack)
        parts.append(f"{pack.pack}: {pack.title}\nsource: {pack.source}\n\n{table_text(pack_table(rows))}")
        why = reasons(rows)
        if why:
            parts.append("\n".join(f"  {one}" for one in why))
    if found.notes:
        parts.append("\n".join(f"warning: {note}" for note in found.notes))
    return "\n\n".join([*parts, f"{finding(found)}."])


def record(found: Validation) -> dict[str, Any]:
    """Return the compared rows, their sources and the settings as JSON-serialisable values."""
    values = {"rows": records(ComparedRow, found.rows), "packs": records(PackSummary, found.packs)}
    return dict(plain({"holds": found.holds} | values | {"notes": [*found.notes], "facts": found.facts}))


def page(found: Validation, command: str = "") -> Report:
    """Return the HTML report: a summary, the picture of differences, and a section for each source of numbers."""
    drawn = FigurePart(functools.partial(differences_figure, found), "Differences over what is allowed.")
    summary = table(PackSummary, found.packs, "t-packs", only=COUNTS)
    sections = [
        Section("summary", "Packs", [summary], "Packs"),
        Section("picture", "Differences", [drawn, NotePart(CRITERION, "note")], "Differences"),
    ]
    for pack in found.packs:
        rows = found.of(pack.pack)
        licence = f" ({pack.licence})" if pack.licence else ""
        parts: list[Any] = [NotePart(f"Source: {pack.source}{licence}.", "note")]
        if pack.note:
            parts.append(NotePart(pack.note))
        parts.append(pack_table(rows, f"t-{pack.pack}"))
        why = reasons(rows)
        if why:
            parts += [NotePart("Why", "h3"), Items(why)]
        sections.append(Section(f"pack-{pack.pack}", pack.title, parts, pack.pack))
    facts = {**found.facts, "machine": platform.machine()}
    notes = [str(note) for note in found.notes]
    return Report(
        "Validation",
        f"mistray {found.facts.get('mistray', '')}".rstrip(),
        [*sections, settings_section(facts, command, link="Settings")],
        lead=[NotePart(f"{finding(found)}.")],
        warnings=[
            *(f"{row.pack}, {row.name}: {WRONG[row.verdict]}" for row in found.rows if row.verdict in WRONG),
            *notes,
        ],
        csv={"validation.csv": frame(ComparedRow, found.rows), "packs.csv": frame(PackSummary, found.packs)},
        json={"validation.json": {"command": command} | record(found)},
        files={"differences.png": as_png(differences_figure(found))},
        result=found,
    )
