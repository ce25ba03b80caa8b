"""The tables of critical, illuminated and common objects, printed, as CSV and for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from mistray.analysis.estimate import Estimate
from mistray.analysis.objects.rows import LISTS, CommonObject, SceneObject, describe
from mistray.analysis.objects.search import Objects
from mistray.files.json_values import plain
from mistray.report.tables.text import ABSENT, number, text_table, with_error

ROWS_SHOWN = 25

POWER_UNIT = "W per W started"
MEANINGS = (
    ("critical", "seen by the detector: met by rays that start there like light from a Lambertian surface, go against "
     "the light and are only transmitted"),
    ("illuminated", "met by light from outside that is only transmitted"),
    ("common", "critical and illuminated, with places that are both; it can send light to the detector by one scatter "
     "event"),
    ("optics", "surfaces of the design path; common by design, listed apart"),
    ("side", "of an opaque surface; a surface that transmits is one object"),
    ("stands between", "surfaces of the design path, as most of the rays that meet the object have it"),
    ("stop", "before or after the aperture stop along the design path; “stop”: a part of it"),
    ("power", "flux of the rays that meet the object, for each W that starts; one ray of n has 1/n"),
    ("Φ", "flux on the object from a distant source of 1 W/mm² across its beam; of a cone the mean over directions"),
    ("BSDF", "mean over pairs of rays that light and that see the object, weighted with the light that they bring"),
    ("GCF", "geometrical configuration factor: projected solid angle of the detector from the object, through the "
     "optics, over π; where the object is lit"),
    ("PST", "Φ · BSDF · π GCF over the area of the detector: light of this object by one scatter event and no ghost"),
    ("± ", "one standard error"),
)  # fmt: skip


def object_text(rows: Sequence[SceneObject], count: int = ROWS_SHOWN) -> str:
    """A list of critical or illuminated objects, the strongest first."""
    if not rows:
        return "none"
    columns = [("rays", ""), ("power", POWER_UNIT), ("object", ""), ("side", ""), ("part", ""), ("space", ""),
               ("stands between", ""), ("stop", "")]  # fmt: skip
    cells = [
        [f"{row.rays}", with_error(Estimate(row.power, row.power_se)), row.id, row.side, row.part, _space(row.space),
         row.between, row.stop]
        for row in rows[:count]
    ]  # fmt: skip
    if len(rows) > count:
        left = rows[count:]
        cells.append([f"{sum(row.rays for row in left)}", number(sum(row.power for row in left), 3),
                      f"… and {len(left)} more", "", "", "", "", ""])  # fmt: skip
    return text_table(columns, cells, left=(2, 3, 4, 6, 7))


def common_text(rows: Sequence[CommonObject], count: int = ROWS_SHOWN) -> str:
    """A list of common objects or of optics, in the order of the light."""
    if not rows:
        return "none"
    columns = [("object", ""), ("side", ""), ("part", ""), ("space", ""), ("stands between", ""), ("stop", ""),
               ("critical", POWER_UNIT), ("illuminated", POWER_UNIT)]  # fmt: skip
    cells = [
        [row.id, row.side, row.part, _space(row.space), row.between, row.stop,
         with_error(Estimate(row.critical_power, row.critical_power_se)),
         with_error(Estimate(row.illuminated_power, row.illuminated_power_se))]
        for row in rows[:count]
    ]  # fmt: skip
    if len(rows) > count:
        cells.append([f"… and {len(rows) - count} more", *[""] * 7])
    return text_table(columns, cells, left=(0, 1, 2, 4, 5))


def estimate_text(estimates: pd.DataFrame, count: int = 10) -> str:
    """The product estimate: the strongest objects at each source angle."""
    shown = estimates[estimates.pst > 0]
    if shown.empty:
        return "none: no common object scatters; give the surfaces scatter models"
    angles = bool(estimates.angle_deg.notna().any())
    columns = [*([("angle", "deg")] if angles else []), ("object", ""), ("side", ""), ("stop", ""),
               ("Φ", "W for 1 W/mm²"), ("BSDF", "1/sr"), ("GCF", ""), ("PST", ""), ("share", "%")]  # fmt: skip
    cells = []
    for angle, rows in shown.groupby("angle_deg", dropna=False, sort=False):
        first = [f"{angle:g}"] if angles else []
        for row in rows.head(count).itertuples(index=False):
            cells.append(
                [*first, f"{row.id}{' (optic)' if row.optic else ''}", row.side, row.stop,
                 with_error(Estimate(row.flux_W, row.flux_W_se)), number(row.bsdf_1_sr, 3), number(row.gcf, 3),
                 with_error(Estimate(row.pst, row.pst_se)), number(row.percent, 3)]
            )  # fmt: skip
        left = rows.iloc[count:]
        if len(left):
            cells.append([*first, f"… and {len(left)} more", "", "", "", "", "", number(left.pst.sum(), 3),
                          number(left.percent.sum(), 3)])  # fmt: skip
    return text_table(columns, cells, left=(1, 2, 3) if angles else (0, 1, 2))


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
        object_text(found.critical, count),
        "",
        f"Illuminated objects: {len(found.illuminated)}, reached by light from outside",
        object_text(found.illuminated, count),
        "",
        f"Common objects: {len(found.common)}, critical and illuminated",
        common_text(found.common, count),
        "",
        f"The {len(found.optics)} surfaces of the design path are common by design and not listed here.",
    ]
    if found.apart:
        parts.append(
            f"Lit in one place and seen in another, so not common: {', '.join(row.id for row in found.apart)}."
        )
    parts += ["", "Light by one scatter event, estimated as Φ · BSDF · π GCF", estimate_text(estimates), "",
              "±: one standard error"]  # fmt: skip
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
