"""Irradiance of the brightest pixel of every path, and ranking of paths by this irradiance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from mistray.metrics.ghost_ranking import ranks
from mistray.recorders.film import images_of
from mistray.toolkit.irradiance import brightest
from mistray.trace import Trace

MAP_BYTES = 400e6  # of the maps of paths while they are summed
BYTES_PER_PIXEL = 8  # of a map; of one with standard errors for each group of batches
SURE = 20  # brightest paths that are certainly found

Floats = npt.NDArray[np.float64]


def with_peaks(table: pd.DataFrame, trace: Trace) -> pd.DataFrame:
    """
    Return a path table with the brightest pixel of each path, found by tracing the same rays again.

    Each run maps as many paths as memory allows, the strongest ones first. It also maps the others together. None
    of them can be brighter than that map, so the runs end as soon as it is darker than the `SURE` brightest paths.

    Parameters
    ----------
    table : DataFrame
        Table from `mistray.metrics.ghost_ranking.ranked`, the strongest path first.
    trace : Trace
        Trace of the table.

    Returns
    -------
    DataFrame
        Table with three more columns. ``peak_W_mm2`` and ``peak_se_W_mm2`` are the irradiance of the brightest pixel,
        NaN where no map was needed. ``rank_peak`` is 1 for the brightest stray path and 0 for direct paths. Paths of
        few rays rank last, because a few rays in one pixel are often too bright; so do those without a map.
    """
    well = ~table.few_rays.to_numpy(np.bool_)
    value, se = _peaks(trace, list(table.path_ids), well)
    table = table.assign(peak_W_mm2=value, peak_se_W_mm2=np.where(well, se, np.nan))
    light, known = table.power_W.to_numpy(np.float64), np.isfinite(value)
    order = np.lexsort((-light, -np.where(known, value, 0.0), ~(well & known)))
    return table.assign(rank_peak=ranks(table, order))


def _peaks(trace: Trace, ways: Sequence[Sequence[int]], well: npt.NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return the brightest pixel of each path and its standard error, W/mm², (n,) each; NaN for unmapped paths."""
    pixels = trace.irradiance.size
    images = MAP_BYTES / (BYTES_PER_PIXEL * pixels) - 1  # less the one of all others
    room = max(int(images / images_of(pixels)), 1)
    value, se = np.full((2, len(ways)), np.nan)
    for first in range(0, len(ways), room):
        after = min(first + room, len(ways))
        others = [path_id for way in ways[after:] for path_id in way]
        *maps, rest = trace.each_map([*ways[first:after], others], [*[True] * (after - first), False])
        for k, found in enumerate(map(brightest, maps), first):
            value[k], se[k] = found.value, found.se
        sure = np.sort(value[:after][well[:after]])[-SURE:]
        if len(sure) == SURE and sure[0] >= rest.value.max():
            break
    return value, se
