"""Step 8 of a stray-light study: ghosts at some field angles, the PST at all angles, and its causes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.ghosts.verdict import brightest_field, most_stray
from mistray.analyses.pst.causes import Break, breaks, cause_frame, first_level_scatter, reigns, stray_paths
from mistray.analyses.pst.result import Pst
from mistray.analyses.study.first_order import FirstOrder
from mistray.analyses.study.image import transfer_facts, transfer_findings, transfer_tables
from mistray.analyses.study.step import Fact, StudyStep, count_of, gathered
from mistray.analyses.transfer.result import Transfer
from mistray.ids import event_words
from mistray.percent import percent_text
from mistray.toolkit.tables.frames import flat

TOP_PATHS = 4  # of each angle, and worst ghosts of each field
MOST_RANGES = 8  # ranges of angles with one main cause that are told
FALLEN = 0.9  # of the PST on axis, below which the curve is said to have fallen
AGREES = 0.05  # relative difference of PST(0) from T A / A_det that is still agreement, beside the error
SURE = 3.0  # standard errors that it must have fallen by
LEAST_ZERO_ORDER = 1e-12  # PST of zero-order light below which it is none


def stray_light_analysis(
    report: GhostReport,
    pst: Pst,
    first: FirstOrder | None = None,
    transmittance: float = math.nan,
    design: Sequence[str] = (),
    images: Transfer | str = "",
) -> StudyStep:
    """
    Return step 8 from a ghost analysis, a PST with paths, and images of points with their stray light.

    Parameters
    ----------
    report : GhostReport
        Ghost analysis.
    pst : Pst
        Point source transmittance (PST).
    first : FirstOrder, optional
        First-order data of the system; without it the PST on axis is not compared with its closed form.
    transmittance : float
        Transmittance of the design path along its base ray, 0 … 1, mean over the light; NaN if unknown.
    design : sequence of str
        Ids of the surfaces of the design path.
    images : Transfer or str
        Images of points, or the reason why there are none.
    """
    causes = cause_frame(pst)
    bends = breaks(pst)
    level_1 = first_level_scatter(pst)
    shots = zero_order(pst, first, design)
    tables = {
        "pst": curve_frame(pst, causes),
        "pst_top_paths": top_paths(pst),
        "pst_breaks": break_frame(bends),
        "first_level_scatter": level_1,
        "zero_order_paths": shots,
        "ghosts": ghost_frame(report, design),
        "worst_ghosts": worst_ghosts(report, design),
    }
    findings = [
        *_level_findings(pst, first, transmittance),
        *_cause_findings(causes),
        *_first_level_finding(pst, level_1),
        *map(_in_words, bends),
        *_zero_order_finding(shots),
        *_ghost_finding(report, design),
        *(order.sentence for order in pst.next_orders),
    ]
    text = (
        "Ghosts of a point source at some field angles, without scatter, and the point source transmittance (PST) at "
        "all angles, with ghosts and scatter. First-level scatter: scattered once, not reflected."
    )
    facts = _facts(pst)
    if isinstance(images, Transfer):
        text += " Images of points with all their stray light, as transfer functions and about the direct image."
        tables |= transfer_tables(images)
        findings += transfer_findings(images)
        facts += transfer_facts(images)
    elif images:
        text += f" There are no images of points: {images}."
    return StudyStep.of(
        "analysis",
        text,
        facts=tuple(facts),
        tables=tables,
        findings=tuple(findings),
        warnings=_warnings(pst),
        result={"ghosts": report, "pst": pst, "images": images if isinstance(images, Transfer) else None},
    )


def _facts(pst: Pst) -> list[Fact]:
    curve = pst.estimates()
    shown = [int(np.argmin(np.abs(pst.field_deg - angle))) for angle in (0, 20, 40, 60, 80)]
    facts = [Fact("convention", pst.convention), Fact("method", pst.method)]
    for i in dict.fromkeys(shown):
        facts.append(Fact(f"PST at {pst.field_deg[i]:g}°", curve[i]))
    return facts


def _warnings(pst: Pst) -> tuple[str, ...]:
    if pst.is_dark:
        return (
            "no light from outside was seen at any angle; more rays may find some, unless the detector is closed in or "
            "nothing within the limits of the trace leads there",
        )
    return ()


def curve_frame(pst: Pst, causes: pd.DataFrame) -> pd.DataFrame:
    """
    Return a DataFrame of the PST (dimensionless) by class of light, one row per field angle (degrees).

    It has the standard errors, the main cause of stray light, and its percentage of the stray light.
    """
    columns: dict[str, object] = {"angle_deg": pst.field_deg, **pst.columns(pst.curve)}
    strongest = [
        (str(row.idxmax()), float(row.max())) if not row.empty and row.max() > 0 else ("-", math.nan)
        for _, row in causes.iterrows()
    ]
    columns["main_cause"] = [name for name, _ in strongest]
    columns["main_cause_percent_of_stray"] = [share for _, share in strongest]
    return pd.DataFrame(columns)


def top_paths(pst: Pst, count: int = TOP_PATHS) -> pd.DataFrame:
    """Return a DataFrame of the `count` strongest stray paths at each angle: PST, and percentage of the stray light."""
    columns = ["rank", "path", "kind", "first_scatter", "rays", "pst", "pst_se", "percent_of_stray"]
    tables = []
    for angle in pst.field_deg:
        rows = stray_paths(pst, angle, count)
        named = rows.assign(rank=np.arange(1, len(rows) + 1), path=rows.label, first_scatter=rows.scatter_1)
        tables.append((angle, named[columns]))
    return gathered("angle_deg", tables)


def zero_order(pst: Pst, first: FirstOrder | None, design: Sequence[str] = ()) -> pd.DataFrame:
    """
    Return a DataFrame of zero-order paths: without scatter or reflection but at mirrors and in total reflection.

    It has the light that does not form the image: past the optics or through an edge or bevel ("straight shot"),
    totally reflected ("TIR"), and of the design path from beyond the field, if `first` is given. A row is a path at one
    angle and azimuth. Columns angle_deg, kind, way (difference from the design path), path (the surfaces), rays, pst,
    pst_se, percent_of_all.
    """
    edge = first.field_deg["diagonal"] if first is not None and math.isfinite(first.focal_length_mm) else math.nan
    columns = ["kind", "way", "path", "rays", "pst", "pst_se", "percent_of_all"]
    tables = []
    for i, angle in enumerate(pst.field_deg):
        beyond = math.isfinite(edge) and pst.grid.edges_deg[i, 0] > edge
        for azimuth in pst.grid.azimuths_deg:
            rows = pst.paths(angle, azimuth)
            unscattered = (rows.order + rows.structure_bounces + rows.scatters) == 0
            rows = rows[unscattered & (rows.kind.isin(["straight shot", "TIR"]) | beyond)]
            rows = rows[rows.pst > LEAST_ZERO_ORDER]
            surfaces = [_surfaces(events) for events in rows.events]
            words = {"way": [_instead(path, design) for path in surfaces], "path": list(map(" ".join, surfaces))}
            tables.append((angle, rows.assign(**words)[columns]))
    return gathered("angle_deg", tables)


def _surfaces(events: str) -> list[str]:
    """Return the surface ids of an event list, including the detector."""
    return [word.rpartition(":")[0] for word in event_words(events)]


def _ghost_words(row: Any, design: Sequence[str]) -> str:
    """Return a ghost path in words; a straight shot or "TIR" is told by its difference from the design path."""
    if row.kind not in ("straight shot", "TIR"):
        return str(row.label)
    return f"{row.kind}, {_instead(_surfaces(row.events), design)}"


def _instead(path: Sequence[str], design: Sequence[str]) -> str:
    """
    Return the difference of a path from the design path in words, such as "L3_bevel_2 instead of L3_rear".

    Without a design path, return the ids of the path.
    """
    if not design:
        return " ".join(path)
    beside = ", ".join(name for name in path if name not in design)
    missed = ", ".join(name for name in design if name not in path)
    if beside and missed:
        return f"{beside} instead of {missed}"
    same = "the design path" if list(path) == list(design) else "the optics in another order"
    return beside or (f"past {missed}" if missed else same)


def break_frame(bends: Sequence[Break]) -> pd.DataFrame:
    """
    Return a DataFrame of the breaks of the curve, a row each.

    Columns: angle_deg, slopes before and after the break and their change (decades per degree), its standard error, and
    the causes before and after.
    """
    columns = ["slope_before_per_deg", "slope_after_per_deg", "change_per_deg", "change_se_per_deg", "before", "after"]
    rows = [
        (b.field_deg, b.slope_before, b.slope_after, b.change, b.change_se, *map(_causes_in_words, (b.before, b.after)))
        for b in bends
    ]
    return pd.DataFrame(rows, columns=["angle_deg", *columns])


def _causes_in_words(causes: Sequence[tuple[str, float]]) -> str:
    return ", ".join(f"{name} {share:.0f} %" for name, share in causes) or "-"


def ghost_frame(report: GhostReport, design: Sequence[str] = ()) -> pd.DataFrame:
    """
    Return a DataFrame with a row per field: field_deg, paths, direct and stray power (W), ratios, worst path.

    `design` are the surfaces of the design path, from which paths without reflection differ.
    """
    rows = []
    for field in report:
        s = report.summary(field)
        top = report.top(field, 1, "rms")
        row = {
            "field_deg": field,
            "paths": s.paths,
            "direct_W": s.direct.power_W,
            "stray_W": s.stray_W,
            "stray_to_nominal": s.stray_to_nominal,
            "worst_path": next((_ghost_words(row, design) for row in top.itertuples()), "-"),
            "worst_normalised": s.brightest_normalised,
        }
        rows.append(flat(row, before_unit=True))
    return pd.DataFrame(rows)


def worst_ghosts(report: GhostReport, design: Sequence[str] = (), count: int = TOP_PATHS) -> pd.DataFrame:
    """
    Return a DataFrame of the `count` worst paths of each field by RMS irradiance, and the strongest one by power.

    Columns: field_deg, rank, path, kind, rays, and with standard errors power_W, rms_radius_mm, rms_irradiance_W_mm2
    and normalised (dimensionless).
    """
    names = {"rank_rms_irradiance": "rank"} | {
        f"normalised_rms_irradiance{se}": f"normalised{se}" for se in ("", "_se")
    }
    numbers = ["power_W", "power_se_W", "rms_radius_mm", "rms_radius_se_mm", "rms_irradiance_W_mm2"]
    numbers += ["rms_irradiance_se_W_mm2", "normalised", "normalised_se"]
    tables = []
    for field in report:
        rows = report.listed(field, count, "rms").rename(columns=names)
        paths = [_ghost_words(row, design) for row in rows.itertuples()]
        tables.append((field, rows.assign(path=paths)[["rank", "path", "kind", "rays", *numbers]]))
    return gathered("field_deg", tables)


# ---- in words


def _level_findings(pst: Pst, first: FirstOrder | None, transmittance: float) -> list[str]:
    value, _ = pst.curve()
    if not np.any(value > 0):
        return []
    angle = pst.field_deg
    last = int(np.flatnonzero(value > 0)[-1])
    to = f" to {value[last]:.2g} at {angle[last]:g}°" if last else ""
    stray = f"{pst.stray[0]:.2g}" + (f" to {pst.stray[last]:.2g}" if last else "")
    found = [f"PST ({pst.convention}): {value[0]:.3g} at {angle[0]:g}°{to}; stray light alone {stray}."]
    direct, direct_se = pst.curve("direct")
    if angle[0] != 0 or not direct[0] > 0:
        return found
    field = min(first.field_deg["x"], first.field_deg["y"]) if first is not None else math.nan
    cell = float(pst.grid.edges_deg[0, 1])
    if cell > field:
        return [
            *found,
            f"The first cell of the PST, 0 to {cell:.3g}°, is wider than the field of ±{field:.3g}°: the image fills a "
            "part of it only. Angles in finer steps would show it.",
        ]
    on_axis = float(direct[0])
    area = float(pst.facts.get("detector_area_mm2", math.nan))
    expected = transmittance * first.pupil_area_mm2 / area if first is not None else math.nan
    # A PST is of plane waves, of which a system for a near object makes no image
    if first is not None and not first.near and math.isfinite(expected) and expected > 0:
        off, error = on_axis / expected - 1, float(direct_se[0]) / on_axis
        agrees = abs(off) < AGREES + SURE * error
        found.append(
            f"The direct light on axis, {on_axis:.4g} ± {percent_text(error)}, is {100 * off:+.1f} % from T A/A_det = "
            f"{expected:.4g} (free area of the entrance pupil {first.pupil_area_mm2:.4g} mm², detector {area:.4g} mm²)"
            + ("." if agrees else ": part of the image or of the beam misses the detector.")
        )
        on_axis = expected if agrees else on_axis
    if first is not None and math.isfinite(first.field_deg["y"]):
        inside = angle <= first.field_deg["y"]
        fallen = np.flatnonzero(inside & (direct + SURE * direct_se < FALLEN * on_axis))
        if inside.sum() > 1:
            k = int(np.flatnonzero(inside)[-1])
            drop = f"; it is below {100 * FALLEN:.0f} % from {angle[fallen[0]]:g}° on" if len(fallen) else ""
            found.append(
                f"At {angle[k]:g}°, inside the field of ±{first.field_deg['y']:.3g}°, the direct light is "
                f"{100 * direct[k] / on_axis:.0f} % of that on axis{drop}."
            )
    return found


def _cause_findings(causes: pd.DataFrame) -> list[str]:
    ranges = reigns(causes)
    chosen = sorted(sorted(ranges, key=lambda r: -(r[1] - r[0]))[:MOST_RANGES])
    words = []
    for first, last, name, low, high in chosen:
        where = f"{first:g}-{last:g}°" if last > first else f"{first:g}°"
        share = f"{low:.0f}-{high:.0f} %" if round(low) != round(high) else f"{low:.0f} %"
        words.append(f"{where} {name} ({share} of the stray light)")
    return [f"Main cause by angle: {'; '.join(words)}."] if words else []


def _first_level_finding(pst: Pst, table: pd.DataFrame) -> list[str]:
    stray = pst.stray
    if table.empty or not np.any(stray > 0):
        return []
    sums = table.groupby("angle_deg").pst.sum().reindex(pst.field_deg).fillna(0.0).to_numpy()
    share = 100 * sums[stray > 0] / stray[stray > 0]
    ghosts = 100 * pst.curve("ghost")[0][stray > 0] / stray[stray > 0]
    middle = [_share_in_words(part) for part in (share, ghosts)]
    return [
        f"First-level scatter alone brings {middle[0]} of the stray light, in the middle of the angles; ghosts and "
        f"reflections without scatter {middle[1]}."
    ]


def _share_in_words(percent: np.ndarray) -> str:
    middle, low, high = (f"{value:.0f}" for value in (np.median(percent), percent.min(), percent.max()))
    return f"{middle} %" if low == high else f"{middle} % (from {low} to {high} %)"


def _in_words(b: Break) -> str:
    way = "steeper" if b.change < 0 else "flatter"
    before, after = _causes_in_words(b.before), _causes_in_words(b.after)
    return (
        f"Break at {b.field_deg:g}°: the curve of stray light becomes {way}, {b.slope_before:+.3f} → "
        f"{b.slope_after:+.3f} decades per degree (± {b.change_se:.3f}). Before: {before}; after: {after}."
    )


def _zero_order_finding(shots: pd.DataFrame) -> list[str]:
    if shots.empty:
        return ["No zero-order path: light comes to the detector as an image, by reflection or by scatter only."]
    worst = shots.sort_values("pst", ascending=False).iloc[0]
    low, high = shots.angle_deg.min(), shots.angle_deg.max()
    where = f"{low:g}-{high:g}°" if high > low else f"{low:g}°"
    return [
        f"Zero-order paths at {where}: {count_of(shots.path.nunique(), 'way')} past or through the optics without "
        f"scatter or reflection; the strongest ({worst.way}) has a PST of {worst.pst:.2g} at {worst.angle_deg:g}°."
    ]


def _ghost_finding(report: GhostReport, design: Sequence[str]) -> list[str]:
    field, strongest = brightest_field(report), most_stray(report)
    if field is None or strongest is None:
        return ["No ghost reaches the detector at the fields that were traced."]
    worst, most = report.summary(field), report.summary(strongest)
    (row,) = report.top(field, 1, "rms").itertuples()
    return [
        f"Brightest ghost: {_ghost_words(row, design)} at {worst.field_deg:g}°, "
        f"{worst.brightest_normalised.value:.2g} of the RMS irradiance of the image on axis. Most ghost light at "
        f"{most.field_deg:g}°: {most.stray_to_nominal.value:.2g} of the power of that image."
    ]
