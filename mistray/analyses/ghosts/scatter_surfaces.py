"""Scattered light on the detector by surface: the power of all paths by the first surface that scatters them.

A material that scatters within its body counts as a surface; its name is in brackets.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from mistray.recorders.path_events import DIRECT
from mistray.trace import Trace

COLUMNS = ("surface", "part", "paths", "rays", "power_W", "power_se_W", "percent_of_stray")


def scatter_surfaces(trace: Trace, table: pd.DataFrame) -> pd.DataFrame:
    """
    Return the power on the detector by the surface where it was scattered first.

    Parameters
    ----------
    trace : Trace
    table : DataFrame
        ``trace.paths.by_way()``, or its rows of one wavelength.

    Returns
    -------
    DataFrame
        Strongest first; empty if nothing scatters. surface, part, paths (number of rows of `table`, each wavelength by
        itself), rays (hits of the detector), power_W, power_se_W and percent_of_stray, the percentage of the power of
        all rows except the direct ones.
    """
    stray = float(table.power_W[table.kind != DIRECT].sum())
    # A medium that scatters is no surface; it is its own part
    parts = {row.id: row.part for row in trace.surfaces}
    rows = []
    for surface, paths in table[table.scatters > 0].groupby("scatter_1", sort=False):
        power, se = trace.paths.power(np.concatenate([np.array(ids) for ids in paths.path_ids]))
        part = parts.get(str(surface), str(surface))
        rows.append((surface, part, len(paths), int(paths.rays.sum()), power, se, 100 * power / stray))
    return pd.DataFrame(rows, columns=COLUMNS).sort_values("power_W", ascending=False, ignore_index=True)
