"""Filters of branches that arrive at any surface or leave the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from mistray.errors import MistrayError
from mistray.execute.tracer import Run
from mistray.recorders.branch_recorder import BranchRecorder
from mistray.recorders.path_events import Events, describe_events
from mistray.recorders.path_key import padded
from mistray.trace.filter_rows import Rows
from mistray.trace.path_filter import PathFilter
from mistray.trace.paths import PathRow

# Columns of `describe_events`; the others are the end of a path and the source of its light
NAMES = [f.name for f in fields(PathRow)]
OF_EVENTS = tuple(NAMES[NAMES.index("key") : NAMES.index("critical") + 1])
COLUMNS = ("wavelength_nm", "source", "type", "surface", "detector", *OF_EVENTS)


def check_columns(requested: PathFilter) -> None:
    """Raise if a filter compares a column that only light on a detector has, such as its power."""
    missing = requested.columns - set(COLUMNS)
    if missing:
        raise MistrayError(
            f"filter '{requested.text}': of light elsewhere than on the detector there is no '{min(missing)}'; compare "
            f"{', '.join(COLUMNS[:4])}, kind, order, scatters, or use flags such as H(x)"
        )


def passing(run: Run, filters: Sequence[PathFilter], recorder: BranchRecorder, count: int) -> np.ndarray:
    """Return masks of the first `count` branches of a recorder that each filter selects, (filters, count) bool."""
    # Branches of one path have the same answer
    for requested in filters:
        check_columns(requested)
    codes, lengths = recorder.events(np.arange(count))
    _, first, path = np.unique(np.array(recorder.path)[:count], return_index=True, return_inverse=True)
    compared = frozenset().union(*(requested.columns for requested in filters))
    rows = _rows(run, Events.of(run.table, run.design, codes, lengths)[first], compared)
    held = np.array([requested.holds(rows) for requested in filters]).reshape(len(filters), len(first))
    return np.asarray(held[:, path.ravel()])


def kinds_and_keys(run: Run, events: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the class of path and the key of each event list, columns ``kind`` and ``key`` of `PathRow`, (n,) each."""
    codes, lengths = padded(events)
    # Rays of one path are described once
    _, first, path = np.unique(np.column_stack([codes, lengths]), axis=0, return_index=True, return_inverse=True)
    facts = describe_events(Events.of(run.table, run.design, codes[first], lengths[first]))
    return facts["kind"][path.ravel()], facts["key"][path.ravel()]


def _rows(run: Run, events: Events, columns: frozenset[str]) -> Rows:
    table, count = run.table, len(events)
    ends = np.array(events.ids, dtype=object)[run.design.ends(events.codes, events.lengths)]
    found = {
        "wavelength_nm": np.full(count, run.source.wavelength_nm),
        "source": np.full(count, run.source.name, dtype=object),
        "type": np.array([types[-1] for types in events.intercepts], dtype=object),
        "surface": ends,
        "detector": ends,
    }
    # Describing events takes longer than all else: only where a filter compares them
    if columns & set(OF_EVENTS):
        found |= describe_events(events)
    return Rows(events, table.event_parts, found, table.count)
