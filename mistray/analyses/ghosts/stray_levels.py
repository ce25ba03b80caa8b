"""Stray light by level and critical surface, as in FRED's Stray Light Report.

The scatter level of a path is the number of its scatter and diffraction events, its split level the number of its
specular reflections other than at mirrors. Its critical surface is the last at which one of these occurred: the one
that the detector sees lit. Every stray path is in one cell of either table, so that both add up to all stray light.
"""

from __future__ import annotations

import pandas as pd

from mistray.errors import MistrayError
from mistray.recorders.path_events import DIRECT
from mistray.trace import Trace

LEVELS = ("scatter", "split")
COLUMNS = ("level", "surface", "part", "paths", "rays", "power_W", "power_se_W", "percent_of_stray", "path_ids")


def stray_levels(trace: Trace, table: pd.DataFrame, by: str = "scatter") -> pd.DataFrame:
    """
    Return the power of stray light, W, by level and by critical surface, the last one that scatters or splits it.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    table : DataFrame
        ``trace.paths.by_way()``, or its rows of one wavelength.
    by : {"scatter", "split"}
        Level of a path: number of its scatter and diffraction events, or of its reflections other than at mirrors.

    Returns
    -------
    DataFrame
        Rows for each level and surface that holds light, by level and then the strongest first. Columns: level,
        surface, part, paths (each wavelength by itself), rays (hits of the detector), power_W, power_se_W (of the sum),
        percent_of_stray and path_ids. Surface is "-" for light that only goes past the optics or is totally reflected.
        ``pivot_table(index="surface", columns="level", values="power_W")`` lays it out as a report.

    Raises
    ------
    MistrayError
        If `by` is neither.
    """
    if by not in LEVELS:
        raise MistrayError(f"stray_levels: by is '{by}'; use 'scatter' or 'split'")
    stray = table[table.kind != DIRECT]
    level = stray.scatters if by == "scatter" else stray.order + stray.structure_bounces
    total = float(stray.power_W.sum())
    parts = {row.id: row.part for row in trace.surfaces}
    rows = []
    for (number, surface), paths in stray.groupby([level.to_numpy(), "critical"], sort=False):
        ids = sum(paths.path_ids, ())
        power, se = trace.paths.power(ids)
        part = parts.get(str(surface), str(surface))
        numbers = power, se, 100 * power / total
        rows.append((int(number), str(surface), part, len(paths), int(paths.rays.sum()), *numbers, ids))
    found = pd.DataFrame(rows, columns=COLUMNS)
    return found.sort_values(["level", "power_W"], ascending=[True, False], ignore_index=True)
