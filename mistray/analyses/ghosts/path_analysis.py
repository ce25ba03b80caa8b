"""Path analysis as in OpticStudio: the paths of a trace sorted by one of seven keys, with weak ones combined."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from mistray.analyses.ghosts.request import SORT_KEYS
from mistray.errors import MistrayError
from mistray.trace import Trace

RAYS = 64  # of a path, for its mean optical path length
UNCATEGORISED = "uncategorised"
COLUMNS = (
    "path_id", "wavelength_nm", "label", "kind", "power_W", "power_se_W", "percent", "branches", "objects",
    "unique_objects", "last_object", "diffractions", "opl_mm", "opl_se_mm", "events",
)  # fmt: skip


def path_analysis(
    trace: Trace, sort: str = "power_W", least_share: float = 0.0, path_ids: Sequence[int] | None = None
) -> pd.DataFrame:
    """
    Return the paths of a trace with their description, sorted by a key.

    Parameters
    ----------
    trace : Trace
    sort : {"power_W", "objects", "branches", "last_object", "unique_objects", "opl_mm", "diffractions"}
        Sort key: text from A to Z, numbers from the largest; equal ones by power.
    least_share : float
        Paths with less than this share of all detected power are combined in a last row, "uncategorised"; 0 … 1.
    path_ids : sequence of int, optional
        Paths to list, such as those of a filter. Default: all.

    Returns
    -------
    DataFrame
        Columns path_id (-1: uncategorised paths), wavelength_nm, label (name of the path), kind, power_W with its
        standard error, and percent (of all detected power). Further columns are branches (number of rays on this path),
        objects (surfaces met, with the detector), unique_objects, last_object (before the detector), diffractions,
        opl_mm and events. opl_mm is the mean optical path length from the start of the rays, mm, weighted by flux. The
        standard error of this mean is for at most `RAYS` rays, taken as independent; infinite for a single ray. In the
        last row power and branches are sums; columns that describe one path only are NaN, -1 or "-".

    Raises
    ------
    MistrayError
        If the key is unknown or the share is not within 0 … 1.
    """
    if sort not in SORT_KEYS:
        raise MistrayError(f"path_analysis: sort is '{sort}'; use {', '.join(SORT_KEYS)}")
    if not 0 <= least_share < 1:
        raise MistrayError(f"path_analysis: least_share is {least_share:g}; it must lie between 0 and 1")
    table = trace.paths.to_pandas()
    total = float(table.power_W.sum())
    if path_ids is not None:
        trace.paths.located(path_ids)  # raises if there is no such path
        table = table[table.path_id.isin(list(path_ids))]
    strong = table.power_W >= least_share * total
    weak, table = table[~strong], table[strong].rename(columns={"rays": "branches"})
    lengths = mean_lengths(trace, table.path_id.tolist())
    table["opl_mm"] = [lengths[path_id][0] for path_id in table.path_id]
    table["opl_se_mm"] = [lengths[path_id][1] for path_id in table.path_id]
    table = table.sort_values([sort, "power_W"], ascending=[not SORT_KEYS[sort], False], kind="stable")[list(COLUMNS)]
    if len(weak):
        power, se = trace.paths.power(weak.path_id.to_numpy())
        rest = {
            "path_id": -1, "wavelength_nm": math.nan, "label": "-", "kind": UNCATEGORISED, "power_W": power,
            "power_se_W": se, "percent": 100 * power / total, "branches": int(weak.rays.sum()), "objects": -1,
            "unique_objects": -1, "last_object": "-", "diffractions": -1, "opl_mm": math.nan, "opl_se_mm": math.nan,
            "events": "-",
        }  # fmt: skip
        table = pd.concat([table, pd.DataFrame([rest])]) if len(table) else pd.DataFrame([rest])
    return table.reset_index(drop=True)


def mean_lengths(trace: Trace, path_ids: Sequence[int]) -> Mapping[int, tuple[float, float]]:
    """Return the mean optical path length of each path, weighted by flux, and its standard error, mm."""
    found = {
        path_id: ([ray.opl_mm[-1] for ray in rays], [ray.flux_W[-1] for ray in rays])
        for path_id, rays in trace.sampled_rays(path_ids, RAYS).items()
        if rays
    }
    rare = [path_id for path_id in path_ids if path_id not in found]
    if rare:  # no ray of the sample takes them: all rays once more, for these paths alone
        rays = trace.rays(" | ".join(f"path_id = {path_id}" for path_id in rare), n=None)
        found |= {int(k): (own.opl_mm.tolist(), own.flux_W.tolist()) for k, own in rays.groupby("path_id")}
    return {path_id: _mean(*(np.array(v) for v in found[path_id])) for path_id in path_ids}


def _mean(values: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    count, whole = len(values), weights.sum()
    mean = float(weights @ values / whole)
    if count == 1:
        return mean, math.inf
    return mean, float(np.sqrt(count / (count - 1) * np.sum((weights * (values - mean)) ** 2)) / whole)
