"""
Hits of a sample of rays, as arrays: positions, sides and angles at which each path meets its surfaces.

`mistray.trace.history` computes the points of a few rays again in float64, one path after the other. Here all paths
come at once with the kernel's own points. These are good to 1e-7 of the system's size: enough for angles and drawings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from mistray.events import kind_of, place_of
from mistray.execute.tracer import PASS_LANES, Run
from mistray.recorders.branch_recorder import BranchRecorder, as_many
from mistray.surfaces.host_rays import normals
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    from mistray.recorders.start_rays import StartRays
    from mistray.trace.result import Trace

CAPACITY = 1 << 16  # branches that are recorded; others are not in the sample
GOLDEN = (5**0.5 - 1) / 2

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class SampledHits:
    """
    Hits of the r rays of a sample, padded to the k hits of the longest ray.

    Attributes
    ----------
    keys : (r,) uint64
        Keys of their paths, see `mistray.recorders.path_key`.
    weight : (r,) float64
        Flux with which each ray meets the detector, in units of a start ray.
    length : (r,) int
        Number of hits of each ray.
    surface, event : (r, k) int
        Numbers of the surfaces, and events there; -1 after the last hit.
    start : (r, 3) float64
        Start points, mm.
    points, arrival, normal : (r, k, 3) float64
        Hits (mm), directions of arrival, and normals from front to back; the last are 0 within a medium.
    """

    keys: npt.NDArray[np.uint64]
    weight: Floats
    length: Whole
    surface: Whole
    event: Whole
    start: Floats
    points: Floats
    arrival: Floats
    normal: Floats

    def polyline(self, ray: int) -> Floats:
        """Return the points of one ray from its start to the detector, (length + 1, 3), mm."""
        return np.concatenate([self.start[ray][None], self.points[ray, : self.length[ray]]])


@dataclass(frozen=True)
class PathHits:
    """
    Hits of a sample of the rays of one source and wavelength, with the paths of these rays.

    Attributes
    ----------
    path_ids : (r,) int
        Rows of the path table that the rays belong to.
    wavelength_nm : float
        Vacuum wavelength, nm.
    table : SurfaceTable
        Surfaces that the hits refer to.
    hits : SampledHits
    """

    path_ids: Whole
    wavelength_nm: float
    table: SurfaceTable
    hits: SampledHits


def sampled_hits(t: Trace, start_rays: int, most: int) -> list[PathHits]:
    """Return the hits of a sample of rays for each source and wavelength, at most `most` rays of each path."""
    found = []
    for number, run in enumerate(t.runs):
        hits = _of_run(run, start_rays, most)
        ids = t.paths.ids_of_keys(number, hits.keys)
        found.append(PathHits(ids, run.source.wavelength_nm, run.table, hits))
    return found


def _of_run(run: Run, start_rays: int, most: int) -> SampledHits:
    """
    Trace some start rays again, spread over the beam.

    Parameters
    ----------
    run : Run
    start_rays : int
        Largest number of start rays; all are of the first pass.
    most : int
        Largest number of rays of each path.
    """
    recorder = BranchRecorder(as_many(CAPACITY, run.settings.max_events), run.settings.max_events)
    sample, kept = record_sample(run, start_rays, recorder, most)
    origins, _ = run.exact(sample)
    place = np.array(sample.lane)
    # Events and nodes, padded
    codes, length = recorder.events(kept)
    nodes = recorder.nodes_of(kept, codes.shape[1])
    there = np.arange(codes.shape[1]) < length[:, None]
    surface = np.where(there, place_of(codes).astype(np.int64), -1)
    points, arrival = nodes[..., :3] + run.table.centre, nodes[..., 3:6]
    # Start points by the numbers of the start rays
    order = np.argsort(place)
    start = origins[order[np.searchsorted(place[order], np.array(recorder.lane)[kept])]]
    return SampledHits(
        np.array(recorder.path)[kept],
        np.array(recorder.weight)[kept],
        length,
        surface,
        np.where(there, kind_of(codes).astype(np.int64), -1),
        start,
        points,
        arrival,
        _normals(run, surface, points, arrival),
    )


def record_sample(run: Run, start_rays: int, recorder: BranchRecorder, most: int) -> tuple[StartRays, Whole]:
    """
    Record a sample of the rays of a run: at most `start_rays` of its first pass, spread over the batches and the beam.

    Returns
    -------
    sample : StartRays
    kept : (n,) int
        Places of at most `most` branches of each path in the recorder.
    """
    # Multiples of the golden ratio, as in `mistray.trace.history.sample_rays`
    numbers = np.unique((np.arange(start_rays) * GOLDEN % 1 * min(run.rays, PASS_LANES)).astype(np.int64))
    sample = run.start_pass(0).take(upload(mi.UInt32, numbers))
    run.trace_trees(sample, recorder)
    paths, lanes = (np.array(values)[: recorder.kept] for values in (recorder.path, recorder.lane))
    # Start rays are numbered along a curve in the beam
    order = np.lexsort((lanes, paths))
    _, first, counts = np.unique(paths[order], return_index=True, return_counts=True)
    number = np.arange(len(order)) - np.repeat(first, counts)
    of = np.repeat(counts, counts)
    kept = (of <= most) | ((number + 1) * most // of > number * most // of)  # every k-th, spread over the beam
    return sample, np.sort(order[kept])


def _normals(run: Run, surface: Whole, points: Floats, arrival: Floats) -> Floats:
    table, found = run.table, np.zeros_like(points)
    for number in np.unique(surface[surface >= 0]):
        here = surface == number
        if number < len(table.pieces):
            found[here] = normals(table, int(number), points[here])
        elif number < table.count:
            found[here] = table.mitsuba_normals(points[here], arrival[here])
    return found
