"""Critical, illuminated and common objects as printed text, JSON values, tables and a report page."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from mistray.analyses.objects.request import ObjectsTables
from mistray.analyses.objects.result import Objects
from mistray.analyses.objects.rows import LISTS, CommonObject, ScatterEstimate, SceneObject, StraightShot
from mistray.files.json_values import plain
from mistray.toolkit.pages.model import (
    FigurePart,
    Fold,
    Folded,
    NotePart,
    PagePart,
    Report,
    Section,
    Table,
    Value,
    columns,
)
from mistray.toolkit.pages.output import write_report
from mistray.toolkit.pages.parts import settings_section, terms, version_settings
from mistray.toolkit.rows import frame, records, table
from mistray.toolkit.tables.text import number, table_text

if TYPE_CHECKING:
    import pandas as pd

ESTIMATES_SHOWN = 10
DEFAULT_TABLES = ObjectsTables()
PLACE = ("id", "side", "part", "space", "between", "stop")  # where an object stands, as tables show it
APART = "Lit in one place and seen in another, so not common: {}."

CAPTION = (
    "Surfaces by what sees them. A surface with two sides has the colour of the more important one; the strongest "
    "common objects have their names above."
)
ESTIMATE = (
    "Flux on the object times its BSDF times the projected solid angle π GCF of the detector, by one scatter event and "
    "no ghost. An estimate: the factors are means over pieces of the object."
)
NO_SCATTER = "No common object scatters; give the surfaces scatter models."
COMMON = "In the order of the light. By one scatter event each of them can send light to the detector."
SHOTS = "Ways by which the detector sees the outside past the optics, with neither reflection nor scatter."
NO_SHOTS = "The detector sees the outside by the design path only."


def object_table(rows: Sequence[SceneObject], most: int = DEFAULT_TABLES.rows, name: str = "") -> Table:
    """Return the table of critical or illuminated objects, the strongest first; as text at most `most` rows."""
    left = rows[most:]
    power = number(sum(row.power for row in left), 3)
    rest: list[Value] = [sum(row.rays for row in left), power, f"… and {len(left)} more", "", "", "", "", ""]
    only = ("rays", "power", *PLACE)
    words = ("filter rows, for example: barrel", "filter the objects")
    return table(SceneObject, rows, name, only, filter=words, most=most, rest=rest, empty="none")


def common_table(rows: Sequence[CommonObject], most: int = DEFAULT_TABLES.rows, name: str = "") -> Table:
    """Return the table of common objects or of optics, in the order of the light; as text at most `most` rows."""
    only = (*PLACE, "critical_power", "critical_rays", "illuminated_power", "illuminated_rays")
    rest = [f"… and {len(rows) - most} more", *[""] * 9]
    return table(CommonObject, rows, name, only, most=most, rest=rest, empty="none")


def main_table(found: Objects) -> Table:
    """Return the table of common objects, or of critical ones if none is common."""
    return common_table(found.common).without("rays") if found.common else object_table(found.critical)


def estimate_table(estimates: Sequence[ScatterEstimate], most: int | None = None) -> Table:
    """
    Return the table of product estimates: all objects, or the `most` strongest at each source angle.

    Estimates of 0 are left out.
    """
    shown = [row for row in estimates if row.pst.value > 0]
    only = ("angle_deg", "id", "optic", "side", "stop", "flux_W", "bsdf_1_sr", "gcf", "pst", "percent")
    words = ("filter rows", "filter the estimates")
    empty = "none: no common object scatters; give the surfaces scatter models"
    found = table(ScatterEstimate, shown, "t-estimates", only, filter=words, empty=empty)
    if most is not None:
        rows: list[Sequence[Value]] = []
        for angle, group in itertools.groupby(shown, lambda row: f"{row.angle_deg:g}"):
            own = [replace(row, id=f"{row.id} (optic)") if row.optic else row for row in group]
            rows += table(ScatterEstimate, own[:most], only=only).rows
            if left := own[most:]:
                sums = [number(sum(row.pst.value for row in left), 3), number(sum(row.percent for row in left), 3)]
                rows.append([angle, f"… and {len(left)} more", *[""] * 6, *sums])
        found = replace(found, rows=rows).without("optic")
    return found if any(math.isfinite(row.angle_deg) for row in shown) else found.without("angle")


def heading(found: Objects) -> str:
    """Return two lines of text on rays, source, wavelength, settings and stop of the trace."""
    facts = found.facts
    stop = f"aperture stop: {found.stop}" if found.stop else "aperture stop: not found"
    view = facts["view_half_angle_deg"]
    cone = "" if view >= 90 else f" within {view:g}° of its normal"
    control = facts["ray_control"].replace("_", " ")
    return (
        f"{facts['rays']:.3g} rays from the detector '{facts['detector']}'{cone} backwards, as many from "
        f"outside ({found.source_text})\n{facts['wavelength_nm']:g} nm; surfaces: {control}"
        f"{'' if facts['total_reflection'] else ', no total reflection'}; "
        f"objects count from {facts['threshold']:g} W for each W that starts; {stop}"
    )


def text(found: Objects, shown: ObjectsTables = DEFAULT_TABLES) -> str:
    """Return the text that `mistray objects` prints; each list of objects has at most as many rows as `shown` says."""
    most = shown.rows
    parts = [
        heading(found),
        "",
        f"Critical objects: {len(found.critical)}, seen by the detector",
        table_text(object_table(found.critical, most)),
        "",
        f"Illuminated objects: {len(found.illuminated)}, reached by light from outside",
        table_text(object_table(found.illuminated, most)),
        "",
        f"Common objects: {len(found.common)}, critical and illuminated",
        table_text(common_table(found.common, most).without("rays")),
        "",
        f"The {len(found.optics)} surfaces of the design path are common by design and not listed here.",
    ]
    if found.apart:
        parts.append(APART.format(", ".join(row.id for row in found.apart)))
    estimates = table_text(estimate_table(found.products, ESTIMATES_SHOWN))
    parts += ["", "Light by one scatter event, estimated as Φ · BSDF · π GCF", estimates, "", "±: one standard error"]
    return "\n".join([*parts, *(f"warning: {note}" for note in found.notes)])


def csv_tables(found: Objects) -> dict[str, pd.DataFrame]:
    """
    Return the tables of a result as DataFrames, by file name.

    Empty lists keep their columns; only the list "apart" is left out if it is empty.
    """
    tables = {f"objects_{name}.csv": found.to_pandas(name) for name in LISTS if name != "apart" or found.apart}
    tables["objects_estimates.csv"] = found.estimates()
    tables["objects_straight_shots.csv"] = frame(StraightShot, found.straight_shots)
    return tables


def shot_table(shots: Sequence[StraightShot]) -> Table:
    """Return the table of straight shots, paths past the optics from outside to the detector."""
    ways = [[Fold(shot.way, " ".join(shot.surfaces))] for shot in shots]
    angles = [[f"{shot.angle_from_deg:.3g} … {shot.angle_to_deg:.3g}"] for shot in shots]
    shown = table(StraightShot, shots, only=("rays", "share"))
    return Table(columns("<way"), ways, "t-shots").beside(shown, Table(columns("field angles [deg]"), angles))


def record(found: Objects, shown: ObjectsTables = DEFAULT_TABLES) -> dict[str, Any]:
    """Return the whole result as JSON-serialisable values; `shown` has no effect."""
    values = {
        "facts": found.facts,
        "stop": found.stop,
        "angles_deg": list(found.field_deg),
        **{name: records(kind, getattr(found, name)) for name, kind in LISTS.items()},
        "estimates": records(ScatterEstimate, found.products),
        "straight_shots": records(StraightShot, found.straight_shots),
        "warnings": found.notes,
    }
    return dict(plain(values))


def page(found: Objects, shown: ObjectsTables = DEFAULT_TABLES, title: str = "scene", command: str = "") -> Report:
    """
    Return the report with all rows, whatever `shown` says; `title` names the optical system.

    `command` is the command line quoted in it.
    """
    from mistray.analyses.objects.figures import objects_layout
    from mistray.toolkit.figures.plots import as_png

    png = as_png(objects_layout(found, title))
    first, second = heading(found).splitlines()
    estimated, shots = estimate_table(found.products), shot_table(found.straight_shots)
    sections = [
        Section("layout", "Layout", [FigurePart(png, CAPTION, "objects in the section of the system")], "Layout"),
        Section("common", "Common objects", _common(found), "Common"),
        Section(
            "estimates",
            "Light by one scatter event",
            [NotePart(ESTIMATE), estimated] if estimated.rows else [NotePart(NO_SCATTER)],
            "Estimate",
        ),
        Section("critical", "Critical objects", [object_table(found.critical, name="t-critical")], "Critical"),
        Section(
            "illuminated", "Illuminated objects", [object_table(found.illuminated, name="t-illuminated")], "Illuminated"
        ),
        Section(
            "straight",
            "Straight shots",
            [NotePart(SHOTS), shots] if shots.rows else [NotePart(NO_SHOTS)],
            "Straight shots",
        ),
        settings_section(found.facts | version_settings(), command, terms("objects"), link="Settings"),
    ]
    return Report(
        "Critical and illuminated objects",
        title,
        sections,
        lead=[NotePart(Markup("{}.<br>{}.").format(first, second), "sub"), NotePart(_finding(found))],
        warnings=found.notes,
        tab="Objects",
        csv=csv_tables(found),
        json={"objects.json": {"title": title, "command": command} | record(found)},
        result=found,
        files={"objects.png": png},
        page="objects.html",
    )


def write_objects(
    found: Objects, estimates: pd.DataFrame, directory: str | Path, title: str = "scene", command: str = ""
) -> list[Path]:
    """
    Write the tables of `csv_tables`, objects.png, objects.json and objects.html into a directory, see `write_report`.

    `estimates` is ignored, because the result has its own. `title`, the name of the optical system, and `command`, the
    command line, appear in the report. Returns the files written; the page is the last.

    Examples
    --------
    >>> found = mistray.objects(mistray.load("cassegrain"), rays=2000)
    >>> files = mistray.report.write_objects(found, found.estimates, "objects")
    >>> [file.name for file in files[-3:]]
    ['objects.json', 'objects.png', 'objects.html']
    """
    return write_report(page(found, DEFAULT_TABLES, title, command), directory)


def objects_text(found: Objects, estimates: pd.DataFrame, count: int = DEFAULT_TABLES.rows) -> str:
    """
    Return the printed text with at most `count` rows in each list of objects; `estimates` is ignored.

    Examples
    --------
    >>> found = mistray.objects(mistray.load("cassegrain"), rays=2000)
    >>> print(mistray.report.objects_text(found, found.estimates, count=3).splitlines()[3])
    Critical objects: 7, seen by the detector
    """
    return text(found, ObjectsTables(count))


def _finding(found: Objects) -> str:
    """
    Return a sentence on how many objects are critical, illuminated and both, and one on the strongest estimate.

    Without an estimate above 0 the second is left out.
    """
    counts = (
        f"The detector sees {len(found.critical)} objects that are not optics, light from outside reaches "
        f"{len(found.illuminated)}, and {len(found.common)} are both."
    )
    row = max(found.products, key=lambda row: row.pst.value, default=None)
    if row is None or not row.pst.value > 0:
        return counts
    angle = f" at {row.angle_deg:g}°" if math.isfinite(row.angle_deg) else ""
    sentence = (
        "{} By the product estimate the most light of a single scatter event comes from <b>{}</b>{}: PST {}, {} % of "
        "all such light."
    )
    return Markup(sentence).format(counts, row.id, angle, number(row.pst.value, 2), number(row.percent, 3))


def _common(found: Objects) -> list[PagePart]:
    parts: list[PagePart] = [NotePart("None but the optics.")]
    if found.common:
        parts = [NotePart(COMMON), common_table(found.common, name="t-common")]
    if found.apart:
        parts.append(NotePart(APART.format(", ".join(row.id for row in found.apart))))
    optics = f"{len(found.optics)} surfaces of the design path, common by design"
    return [*parts, Folded(optics, [common_table(found.optics, name="t-optics")])]
