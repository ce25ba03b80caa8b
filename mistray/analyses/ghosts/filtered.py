"""Paths that pass a filter, and how much of the stray light they are."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from mistray.estimate import Estimate
from mistray.recorders.path_events import DIRECT
from mistray.trace import Trace


@dataclass(frozen=True)
class Filtered:
    """
    Paths of a trace that pass a filter.

    Attributes
    ----------
    selection : str
        The filter.
    table : DataFrame
        Their rows of ``trace.paths.to_pandas()``, the strongest first.
    power_W : Estimate
        Of all of them together.
    percent_of_stray : float
        Share that the stray ones among them have of all stray light; NaN where there is none.
    """

    selection: str
    table: pd.DataFrame
    power_W: Estimate
    percent_of_stray: float


def filtered(trace: Trace, rows: pd.DataFrame, selection: str) -> Filtered:
    """
    Filter the paths of a trace.

    Parameters
    ----------
    trace : Trace
    rows : DataFrame
        ``trace.paths.by_way()``.
    selection : str
        See `mistray.trace.path_filter`.
    """
    ids = [row.path_id for row in trace.paths.select(selection)]
    table = trace.paths.to_pandas().iloc[ids].reset_index(drop=True)
    stray = float(rows.power_W[rows.kind != DIRECT].sum())
    own = float(table.power_W[table.kind != DIRECT].sum())
    share = 100 * own / stray if stray > 0 else float("nan")
    return Filtered(selection, table, Estimate(*trace.paths.power(ids)), share)
