"""Path analysis as in OpticStudio: the paths of a trace sorted by one of seven keys, weak ones combined."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mistray.analyses.ghosts.request import SORT_KEYS
from mistray.errors import MistrayError
from mistray.toolkit.rows import column, frame
from mistray.trace import Trace

RAYS = 64  # of a path, for its mean optical path length
UNCATEGORISED = "uncategorised"


@dataclass(frozen=True, kw_only=True)
class AnalysedPath:
    """
    Row of a path analysis: one path, or all weak paths together.

    The latter has only power (W), share and branches.
    """

    path_id: int = column("number of the path; -1: the uncategorised ones", -1, head="path", absent=-1)
    wavelength_nm: float = column("its vacuum wavelength", math.nan)
    label: str = column("its name", "-", head="name")
    kind: str = column("its kind", UNCATEGORISED)
    power_W: float = column("its power", head="power [W absorbed]")
    power_se_W: float = column("its standard error")
    percent: float = column("share of all detected power")
    branches: int = column("rays that came this way")
    objects: int = column("surfaces met, the detector included", -1, absent=-1)
    unique_objects: int = column("the different ones of them", -1, head="unique [objects]", absent=-1)
    last_object: str = column("the last one before the detector", "-", absent="-")
    diffractions: int = column("diffraction events", -1, absent=-1)
    opl_mm: float = column(
        "mean optical path length from the start of the rays, with the flux as weight", math.nan, head="mean OPL [mm]"
    )
    opl_se_mm: float = column(
        f"its standard error over at most {RAYS} rays, as of independent ones; infinite for a single ray", math.nan
    )
    events: str = column("its events", "-")


def path_analysis(
    trace: Trace, sort: str = "power_W", least_share: float = 0.0, path_ids: int | Sequence[int] | None = None
) -> pd.DataFrame:
    """
    Return a table of the paths of a trace with power, optical path length and other properties, sorted by a key.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    sort : {"power_W", "objects", "branches", "last_object", "unique_objects", "opl_mm", "diffractions"}
        Sort key: text from A to Z, numbers from the largest; paths with equal keys by power.
    least_share : float
        Paths with less than this share of all detected power, 0 … 1, are combined in a last row, "uncategorised".
    path_ids : int or sequence of int, optional
        Paths to include, such as those that pass a filter. Default: all.

    Returns
    -------
    DataFrame
        A row for each path with the fields of `AnalysedPath` as columns; a last row combines the weak paths, if any.

    Raises
    ------
    MistrayError
        If the key or a path id is unknown, or the share is below 0 or not below 1.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> table = mistray.analysis.path_analysis(t, sort="opl_mm")
    >>> table[["label", "branches"]].head(2)
                     label  branches
    0   L3_rear → L1_front      2081
    1  L3_front → L1_front      1055
    """
    if sort not in SORT_KEYS:
        raise MistrayError(f"path_analysis: sort is '{sort}'; use {', '.join(SORT_KEYS)}")
    if not 0 <= least_share < 1:
        raise MistrayError(f"path_analysis: least_share is {least_share:g}; it must lie between 0 and 1")
    table = trace.paths.to_pandas()
    total = float(table.power_W.sum())
    if path_ids is not None:
        table = table[table.path_id.isin(trace.paths.check_ids(path_ids))]
    strong = table.power_W >= least_share * total
    weak, table = table[~strong], table[strong].rename(columns={"rays": "branches"})
    lengths = mean_lengths(trace, table.path_id.tolist())
    table["opl_mm"] = [lengths[path_id][0] for path_id in table.path_id]
    table["opl_se_mm"] = [lengths[path_id][1] for path_id in table.path_id]
    table = table.sort_values([sort, "power_W"], ascending=[not SORT_KEYS[sort], False], kind="stable")
    rows = list(table.itertuples(index=False))
    if len(weak):
        power, se = trace.paths.power(weak.path_id.to_numpy())
        branches = int(weak.rays.sum())
        rows.append(AnalysedPath(power_W=power, power_se_W=se, percent=100 * power / total, branches=branches))
    return frame(AnalysedPath, rows)


def mean_lengths(trace: Trace, path_ids: Sequence[int]) -> Mapping[int, tuple[float, float]]:
    """
    Return the mean optical path length of each path, weighted by flux, and its standard error, mm, by path id.

    The error is infinite for a path of a single ray.
    """
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
