"""Numerical aperture of the light of paths at the detector, from a sample of their rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from mistray.execute.tracer import Run
from mistray.recorders.branch_recorder import as_many
from mistray.recorders.sampled import ERROR_RAYS
from mistray.surfaces.surfaces import SurfaceTable
from mistray.trace.history import Bundle, bundles
from mistray.trace.sampled_hits import record_sample

if TYPE_CHECKING:
    from mistray.trace.paths import LocatedPaths
    from mistray.trace.result import Trace

CAPACITY = 1 << 14  # branches of 64 events that are recorded
START_RAYS = 1 << 11  # largest number of start rays of the sample
RAYS = 256  # largest number of rays of each path


class LightCone(NamedTuple):
    """
    Cone of directions of the light of a path at the detector.

    Attributes
    ----------
    aperture, aperture_se : float
        Numerical aperture n sin u of a round, evenly filled cone with the same RMS spread of directions, and its
        standard error. For a round pupil that is NA; a central obstruction of the relative radius ε makes it √(1 + ε²)
        times as large.
    rays : int
        Number of rays that were found.
    """

    aperture: float
    aperture_se: float
    rays: int

    @property
    def known(self) -> bool:
        """Whether there are enough rays for a standard error, and they are no parallel beam."""
        return self.rays >= ERROR_RAYS and self.aperture > 0


def light_cones(t: Trace, path_ids: Sequence[int]) -> dict[int, LightCone]:
    """Return the cone of directions of each path at the detector, by path id; without paths of fewer than two rays."""
    found: dict[int, LightCone] = {}
    for run, paths in zip(t.runs, t.paths.located(path_ids), strict=True):
        found |= _of_run(run, paths) if len(paths.ids) else {}
    return found


def _of_run(run: Run, paths: LocatedPaths) -> dict[int, LightCone]:
    """Return the light cones of paths of a run by their ids."""
    capacity = as_many(CAPACITY, run.settings.max_events)
    recorder = run.recorder(capacity, paths.slots)
    _, kept = record_sample(run, min(START_RAYS, max(capacity // len(paths.ids), 1)), recorder, RAYS)
    keys, lanes = np.array(recorder.path)[kept], np.array(recorder.lane)[kept]
    id_of_key = dict(zip(paths.keys.tolist(), paths.ids.tolist(), strict=True))
    found = {}
    for bundle in bundles(run, recorder, kept, *run.start_rays(lanes)) if len(kept) else ():
        if len(bundle.numbers) > 1:
            found[id_of_key[int(keys[bundle.numbers[0]])]] = _cone(run.table, bundle)
    return found


def _cone(table: SurfaceTable, bundle: Bundle) -> LightCone:
    """
    Return the cone of the rays of one path.

    A spot in the plane of the detector is the Fourier transform of the pupil over the direction cosines along that
    plane, times n/λ. The direction cosines of a round, evenly filled cone lie evenly in a disc of the radius sin u. Its
    mean square distance from the centre is sin²u/2.
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


def _axes(table: SurfaceTable) -> npt.NDArray[np.float64]:
    """Return unit vectors along x and y of the detector, (2, 3)."""
    if table.detector in table.detector_frames:
        axes = table.detector_frames[table.detector][1:]
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))
    return np.asarray(table.rotations[table.detector].T[:2])
