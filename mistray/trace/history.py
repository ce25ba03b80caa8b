"""Rays traced on demand, as polylines and as a table of their events (ray history)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.events import INTERCEPTS, kind_of, place_of
from mistray.execute.tracer import PASS_LANES, Run
from mistray.kernel.launches import GOLDEN, golden_stride
from mistray.ranges import ANYTHING, RAYS_LISTED, ByName, several, shown
from mistray.recorders.branch_recorder import BranchRecorder, as_many
from mistray.recorders.start_rays import StartRays
from mistray.result import KeyNumber, Result
from mistray.surfaces.upload import upload
from mistray.time_budget import time_is_up
from mistray.trace.host.retrace import retrace
from mistray.trace.located_paths import LocatedPaths
from mistray.trace.paths import PathTable

if TYPE_CHECKING:
    import pandas as pd


FACTS = ByName(ANYTHING, "{'kind': one text for each ray}")
SAMPLE_RAYS = 640  # number of start rays of the sample of `sample_rays`
FIRST_RAYS = 32  # number of the first of them; it doubles until all paths have enough
SAMPLE_CAPACITY = 1 << 17  # branches that are recorded at a time; others are not in the sample


class Ray(NamedTuple):
    """
    Ray from the source to its end, event by event: points, directions, optical path lengths and flux.

    Attributes
    ----------
    start_ray : int
        Index of the start ray of which it is a branch.
    codes : (k,) uint32
        Events, see `mistray.events`.
    points : (k + 1, 3) float64
        Start and all hits, mm.
    directions : (k + 1, 3) float64
        Unit direction in which the ray leaves each point; zero at the last point, unless the ray leaves the scene from
        there.
    opl_mm : (k + 1,) float64
        Optical path length from the start, mm.
    flux_W : (k + 1,) float64
        Flux with which the ray starts, and with which it arrives at each hit, W. For a ray that leaves the scene the
        last entry is the flux after the last hit.
    """

    start_ray: int
    codes: np.ndarray
    points: np.ndarray
    directions: np.ndarray
    opl_mm: np.ndarray
    flux_W: np.ndarray


class RayHistory(Result, table="..toolkit.tables.traces:rays_table", figure="..toolkit.figures.traces:rays_figure"):
    """
    Recorded rays of a run, event by event, as polylines and as a table.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> history = t.history(1, n=2)
    >>> len(history), history.rays[0].shape  # two rays; start and nine hits of the first
    (2, (10, 3))
    >>> history.to_pandas().surface[:4].tolist()
    ['-', 'L1_front', 'L1_rear', 'L2_front']
    """

    def __init__(self, run: Run, rays: list[Ray]) -> None:
        self._run, self._rays = run, rays

    def __len__(self) -> int:
        return len(self._rays)

    def __getitem__(self, numbers: int | slice | Sequence[int]) -> RayHistory:
        """
        Return a ray history of only those rays that an index, a slice or several indices select.

        Raises
        ------
        IndexError
            If there is no ray of an index.
        MistrayError
            If an index is not a whole number.
        """
        if isinstance(numbers, slice):
            return RayHistory(self._run, self._rays[numbers])
        found = []
        for number in several(numbers):
            if not isinstance(number, int | np.integer):
                raise MistrayError(f"ray {shown(number)} of a history; give its number, a slice, or several numbers")
            if not -len(self) <= number < len(self):
                raise IndexError(f"ray {number} of a history of {len(self)} rays")
            found.append(self._rays[number])
        return RayHistory(self._run, found)

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of rays, the number of their nodes, and their wavelength (nm), by label."""
        nodes = sum(len(ray.points) for ray in self._rays)
        return {"rays": len(self), "nodes": nodes, "wavelength [nm]": self._run.source.wavelength_nm}

    @property
    def rays(self) -> list[np.ndarray]:
        """Polyline of each ray, its start and its hits, (k + 1, 3), mm."""
        return [ray.points for ray in self._rays]

    def with_facts(self, facts: Mapping[str, np.ndarray]) -> pd.DataFrame:
        """
        Return the ray history table with further columns after ``node``.

        `facts` holds an array (n,) by column name, with a value for each of the n rays, repeated at all its nodes.
        """
        table = self.to_pandas()
        for place, (name, values) in enumerate(FACTS.check("facts", facts).items(), start=2):
            table.insert(place, name, np.asarray(values)[table.ray.to_numpy(np.int64)].tolist())
        return table

    def to_pandas(self) -> pd.DataFrame:
        """
        Return the ray history table: one row for each node of each ray.

        Columns: ray, node, start_ray, intercept (Emitted, SpecTran, SpecRefl, TIR, RandTran, RandRefl, ImpTran,
        ImpRefl, Absorbed), object (part, at the start the source), surface, wavelength_nm, x_mm, y_mm, z_mm, flux_W
        (arriving), opl_mm (from the start), dx, dy, dz (leaving, unit vector; 0 at an end). At the last node of a ray
        that leaves the scene flux_W is that after the hit.
        """
        import pandas as pd

        table, source = self._run.table, self._run.source
        ids, parts = table.event_ids, table.event_parts
        rows = []
        for number, ray in enumerate(self._rays):
            # A start ray has no event: its source stands for the object
            met = [(INTERCEPTS[kind_of(code)], place_of(code)) for code in ray.codes.tolist()]
            events = [("Emitted", source.name, "-"), *((what, parts[place], ids[place]) for what, place in met)]
            nodes = zip(events, ray.points, ray.flux_W, ray.opl_mm, ray.directions, strict=True)
            for node, (event, point, flux, opl, direction) in enumerate(nodes):
                facts = number, node, ray.start_ray, *event, source.wavelength_nm
                rows.append((*facts, *point, flux, opl, *direction))
        # In the order of the rows above
        names = ["ray", "node", "start_ray", "intercept", "object", "surface", "wavelength_nm"]
        return pd.DataFrame(rows, columns=[*names, "x_mm", "y_mm", "z_mm", "flux_W", "opl_mm", "dx", "dy", "dz"])


def joined_histories(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """
    Return the ray history tables of several runs, at least one, as one table, with rays numbered consecutively.

    The column ray of the given tables is renumbered, too.
    """
    import pandas as pd

    done = 0
    for table in tables:
        rays = table.ray.nunique()
        table["ray"] += done
        done += rays
    return pd.concat([table for table in tables if len(table)] or tables[:1], ignore_index=True)


def spread(count: int, most: int | None) -> np.ndarray:
    """Return at most `most` evenly spaced indices from 0 to count - 1, (n,) int; all of them if `most` is None."""
    if most is None or count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(int)


def golden_order(count: int) -> np.ndarray:
    """Return the indices from 0 to count - 1, (count,) int, in an order of which every beginning is spread over all."""
    return np.arange(count) * golden_stride(count) % count


def over_the_beam(count: int, most: int | None) -> np.ndarray:
    """
    Return at most `most` of the indices from 0 to count - 1 of rays in the order of their start rays, ascending.

    They are spread over the beam, (n,) int; all of them if `most` is None. Start rays are numbered along a curve
    through the beam, once for each batch: equal steps would meet the same place of it in every batch.
    """
    return np.arange(count) if most is None or count <= most else np.sort(golden_order(count)[:most])


def path_history(table: PathTable, path_id: int, most: int) -> RayHistory:
    """
    Return up to `most` rays of the path of an id, spread over the beam, with hit points recomputed in float64, mm.

    Raise `MistrayError` if the table has no such path, or if `most` is not a whole number from 1.
    """
    most = RAYS_LISTED.check("n", most)
    (own,) = (own for own in table.located([path_id]) if len(own.ids))
    run = own.run
    recorder = run.record(own.slots, most)
    lanes = np.array(recorder.lane)[: recorder.kept]
    order = np.argsort(lanes, kind="stable")
    order = order[over_the_beam(len(lanes), most)]
    return RayHistory(run, rays_in_slots(run, recorder, order, *run.weighted_start_rays(lanes[order])))


def rays_in_slots(
    run: Run,
    recorder: BranchRecorder,
    slots: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
    weights: np.ndarray,
) -> list[Ray]:
    """
    Return the rays in given slots of a recorder as `Ray`, with hit points recomputed in float64, mm.

    Parameters
    ----------
    run : Run
        Run of the rays.
    recorder : BranchRecorder
        Recorder that holds the rays.
    slots : (n,) int
        Places of the rays in the recorder.
    origins, directions : (n, 3) float64
        Origins, mm, and directions of their start rays.
    weights : (n,) float64
        Throughputs of their start rays, see `mistray.recorders.start_rays.StartRays`.
    """
    lanes = np.array(recorder.lane)[slots]
    # Bundles come in the order of their events; the rays go back to that of the slots
    rays: dict[int, Ray] = {}
    for bundle in bundles(run, recorder, slots, origins, directions, weights):
        rays |= {k: bundle.ray(j, int(lanes[k])) for j, k in enumerate(bundle.numbers.tolist())}
    return [rays[number] for number in range(len(slots))]


class Bundle(NamedTuple):
    """
    Recorded rays with equal events: their indices among the requested slots, (n,), and the attributes of `Ray`.

    All but `codes` have a row per ray.
    """

    numbers: np.ndarray
    codes: np.ndarray
    points: np.ndarray
    directions: np.ndarray
    opl_mm: np.ndarray
    flux_W: np.ndarray

    def ray(self, row: int, start_ray: int) -> Ray:
        """Return the ray in one row of the arrays as a `Ray`; `start_ray` is the index of its start ray."""
        return Ray(start_ray, self.codes, *(values[row] for values in self[2:]))


def bundles(
    run: Run,
    recorder: BranchRecorder,
    slots: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
    weights: np.ndarray,
) -> Iterator[Bundle]:
    """Yield recorded rays in groups of equal events, with positions, mm, recomputed in float64; see `rays_in_slots`."""
    codes, lengths = recorder.events(slots)
    nodes = recorder.nodes_of(slots, codes.shape[1])
    # All rays at once, whatever their paths: `retrace` groups them by surface, step by step
    exact = retrace(run.table, origins, directions, codes, lengths, nodes[:, :, :3] + run.table.centre)
    flux = run.unit * np.concatenate([weights[:, None], nodes[:, :, 6]], axis=1)
    alike: dict[bytes, list[int]] = {}  # numbers of the rays of the same events
    for number, length in enumerate(lengths.tolist()):
        alike.setdefault(codes[number, :length].tobytes(), []).append(number)
    for same in alike.values():
        numbers = np.array(same)
        length = int(lengths[same[0]])
        own = (values[numbers, : length + 1] for values in (*exact, flux))
        yield Bundle(numbers, codes[same[0], :length].copy(), *own)


def sample_rays(table: PathTable, path_ids: int | Sequence[int], most: int) -> dict[int, list[Ray]]:
    """
    Return at most `most` rays of each path by its id, from a sample of the start rays spread over the beam.

    A path has fewer, or none, if the sample or the time ends before. Raise `MistrayError` for an unknown id, or if
    `most` is not a whole number from 1.
    """
    most = RAYS_LISTED.check("n", most)
    found: dict[int, list[Ray]] = {}
    for own in table.located(dict.fromkeys(table.check_ids(path_ids).tolist())):
        found |= _sample_of_run(own, most) if len(own.ids) else {}
    return found


def _sample_of_run(own: LocatedPaths, most: int) -> dict[int, list[Ray]]:
    """
    Return at most `most` rays of each path of a run, by `path_id`, from a sample of its start rays.

    A path has fewer, or none, if the sample or the time ends before.
    """
    run = own.run
    found: dict[int, list[Ray]] = {path_id: [] for path_id in own.ids.tolist()}
    lanes = sampled_numbers(SAMPLE_RAYS, run.rays)
    recorder = BranchRecorder(as_many(SAMPLE_CAPACITY, run.settings.max_events), run.settings.max_events)
    for number in np.unique(lanes // PASS_LANES):
        here = lanes[lanes // PASS_LANES == number] - number * PASS_LANES
        sample = run.start_pass(int(number)).take(upload(mi.UInt32, here))
        started = *run.exact(sample), sample.weights
        for part in np.split(
            np.arange(len(here)), FIRST_RAYS * 2 ** np.arange(int(np.log2(SAMPLE_RAYS / FIRST_RAYS)) + 1)
        ):
            if not len(part):
                continue
            recorder.clear()
            run.trace_trees(sample.take(upload(mi.UInt32, part)), recorder)
            missing = np.array([len(rays) < most for rays in found.values()])
            starts = start_places(sample, recorder)
            slots = first_branches(recorder, own.keys[missing], most, starts)
            rays = rays_in_slots(run, recorder, slots, *(values[starts[slots]] for values in started))
            for path_id, ray in zip(own.ids_of(np.array(recorder.path)[slots]).tolist(), rays, strict=True):
                if len(found[path_id]) < most:
                    found[path_id].append(ray)
            if time_is_up() or all(len(rays) >= most for rays in found.values()):
                return found
    return found


def sampled_numbers(most: int, count: int) -> np.ndarray:
    """
    Return up to `most` numbers below `count` of start rays, (n,) int, in an order of which every beginning is a sample.

    Multiples of the golden ratio are spread over batches and beam, unlike equal steps, see `over_the_beam`.
    """
    return np.array(list(dict.fromkeys((np.arange(most) * GOLDEN % 1 * count).astype(np.int64).tolist())))


def start_places(sample: StartRays, recorder: BranchRecorder) -> np.ndarray:
    """Return the place in a sample of the start ray of each recorded branch, (b,) int."""
    numbers = np.array(sample.lane)
    order = np.argsort(numbers)
    return np.asarray(order[np.searchsorted(numbers, np.array(recorder.lane)[: recorder.kept], sorter=order)])


def first_branches(recorder: BranchRecorder, keys: np.ndarray, most: int, starts: np.ndarray) -> np.ndarray:
    """
    Return the recorder slots, (n,) int, of at most `most` branches of each path whose key is in `keys`, (p,) uint64.

    They are those of the first start rays. `starts` are from `start_places`: the order of the slots is that of threads,
    and differs from call to call.
    """
    paths = np.array(recorder.path)[: recorder.kept]
    order = np.lexsort((starts, paths))
    ends = [np.searchsorted(paths[order], keys, side) for side in ("left", "right")]
    parts = [order[first : min(last, first + most)] for first, last in zip(*ends, strict=True)]
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])
