"""Critical, illuminated and common objects of the phone camera beside Tables 7, 9 and 10 of the FRED study."""

from dataclasses import dataclass
from typing import Any

import numpy as np

import mistray
from mistray.analyses.validate.packs.known import PACKS
from mistray.analysis import DiskSource, Objects, objects

FILE = "phone_camera_objects.md"
STUDY_RAYS = 1_000_000
BEAM_RADIUS = 1.252  # of the study's beam, about the centre of the stop


@dataclass(frozen=True)
class Row:
    """An object of the study, rays of 1 000 000, W of 1 W, and shape and side of the objects here that stand for it."""

    label: str
    rays: int
    power: float
    common: bool
    here: tuple[tuple[str, str], ...]


def _rows(which: str) -> tuple[Row, ...]:
    (pack,) = [one for one in PACKS if one.name == "phone_camera_objects"]
    rows = []
    for row in pack.file.rows:
        if row.argument("list") == which:
            here = tuple(tuple(place.split(":")) for place in row.argument("here"))
            label = row.name.removeprefix(f"{which}: ")
            rows.append(Row(label, row.argument("rays"), row.published, row.argument("common"), here))
    return tuple(rows)


CRITICAL, ILLUMINATED = _rows("critical"), _rows("illuminated")
COMMON = {row.label for row in (*CRITICAL, *ILLUMINATED) if row.common}


def search(rays: int = STUDY_RAYS, total_reflection: bool = False) -> Objects:
    # Its Table 8: the semi-diameter of its dummy surface 5 mm in front of the window; its Table 6: ±45°
    more: dict[str, Any] = {"view_half_angle_deg": 45.0, "threshold": 0.0, "total_reflection": total_reflection}
    return objects(mistray.load("phone_camera"), rays=rays, source=DiskSource((0.0, 0.0, -5.749), 3.083, 20.0), **more)


def sums(found: Objects, which: str, row: Row) -> tuple[float, float, float]:
    """Rays of 1 000 000, power and its standard error of the objects that stand for a row of the study."""
    wanted = [entry for entry in getattr(found, which) if (entry.id, entry.side) in row.here]
    scale = STUDY_RAYS / found.facts["rays"]
    power, se = sum(entry.power for entry in wanted), np.sqrt(sum(entry.power_se**2 for entry in wanted))
    return scale * sum(entry.rays for entry in wanted), power, float(se)


def names(row: Row) -> str:
    return "board" if len(row.here) == 4 else " + ".join(name for name, _ in row.here) or "–"


def common_rows(found: Objects) -> list[tuple[str, str, bool, bool]]:
    """Rows of the study in one of its tables: label, here, whether common in the study and here."""
    common = {(entry.id, entry.side) for entry in found.common}
    rows: dict[str, Row] = {row.label: row for row in (*ILLUMINATED, *CRITICAL)}
    own = {label: any(place in common for place in row.here) for label, row in rows.items()}
    listed = [label for label in rows if own[label] or label in COMMON]
    return [(label, names(rows[label]), label in COMMON, own[label]) for label in listed]


def products(angle_deg: float, rays: int, trace_rays: int) -> list[dict[str, Any]]:
    """Product estimate and trace of the light of one scatter event, object by object, for the study's beam."""
    scene = mistray.load("phone_camera_scatter")
    theta = np.radians(angle_deg)
    direction = np.array([0.0, np.sin(theta), np.cos(theta)])
    beam = DiskSource(tuple(-20 * direction), BEAM_RADIUS, 1e-4, axis=tuple(direction))
    estimates = objects(scene, rays=rays, source=beam, threshold=0.0).estimates()
    traced = mistray.trace(scene, field_deg=angle_deg, rays=trace_rays, max_scatters=1, max_reflections=0)
    table = traced.paths.to_pandas()
    absorbed = 0.8  # of what meets the detector
    rows = []
    for name, part in table[(table.scatters == 1) & (table.order == 0)].groupby("scatter_1"):
        power, se = (value / absorbed for value in traced.paths.power(list(part.path_id)))
        own = estimates[estimates.id == name]
        cells = {"id": str(name), "traced": power, "traced_se": se, "product": float(own.detector_W.sum())}
        cells["product_se"] = float(np.sqrt((own.detector_W_se**2).sum()))
        # A surface that transmits has a row for each side on which it is seen, with the same flux
        cells["flux"] = float(own.flux_W.drop_duplicates().sum())
        cells["bsdf"], cells["gcf"] = (float(own[key].iloc[0]) if len(own) else 0.0 for key in ("bsdf_1_sr", "gcf"))
        rows.append(cells)
    return sorted(rows, key=lambda row: -row["traced"])
