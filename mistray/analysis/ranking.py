"""The rows of a path table set against the direct image on axis, and in the order of their harm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mistray.analysis.estimate import UNKNOWN, Estimate
from mistray.analysis.pool import pooled, power
from mistray.trace.path_events import DIRECT

FEWEST_RAYS = 30  # below this the RMS radius of a path is too uncertain to rank by


@dataclass(frozen=True)
class DirectImage:
    """
    The direct image at one field angle, at one wavelength or at all together.

    Attributes
    ----------
    power_W, rms_radius_mm, rms_irradiance_W_mm2 : Estimate
        Absorbed power, RMS radius about the centroid and ``P / (π r_rms²)``. The last two are NaN, and the power is 0,
        where no direct light reaches the detector.
    """

    power_W: Estimate
    rms_radius_mm: Estimate
    rms_irradiance_W_mm2: Estimate


def direct_image(table: pd.DataFrame) -> DirectImage:
    """
    Direct image from the rows of a path table; see `mistray.analysis.pool.pooled` for the errors.

    Parameters
    ----------
    table : DataFrame
        ``Trace.paths.to_pandas()``, or its rows of one wavelength.
    """
    rows = table[table.kind == DIRECT]
    light = power(rows)
    if light.value <= 0:
        return DirectImage(Estimate(0.0, light.se), UNKNOWN, UNKNOWN)
    numbers = rows.iloc[0] if len(rows) == 1 else pooled(rows)
    return DirectImage(
        light,
        Estimate(float(numbers["rms_radius_mm"]), float(numbers["rms_radius_se_mm"])),
        Estimate(float(numbers["rms_irradiance_W_mm2"]), float(numbers["rms_irradiance_se_W_mm2"])),
    )


def label(ghost_1: str, ghost_2: str, kind: str, scatter_1: str = "-", scatters: int = 0) -> str:
    """A path in words: its ghost surfaces in the order of the light and where it scatters, or its kind."""
    ghosts = " → ".join(name for name in (ghost_1, ghost_2) if name != "-")
    if scatters:
        more = f" and {scatters - 1} more" if scatters > 1 else ""
        return f"{ghosts}{', ' if ghosts else ''}scatter at {scatter_1}{more}"
    return ghosts or ("direct image" if kind == DIRECT else kind)


def ranked(table: pd.DataFrame, yardstick: Estimate) -> pd.DataFrame:
    """
    A path table with labels, normalised RMS irradiance and ranks.

    Parameters
    ----------
    table : DataFrame
        Columns as in ``Trace.paths``.
    yardstick : Estimate
        The RMS irradiance that each row is divided by, W/mm².

    Returns
    -------
    DataFrame
        The same rows with the columns that `GhostReport.table` lists.
    """
    table = table.copy()
    words = table[["ghost_1", "ghost_2", "kind", "scatter_1", "scatters"]]
    table["label"] = [label(*row) for row in words.itertuples(index=False)]
    pairs = table[["rms_irradiance_W_mm2", "rms_irradiance_se_W_mm2"]].itertuples(index=False)
    normalised = [Estimate(*pair).over(yardstick) for pair in pairs]
    table["normalised_rms_irradiance"] = [estimate.value for estimate in normalised]
    table["normalised_rms_irradiance_se"] = [estimate.se for estimate in normalised]
    table["well_sampled"] = table.rays.to_numpy(np.int64) >= FEWEST_RAYS
    stray = table.kind != DIRECT
    for name, power_name in (("percent_of_stray", "power_W"), ("percent_of_stray_se", "power_se_W")):
        table[name] = (100 * table[power_name] / table.power_W[stray].sum()).where(stray)
    light, irradiance = (table[name].to_numpy(np.float64) for name in ("power_W", "rms_irradiance_W_mm2"))
    irradiance = np.where(np.isfinite(irradiance), irradiance, 0.0)
    orders = {
        "rank_power": np.lexsort((-light, ~stray)),
        "rank_rms_irradiance": np.lexsort((-light, -irradiance, ~table.well_sampled, ~stray)),
    }
    for name, order in orders.items():
        rank = np.empty(len(table), dtype=np.int64)
        rank[order] = np.arange(1, len(table) + 1)
        table[name] = np.where(stray, rank, 0)
    return table
