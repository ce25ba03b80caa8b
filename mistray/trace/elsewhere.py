"""Light that reaches any surface or leaves the scene, whether or not a detector sees it: rays, maps and filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from mistray.errors import MistrayError, UnfinishedError
from mistray.execute.tracer import Run
from mistray.ranges import RAYS_OR_ALL, TEXT, Several
from mistray.recorders.branch_recorder import BranchRecorder, CellRecorder, ElsewhereRecorder
from mistray.recorders.flux_maps.surface_maps import SurfaceMap, SurfaceMaps
from mistray.recorders.path_events import Events, describe_events
from mistray.recorders.path_key import padded
from mistray.recorders.sampled import Sampled
from mistray.settings import BATCHES
from mistray.surfaces.optics import DETECTOR, OPAQUE
from mistray.time_budget import time_is_up
from mistray.trace.filter_rows import Rows, named_like, unknown_name
from mistray.trace.history import Ray, RayHistory, joined_histories, over_the_beam, rays_in_slots
from mistray.trace.path_filter import PathFilter
from mistray.trace.path_row import PathRow
from mistray.trace.ray_table import portions, recorded

if TYPE_CHECKING:
    import pandas as pd

BLOCKED, ESCAPED, RETURNED = "blocked", "escaped", "returned"
ELSEWHERE = (BLOCKED, ESCAPED, RETURNED)
CAPACITY, MAP_CAPACITY = 1 << 14, 1 << 15  # branches that are recorded at a time, for tables and for maps
FULL = 0.8  # fraction of the recorder that a portion of the start rays should fill
# Columns of `describe_events`; the others are the end of a path and the source of its light
NAMES = [f.name for f in fields(PathRow)]
OF_EVENTS = tuple(NAMES[NAMES.index("key") : NAMES.index("critical") + 1])
COLUMNS = ("wavelength_nm", "source", "type", "surface", "detector", *OF_EVENTS)


def rays_elsewhere(
    runs: Sequence[Run], where: str | Sequence[str], requested: PathFilter, n: int | None, events: bool
) -> pd.DataFrame:
    """
    Return a table of rays that arrive at surfaces or leave the scene, one row for each ray.

    With `events` it has a row for each node of each ray. `n` is the most rays that are returned, spread over the beam;
    None: all. `where` names the surfaces, and `requested` is the filter, see `mistray.trace.Trace.rays_at`. Columns and
    units are those of `RayHistory.to_pandas` (mm, W), with source, kind and key. An `n` that is no whole number
    from 1, or a `where` that does not exist or combines leaving light with surfaces, raises `MistrayError`.
    """
    n = None if n is None else RAYS_OR_ALL.check("n", n)
    words = list(Several(TEXT).check("where", where))
    _check_filter(runs, requested)
    # Rays of each run
    tables = []
    for run in runs:
        rays = _rays(run, words, requested, n)
        rays = [rays[k] for k in over_the_beam(len(rays), n)]
        facts = {"source": np.full(len(rays), run.source.name, dtype=object)}
        if rays:
            facts |= zip(("kind", "key"), kinds_and_keys(run, [ray.codes for ray in rays]), strict=True)
        tables.append(RayHistory(run, rays).with_facts(facts))
    table = joined_histories(tables)
    # Every run has found up to n rays: choose n of all
    if n is not None and table.ray.nunique() > n:
        kept = over_the_beam(table.ray.nunique(), n)
        table = table[table.ray.isin(kept)].reset_index(drop=True)
        table["ray"] = np.searchsorted(kept, table.ray)
    return table if events else _ends(table)


def _ends(table: pd.DataFrame) -> pd.DataFrame:
    """
    Return the last node of each ray of a node table, with the unit direction of the ray there.

    It is the direction of arrival, or of departure where a ray leaves the scene. The column history lists the events of
    the ray.
    """
    last = table.groupby("ray").tail(1).reset_index(drop=True)
    before = table[table.node == table.groupby("ray").node.transform("max") - 1].reset_index(drop=True)
    # A ray that ends on a surface has no direction after its last node
    gone = np.abs(last[["dx", "dy", "dz"]]).sum(axis=1) > 0
    for name in ("dx", "dy", "dz"):
        last[name] = np.where(gone, last[name], before[name])
    history = table[table.node > 0].groupby("ray").apply(lambda one: " ".join(one.surface + ":" + one.intercept))
    last["history"] = history.to_numpy() if len(last) else []
    return last


def _rays(run: Run, words: Sequence[str], requested: PathFilter, n: int | None) -> list[Ray]:
    """
    Return rays of a run that reach named places and pass the filter, by tracing more and more start rays.

    It stops once there are at least `n` of them; if `n` is None or the run has fewer, all are returned. `words` are the
    places, see `check_where` and `_chosen`, which raise `MistrayError`.
    """
    check_where(words)
    departs = any(word in (ESCAPED, RETURNED) for word in words)
    chosen = np.zeros(run.table.count, dtype=bool) if departs else _chosen(run, words)
    recorder = ElsewhereRecorder(CAPACITY, run.settings.max_events, surfaces=chosen, departs=departs)
    found: list[Ray] = []
    for start in portions(run):
        for count in recorded(run, start, recorder):
            rays = _read(run, recorder, count, requested)
            found += [ray for ray in rays if words != [RETURNED] or ray.directions[-1] @ ray.directions[0] < 0]
        if n is not None and len(found) >= n:
            break
    return found


def check_where(words: Sequence[str]) -> list[str]:
    """
    Return the words that name surfaces, without those of `ELSEWHERE`.

    Raise `MistrayError` if `ESCAPED` or `RETURNED` is combined with other words.
    """
    if len(words) > 1 and any(word in (ESCAPED, RETURNED) for word in words):
        raise MistrayError(f"where is {', '.join(words)}; give {ESCAPED} or {RETURNED} alone, or names of surfaces")
    return [word for word in words if word not in ELSEWHERE]


def _chosen(run: Run, words: Sequence[str]) -> np.ndarray:
    """
    Return a mask of the surfaces that words name, (s,) bool: ids, parts, patterns or `BLOCKED`.

    `BLOCKED` stands for all opaque surfaces but detectors. Another word that names nothing raises `MistrayError`.
    """
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


def _read(run: Run, recorder: ElsewhereRecorder, count: int, requested: PathFilter) -> list[Ray]:
    """
    Return the rays among the first `count` recorded branches that pass the filter.

    They are in the order of their start rays. If the recorder holds rays that leave the scene, their last direction and
    flux are those after the last hit.
    """
    slots = np.flatnonzero(passing(run, [requested], recorder, count)[0])
    slots = slots[np.argsort(np.array(recorder.lane)[slots], kind="stable")]
    rays = rays_in_slots(run, recorder, slots, *run.weighted_start_rays(np.array(recorder.lane)[slots]))
    if recorder.departs:
        # The last node of a ray that leaves is the last surface: direction and flux are those after it
        headings = np.array(recorder.heading).reshape(-1, 3)[slots].astype(np.float64)
        leaving = run.unit * np.array(recorder.weight)[slots]
        for ray, heading, flux in zip(rays, headings, leaving, strict=True):
            ray.directions[-1], ray.flux_W[-1] = heading, flux
    return rays


def light_maps(runs: Sequence[Run], maps: SurfaceMaps, filters: Sequence[PathFilter]) -> list[dict[str, SurfaceMap]]:
    """
    Return maps of the incident and absorbed flux, W, that filters select on surfaces, by tracing the same rays again.

    Parameters
    ----------
    runs : sequence of Run
        Runs of the trace.
    maps : SurfaceMaps
        Surfaces and their cells; the flux that it has recorded stays as it is.
    filters : sequence of PathFilter
        Filters, each of which gets a map of each surface; they may overlap.

    Returns
    -------
    list of dict
        Maps by the ids of their surfaces, for each filter.

    Raises
    ------
    MistrayError
        If a filter compares a column that only light on a detector has, or names what the scene lacks.
    UnfinishedError
        If the time is up before all rays are traced.
    """
    for requested in filters:
        _check_filter(runs, requested)
    found: list[Sampled] | None = None
    for run in runs:
        parts = _flux_of_run(run, maps, filters)
        found = parts if found is None else [a + b for a, b in zip(found, parts, strict=True)]
    return [maps.maps_of(flux) for flux in found or ()]


def _flux_of_run(run: Run, maps: SurfaceMaps, filters: Sequence[PathFilter]) -> list[Sampled]:
    """
    Return the flux that each filter selects in every cell of the maps, with its noise, W, (cells,) for each filter.

    The incident flux of all cells comes first, then the absorbed flux. If the time is up before all rays are traced, it
    raises `UnfinishedError`.
    """
    maps.attach(run.scene)
    sums = np.zeros((len(filters), maps.groups, maps.cells))
    recorder = CellRecorder(MAP_CAPACITY, run.settings.max_events, maps=maps)
    behind = maps.shape[0] * maps.shape[1]
    branches = 0.0  # largest number of branches per start ray so far

    def grow(size: int) -> int:
        return max(1, min(int(FULL * MAP_CAPACITY / max(branches, 1e-6)), 8 * size))

    for start in portions(run, grow):
        if time_is_up():
            raise UnfinishedError("the time is up before the maps of parts of the light are traced; give more seconds")
        total = 0
        for count in recorded(run, start, recorder):
            total += count
            held = passing(run, filters, recorder, count)
            cell, batch = np.array(recorder.cell)[:count], np.array(recorder.batch)[:count]
            # Incident and absorbed flux of a cell, one after the other
            group = batch // (BATCHES // maps.groups)
            flux = [np.array(values)[:count] for values in (recorder.weight, recorder.absorbed)]
            for own, here in zip(sums, held, strict=True):
                for place, values in zip((cell, cell + behind), flux, strict=True):
                    np.add.at(own, (group[here], place[here]), values[here])
        branches = max(branches, total / dr.width(start.lane))
    started = run.started.reshape(maps.groups, -1).sum(axis=1)
    return [Sampled.of(own.T, started).scaled(run.unit) for own in sums]


def _check_filter(runs: Sequence[Run], requested: PathFilter) -> None:
    """Raise `MistrayError` if a filter names what the scene lacks, a source of all runs too, or as `check_columns`."""
    check_columns(requested)
    none = Events.of(runs[0].table, runs[0].design, *padded([]))
    rows = _rows(runs[0], none, requested.columns)
    requested.bounds(replace(rows, sources=[run.source.name for run in runs]))


def check_columns(requested: PathFilter) -> None:
    """Raise `MistrayError` if a filter compares a column that exists only for light on a detector, such as power_W."""
    missing = requested.columns - set(COLUMNS)
    if missing:
        raise MistrayError(
            f"filter '{requested.text}': of light elsewhere than on the detector there is no '{min(missing)}'; compare "
            f"{', '.join(COLUMNS[:4])}, kind, order, scatters, or use flags such as H(x)"
        )


def passing(run: Run, filters: Sequence[PathFilter], recorder: BranchRecorder, count: int) -> np.ndarray:
    """
    Return masks of the first `count` branches of a recorder that each filter selects, (filters, count) bool.

    The filters have passed `check_columns`.
    """
    # Branches of one path have the same answer
    codes, lengths = recorder.events(np.arange(count))
    _, first, path = np.unique(np.array(recorder.path)[:count], return_index=True, return_inverse=True)
    compared = frozenset().union(*(requested.columns for requested in filters))
    rows = _rows(run, Events.of(run.table, run.design, codes, lengths)[first], compared)
    held = np.array([requested.holds(rows) for requested in filters]).reshape(len(filters), len(first))
    return np.asarray(held[:, path.ravel()])


def kinds_and_keys(run: Run, events: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the kind of path and the path key of each event list, (n,) each, as in `PathRow`."""
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
