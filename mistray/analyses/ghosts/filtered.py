"""Selection of the paths that pass a filter, with their power and share of the stray light."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from mistray.estimate import Estimate
from mistray.recorders.path_events import DIRECT
from mistray.trace import Trace


@dataclass(frozen=True)
class Filtered:
    """
    Paths of a trace that pass a filter, with their total power.

    Attributes
    ----------
    selection : str
        Text of the filter.
    table : DataFrame
        Rows of ``trace.paths.to_pandas()`` that pass, the strongest first.
    power_W : Estimate
        Power of all these paths together, W.
    percent_of_stray : float
        Percentage of all stray light that the stray paths among them carry; NaN without stray light.
    """

    selection: str
    table: pd.DataFrame
    power_W: Estimate
    percent_of_stray: float


def filtered(trace: Trace, rows: pd.DataFrame, selection: str) -> Filtered:
    """
    Return the paths of a trace that pass a filter, with their power and share of stray light.

    Parameters
    ----------
    trace : Trace
        Finished trace.
    rows : DataFrame
        ``trace.paths.by_way()``.
    selection : str
        Filter, see `mistray.trace.path_filter`.
    """
    ids = [row.path_id for row in trace.paths.select(selection)]
    table = trace.paths.to_pandas().iloc[ids].reset_index(drop=True)
    stray = float(rows.power_W[rows.kind != DIRECT].sum())
    own = float(table.power_W[table.kind != DIRECT].sum())
    share = 100 * own / stray if stray > 0 else float("nan")
    return Filtered(selection, table, Estimate(*trace.paths.power(ids)), share)
