"""Scattered light on the detector by surface: the power of all paths by the first surface that scatters them.

A material that scatters within its body counts as a surface; its name is in brackets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mistray.recorders.path_events import DIRECT
from mistray.toolkit.rows import column, frame
from mistray.trace import Trace


@dataclass(frozen=True)
class ScatteredBy:
    """Light on the detector that a surface was the first to scatter: a row of the table."""

    surface: str = column("the surface, or a material", head="first scatter at")
    part: str = column("part that it belongs to")
    paths: int = column("ways of the light, however they were sampled, each wavelength for itself")
    rays: int = column("hits of the detector")
    power_W: float = column("their power", head="power [W absorbed]")
    power_se_W: float = column("its standard error")
    percent_of_stray: float = column("share of the power of all stray paths")


def scatter_surfaces(trace: Trace, table: pd.DataFrame) -> pd.DataFrame:
    """
    Return the power that reaches the detector, W, by the first surface that scatters it.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    table : DataFrame
        ``trace.paths.by_way()``, or its rows of one wavelength.

    Returns
    -------
    DataFrame
        A row for each `ScatteredBy`, the strongest first; empty if nothing scatters.
    """
    stray = float(table.power_W[table.kind != DIRECT].sum())
    # A medium that scatters is no surface; it is its own part
    parts = {row.id: row.part for row in trace.surfaces}
    rows = []
    for surface, paths in table[table.scatters > 0].groupby("scatter_1", sort=False):
        power, se = trace.paths.power(np.concatenate([np.array(ids) for ids in paths.path_ids]))
        part = parts.get(str(surface), str(surface))
        numbers = len(paths), int(paths.rays.sum()), power, se, 100 * power / stray
        rows.append(ScatteredBy(str(surface), part, *numbers))
    return frame(ScatteredBy, sorted(rows, key=lambda row: -row.power_W))
