"""Critical, illuminated and common objects as text, values for JSON, tables and a report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from mistray.analyses.objects.rows import LISTS, CommonObject, SceneObject, describe
from mistray.analyses.objects.search import Objects
from mistray.estimate import Estimate
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
from mistray.toolkit.tables.text import ABSENT, number, table_text

ROWS_SHOWN, ESTIMATES_SHOWN = 25, 10
APART = "Lit in one place and seen in another, so not common: {}."

POWER_UNIT = "W per W started"
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


def object_table(rows: Sequence[SceneObject], most: int = ROWS_SHOWN, name: str = "") -> Table:
    """A list of critical or illuminated objects, the strongest first."""
    cells: list[list[Value]] = [
        [row.rays, Estimate(row.power, row.power_se), row.id, row.side, row.part, _space(row.space), row.between,
         row.stop]
        for row in rows
    ]  # fmt: skip
    left = rows[most:]
    power = number(sum(row.power for row in left), 3)
    rest: list[Value] = [sum(row.rays for row in left), power, f"… and {len(left)} more", "", "", "", "", ""]
    heads = columns("rays", f"power [{POWER_UNIT}]", "<object", "<side", "<part", "space", "<stands between", "<stop")
    words = ("filter rows, for example: barrel", "filter the objects")
    return Table(heads, cells, name, filter=words, most=most, rest=rest, empty="none")


def common_table(rows: Sequence[CommonObject], most: int = ROWS_SHOWN, name: str = "") -> Table:
    """A list of common objects or of optics, in the order of the light."""
    cells: list[list[Value]] = [
        [
            *(row.id, row.side, row.part, _space(row.space), row.between, row.stop),
            *(Estimate(row.critical_power, row.critical_power_se), row.critical_rays),
            *(Estimate(row.illuminated_power, row.illuminated_power_se), row.illuminated_rays),
        ]
        for row in rows
    ]
    heads = columns(
        "<object", "<side", "<part", "space", "<stands between", "<stop", f"critical [{POWER_UNIT}]", "rays",
        f"illuminated [{POWER_UNIT}]", "rays",
    )  # fmt: skip
    rest = [f"… and {len(rows) - most} more", *[""] * 9]
    return Table(heads, cells, name, most=most, rest=rest, empty="none")


def estimate_table(estimates: pd.DataFrame, count: int | None = None) -> Table:
    """The product estimate: all objects, or in text the `count` strongest at each source angle."""
    shown = estimates[estimates.pst > 0]
    rows: list[list[Value]] = []
    for angle, own in shown.groupby("angle_deg", dropna=False, sort=False):
        for row in own.head(count or len(own)).itertuples(index=False):
            optic = " (optic)" if row.optic and count else ""
            rows.append(
                [f"{angle:g}", f"{row.id}{optic}", "yes" if row.optic else "", row.side, row.stop,
                 Estimate(row.flux_W, row.flux_W_se), number(row.bsdf_1_sr, 3), number(row.gcf, 3),
                 Estimate(row.pst, row.pst_se), number(row.percent, 3)]
            )  # fmt: skip
        left = own.iloc[count or len(own) :]
        if len(left):
            sums = [number(left.pst.sum(), 3), number(left.percent.sum(), 3)]
            rows.append([f"{angle:g}", f"… and {len(left)} more", *[""] * 6, *sums])
    heads = columns("angle [deg]", "<object", "<optic", "<side", "<stop", "Φ [W for 1 W/mm²]", "BSDF [1/sr]", "GCF",
                    "PST", "share [%]")  # fmt: skip
    words = ("filter rows", "filter the estimates")
    empty = "none: no common object scatters; give the surfaces scatter models"
    table = Table(heads, rows, "t-estimates", filter=words, empty=empty)
    left_out = [*([] if shown.angle_deg.notna().any() else ["angle"]), *(["optic"] if count else [])]
    return table.without(*left_out)


def heading(found: Objects) -> str:
    """Describe the trace in two lines."""
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


def objects_text(found: Objects, estimates: pd.DataFrame, count: int = ROWS_SHOWN) -> str:
    """
    Return the text that `mistray objects` prints.

    Parameters
    ----------
    found : Objects
    estimates : DataFrame
        ``found.estimates()``.
    count : int
        Rows of each table.
    """
    parts = [
        heading(found),
        "",
        f"Critical objects: {len(found.critical)}, seen by the detector",
        table_text(object_table(found.critical, count)),
        "",
        f"Illuminated objects: {len(found.illuminated)}, reached by light from outside",
        table_text(object_table(found.illuminated, count)),
        "",
        f"Common objects: {len(found.common)}, critical and illuminated",
        table_text(common_table(found.common, count).without("rays")),
        "",
        f"The {len(found.optics)} surfaces of the design path are common by design and not listed here.",
    ]
    if found.apart:
        parts.append(APART.format(", ".join(row.id for row in found.apart)))
    parts += ["", "Light by one scatter event, estimated as Φ · BSDF · π GCF",
              table_text(estimate_table(estimates, ESTIMATES_SHOWN)), "", "±: one standard error"]  # fmt: skip
    parts += [f"warning: {text}" for text in found.notes]
    return "\n".join(parts)


def csv_tables(found: Objects, estimates: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The tables by file name; lists that are empty have their columns all the same."""
    tables = {f"objects_{name}.csv": found.to_pandas(name) for name in LISTS if name != "apart" or found.apart}
    tables["objects_estimates.csv"] = estimates
    tables["objects_straight_shots.csv"] = shot_frame(found)
    return tables


def shot_frame(found: Objects) -> pd.DataFrame:
    """Ways by which the detector sees the outside past the optics: way (in words), surfaces, share, field angles."""
    rows = [
        {
            "way": describe(shot),
            "surfaces": " ".join(shot.surfaces),
            "rays": shot.rays,
            "share": shot.share,
            "share_se": shot.share_se,
            "angle_from_deg": shot.field_deg[0],
            "angle_to_deg": shot.field_deg[1],
        }
        for shot in found.straight_shots
    ]
    columns = ["way", "surfaces", "rays", "share", "share_se", "angle_from_deg", "angle_to_deg"]
    return pd.DataFrame(rows, columns=columns)


def shot_table(found: Objects) -> Table:
    """Return the ways of `shot_frame` as a table for a page."""
    rows: list[list[Value]] = [
        [Fold(row.way, row.surfaces), row.rays, Estimate(row.share, row.share_se),
         f"{row.angle_from_deg:.3g} … {row.angle_to_deg:.3g}"]
        for row in shot_frame(found).itertuples(index=False)
    ]  # fmt: skip
    heads = columns("<way", "rays", "share [of the view of the detector]", "field angles [deg]")
    return Table(heads, rows, "t-shots")


def objects_record(found: Objects, estimates: pd.DataFrame) -> dict[str, Any]:
    """All of a result as values that JSON knows."""
    record = {
        "facts": found.facts,
        "stop": found.stop,
        "angles_deg": list(found.field_deg),
        **{name: found.to_pandas(name).to_dict("records") for name in LISTS},
        "estimates": estimates.to_dict("records"),
        "straight_shots": shot_frame(found).to_dict("records"),
        "warnings": found.notes,
    }
    return dict(plain(record))


def _space(space: int) -> str:
    return str(space) if space >= 0 else ABSENT


def objects_report(found: Objects, estimates: pd.DataFrame, title: str = "scene", command: str = "") -> Report:
    """The report; see `write_objects`."""
    from mistray.analyses.objects.figures import objects_layout
    from mistray.toolkit.figures.plots import as_png

    png = as_png(objects_layout(found, title))
    first, second = heading(found).splitlines()
    estimated, shots = estimate_table(estimates), shot_table(found)
    sections = [
        Section("layout", "Layout", [FigurePart(png, CAPTION, "objects in the section of the system")], "Layout"),
        Section("common", "Common objects", _common(found), "Common"),
        Section("estimates", "Light by one scatter event",
                [NotePart(ESTIMATE), estimated] if estimated.rows else [NotePart(NO_SCATTER)], "Estimate"),
        Section("critical", "Critical objects", [object_table(found.critical, name="t-critical")], "Critical"),
        Section("illuminated", "Illuminated objects",
                [object_table(found.illuminated, name="t-illuminated")], "Illuminated"),
        Section("straight", "Straight shots",
                [NotePart(SHOTS), shots] if shots.rows else [NotePart(NO_SHOTS)], "Straight shots"),
        settings_section(found.facts | version_settings(), command, terms("objects"), link="Settings"),
    ]  # fmt: skip
    return Report(
        "Critical and illuminated objects",
        title,
        sections,
        lead=[NotePart(Markup("{}.<br>{}.").format(first, second), "sub"), NotePart(_finding(found, estimates))],
        warnings=found.notes,
        tab="Objects",
        csv=csv_tables(found, estimates),
        json={"objects.json": {"title": title, "command": command} | objects_record(found, estimates)},
        result=found,
        files={"objects.png": png},
        page="objects.html",
    )


def write_objects(
    found: Objects, estimates: pd.DataFrame, directory: str | Path, title: str = "scene", command: str = ""
) -> list[Path]:
    """
    Write the tables of `csv_tables`, objects.png, objects.json and objects.html.

    `estimates` are those of ``found.estimates()``. `write_report` says what becomes of the directory; `title` is the
    name of the optical system, `command` the command line, both for the report.

    Returns the files written, of which the page is the last.
    """
    return write_report(objects_report(found, estimates, title, command), directory)


def _finding(found: Objects, estimates: pd.DataFrame) -> str:
    """The result in two sentences."""
    counts = (
        f"The detector sees {len(found.critical)} objects that are no optics, light from outside reaches "
        f"{len(found.illuminated)}, and {len(found.common)} are both."
    )
    strongest = estimates[estimates.pst > 0].sort_values("pst", ascending=False).head(1)
    if strongest.empty:
        return counts
    row = strongest.iloc[0]
    angle = f" at {row.angle_deg:g}°" if pd.notna(row.angle_deg) else ""
    text = (
        "{} By the product estimate the most light of a single scatter event comes from <b>{}</b>{}: PST {}, {} % of "
        "all such light."
    )
    return Markup(text).format(counts, row.id, angle, number(row.pst, 2), number(row.percent, 3))


def _common(found: Objects) -> list[PagePart]:
    parts: list[PagePart] = [NotePart("None but the optics.")]
    if found.common:
        parts = [NotePart(COMMON), common_table(found.common, name="t-common")]
    if found.apart:
        parts.append(NotePart(APART.format(", ".join(row.id for row in found.apart))))
    optics = f"{len(found.optics)} surfaces of the design path, common by design"
    return [*parts, Folded(optics, [common_table(found.optics, name="t-optics")])]
