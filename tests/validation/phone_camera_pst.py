"""PST of the phone camera beside that of the FRED study, whose numbers stand in the notebook."""

from functools import cache
from pathlib import Path
from typing import Any

import nbformat
import pandas as pd

import mistray
from mistray import Pst, pst
from mistray.analyses.pst.causes import breaks, cause_frame, first_level_scatter

NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "phone_camera_pst.ipynb"
SIDE = 4.367886545  # of the detector in the study's script, mm
ABSORBED = 0.8


@cache
def study() -> dict[str, Any]:
    """The tables of the study that the notebook holds: TABLE_7, TABLE_9, TABLE_10, TABLE_27."""
    cells = [cell.source for cell in nbformat.read(NOTEBOOK, as_version=4).cells if cell.cell_type == "code"]
    (source,) = [text for text in cells if "TABLE_7 = [" in text]
    found: dict[str, Any] = {}
    exec(source, found)
    return {name: table for name, table in found.items() if name.startswith("TABLE_")}


def scene() -> Any:
    return mistray.load("phone_camera_scatter")


def curve(loaded: Any, rays: int) -> Pst:
    return pst(loaded, rays=rays)


def implied() -> pd.DataFrame:
    """PST that a power and its share in Table 27 imply, by angle: power (W) and PST."""
    rows = pd.DataFrame(study()["TABLE_27"], columns=["angle", "percent", "power", "name", "ours"])
    rows = rows.groupby("angle").first()
    power = rows.power / (rows.percent / 100)
    return pd.DataFrame({"power": power, "PST": power / SIDE**2})


def main_causes(found: Pst) -> pd.DataFrame:
    causes, once = cause_frame(found), first_level_scatter(found).set_index("angle_deg")
    rows = []
    for angle in sorted({row[0] for row in study()["TABLE_27"]}):
        _, percent, _, name, ours = next(row for row in study()["TABLE_27"] if row[0] == angle)
        scatter, light = once.loc[[angle]].iloc[0], causes.loc[angle]
        rows.append(
            (angle, name, ours, percent, scatter.surface, scatter.percent_of_first_level, light.idxmax(), light.max())
        )
    columns = ["angle", "name", "ours", "percent", "surface", "surface_percent", "cause", "cause_percent"]
    return pd.DataFrame(rows, columns=columns)


def watts(loaded: Any, rays: int) -> pd.DataFrame:
    """First-level scatter in W absorbed, of a beam of 1.252 mm: rows of Table 27 and ours at the same ranks."""
    table = study()["TABLE_27"]
    angles = sorted({row[0] for row in table})
    beam = mistray.ghosts(loaded, field_deg=angles, rays=rays, max_reflections=0, max_scatters=1)
    rows = []
    for angle in angles:
        by_surface = beam.scatter_surfaces(angle).set_index("surface")
        for rank, (_, _, power, name, ours) in enumerate(row for row in table if row[0] == angle):
            same = by_surface.loc[ours] if ours in by_surface.index else None
            own = by_surface.iloc[rank]
            watt = (0.0, 0.0) if same is None else (same.power_W, same.power_se_W)
            rows.append((angle, name, ours, power, *watt, own.name, own.power_W, own.power_se_W))
    columns = ["angle", "name", "ours", "study", "same", "same_se", "surface", "power", "power_se"]
    return pd.DataFrame(rows, columns=columns)


def bends(found: Pst) -> pd.DataFrame:
    rows = [
        (b.field_deg, b.slope_before, b.slope_after, b.change_se, _words(b.before), _words(b.after))
        for b in breaks(found)
    ]
    return pd.DataFrame(rows, columns=["angle", "before", "after", "se", "causes_before", "causes_after"])


def _words(causes: tuple[tuple[str, float], ...]) -> str:
    return ", ".join(f"{name} {share:.0f} %" for name, share in causes)
