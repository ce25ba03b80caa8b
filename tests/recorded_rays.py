"""All rays of a trace that reach the detector, for the oracle of frozen paths."""

from __future__ import annotations

import numpy as np
from oracles.frozen_paths import Bundle

from mistray.events import EVENT_BITS, EVENT_MASK, INTERCEPTS
from mistray.recorders.branch_recorder import NODE_FLOATS
from mistray.trace import Trace


def recorded_bundles(trace: Trace, run: int = 0) -> list[Bundle]:
    """
    Every branch of one source and wavelength that ends on the detector, by path, as the kernel wrote it down.

    Positions found again in float64, as `Trace.history` has them, would share code with the program under test.
    """
    of = trace.runs[run]
    count = int(trace.paths.column("rays")[trace.paths.located()[run].ids].sum())
    recorder = of.record(None, count)
    assert int(recorder.count[0]) == count, "the rays that were recorded are not those of the ledger"
    lanes, lengths = np.array(recorder.lane)[:count], np.array(recorder.length)[:count]
    codes = np.array(recorder.codes).reshape(recorder.capacity, -1)[:count]
    nodes = np.array(recorder.nodes).reshape(recorder.capacity, -1, NODE_FLOATS)[:count].astype(np.float64)
    nodes[:, :, :3] += of.table.centre
    origins, directions = of.start_rays(lanes)
    weights = np.array(of.start_pass(0).w, dtype=np.float64)[lanes]
    codes = np.where(np.arange(codes.shape[1]) < lengths[:, None], codes, 0)
    lists, group = np.unique(codes, axis=0, return_inverse=True)
    ids = of.table.event_ids
    bundles = []
    for number, events in enumerate(lists):
        here = np.flatnonzero(group.ravel() == number)
        here = here[np.argsort(lanes[here], kind="stable")]
        k = lengths[here[0]]
        names = tuple((ids[int(c) >> EVENT_BITS], INTERCEPTS[int(c) & EVENT_MASK]) for c in events[:k])
        own = np.moveaxis(nodes[here, :k], 0, 1)
        leaving = np.concatenate([own[1:, :, 3:6], np.zeros((1, len(here), 3))])
        leaving[:-1] /= np.linalg.norm(leaving[:-1], axis=2, keepdims=True)
        bundles.append(Bundle(names, origins[here], directions[here], own[:, :, :3], leaving, of.unit * weights[here],
                              of.unit * own[-1, :, 6], lanes[here]))  # fmt: skip
    return bundles
