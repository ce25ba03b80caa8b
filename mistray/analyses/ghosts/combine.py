"""Merging the rows of one path at several wavelengths into one row of a path table."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mistray.trace.paths import PathTable


def by_path(table: pd.DataFrame, paths: PathTable) -> pd.DataFrame:
    """
    Return a path table with one row for all wavelengths of the same source and events, strongest path first.

    Parameters
    ----------
    table : DataFrame
        ``paths.by_way()``, or rows of it.
    paths : PathTable
        Paths of the trace.

    Returns
    -------
    DataFrame
        Table with unchanged columns: ``path_ids`` of all members, ``path_id`` of the strongest, and ``wavelength_nm``
        as the mean weighted by power. A path of one wavelength keeps its values.
    """
    if not table.duplicated(["source", "events"]).any():
        return table
    group = table.groupby(["source", "events"], sort=False).ngroup().to_numpy(np.int64)
    order = np.argsort(group, kind="stable")
    _, starts = np.unique(group[order], return_index=True)
    ids = table.path_ids.to_numpy()[order]
    together = [sum(ids[a:b], ()) for a, b in zip(starts, [*starts[1:], len(order)], strict=True)]
    power, wavelength = (table[name].to_numpy(np.float64) for name in ("power_W", "wavelength_nm"))
    mean = np.bincount(group, power * wavelength) / np.bincount(group, power)
    single = np.bincount(group) == 1
    heads = table.iloc[order[starts]]  # the table is sorted: the strongest
    mean = np.where(single, heads.wavelength_nm, mean)
    result = heads.assign(**paths.columns_of(together), wavelength_nm=mean, path_ids=together)
    return result.sort_values("power_W", ascending=False, kind="stable", ignore_index=True)
