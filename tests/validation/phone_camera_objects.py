"""Critical, illuminated and common objects of the phone camera beside Tables 7, 9 and 10 of the FRED study."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import vectors
from validation.tables import markdown, number, table, write

import mistray
from mistray.analyses.objects.result import Objects
from mistray.analyses.objects.run import objects
from mistray.trace.host.ray_sources import DiskSource

FILE = "phone_camera_objects.md"
STUDY_RAYS = 1_000_000
# Its Table 8: a disc of 3.083 mm, the semi-diameter of its dummy surface 5 mm in front of the window; its Table 6: ±45°
SOURCE = DiskSource((0.0, 0.0, -5.749), 3.083, 20.0)
VIEW_DEG = 45.0
BEAM_RADIUS = 1.252  # of the study's beam, about the centre of the stop
PRODUCT_ANGLES = (4.0, 30.0)
PRODUCTS_SHOWN = 12


@dataclass(frozen=True)
class Row:
    """An object of the study, rays of 1 000 000, W of 1 W, and shape and side of the objects here that stand for it."""

    label: str
    rays: int
    power: float
    common: bool
    here: tuple[tuple[str, str], ...]


def _rows(which: str) -> tuple[Row, ...]:
    rows = []
    for line in vectors.rows("phone_camera_objects.csv"):
        if line["list"] == which:
            here = tuple(tuple(place.split(":")) for place in line["here"].split())
            rows.append(Row(line["label"], int(line["rays"]), float(line["power"]), line["common"] == "1", here))
    return tuple(rows)


CRITICAL, ILLUMINATED = _rows("critical"), _rows("illuminated")
COMMON = {row.label for row in (*CRITICAL, *ILLUMINATED) if row.common}


def search(rays: int = STUDY_RAYS, total_reflection: bool = False) -> Objects:
    return objects(
        mistray.load("phone_camera"),
        rays=rays,
        source=SOURCE,
        view_half_angle_deg=VIEW_DEG,
        threshold=0.0,
        total_reflection=total_reflection,
    )


def sums(found: Objects, which: str, row: Row) -> tuple[float, float, float]:
    """Rays of 1 000 000, power and its standard error of the objects that stand for a row of the study."""
    wanted = [entry for entry in getattr(found, which) if (entry.id, entry.side) in row.here]
    scale = STUDY_RAYS / found.facts["rays"]
    power, se = sum(entry.power for entry in wanted), np.sqrt(sum(entry.power_se**2 for entry in wanted))
    return scale * sum(entry.rays for entry in wanted), power, float(se)


def names(row: Row) -> str:
    if len(row.here) == 4:
        return "board"
    return " + ".join(name for name, _ in row.here) or "–"


def list_table(rows: Sequence[Row], which: str, found: Objects, other: Objects | None = None) -> str:
    def cells(row: Row) -> list[str]:
        rays, *watt = sums(found, which, row)
        watts = [watt, *([sums(other, which, row)[1:]] if other else [])]
        own = (number(power, se) if power else "0" for power, se in watts)
        return [row.label, f"{row.rays}", f"{row.power:.6f}", names(row), f"{rays:.0f}", *own]

    header = ["study", "study rays", "study W", "here", "rays", "W", *(["W with total reflection"] if other else [])]
    return markdown(header, [cells(row) for row in rows])


def beyond_table(rows: Sequence[Row], which: str, found: Objects, least: float = 1e-4) -> str:
    known = {place for row in rows for place in row.here}
    left = [entry for entry in getattr(found, which) if (entry.id, entry.side) not in known and entry.power > least]
    return markdown(
        ("object", "side", "rays", "W"),
        [(e.id, e.side, f"{e.rays * STUDY_RAYS / found.facts['rays']:.0f}", number(e.power, e.power_se)) for e in left],
    )


def common_rows(found: Objects) -> list[tuple[str, str, bool, bool]]:
    """Rows of the study in one of its tables: label, here, whether common in the study and here."""
    common = {(entry.id, entry.side) for entry in found.common}
    rows: dict[str, Row] = {row.label: row for row in (*ILLUMINATED, *CRITICAL)}
    found_rows = []
    for label, row in rows.items():
        own = any(place in common for place in row.here)
        if own or label in COMMON:
            found_rows.append((label, names(row), label in COMMON, own))
    return found_rows


def common_table(found: Objects) -> str:
    lines = [(label, here, "yes" if study else "–", "yes" if own else "–")
             for label, here, study, own in common_rows(found)]  # fmt: skip
    known = {place for row in (*CRITICAL, *ILLUMINATED) for place in row.here}
    lines += [("–", f"{e.id}", "–", "yes") for e in found.common if (e.id, e.side) not in known]
    return markdown(("study", "here", "common in the study", "common here"), lines)


def products(angle_deg: float, rays: int, trace_rays: int) -> list[dict[str, Any]]:
    """Product estimate and trace of the light of one scatter event, object by object, for the study's beam."""
    scene = mistray.load("phone_camera_scatter")
    theta = np.radians(angle_deg)
    direction = np.array([0.0, np.sin(theta), np.cos(theta)])
    beam = DiskSource(tuple(-20 * direction), BEAM_RADIUS, 1e-4, axis=tuple(direction))
    estimates = objects(scene, rays=rays, source=beam, threshold=0.0).estimates()
    traced = mistray.trace(scene, field_deg=angle_deg, rays=trace_rays, max_scatters=1, max_reflections=0)
    table = traced.paths.to_pandas()
    once = table[(table.scatters == 1) & (table.order == 0)]
    absorbed = 0.8  # of what meets the detector
    rows = []
    for name, part in once.groupby("scatter_1"):
        power, se = (value / absorbed for value in traced.paths.power(list(part.path_id)))
        own = estimates[estimates.id == name]
        rows.append(
            {
                "id": str(name),
                "traced": power,
                "traced_se": se,
                "product": float(own.detector_W.sum()),
                "product_se": float(np.sqrt((own.detector_W_se**2).sum())),
                # A surface that transmits has a row for each side on which it is seen, with the same flux
                "flux": float(own.flux_W.drop_duplicates().sum()),
                "bsdf": float(own.bsdf_1_sr.iloc[0]) if len(own) else 0.0,
                "gcf": float(own.gcf.iloc[0]) if len(own) else 0.0,
            }
        )
    return sorted(rows, key=lambda row: -row["traced"])


def product_table(results: dict[float, list[dict[str, Any]]]) -> str:
    def with_ratio(angle: float, row: dict[str, Any]) -> dict[str, Any]:
        ratio = row["product"] / row["traced"]
        error = ratio * np.hypot(row["product_se"] / row["product"], row["traced_se"] / row["traced"])
        return row | {"angle": angle, "ratio": ratio, "ratio_se": error}

    return table(
        "angle ° | object | Φ W | BSDF 1/sr | GCF | product W | traced W | product / traced",
        "{angle:g} | {id} | {flux:.4g} | {bsdf:.3g} | {gcf:.3g} | {product±product_se} | {traced±traced_se} | "
        "{ratio±ratio_se}",
        [with_ratio(angle, row) for angle, rows in results.items() for row in rows[:PRODUCTS_SHOWN]],
    )


if __name__ == "__main__":
    found, reflected = search(), search(total_reflection=True)
    write(
        FILE,
        {
            "critical": list_table(CRITICAL, "critical", found, reflected),
            "critical_only_here": beyond_table(CRITICAL, "critical", found),
            "illuminated": list_table(ILLUMINATED, "illuminated", found),
            "illuminated_only_here": beyond_table(ILLUMINATED, "illuminated", found),
            "common": common_table(found),
            "products": product_table({angle: products(angle, 1_000_000, 400_000) for angle in PRODUCT_ANGLES}),
        },
    )
