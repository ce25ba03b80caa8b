"""First page of the report of a ghost analysis: verdict, and the worst paths as picture and table."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.verdict import (
    Remedy,
    WorstPath,
    brightest_field,
    most_stray,
    remedy,
    shares_of_kinds,
    worst_of_all_fields,
)
from mistray.estimate import Estimate
from mistray.toolkit.pages.model import FigurePart, Items, Link, NotePart, PagePart, PartGroup, Table, Value, columns
from mistray.toolkit.rows import table
from mistray.toolkit.tables.frames import estimate_of
from mistray.toolkit.tables.text import number, plain_sentences, with_error

if TYPE_CHECKING:
    from mistray.toolkit.figures.figure import Figure as Drawing

PATHS_DRAWN = 3
LEAST_PERCENT = 1.0  # of the stray light, for a kind of path to be named
DRAWN = (
    "The worst paths of all fields, each at the field where it is worst. Section x = 0, onto which rays are projected; "
    "dots are reflections and scatter."
)
WORST = (
    "Each path stands once, at the field where it is worst{drawn}. Normalised: RMS irradiance over that of the direct "
    "image on axis."
)
DEEDS = {"reflects": "is reflected there", "scatters": "is scattered there", "passes": "passes through it"}
Sentence = str | Markup


def answer(report: GhostReport, shown: GhostReport) -> list[PagePart]:
    """
    Return the verdict and the picture of the worst paths as page parts; `shown` holds the fields that are drawn.

    Without a stray path in these fields there is no picture.
    """
    worst = worst_of_all_fields(shown, PATHS_DRAWN) if shown else []
    parts: list[PagePart] = [Items(verdict(report), "verdict")]
    if worst:
        parts.append(FigurePart(functools.partial(draw_answer, report, worst), DRAWN, _told(worst)))
    return [PartGroup("answer", parts)]


def draw_answer(report: GhostReport, worst: Sequence[WorstPath]) -> Drawing:
    """Return a drawing of the section of the system with rays of the worst paths of all fields."""
    from mistray.toolkit.drawings.section_layout import layout_of_fields  # the values of this page need no pictures

    return layout_of_fields(
        report, [(path.field_deg, path.path_id, f"{k} {_name(path)}") for k, path in enumerate(worst, 1)]
    )


def worst_table(report: GhostReport, shown: GhostReport) -> list[PagePart]:
    """
    Return the table of the worst paths of all fields, with links to the fields in `shown`, as page parts.

    Without a stray path a note takes its place.
    """
    worst = worst_of_all_fields(report)
    if not worst:
        return [NotePart("No stray path reaches the detector.")]
    fields = [[", ".join(f"{field:g}" for field in path.fields)] for path in worst]
    places: list[list[Value]] = [
        [Link(f"{at:g}", field_anchor(at)) if at in shown else f"{at:g}"] for at in (path.field_deg for path in worst)
    ]
    listed = Table(columns("no."), [[k] for k in range(1, len(worst) + 1)], "t-worst").beside(
        table(WorstPath, worst, only=("marked", "kind")),
        Table(columns("worst at [deg]"), places),
        table(WorstPath, worst, only=("power_W", "percent_of_stray", "normalised", "peak_W_mm2")),
        Table(columns("<fields [deg]"), fields),
    )
    note = WORST.format(
        drawn=f"; the first {min(PATHS_DRAWN, len(worst))} are drawn above" if list(shown) == list(report) else ""
    )
    return [listed if report.rank == "peak" else listed.without("peak"), NotePart(note, "note")]


def field_anchor(field_deg: float) -> str:
    """Return the HTML id of a field's section on the page."""
    return f"field-{field_deg:g}".replace(".", "_")


def verdict(report: GhostReport) -> list[Sentence]:
    """
    Return sentences on the amount, kinds and angles of the stray light, the surface to change first and the gain.

    Without a stray path a single sentence says so.
    """
    field = most_stray(report)
    if field is None:
        return ["No stray path reaches the detector."]
    return [_how_much(report, field), _from_where(report, field), *_brightest(report), *_change(remedy(report))]


def verdict_record(report: GhostReport) -> dict[str, Any]:
    """Return the verdict as JSON-serialisable values, with the remedy and the stray power that it leaves, W."""
    found = remedy(report)
    record: dict[str, Any] = {"sentences": plain_sentences(verdict(report)), "remedy": None}
    if found is not None:
        record["remedy"] = {
            "surface": found.surface,
            "deed": found.deed,
            "field_deg": found.field_deg,
            "percent_of_stray": found.percent.value,
            "percent_of_stray_se": found.percent.se,
            "left": [
                {"field_deg": field, "stray_W": left.value, "stray_se_W": left.se}
                for field, left in found.left_W.items()
            ],
        }
    return record


def _how_much(report: GhostReport, field: float) -> str:
    most = report.summary(field)
    text = f"Most stray light arrives at {field:g}°: {_plain(most.stray_W)} W"
    relative = {at: report.summary(at).stray_to_nominal for at in report}
    if relative[field].value > 0:
        text += f", {_percent(relative[field])} of the power of the direct image on axis"
        least = min(relative, key=lambda at: relative[at].value)
        if least != field:
            text += f"; least at {least:g}°, {_percent(relative[least])}"
    return f"{text}."


def _from_where(report: GhostReport, field: float) -> Markup:
    kinds = shares_of_kinds(report, field)
    named = [kind for kind, share in kinds.items() if share.value >= LEAST_PERCENT] or list(kinds)[:1]
    shares = ", ".join(f"{number(kinds[kind].value, 3)} % {kind}" for kind in named)
    row = report.top(field, 1, "power").iloc[0]
    power = _plain(estimate_of(row, "power_W"))
    return Markup("At {:g}° it is {}; the strongest path is <b>{}</b> with {} W.").format(
        field, shares, row.label, power
    )


def _brightest(report: GhostReport) -> list[Markup]:
    field = brightest_field(report)
    if field is None:
        return []
    row = report.top(field, 1, "rms").iloc[0]
    normalised = _plain(report.summary(field).brightest_normalised)
    text = "The brightest path is <b>{}</b> at {:g}°: its RMS irradiance is {} of that of the direct image on axis."
    return [Markup(text).format(row.label, field, normalised)]


def _change(found: Remedy | None) -> list[Sentence]:
    if found is None:
        return []
    left = found.left_W[found.field_deg]
    first = Markup("Change <b>{}</b> first: {} % of the stray light at {:g}° {}.").format(
        found.surface, _plain(found.percent), found.field_deg, DEEDS[found.deed]
    )
    second = f"Without that light {f'{_plain(left)} W' if left.value else 'nothing'} is left there"
    most = max(found.left_W, key=lambda at: found.left_W[at].value)
    if most != found.field_deg:
        second += f", and the field with the most would be {most:g}° with {_plain(found.left_W[most])} W"
    return [first, f"{second}."]


def _plain(value: Estimate) -> str:
    """Return a value and its standard error, of one digit, as text, such as "9.355e-05 ± 1e-08"."""
    return with_error(value, 1)


def _percent(share: Estimate) -> str:
    return f"{_plain(share.times(100))} %"


def _name(path: WorstPath) -> str:
    kind = f" ({path.kind})"  # labels of structure paths end in it
    return f"{path.label.removesuffix(kind)}{kind}, {path.field_deg:g}°"


def _told(worst: Sequence[WorstPath]) -> str:
    return f"Section of the system with rays of {'; '.join(_name(path) for path in worst)}"
