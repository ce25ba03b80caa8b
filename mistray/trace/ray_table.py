"""Tables of rays at the detector, selected by a filter and by position."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.tracer import Run
from mistray.ranges import PLACE_MM, RAYS_OR_ALL, Each, Range
from mistray.recorders.branch_recorder import BranchRecorder
from mistray.recorders.film import Box
from mistray.recorders.path_events import Events
from mistray.recorders.path_key import padded
from mistray.recorders.recorder import Recorder
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.upload import upload
from mistray.trace.filter_rows import Rows
from mistray.trace.history import Ray, RayHistory, bundles, golden_order, joined_histories, over_the_beam
from mistray.trace.located_paths import LocatedPaths
from mistray.trace.path_filter import PathFilter
from mistray.trace.path_row import PathRow
from mistray.trace.paths import PathTable

if TYPE_CHECKING:
    import pandas as pd

CAPACITY = 1 << 14  # branches that are recorded at a time
FIRST = 1 << 12  # number of start rays of the first portion; it doubles from portion to portion
ALONG = ("x_mm", "y_mm", "z_mm", "dx", "dy", "dz")
PEAK = "relative_flux"
AT_DETECTOR = ("detector_x_mm", "detector_y_mm")
FACTS = ("start_ray", "node", "type", "history", "flux_W", *ALONG, "opl_mm", *AT_DETECTOR, "column", "row")
COLUMNS = ("path_id", "kind", "wavelength_nm", "source", *FACTS)
BY_RAY = frozenset({*FACTS, PEAK})
PATH_COLUMNS = frozenset(f.name for f in fields(PathRow))

Columns = dict[str, np.ndarray]


def check_box(box: Sequence[float]) -> Sequence[float]:
    """Return a rectangle, (x0, x1, y0, y1), mm; raise `MistrayError` if it is empty."""
    x0, x1, y0, y1 = box = Each(PLACE_MM, 4).check("box", box)
    if not (x0 < x1 and y0 < y1):
        raise MistrayError(f"box is x {x0:g} … {x1:g}, y {y0:g} … {y1:g} mm; it needs x0 < x1 and y0 < y1")
    return box


def ray_table(
    table: PathTable,
    requested: PathFilter,
    n: int | None,
    box: Sequence[float] | None,
    pixels: Sequence[int] | None,
    events: bool,
) -> pd.DataFrame:
    """
    Return a table of rays that reach the detector, one row for each ray, or for each node of each ray if `events`.

    `n` is the most rays that are returned, spread over the beam; None: all. `box` is x0, x1, y0, y1 on the detector,
    mm; `pixels` is c0, c1, r0, r1 for its columns c0 … c1 - 1 and rows r0 … r1 - 1. None: the whole detector. Flux is
    in W, positions and optical path lengths in mm; see `mistray.trace.Trace.rays` for the columns. An `n` that is
    no whole number from 1, an empty box, pixels out of range and several detectors raise `MistrayError`.
    """
    import pandas as pd

    n = None if n is None else RAYS_OR_ALL.check("n", n)
    box = None if box is None else check_box(box)
    pixels = None if pixels is None else _check_pixels(pixels, table.runs[0])
    # Only a filter that needs the strongest ray pays for the run that finds it
    peak = max(run.peak_W() for run in table.runs) if PEAK in requested.columns else math.nan

    # Rays of each run
    parts: list[Columns] = []
    rays: list[tuple[int, Ray]] = []
    for number, own in enumerate(table.chosen(requested, BY_RAY)):
        found, lines = _Search(own, table, requested, peak, box, pixels, events).rays(n)
        parts.append(found)
        rays += [(number, ray) for ray in lines]

    # Choose n of them, spread over the runs
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    count = len(whole["start_ray"])
    kept = over_the_beam(count, n)  # every run has found as many as were requested, or all that it has
    if not events:
        texts = {name: pd.Series(v[kept].tolist(), dtype="str") for name, v in whole.items() if v.dtype == object}
        rows = pd.DataFrame({name: values[kept] for name, values in whole.items()} | texts)
        rows.insert(0, "ray", np.arange(len(rows)))
        return rows

    # With events: one row for each node
    histories = []
    for number, run in enumerate(table.runs):
        its = kept[[rays[k][0] == number for k in kept.tolist()]]
        facts = {name: whole[name][its] for name in ("path_id", "kind")}
        histories.append(RayHistory(run, [rays[k][1] for k in its.tolist()]).with_facts(facts))
    return joined_histories(histories)


def _check_pixels(pixels: Sequence[int], run: Run) -> Sequence[int]:
    c0, c1, r0, r1 = found = [int(number) for number in Each(Range(whole=True), 4).check("pixels", pixels)]
    width, height, _ = run.table.film()
    if not (0 <= c0 < c1 <= width and 0 <= r0 < r1 <= height):
        raise MistrayError(
            f"pixels is columns {c0}:{c1}, rows {r0}:{r1}; the detector has {width} columns and {height} rows, and "
            "each range needs a pixel"
        )
    return found


class _Search:
    """
    Search of one run for rays of given paths that pass a filter and hit a box (mm) and a range of pixels.

    `own` are its paths, and `paths` the table of all. `peak` is the flux of the strongest ray, W, for a filter of
    relative flux. For `box`, `pixels` and `events` see `ray_table`.
    """

    def __init__(
        self,
        own: LocatedPaths,
        paths: PathTable,
        requested: PathFilter,
        peak: float,
        box: Sequence[float] | None,
        pixels: Sequence[int] | None,
        events: bool,
    ) -> None:
        self._own, self._run, self._paths, self._requested, self._peak = own, own.run, paths, requested, peak
        self._pixels, self._events = pixels, events
        self._box = _corners(own.run, box, pixels)

    def rays(self, n: int | None) -> tuple[Columns, list[Ray]]:
        """Return columns of up to `n` (None: all) selected rays, and the rays themselves if events were requested."""
        parts, rays, found = [self._facts(Events.of(self._run.table, self._run.design, *padded([])), {})], [], 0
        if len(self._own.ids):
            recorder = self._run.recorder(CAPACITY, self._own.slots)
            box = None if self._box is None else Box(self._box)
            for start in portions(self._run):
                for count in recorded(self._run, start, recorder, box):
                    if count:
                        columns, lines = self._read(recorder, count)
                        found += len(columns["start_ray"])
                        parts.append(columns)
                        rays += lines
                if n is not None and found >= n:
                    break
        whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        order = np.argsort(whole["start_ray"], kind="stable")[over_the_beam(found, n)]
        return {name: values[order] for name, values in whole.items()}, [rays[k] for k in order] if rays else []

    def _read(self, recorder: BranchRecorder, count: int) -> tuple[Columns, list[Ray]]:
        """Return columns of the selected rays among the first `count` recorded, and rays if events are asked for."""
        slots = np.arange(count)
        lanes = np.array(recorder.lane)[:count]
        started = self._run.weighted_start_rays(lanes)
        # The kernel's hits are float32: positions are computed again in float64
        events = Events.of(self._run.table, self._run.design, *recorder.events(slots))
        numbers = {name: np.zeros(count) for name in ("flux_W", *ALONG, "opl_mm")}
        rays: dict[int, Ray] = {}
        for bundle in bundles(self._run, recorder, slots, *started):
            ends = [*bundle.points[:, -1].T, *bundle.directions[:, -2].T, bundle.opl_mm[:, -1]]
            for name, values in zip((*ALONG, "opl_mm"), ends, strict=True):
                numbers[name][bundle.numbers] = values
            numbers["flux_W"][bundle.numbers] = bundle.flux_W[:, -1]
            if self._events:
                rays |= {k: bundle.ray(j, int(lanes[k])) for j, k in enumerate(bundle.numbers.tolist())}

        # Columns
        place = np.array(recorder.place).reshape(-1, 2)[:count]
        keys = np.array(recorder.path)[:count]
        columns = self._facts(
            events,
            {"path_id": self._own.ids_of(keys), "start_ray": lanes.astype(np.int64)}
            | {"node": events.lengths, "detector_x_mm": place[:, 0], "detector_y_mm": place[:, 1]}
            | numbers,
        )
        held = self._held(columns, events)
        kept = np.flatnonzero(held)
        return {name: values[kept] for name, values in columns.items()}, [rays[int(k)] for k in kept] if rays else []

    def _facts(self, events: Events, given: Columns) -> Columns:
        """
        Return all columns of the ray table, (n,) each, for rays with these events.

        `given` holds the columns of these rays that do not follow from their events, by name; of no rays it may be
        empty.
        """
        whole = ("path_id", "start_ray", "node")
        given = {name: np.zeros(0, dtype=np.int64 if name in whole else float) for name in COLUMNS} | given
        source, count, words = self._run.source, len(events), events.intercepts
        width, height, (x0, x1, y0, y1) = self._run.table.film()
        # In float32, as the film does: a ray at a border is in the same pixel as in the map
        along = [given[name].astype(np.float32) for name in AT_DETECTOR]
        steps = [np.float32(width / (x1 - x0)), np.float32(height / (y1 - y0))]
        pixel = [
            np.clip(((v - np.float32(first)) * step).astype(np.int64), 0, size - 1)
            for v, first, step, size in zip(along, (x0, y0), steps, (width, height), strict=True)
        ]
        found = given | {
            "kind": self._paths.column("kind")[given["path_id"]],
            "wavelength_nm": np.full(count, source.wavelength_nm),
            "source": np.full(count, source.name, dtype=object),
            "type": np.array([row[-2] if len(row) > 1 else "Emitted" for row in words], dtype=object),
            "history": np.array([" ".join(row) for row in words], dtype=object),
            "column": pixel[0],
            "row": pixel[1],
        }
        return {name: found[name] for name in COLUMNS}

    def _held(self, columns: Columns, events: Events) -> np.ndarray:
        """Return a mask of the rays that pass the filter and lie in the pixel range, (n,) bool."""
        held = np.full(len(events), True)
        if self._pixels is not None:
            c0, c1, r0, r1 = self._pixels
            held &= (columns["column"] >= c0) & (columns["column"] < c1)
            held &= (columns["row"] >= r0) & (columns["row"] < r1)
        # Columns of the ray's path, where the filter has any
        more = {
            name: self._paths.column(name)[columns["path_id"]]
            for name in self._requested.columns
            if name in PATH_COLUMNS
        }
        table = self._run.table
        known = more | columns | {PEAK: columns["flux_W"] / self._peak}
        return held & self._requested.holds(Rows(events, table.event_parts, known, table.count))


def _corners(run: Run, box: Sequence[float] | None, pixels: Sequence[int] | None) -> tuple[float, ...] | None:
    """
    Return the rectangle of the detector to record, x0, x1, y0, y1, mm: the box, or what surrounds the pixels.

    The result is None for the whole detector, and limits may be infinite.
    """
    if box is None and pixels is None:
        return None
    corners = [-math.inf, math.inf, -math.inf, math.inf] if box is None else [float(v) for v in box]
    if pixels is not None:
        width, height, (x0, x1, y0, y1) = run.table.film()
        for k, (size, low, high) in enumerate(((width, x0, x1), (height, y0, y1))):
            first, last = pixels[2 * k : 2 * k + 2]
            step = (high - low) / size
            if first > 0:  # rays that land beyond the border are in the pixels at the border
                corners[2 * k] = max(corners[2 * k], low + (first - 1) * step)
            if last < size:
                corners[2 * k + 1] = min(corners[2 * k + 1], low + (last + 1) * step)
    return tuple(corners)


def recorded(run: Run, start: StartRays, recorder: BranchRecorder, *before: Recorder | None) -> Iterator[int]:
    """
    Trace start rays into a recorder, in halves if they overflow it; the recorders `before` see each event first.

    Yields
    ------
    int
        Number of branches that the recorder holds, after all start rays or after each part of them.

    Raises
    ------
    MistrayError
        If a single start ray has more branches than the recorder has room for.
    """
    recorder.clear()
    run.trace_trees(start, *before, recorder)
    count, lanes = int(recorder.count[0]), dr.width(start.lane)
    if count <= recorder.capacity:
        yield count
        return
    if lanes == 1:
        raise MistrayError(
            f"a single start ray has {count} branches that are recorded, more than {recorder.capacity}; raise "
            "flux_threshold or lower max_reflections or max_scatters"
        )
    for half in np.array_split(np.arange(lanes), 2):
        yield from recorded(run, start.take(upload(mi.UInt32, half)), recorder, *before)


def portions(run: Run, grow: Callable[[int], int] = lambda size: 2 * size) -> Iterator[StartRays]:
    """
    Yield the start rays of a run in portions of growing size, each spread over all rays of a pass.

    `grow` maps the number of rays of a portion to that of the next.
    """
    for _, start in run.starts():
        count = dr.width(start.lane)
        order = golden_order(count)
        first, size = 0, FIRST
        while first < count:
            yield start.take(upload(mi.UInt32, order[first : first + size]))
            first, size = first + size, grow(size)
