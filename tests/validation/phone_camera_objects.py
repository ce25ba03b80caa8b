"""Critical, illuminated and common objects of the phone camera beside Tables 7, 9 and 10 of the FRED study.

Run as a script it writes the tables of docs/validation/phone_camera_objects.md.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from validation.tables import markdown, number, write

import mistray
from mistray.analysis.objects.search import Objects, objects
from mistray.analysis.objects.sources import DiskSource

FILE = "phone_camera_objects.md"
STUDY_RAYS = 1_000_000
# Its Table 8: a disc of 3.083 mm, the semi-diameter of its dummy surface 5 mm in front of the window; its Table 6: ±45°
SOURCE = DiskSource((0.0, 0.0, -5.749), 3.083, 20.0)
VIEW_DEG = 45.0
BEAM_RADIUS = 1.252  # of the study's beam, about the centre of the stop
PRODUCT_ANGLES = (4.0, 30.0)
PRODUCTS_SHOWN = 12
FRONT, BACK, BOTH = "front", "back", "both"


@dataclass(frozen=True)
class Row:
    """
    One object of the study, its halves added up, and the objects here that stand for it.

    Attributes
    ----------
    label : str
        Element and surfaces as the study names them; "B" is the barrel with its optical space.
    rays : int
        Of 1 000 000.
    power : float
        W of 1 W.
    here : tuple of (str, str)
        Shape and side; empty where there is none.
    """

    label: str
    rays: int
    power: float
    here: tuple[tuple[str, str], ...] = ()


CRITICAL = (
    Row("Lens 2, bevel 1", 7318, 0.006226, (("L2_bevel_1", BOTH), ("L2_flange_1", BACK))),
    Row("Lens 3, bevel 1", 43844, 0.038842, (("L3_bevel_1", BOTH), ("L3_flange_1", BACK))),
    Row("IR filter, edge", 6368, 0.006349, (("filter_edge", FRONT),)),
    Row("Lens 4, edge", 386, 0.000341, (("L4_edge", FRONT),)),
    Row("Lens 4, bevel 2", 830, 0.000735, (("L4_flange_2", FRONT),)),
    Row("Lens 5, bevel 2", 13299, 0.013034, (("L5_bevel_2", BOTH),)),
    Row("Stop, inner wall", 301, 0.000241, (("stop_wall", FRONT),)),
    Row("B 0, plane 22", 242, 0.000193),
    Row("B 1, cone 4 + 5", 6216 + 6308, 0.004977 + 0.005051, (("barrel_1_cone", FRONT),)),
    Row("B 1, plane 31", 304, 0.000248, (("stop_rear", BACK),)),
    Row("B 2, cone 3 + 22", 6841 + 6867, 0.005704 + 0.005725, (("barrel_2_cone", FRONT),)),
    Row("B 3, cone 2 + 31", 30261 + 30296, 0.026273 + 0.026303, (("barrel_3_cone", FRONT),)),
    Row("B 3, plane 12", 1385, 0.001202),
    Row("B 4, cone 2 + 31", 106778 + 106247, 0.096482 + 0.096002, (("barrel_4_cone", FRONT),)),
    Row("B 4, plane 12", 55986, 0.051443, (("L4_bevel_1", BOTH), ("L4_flange_1", BACK))),
    Row("B 5, cone 2 + 31", 2602 + 2679, 0.002439 + 0.002509, (("barrel_5_cone", FRONT),)),
    Row("B 5, 4 + 13", 231 + 290, 0.000204 + 0.000256),
    Row("B 5, plane 12", 92, 8.03e-5),
    Row("B 5, plane 30", 2629, 0.002485),
    Row("B 6, cone 3 + 22", 94618 + 94714, 0.0927 + 0.092829, (("barrel_6_cone", FRONT),)),
    Row("B 6, plane 30", 32952, 0.032296, (("barrel_6_plane", BACK),)),
    Row("B 7, cone 2 + 31", 16406 + 16600, 0.016405 + 0.016599, (("barrel_7_cone", FRONT),)),
    Row("B 7, wall 3 + 22", 6994 + 5999, 0.006972 + 0.005982, (("barrel_7_cyl", FRONT),)),
    Row("B 7, plane 21", 165677, 0.165676, (("barrel_7_plane", BACK),)),
    Row("B 7, plane 30", 6669, 0.006668, tuple((f"board_{k}", FRONT) for k in ("left", "right", "bottom", "top"))),
)
ILLUMINATED = (
    Row("Lens 3, edge", 1, 8.51e-7, (("L3_edge", FRONT),)),
    Row("Lens 3, bevel 1", 71, 6.04e-5, (("L3_bevel_1", BOTH),)),
    Row("Lens 4, bevel 2", 2443, 0.002078, (("L4_flange_2", FRONT),)),
    Row("Lens 5, bevel 2", 2834, 0.002315, (("L5_bevel_2", BOTH), ("L5_flange_2", FRONT))),
    Row("Stop, face", 71348, 0.069928, (("stop_front", FRONT),)),
    Row("Stop, inner wall", 1286, 0.00126, (("stop_wall", FRONT),)),
    Row("B 0, recess 3 + 32", 3582 + 3585, 0.003581 + 0.003584, (("barrel_0_recess", FRONT),)),
    Row("B 0, cone 5 + 14", 35540 + 35192, 0.034832 + 0.034491, (("barrel_0_cone", FRONT),)),
    Row("B 0, plane 13", 339581, 0.336185, (("barrel_0_window_seat", FRONT),)),
    Row("B 0, plane 22", 68527, 0.067163, (("barrel_0_plane", FRONT),)),
    Row("B 0, plane 31", 71304, 0.071303, (("barrel_0_front_face", FRONT),)),
    Row("B 1, cone 4 + 5", 23 + 37, 2.25e-5 + 3.63e-5, (("barrel_1_cone", FRONT),)),
    Row("B 1, plane 13", 912, 0.000893, (("barrel_1_L1_seat_lip", FRONT),)),
    Row("B 1, plane 22", 126030, 0.123522, (("barrel_1_plane", FRONT),)),
    Row("B 2, cone 3 + 22", 33 + 33, 2 * 3.11e-5, (("barrel_2_cone", FRONT),)),
    Row("B 2, plane 21", 10, 9.60e-6),
    Row("B 3, cone 2 + 31", 1027 + 1031, 0.000928 + 0.000932, (("barrel_3_cone", FRONT),)),
    Row("B 3, plane 30", 43, 3.97e-5),
    Row("B 4, cone 2 + 31", 4203 + 4318, 0.003648 + 0.003748, (("barrel_4_cone", FRONT),)),
    Row("B 4, 3 + 22", 6 + 2, 5.11e-6 + 1.70e-6),
    Row("B 4, plane 30", 1406, 0.001245, (("L3_flange_2", FRONT),)),
    Row("B 5, cone 2 + 31", 685 + 667, 0.000571 + 0.000556, (("barrel_5_cone", FRONT),)),
    Row("B 5, plane 12", 2240, 0.001878),
    Row("B 6, cone 3 + 22", 949 + 1042, 0.000764 + 0.000839, (("barrel_6_cone", FRONT),)),
    Row("B 6, plane 21", 2029, 0.001658, (("barrel_6_IR_seat", FRONT),)),
    Row("B 7, cone 2 + 31", 1459 + 1470, 0.001145 + 0.001153, (("barrel_7_cone", FRONT),)),
    Row("B 7, plane 12", 115, 9.03e-5, (("barrel_7_IR_seat", FRONT),)),
    Row("B 7, plane 30", 2201, 0.001744, tuple((f"board_{k}", FRONT) for k in ("left", "right", "bottom", "top"))),
)
# Table 10; the rows of the tables above that it names
COMMON = (
    "Stop, inner wall", "Lens 3, bevel 1", "Lens 4, bevel 2", "Lens 5, bevel 2", "B 0, plane 22", "B 1, cone 4 + 5",
    "B 1, plane 31", "B 2, cone 3 + 22", "B 3, cone 2 + 31", "B 4, cone 2 + 31", "B 5, cone 2 + 31", "B 5, plane 12",
    "B 6, cone 3 + 22", "B 7, cone 2 + 31", "B 7, plane 30",
)  # fmt: skip


def search(rays: int = STUDY_RAYS, total_reflection: bool = False) -> Objects:
    """The study's search on the shipped camera; every ray counts."""
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
    """The objects that stand for a row, in words."""
    if len(row.here) == 4:
        return "board"
    return " + ".join(name for name, _ in row.here) or "–"


def text(power: float, se: float) -> str:
    """A power with its error; 0 where no ray came."""
    return number(power, se) if power else "0"


def list_table(rows: Sequence[Row], which: str, found: Objects, other: Objects | None = None) -> str:
    """The rows of the study beside the objects here; `other`: with total reflection."""
    header = ["study", "study rays", "study W", "here", "rays", "W", *(["W with total reflection"] if other else [])]
    lines = []
    for row in rows:
        rays, power, se = sums(found, which, row)
        cells = [
            row.label,
            f"{row.rays}",
            f"{row.power:.6f}",
            names(row),
            f"{rays:.0f}",
            number(power, se) if power else "0",
        ]
        if other is not None:
            _, power, se = sums(other, which, row)
            cells.append(number(power, se) if power else "0")
        lines.append(cells)
    return markdown(header, lines)


def beyond_table(rows: Sequence[Row], which: str, found: Objects, least: float = 1e-4) -> str:
    """Objects here that stand for no row of the study."""
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
    """Table 10 beside the common objects here, and those here that have no row there."""
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
    """The strongest objects of each angle."""
    header = ("angle °", "object", "Φ W", "BSDF 1/sr", "GCF", "product W", "traced W", "product / traced")
    lines = []
    for angle, rows in results.items():
        for row in rows[:PRODUCTS_SHOWN]:
            ratio = row["product"] / row["traced"]
            error = ratio * np.hypot(row["product_se"] / row["product"], row["traced_se"] / row["traced"])
            lines.append(
                (f"{angle:g}", row["id"], f"{row['flux']:.4g}", f"{row['bsdf']:.3g}", f"{row['gcf']:.3g}",
                 number(row["product"], row["product_se"]), number(row["traced"], row["traced_se"]),
                 number(ratio, error))
            )  # fmt: skip
    return markdown(header, lines)


def write_tables() -> None:
    """docs/validation/phone_camera_objects.md."""
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


if __name__ == "__main__":
    write_tables()
