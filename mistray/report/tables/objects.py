"""The tables of critical, illuminated and common objects, printed, as CSV and for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from mistray.analysis.estimate import Estimate
from mistray.analysis.objects.rows import LISTS, CommonObject, SceneObject, describe
from mistray.analysis.objects.search import Objects
from mistray.files.json_values import plain
from mistray.report.model import Fold, Table, Value, columns
from mistray.report.tables.text import ABSENT, number, table_text

ROWS_SHOWN, ESTIMATES_SHOWN = 25, 10
APART = "Lit in one place and seen in another, so not common: {}."

POWER_UNIT = "W per W started"


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
    """What was traced, in two lines."""
    facts = found.facts
    stop = f"aperture stop: {found.stop}" if found.stop else "aperture stop: not found"
    view = facts["view_half_angle_deg"]
    cone = "" if view >= 90 else f" within {view:g}° of its normal"
    control = facts["ray_control"].replace("_", " ")
    return (
        f"{facts['rays']:.3g} rays from the detector '{facts['detector']}'{cone} against the light, as many from "
        f"outside ({found.source_text})\n{facts['wavelength_nm']:g} nm; surfaces: {control}"
        f"{'' if facts['total_reflection'] else ', no total reflection'}; "
        f"objects count from {facts['threshold']:g} W for each W that starts; {stop}"
    )


def objects_text(found: Objects, estimates: pd.DataFrame, count: int = ROWS_SHOWN) -> str:
    """
    What `mistray objects` prints.

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
    parts += [f"warning: {text}" for text in found.warnings]
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
    """The same for a page."""
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
        "warnings": found.warnings,
    }
    return dict(plain(record))


def _space(space: int) -> str:
    return str(space) if space >= 0 else ABSENT
