"""Maps of parts of the light on any surface: kinds of paths, or the light that filters select."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from mistray.errors import UnfinishedError
from mistray.execute.tracer import Run
from mistray.recorders.branch_recorder import CellRecorder
from mistray.recorders.passing.surface_maps import SurfaceMap, SurfaceMaps
from mistray.recorders.sampled import Sampled
from mistray.settings import BATCHES
from mistray.time_budget import time_is_up
from mistray.trace.elsewhere.arriving import check_columns, passing
from mistray.trace.path_filter import PathFilter
from mistray.trace.ray_table import portions, recorded

if TYPE_CHECKING:
    from mistray.trace.result import Trace

CAPACITY = 1 << 15  # branches that are recorded at a time
FULL = 0.8  # fraction of the recorder that a portion of the start rays should fill


def light_maps(t: Trace, maps: SurfaceMaps, filters: Sequence[PathFilter]) -> list[dict[str, SurfaceMap]]:
    """
    Return maps of the incident and absorbed flux that filters select on surfaces, by tracing the same rays again.

    Parameters
    ----------
    t : Trace
    maps : SurfaceMaps
        Surfaces and their cells; the flux that it has recorded stays as it is.
    filters : sequence of PathFilter
        Filters, each of which gets a map of each surface; they may overlap.

    Returns
    -------
    list of dict
        Maps by the ids of their surfaces, for each filter.
    """
    for requested in filters:
        check_columns(requested)
    found: list[Sampled] | None = None
    for run in t.runs:
        parts = _of_run(run, maps, filters)
        found = parts if found is None else [a + b for a, b in zip(found, parts, strict=True)]
    return [maps.maps_of(flux) for flux in found or ()]


def _of_run(run: Run, maps: SurfaceMaps, filters: Sequence[PathFilter]) -> list[Sampled]:
    """Return the flux that filters select by cell, with its noise, (cells,) each, W."""
    maps.attach(run.scene)
    sums = np.zeros((len(filters), maps.groups, maps.cells))
    recorder = CellRecorder(CAPACITY, run.settings.max_events, points_only=True, maps=maps)
    behind = maps.shape[0] * maps.shape[1]
    branches = 0.0  # largest number of branches per start ray so far

    def grow(size: int) -> int:
        return max(1, min(int(FULL * CAPACITY / max(branches, 1e-6)), 8 * size))

    for start in portions(run, grow):
        if time_is_up():
            raise UnfinishedError("the time is up before the maps of parts of the light are traced; give more seconds")
        many = 0
        for count in recorded(run, start, recorder):
            many += count
            held = passing(run, filters, recorder, count)
            cell, batch = np.array(recorder.cell)[:count], np.array(recorder.batch)[:count]
            # Incident and absorbed flux of a cell, one after the other
            group = batch // (BATCHES // maps.groups)
            flux = [np.array(values)[:count] for values in (recorder.weight, recorder.absorbed)]
            for own, here in zip(sums, held, strict=True):
                for place, values in zip((cell, cell + behind), flux, strict=True):
                    np.add.at(own, (group[here], place[here]), values[here])
        branches = max(branches, many / dr.width(start.lane))
    started = run.started.reshape(maps.groups, -1).sum(axis=1)
    return [Sampled.of(own.T, started).scaled(run.unit) for own in sums]
