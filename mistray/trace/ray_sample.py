"""Rays of many paths at once, from one sample of the start rays."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from mistray.execute.tracer import PASS_LANES, Run
from mistray.recorders.branch_recorder import BranchRecorder, as_many
from mistray.surfaces.upload import upload
from mistray.time_budget import time_is_up
from mistray.trace.history import Ray, rays_in_slots
from mistray.trace.sampled_hits import GOLDEN

START_RAYS = 640  # number of start rays of the sample
FIRST = 32  # number of the first of them; it doubles until all paths have enough
CAPACITY = 1 << 17  # branches that are recorded at a time; others are not in the sample


def sample_rays(run: Run, keys: Sequence[int], most: int) -> dict[int, list[Ray]]:
    """
    Return rays of paths, spread over the beam.

    Parameters
    ----------
    run : Run
    keys : sequence of int
        Keys of the paths, see `mistray.recorders.path_key.extend_key`.
    most : int
        Number of rays of each path that is enough.

    Returns
    -------
    dict
        Rays by key; none of a path that no ray of the sample follows. When the time is up the sample is smaller.
    """
    found: dict[int, list[Ray]] = {key: [] for key in keys}
    # Start rays are numbered along a curve through the beam, once for each batch: equal steps would meet the same place
    # of it in every batch. Multiples of the golden ratio are spread over the batches and over the curve, early ones too
    lanes = (np.arange(START_RAYS) * GOLDEN % 1 * run.rays).astype(np.int64)
    lanes = np.array(list(dict.fromkeys(lanes.tolist())))
    recorder = BranchRecorder(as_many(CAPACITY, run.settings.max_events), run.settings.max_events)
    for number in np.unique(lanes // PASS_LANES):
        own = lanes[lanes // PASS_LANES == number] - number * PASS_LANES
        sample = run.start_pass(int(number)).take(upload(mi.UInt32, own))
        origins, directions = run.exact(sample)
        place = {int(lane): k for k, lane in enumerate(np.array(sample.lane))}
        for part in np.split(np.arange(len(own)), FIRST * 2 ** np.arange(int(np.log2(START_RAYS / FIRST)) + 1)):
            if not len(part):
                continue
            recorder.clear()
            run.trace_trees(sample.take(upload(mi.UInt32, part)), recorder)
            slots = _requested(recorder, [key for key, rays in found.items() if len(rays) < most], most)
            starts = [place[int(lane)] for lane in np.array(recorder.lane)[slots]]
            rays = rays_in_slots(run, recorder, slots, origins[starts], directions[starts])
            for key, ray in zip(np.array(recorder.path)[slots].tolist(), rays, strict=True):
                if len(found[key]) < most:
                    found[key].append(ray)
            if time_is_up() or all(len(rays) >= most for rays in found.values()):
                return found
    return found


def _requested(recorder: BranchRecorder, keys: Sequence[int], most: int) -> np.ndarray:
    """Return the places of at most `most` recorded branches of each of these paths."""
    count = min(int(recorder.count[0]), recorder.capacity)
    paths = np.array(recorder.path)[:count]
    order = np.argsort(paths, kind="stable")
    ends = [np.searchsorted(paths[order], np.array(keys, dtype=np.uint64), side) for side in ("left", "right")]
    parts = [order[first : min(last, first + most)] for first, last in zip(*ends, strict=True)]
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])
