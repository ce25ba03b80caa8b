"""Tables of rays that arrive at any surface or leave the scene, whether or not the detector sees their light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mistray.errors import MistrayError
from mistray.execute.tracer import Run
from mistray.recorders.branch_recorder import ElsewhereRecorder
from mistray.surfaces.optics import DETECTOR, OPAQUE
from mistray.trace.elsewhere.arriving import kinds_and_keys, passing
from mistray.trace.filter_rows import named_like, unknown_name
from mistray.trace.history import Ray, RayHistory, joined_histories, rays_in_slots, spread
from mistray.trace.path_filter import PathFilter
from mistray.trace.ray_table import portions, recorded

if TYPE_CHECKING:
    import pandas as pd

    from mistray.recorders.start_rays import StartRays
    from mistray.trace.result import Trace

BLOCKED, ESCAPED, RETURNED = "blocked", "escaped", "returned"
ELSEWHERE = (BLOCKED, ESCAPED, RETURNED)
CAPACITY = 1 << 14  # branches that are recorded at a time


def rays_elsewhere(
    t: Trace, where: str | Sequence[str], requested: PathFilter, n: int | None, events: bool
) -> pd.DataFrame:
    """Return a table of rays that arrive at surfaces or leave the scene, see `mistray.trace.Trace.rays_at`."""
    if n is not None and n < 1:
        raise MistrayError(f"n is {n}; ask for at least one ray, or None for all")
    words = [where] if isinstance(where, str) else list(where)
    # Rays of each run
    tables = []
    for run in t.runs:
        rays = list(_rays(run, words, requested, n))
        rays = [rays[k] for k in spread(len(rays), n)]
        facts = {"source": np.full(len(rays), run.source.name, dtype=object)}
        if rays:
            facts |= zip(("kind", "key"), kinds_and_keys(run, [ray.codes for ray in rays]), strict=True)
        tables.append(RayHistory(run, rays).with_facts(facts))
    table = joined_histories(tables)
    # Every run has found up to n rays: choose n of all
    if n is not None and table.ray.nunique() > n:
        kept = spread(table.ray.nunique(), n)
        table = table[table.ray.isin(kept)].reset_index(drop=True)
        table["ray"] = np.searchsorted(kept, table.ray)
    return table if events else _ends(table)


def _ends(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each ray of a table of nodes: its last node, with the direction in which it arrives there."""
    last = table.groupby("ray").tail(1).reset_index(drop=True)
    before = table[table.node == table.groupby("ray").node.transform("max") - 1].reset_index(drop=True)
    # A ray that ends on a surface has no direction after its last node
    gone = np.abs(last[["dx", "dy", "dz"]]).sum(axis=1) > 0
    for name in ("dx", "dy", "dz"):
        last[name] = np.where(gone, last[name], before[name])
    history = table[table.node > 0].groupby("ray").apply(lambda one: " ".join(one.surface + ":" + one.intercept))
    last["history"] = history.to_numpy() if len(last) else []
    return last


def _rays(run: Run, words: Sequence[str], requested: PathFilter, n: int | None) -> Iterator[Ray]:
    """Yield enough rays of one run, from growing portions of its start rays, each spread over the beam."""
    check_where(words)
    departs = any(word in (ESCAPED, RETURNED) for word in words)
    chosen = np.zeros(run.table.count, dtype=bool) if departs else _chosen(run, words)
    recorder = ElsewhereRecorder(CAPACITY, run.settings.max_events, surfaces=chosen, departs=departs)
    found = 0
    for start in portions(run):
        for ray in _walk(run, start, recorder, requested):
            if words == [RETURNED] and ray.directions[-1] @ ray.directions[0] >= 0:
                continue
            found += 1
            yield ray
        if n is not None and found >= n:
            return


def check_where(words: Sequence[str]) -> list[str]:
    """Return the names of surfaces among `words`; raise if light that leaves is combined with anything else."""
    if len(words) > 1 and any(word in (ESCAPED, RETURNED) for word in words):
        raise MistrayError(f"where is {', '.join(words)}; give {ESCAPED} or {RETURNED} alone, or names of surfaces")
    return [word for word in words if word not in ELSEWHERE]


def _chosen(run: Run, words: Sequence[str]) -> np.ndarray:
    """Return which surfaces are meant."""
    ids, parts = run.table.ids, run.table.parts
    chosen = np.zeros(len(ids), dtype=bool)
    for word in words:
        here = named_like(word, ids, parts)
        if word == BLOCKED:
            here = (run.table.optics.host_words & np.uint32(OPAQUE | DETECTOR)) == OPAQUE
        elif not here.any():
            raise MistrayError(f"rays_at: {unknown_name(word, [*ids, *ELSEWHERE], [*parts, *ELSEWHERE])}")
        chosen |= here
    return chosen


def _walk(run: Run, start: StartRays, recorder: ElsewhereRecorder, requested: PathFilter) -> Iterator[Ray]:
    """Yield the rays of some start rays that the filter selects."""
    for count in recorded(run, start, recorder):
        slots = np.flatnonzero(passing(run, [requested], recorder, count)[0])
        slots = slots[np.argsort(np.array(recorder.lane)[slots], kind="stable")]
        headings = np.array(recorder.heading).reshape(-1, 3)[slots].astype(np.float64)
        rays = rays_in_slots(run, recorder, slots, *run.start_rays(np.array(recorder.lane)[slots]))
        leaving = run.unit * np.array(recorder.weight)[slots]
        for ray, heading, flux in zip(rays, headings, leaving, strict=True):
            # The last node of a ray that leaves is the last surface: direction and flux are those after it
            if recorder.departs:
                ray.directions[-1], ray.flux_W[-1] = heading, flux
            yield ray
