"""Steps 3 to 5 of a stray-light study: critical, illuminated and common objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mistray.analyses.objects.result import Objects
from mistray.analyses.objects.rows import SceneObject, StraightShot
from mistray.analyses.study.step import Fact, StudyStep, count_of
from mistray.percent import percent_text
from mistray.toolkit.rows import frame

NAMED = 6  # objects that a finding names
ESTIMATE = ["angle_deg", "id", "side", "optic", "flux_W", "flux_W_se", "bsdf_1_sr", "gcf", "pst", "pst_se", "percent"]
OF_SHOTS = {"surfaces": "through", "angle_from_deg": "from_deg", "angle_to_deg": "to_deg"}
SOURCE_ANGLES_DEG = (30.0, 40.0, 60.0, 80.0)  # source angles beside the fields of the ghost analysis


def source_angles(field_deg: Sequence[float], largest_deg: float) -> list[float]:
    """
    Return source angles, degrees, for illuminated objects, sorted.

    They are the field angles, and those of `SOURCE_ANGLES_DEG` beyond the fields of either sign up to `largest_deg`,
    the largest angle of the PST.
    """
    beyond = [angle for angle in SOURCE_ANGLES_DEG if max(map(abs, field_deg), default=0.0) < angle <= largest_deg]
    return sorted({*map(float, field_deg), *beyond})


def object_steps(found: Objects) -> tuple[StudyStep, StudyStep, StudyStep]:
    """Return steps 3, 4 and 5, critical, illuminated and common objects, from one search."""
    return _critical(found), _illuminated(found), _common(found)


def _strongest(rows: Sequence[SceneObject]) -> str:
    ids = [row.id for row in rows]
    names = [f"{row.id} ({row.side})" if ids.count(row.id) > 1 else row.id for row in rows[:NAMED]]
    named = ", ".join(f"{name} {percent_text(row.power, 3)}" for name, row in zip(names, rows, strict=False))
    return f"{named}{' …' if len(rows) > NAMED else ''}"


def _critical(found: Objects) -> StudyStep:
    rows = found.critical
    through = [", ".join(shot.surfaces) or "-" for shot in found.straight_shots]
    shots = frame(StraightShot, found.straight_shots).assign(surfaces=through).rename(columns=OF_SHOTS)
    findings = [
        f"Besides optics the detector sees {count_of(len(rows), 'object')}: {_strongest(rows)} of its view."
        if rows
        else "The detector sees nothing but optics."
    ]
    if found.straight_shots:
        worst = found.straight_shots[0]
        findings.append(
            f"It sees the outside in {count_of(len(found.straight_shots), 'way')} beside the design path, most of it "
            f"{worst.way}: {worst.share:.2g} of its view, at field angles {worst.field_deg[0]:.3g} to "
            f"{worst.field_deg[1]:.3g}°."
        )
    return StudyStep.of(
        "critical_objects",
        "What the detector sees: Lambertian rays from it backwards, which surfaces only transmit. Power: share "
        "of these rays' flux that meets an object.",
        facts=(Fact("start rays", float(found.facts["rays"])), Fact("threshold", float(found.facts["threshold"]))),
        tables={"critical": found.to_pandas("critical").drop(columns="optic"), "straight_shots": shots},
        findings=tuple(findings),
        # The ways past the optics stand in a table and among the findings
        warnings=tuple(text for text in found.notes if "sees the outside" not in text and "more ways" not in text),
        result=found,
    )


def _illuminated(found: Objects) -> StudyStep:
    rows = found.illuminated
    return StudyStep.of(
        "illuminated_objects",
        f"What light from outside reaches ({found.source_text}); surfaces only transmit it. Power: share of the "
        "flux started, the mean over the source angles.",
        facts=(Fact("start rays at each angle", float(found.facts["rays"])),),
        tables={"illuminated": found.to_pandas("illuminated").drop(columns="optic")},
        findings=(
            f"Besides optics light reaches {count_of(len(rows), 'object')}: {_strongest(rows)} of the flux."
            if rows
            else "Light from outside reaches nothing but optics.",
        ),
        result=found,
    )


def _common(found: Objects) -> StudyStep:
    common = found.to_pandas("common").drop(columns="optic")
    optics, apart = (found.to_pandas(which).drop(columns="optic") for which in ("optics", "apart"))
    estimates = found.estimates()
    estimates = estimates[estimates.pst > 0][ESTIMATE].reset_index(drop=True)
    return StudyStep.of(
        "common_objects",
        "What is both critical and illuminated can send light to the detector by one scatter event. The estimate of "
        "that light is a product: the flux on the object, its BSDF, and its geometric configuration factor (GCF). The "
        "GCF is the projected solid angle of the detector over π. Optics are common by design and listed apart.",
        facts=(Fact("common objects", float(len(common))), Fact("optics", float(len(optics)))),
        tables={"common": common, "optics": optics, "apart": apart, "product_estimate": estimates},
        findings=tuple(_estimate_findings(common, estimates)),
        result=found,
    )


def _estimate_findings(common: pd.DataFrame, estimates: pd.DataFrame) -> list[str]:
    """Return sentences on the common objects, and on the two largest scatter estimates (PST) at each angle."""
    places = ", ".join(f"{count} {place} the stop" for place, count in common.stop.value_counts().items() if place)
    places = places.replace("stop the stop", "at the stop")
    found = [
        f"Common besides the optics: {count_of(len(common), 'object')}{f' ({places})' if places else ''}."
        if len(common)
        else "No object but the optics is common."
    ]
    words = []
    for angle, rows in estimates.groupby("angle_deg", dropna=False):
        first = rows.sort_values("pst", ascending=False).head(2)
        if len(first) and first.pst.iloc[0] > 0:
            named = ", ".join(f"{row.id} {row.pst:.2g}" for row in first.itertuples() if row.pst > 0)
            words.append(f"{angle:g}° {named}" if np.isfinite(angle) else named)
    if words:
        found.append(f"Largest product estimates, as PST: {'; '.join(words)}.")
    return found
