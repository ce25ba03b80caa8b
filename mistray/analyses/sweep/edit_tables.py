"""Tables, text and JSON values on the effect of edits on the PST, by comparison or by derivatives."""

from __future__ import annotations

from typing import Any

from mistray.analyses.sweep.edit_ranking import Edit, EditRanking
from mistray.analyses.sweep.pst_sweep import PstSweep
from mistray.files.json_values import plain
from mistray.toolkit.pages.model import Table, columns
from mistray.toolkit.tables.frames import chosen
from mistray.toolkit.tables.text import number, table_text, with_error

ENTERS = "of it by new first surfaces"
SHOWN = {
    "configuration": "<configuration",
    "angle_deg": "angle [deg]",
    "before": "stray PST before",
    "after": "after",
    "ratio": "after/before",
    "entering_percent": f"{ENTERS} [%]",
}
OPENS = (
    "opens: surfaces that meet, and how far one step takes them apart in the sense that lowers the PST. "
    "The derivatives do not contain the light that enters there; such edits come after the others"
)


PAIRED = "the error of after/before is that of runs with the same random numbers"


def pst_sweep_table(found: PstSweep) -> Table:
    """Return the table of stray PST before and after edits, with a row for each configuration and field angle."""
    changes = found.to_pandas()
    enters = changes.entering != ""
    shown = chosen(changes.assign(entering_percent=changes.entering_percent.where(enters)), SHOWN, "t-edits")
    return shown if enters.any() else shown.without(ENTERS)


def pst_sweep_text(found: PstSweep) -> str:
    """Return the table of PSTs before and after edits as text, with a remark on the errors and the warnings."""
    return "\n".join([table_text(pst_sweep_table(found)), "", PAIRED, *(f"warning: {text}" for text in found.warnings)])


def pst_sweep_record(found: PstSweep) -> dict[str, Any]:
    """Return a PST sweep as JSON-serialisable values."""
    rows = found.to_pandas().to_dict("records")
    for row in rows:
        row["entering"] = found.changed(row["configuration"], row["angle_deg"]).entering
    gaps = {name: some for name, some in found.gaps.items() if some}
    record = {"configurations": list(found.configurations), "rows": rows, "gaps": gaps, "warnings": found.warnings}
    return dict(plain(record))


def edit_ranking_table(found: EditRanking, count: int = 20) -> Table:
    """
    Return the table of edits with the effect of one step at each field angle, percent.

    Edits that change nothing are left out.

    Parameters
    ----------
    found : EditRanking
        Ranking of the edits.
    count : int
        Largest number of rows.
    """
    each = (f"at {angle:g} deg [% per step]" for angle in found.field_deg)
    heads = columns("<edit", "<parameter", "value", "step", "<unit", *each, "<opens")
    shown = _that_matter(found)[:count]
    lines = [
        [edit.method, edit.label, number(edit.value), number(edit.step), edit.unit]
        + [change.times(100) for change in edit.change]
        + ["; ".join(f"{' – '.join(gap.surfaces)} {gap.gap_mm:.3g} mm" for gap in edit.gaps)]
        for edit in shown
    ]
    if not any(edit.gaps for edit in shown):
        heads, lines = heads[:-1], [line[:-1] for line in lines]
    return Table(heads, lines, "t-ranking", empty="none")


def edit_ranking_text(found: EditRanking, count: int = 20) -> str:
    """Return the PST that is ranked, the first `count` rows of `edit_ranking_table`, and remarks on it, as text."""
    parts = [ranked_light(found), "", table_text(edit_ranking_table(found, count))]
    return "\n".join([*parts, *ranking_notes(found, count)])


def ranked_light(found: EditRanking) -> str:
    """Return a line of text with the PST, at each field angle, of the class of light that the ranking is about."""
    pst = ", ".join(f"{with_error(at)} at {angle:g} deg" for angle, at in zip(found.field_deg, found.pst, strict=True))
    return f"PST of the {found.light} light: {pst}"


def ranking_notes(found: EditRanking, count: int = 20) -> list[str]:
    """Return remarks on edits that a table of `count` rows leaves out, and on the limits of the derivatives."""
    matter, notes = _that_matter(found), []
    if len(matter) > count:
        notes.append(f"… and {len(matter) - count} with less")
    if len(found.edits) > len(matter):
        notes.append(f"{len(found.edits) - len(matter)} more change nothing")
    widths = [f"{w:g} at {a:g} deg" for a, w in zip(found.field_deg, found.edge_width, strict=True) if w is not None]
    if widths:
        notes.append(f"width of the zones at rims, over their radii: {', '.join(widths)}; errors hold its bias")
    if any(edit.gaps for edit in matter[:count]):
        notes.append(OPENS)
    return [*notes, *(f"not in the derivatives: {text}" for text in found.left_out)]


def _that_matter(found: EditRanking) -> list[Edit]:
    return [edit for edit in found.edits if any(change.value for change in edit.change)]


def edit_ranking_record(found: EditRanking) -> dict[str, Any]:
    """Return a ranking of edits as JSON-serialisable values."""
    rows = found.to_pandas().to_dict("records")
    for row in rows:
        row["gaps"] = found[row["label"]].gaps
    facts = {"light": found.light, "ranking": rows, "left_out": found.left_out, "edge_width": found.edge_width}
    return dict(plain(facts))
