"""Notes on the reliability of the results of a ghost analysis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mistray.messages import Message, fewer_rays
from mistray.notes import Code, Note
from mistray.time_budget import not_traced
from mistray.trace.reliability import trace_notes

if TYPE_CHECKING:
    from mistray.analyses.ghosts.result import GhostReport

WORST = 4  # paths of a field whose errors must be known


def ghost_notes(report: GhostReport) -> list[Note]:
    """Return notes on the traces, each once with its field angles, and on the ranking; the list may be empty."""
    found: list[Note] = []
    if missing := [f"{field:g}" for field in report.not_traced]:
        text = not_traced(missing, len(missing) + len(report), "fields, deg")
        found.append(Message.NOT_TRACED.note(what=text))
    if report.nominal.power_W.value == 0:
        found.append(Message.DARK_ON_AXIS.note())
    fields = list(report)
    own = {note for t in report.values() for note in t.own_notes}
    notes = [(at, note) for at, note in trace_notes(list(report.values())) if note.code != Code.UNFINISHED]
    found += [note if note in own else note.beside(fields_text([fields[k] for k in at])) for at, note in notes]
    if fewer := {f: t for f, t in report.items() if any(note.code == Code.UNFINISHED for note in t.own_notes)}:
        least = min(t.rays_traced for t in fewer.values())
        of_least = [field for field, t in fewer.items() if t.rays_traced == least]
        more = f"; of {len(fewer) - len(of_least)} other fields more" if len(fewer) > len(of_least) else ""
        found.append(fewer_rays(least, fewer[of_least[0]].rays_planned, more).beside(fields_text(of_least)))
    if few := [field for field in report if report.top(field, WORST).few_rays.any()]:
        found.append(Message.FEW_RAYS.note().beside(fields_text(few)))
    if report.rank == "rms":
        for field in report:
            for path_id in report.rivals(field).path_id[:1]:
                found.append(Message.CONTESTED.note(path_id=path_id).beside(fields_text([field])))
    return found


def fields_text(field_deg: Sequence[float]) -> str:
    """Return the text "field … deg" with field angles, as the prefix of a note."""
    return f"field {', '.join(f'{field:g}' for field in field_deg)} deg"
