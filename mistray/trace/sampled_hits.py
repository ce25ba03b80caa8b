"""
Samples of rays of all paths at once: hits on surfaces, and numerical aperture of the light at the detector.

`mistray.trace.history` computes the points of rays again in float64. Hits have the kernel's own points. These are good
to 1e-7 of the system's size: enough for angles and drawings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from mistray.events import kind_of, place_of
from mistray.execute.tracer import PASS_LANES, Run
from mistray.recorders.branch_recorder import BranchRecorder, as_many
from mistray.recorders.sampled import ERROR_RAYS
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.host_rays import normals
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload
from mistray.trace.history import Bundle, bundles, first_branches, sampled_numbers, start_places
from mistray.trace.located_paths import LocatedPaths
from mistray.trace.paths import PathTable

CAPACITY = 1 << 16  # branches that are recorded; others are not in the sample
CONE_CAPACITY = 1 << 14  # branches of 64 events that are recorded for light cones
CONE_START_RAYS = 1 << 11  # largest number of start rays of their sample
CONE_RAYS = 256  # largest number of rays of each path
PARALLEL = 1e-6  # numerical aperture below which light is parallel but for rounding

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class SampledHits:
    """
    Hits of a sample of r rays of one source and wavelength, padded to the k hits of the longest ray.

    Attributes
    ----------
    path_ids : (r,) int
        Rows of the path table that the rays belong to.
    wavelength_nm : float
        Vacuum wavelength, nm.
    table : SurfaceTable
        Surfaces that the hits refer to.
    weight : (r,) float64
        Flux with which each ray meets the detector, in units of a start ray.
    length : (r,) int
        Number of hits of each ray.
    surface, event : (r, k) int
        Indices of the surfaces or media, and events there; -1 after the last hit.
    start : (r, 3) float64
        Start points, mm.
    points, arrival, normal : (r, k, 3) float64
        Hits (mm), unit directions of arrival, and unit normals from front to back, 0 within a medium. Entries after the
        last hit have no meaning.
    """

    path_ids: Whole
    wavelength_nm: float
    table: SurfaceTable
    weight: Floats
    length: Whole
    surface: Whole
    event: Whole
    start: Floats
    points: Floats
    arrival: Floats
    normal: Floats

    def polyline(self, ray: int) -> Floats:
        """Return the points of one ray, start and hits, (hits + 1, 3), mm."""
        return np.concatenate([self.start[ray][None], self.points[ray, : self.length[ray]]])


def sampled_hits(own: LocatedPaths, start_rays: int, most: int) -> SampledHits:
    """
    Return the surface hits of a sample of rays of a run, by tracing them again.

    Parameters
    ----------
    own : LocatedPaths
        All paths of the run.
    start_rays : int
        Largest number of start rays; all are of the first pass.
    most : int
        Largest number of rays of each path.
    """
    run = own.run
    recorder = BranchRecorder(as_many(CAPACITY, run.settings.max_events), run.settings.max_events)
    sample, kept = _record_sample(run, start_rays, recorder, most)
    origins, _ = run.exact(sample)
    # Events and nodes, padded
    codes, length = recorder.events(kept)
    nodes = recorder.nodes_of(kept, codes.shape[1])
    there = np.arange(codes.shape[1]) < length[:, None]
    surface = np.where(there, place_of(codes).astype(np.int64), -1)
    points, arrival = nodes[..., :3] + run.table.centre, nodes[..., 3:6]
    start = origins[start_places(sample, recorder)[kept]]
    return SampledHits(
        own.ids_of(np.array(recorder.path)[kept]),
        run.source.wavelength_nm,
        run.table,
        np.array(recorder.weight)[kept],
        length,
        surface,
        np.where(there, kind_of(codes).astype(np.int64), -1),
        start,
        points,
        arrival,
        _normals(run, surface, points, arrival),
    )


def _record_sample(run: Run, start_rays: int, recorder: BranchRecorder, most: int) -> tuple[StartRays, Whole]:
    """
    Record a sample of the rays of a run: at most `start_rays` of its first pass, spread over the batches and the beam.

    Returns
    -------
    sample : StartRays
        Start rays of the sample.
    kept : (n,) int
        Places of at most `most` branches of each path in the recorder.
    """
    sample = run.start_pass(0).take(upload(mi.UInt32, sampled_numbers(start_rays, min(run.rays, PASS_LANES))))
    run.trace_trees(sample, recorder)
    keys = np.unique(np.array(recorder.path)[: recorder.kept])
    return sample, first_branches(recorder, keys, most, start_places(sample, recorder))


def _normals(run: Run, surface: Whole, points: Floats, arrival: Floats) -> Floats:
    table, found = run.table, np.zeros_like(points)
    for number in np.unique(surface[surface >= 0]):
        here = surface == number
        if number < len(table.pieces):
            found[here] = normals(table, int(number), points[here])
        elif number < table.count:
            found[here] = table.mitsuba_normals(points[here], arrival[here])
    return found


class LightCone(NamedTuple):
    """
    Cone in which the light of a path arrives at the detector: numerical aperture with standard error, and rays.

    Attributes
    ----------
    aperture, aperture_se : float
        Numerical aperture n sin u of a round, evenly filled cone with the same RMS spread of directions, and its
        standard error, dimensionless. For a round pupil that is NA; a central obstruction of the relative radius ε
        makes it √(1 + ε²) times as large.
    rays : int
        Number of rays that were found.
    """

    aperture: float
    aperture_se: float
    rays: int

    @property
    def known(self) -> bool:
        """True if the cone has enough rays for a standard error and the light is not parallel."""
        return self.rays >= ERROR_RAYS and self.aperture > PARALLEL


def light_cones(paths: PathTable, path_ids: int | Sequence[int]) -> dict[int, LightCone]:
    """
    Return the cone in which each path's light arrives at the detector, by path id.

    Paths of fewer than two rays in the sample are left out. An unknown id raises `MistrayError`.
    """
    found: dict[int, LightCone] = {}
    for own in paths.located(path_ids):
        if not len(own.ids):
            continue
        run = own.run
        capacity = as_many(CONE_CAPACITY, run.settings.max_events)
        recorder = run.recorder(capacity, own.slots)
        _, kept = _record_sample(run, min(CONE_START_RAYS, max(capacity // len(own.ids), 1)), recorder, CONE_RAYS)
        ids, lanes = own.ids_of(np.array(recorder.path)[kept]), np.array(recorder.lane)[kept]
        for bundle in bundles(run, recorder, kept, *run.weighted_start_rays(lanes)) if len(kept) else ():
            if len(bundle.numbers) > 1:
                found[int(ids[bundle.numbers[0]])] = _cone(run.table, bundle)
    return found


def _cone(table: SurfaceTable, bundle: Bundle) -> LightCone:
    """
    Return the `LightCone` at the detector of a bundle, the rays of one path.

    A spot in the detector plane is the Fourier transform of the pupil over the direction cosines along that plane,
    times n/λ. Here n is the index before the detector and λ the vacuum wavelength. The direction cosines of a round,
    evenly filled cone of half angle u lie evenly in a disc of radius sin u. Their mean square distance from the centre
    is sin²u/2.
    """
    way = bundle.points[:, -1] - bundle.points[:, -2]
    # Index of the last medium, from the optical and the geometric length of the last segment
    index = np.diff(bundle.opl_mm, axis=1)[:, -1] / np.linalg.norm(way, axis=1)
    cosines = index[:, None] * bundle.directions[:, -2] @ _axes(table).T
    weight = bundle.flux_W[:, -1] / bundle.flux_W[:, -1].sum()
    apart = np.sum(np.square(cosines - weight @ cosines), axis=1)
    square = float(weight @ apart)
    error = float(np.sqrt(np.sum(np.square(weight * (apart - square)))))
    aperture = np.sqrt(2 * square)
    return LightCone(float(aperture), float(error / aperture) if aperture > 0 else 0.0, len(weight))


def _axes(table: SurfaceTable) -> Floats:
    """Return the unit vectors along x and y of the detector in world coordinates, (2, 3)."""
    if table.detector in table.detector_frames:
        axes = table.detector_frames[table.detector][1:]
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))
    return np.asarray(table.rotations[table.detector].T[:2])
