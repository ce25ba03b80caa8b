"""Critical rays to check a mechanical design: the centre and the rim of the beam of each field.

They are like OpticStudio's critical ray set. After a change of a mount or baffle, tracing them again shows whether the
image keeps its light.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pandas as pd

from mistray.analyses.export.request import CriticalRaysRequest
from mistray.errors import MistrayError
from mistray.recorders.path_events import DIRECT
from mistray.toolkit.analysis import analysis
from mistray.trace import Settings, trace


def run(scene: mi.Scene, request: CriticalRaysRequest) -> pd.DataFrame:
    """
    Return the ray nearest to the centre of the image-forming light, and the outermost rays around it, node by node.

    What is nearest or outermost is decided by the points where the rays first meet a surface, seen along the light.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    request : CriticalRaysRequest

    Returns
    -------
    DataFrame
        field_deg (degrees), name ("centre", "rim 0°", …), and the columns of `mistray.trace.RayHistory.to_pandas`;
        positions in float64, mm. Rims count about the direction of the light, from the scene's x axis; for light along
        +z towards y. There are rim + 1 rays per field, source and wavelength, fewer if one ray is the outermost in two
        directions.

    Raises
    ------
    MistrayError
        If no light of a field forms an image, and for all reasons for which `mistray.trace` does.

    Examples
    --------
    >>> table = mistray.analysis.critical_rays(mistray.load("cooke_triplet"), 10, rays=2000, rim=4)
    >>> table.name.unique().tolist()
    ['centre', 'rim 0°', 'rim 90°', 'rim 180°', 'rim 270°']
    >>> ends = table.groupby("name").last()
    >>> print(f"the centre of the beam arrives at y = {ends.y_mm['centre']:.1f} mm")
    the centre of the beam arrives at y = 8.8 mm
    """
    tables: list[pd.DataFrame] = []
    light: Any = {"wavelength_nm": request.wavelength_nm, "azimuth_deg": request.azimuth_deg, "rays": request.rays}
    direct: Any = {"max_reflections": 0, "max_scatters": 0, "polarization": Settings.of(scene).polarization}
    for field in dict.fromkeys(request.field_deg or [None]):
        t = trace(scene, field_deg=field, **light, **direct)
        angle = float(t.settings["field_deg"])
        image = [row for row in t.paths if row.kind == DIRECT]
        if not image:
            raise MistrayError(f"field {angle:g} deg: no light forms an image; leave the field out")
        # The strongest path of each source and wavelength: others are the same light by another way
        for row in {(row.source, row.wavelength_nm): row for row in reversed(image)}.values():
            history = t.history(row.path_id, row.rays)
            met = np.array([points[1] for points in history.rays])  # rays of a near source may share their start
            first = history.to_pandas().query("node == 0")[["dx", "dy", "dz"]].to_numpy(np.float64)
            chosen = _outermost(met, first.mean(axis=0), request.rim)
            table = history[list(chosen.values())].to_pandas()
            table.insert(0, "name", [list(chosen)[number] for number in table.ray])
            table.insert(0, "field_deg", angle)
            table["ray"] += tables[-1].ray.max() + 1 if tables else 0
            tables.append(table)
    return pd.concat(tables, ignore_index=True)


critical_rays = analysis("critical_rays", CriticalRaysRequest, run)


def _outermost(points: np.ndarray, along: np.ndarray, rim: int) -> dict[str, int]:
    """
    Return the index of the ray nearest the beam's centre, and indices of rays at its rim, by name.

    The rays go through `points`, (n, 3), mm, about the vector `along`, (3,). The rim has `rim` directions; a ray that
    is outermost in several has the name of the first. Names are those of `run`.
    """
    along = along / np.linalg.norm(along)
    across = np.array([1.0, 0.0, 0.0]) - along[0] * along
    if np.linalg.norm(across) < 1e-6:
        across = np.array([0.0, 1.0, 0.0]) - along[1] * along
    across /= np.linalg.norm(across)
    plane = (points - points.mean(axis=0)) @ np.column_stack([across, np.cross(along, across)])
    found = {"centre": int(np.argmin(np.linalg.norm(plane, axis=1)))}
    for k in range(rim):
        turn = 2 * np.pi * k / rim
        number = int(np.argmax(plane @ [np.cos(turn), np.sin(turn)]))
        if number not in found.values():
            found[f"rim {360 * k / rim:g}°"] = number
    return found
