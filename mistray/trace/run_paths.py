"""The paths that a run has found, and what a filter is asked about of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.path_events import Events
from mistray.trace.filter_rows import Rows

if TYPE_CHECKING:
    from mistray.recorders.ledger import DecodedPaths
    from mistray.surfaces.surfaces import SurfaceTable


class RunPaths(NamedTuple):
    """Ledger of a run: contents, start rays by batch (BATCHES,), flux of one (W), surfaces, design, source."""

    paths: DecodedPaths
    started: np.ndarray
    unit: float
    table: SurfaceTable
    design: DesignSequences
    source: str


def rows_of(
    run: RunPaths,
    place: np.ndarray,
    columns: Mapping[str, np.ndarray],
    by_ray: frozenset[str] = frozenset(),
    sources: Sequence[str] = (),
) -> Rows:
    """What a filter is asked about: the paths at these places of the ledger of a run, with columns of as many rows."""
    paths, table = run.paths, run.table
    events = Events(paths.events[place], paths.lengths[place], table.event_words, run.design)
    return Rows(events, table.event_ids, table.event_parts, columns, table.count, by_ray, sources)
