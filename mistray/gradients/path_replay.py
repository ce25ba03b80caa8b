"""Recorded rays of a pass, sorted by path and replayed: the part that forward and backward traces share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.coating_gradient import NO_STOKES
from mistray.gradients.edges import EdgeEvents
from mistray.gradients.grazing import SILHOUETTE, jump_distance
from mistray.gradients.replay import Branches, End, Exit, follow, replay_rays
from mistray.gradients.replay_surfaces import Hit, ReplaySurfaces, Split
from mistray.gradients.scatter_replay import ScatterReplay
from mistray.gradients.start_motion import SourceStart, StartMotion, SurfaceStart, source_derivatives
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.kernel.scattering import Scattering
from mistray.recorders.adjoint import CHANNELS
from mistray.recorders.branch_recorder import BranchRecorder, as_many
from mistray.recorders.start_rays import StartRays
from mistray.sampling.source import SceneSource
from mistray.settings import Settings
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

CAPACITY = 1 << 18  # rays that are recorded at once
ROOM = 1.3  # size of the buffer over the number of rays that the trace has counted


class PathReplay:
    """
    Sums of the derivatives of a metric over recorded rays.

    Parameters
    ----------
    table : SurfaceTable
    scattering : Scattering
    settings : Settings
    request : GradientRequest
    longest : int
        Number of events of the longest path.
    start : SceneSource or int, optional
        Source of the rays, or the surface from which backward rays start; None: the start does not move.

    Raises
    ------
    MistrayError
        For meshes and other shapes of Mitsuba's own, media that scatter, polarised light.
    """

    def __init__(
        self,
        table: SurfaceTable,
        scattering: Scattering,
        settings: Settings,
        request: GradientRequest,
        longest: int,
        start: SceneSource | int | None = None,
    ) -> None:
        _check(table, settings)
        self.table, self.scattering, self.request = table, scattering, request
        self.surfaces = ReplaySurfaces(table, request)
        self.scatter = ScatterReplay(table, scattering) if scattering.any else None
        self.recorder = BranchRecorder(as_many(CAPACITY, longest), longest, points_only=True)
        self.backward = isinstance(start, int)
        # Of hits close to rims only the position moves: their coefficients already hold the change of flux
        places = replace(request, rows=False, scatter=False)
        self.edges = [ReplaySurfaces(table, places) for _ in request.edge_widths if request.moves]
        self._starts = [self._start_motion(start, surfaces) for surfaces in (self.surfaces, *self.edges)]
        self.strayed = self.rays = 0

    def _start_motion(self, start: SceneSource | int | None, surfaces: ReplaySurfaces) -> StartMotion | None:
        if start is None:
            return None
        if isinstance(start, int):
            return SurfaceStart(surfaces, start)
        return SourceStart(start, self.request.sources, self.table.centre)

    def portions(
        self, start: StartRays, hits_per_ray: float, trace: Callable[[StartRays], None]
    ) -> Iterator[StartRays]:
        """
        Trace the rays of a pass in portions that fit the recorder, and yield each once it is recorded.

        Parameters
        ----------
        start : StartRays
        hits_per_ray : float
            Average number of recorded rays per start ray.
        trace : callable
            Traces a portion of the start rays with `recorder`.
        """
        lanes = max(1, int(self.recorder.capacity / (ROOM * max(1.0, hits_per_ray))))
        count, done = dr.width(start.lane), 0
        while done < count:
            here = min(lanes, count - done)
            part = start if here == count else start.take(dr.arange(mi.UInt32, here) + dr.opaque(mi.UInt32, done))
            self.recorder.clear()
            trace(part)
            recorded = int(self.recorder.count[0])
            # Overflow: nothing of the portion is used, and half as many rays are traced again
            if recorded <= self.recorder.capacity:
                yield part
                done += here
            elif here == 1:
                raise MistrayError(
                    f"a single start ray has {recorded} ends, more than {self.recorder.capacity}; raise flux_threshold "
                    "or lower max_reflections or max_scatters"
                )
            lanes = here // 2 if recorded > self.recorder.capacity else lanes

    def replay(
        self,
        start: StartRays,
        counts: Callable[[np.ndarray], np.ndarray],
        end: Callable[[mi.UInt32, np.ndarray], End | Exit],
        group: Callable[[mi.UInt32], mi.UInt32] | None = None,
    ) -> None:
        """
        Replay the recorded rays of a portion.

        Parameters
        ----------
        start : StartRays
            The portion.
        counts : callable
            Takes the keys of the rays, (n,) uint64, and returns which of them contribute, (n,) bool.
        end : callable
            Takes the rows of the rays in the recorder, in the order of the lanes, and their keys; returns their
            contribution to the metric.
        group : callable, optional
            Takes the rows; returns numbers below BATCHES by which sums are kept, instead of by batch.
        """
        keys = np.array(self.recorder.path)[: int(self.recorder.count[0])]
        # Sorted by path, so that the lanes of a warp run through the same events
        order = np.argsort(keys, kind="stable")
        order = order[each(counts, keys[order])]
        if not len(order):
            return
        rays = branches(self.recorder, start, order)
        if group is not None:
            rays = replace(rays, batch=group(rays.row))
        # Forward in float64, then backward with derivatives
        found = follow(self.surfaces, rays)
        replay_rays(self.surfaces, rays, found, end(rays.row, keys[order]), self.scatter, self._starts[0])
        self.strayed += int(dr.count(found.strayed)[0])
        self.rays += len(order)

    def replay_edges(self, start: StartRays, events: EdgeEvents) -> None:
        """Replay the hits close to rims of a portion."""
        rows = np.array(events.row)
        for surfaces, start_motion, c in zip(self.edges, self._starts[1:], events.c, strict=True):
            used = np.flatnonzero(np.array(c))
            if not len(used):
                continue
            chosen = used[np.argsort(np.array(events.paths.path)[rows[used]], kind="stable")]
            rays = branches(events.paths, start, rows[chosen])
            picked = upload(mi.UInt32, chosen)
            kept = (dr.gather(type(v), v, picked) for v in (events.rim, events.joined, events.scale, c))
            end = RimEnd(*kept)
            replay_rays(surfaces, rays, follow(surfaces, rays), end, None, start_motion)

    def result(self) -> TableGradient:
        """Return the derivatives accumulated so far."""
        request = self.request
        raw = TableGradient(self.table, self.scattering, backward=self.backward)
        if not self.backward and request.sources:
            raw.sources = source_derivatives(self._starts)
        if request.geometry:
            raw.geometry = self.surfaces.geometry()
        if request.indices:
            raw.indices = self.surfaces.index_gradient()
        if self.edges:
            raw.edges = np.stack([surfaces.geometry() for surfaces in self.edges])
            if request.indices:
                raw.edge_indices = np.stack([surfaces.index_gradient() for surfaces in self.edges])
        if request.rows:
            raw.rows = self.surfaces.row_gradient(CHANNELS)
        if request.scatter and self.scatter is not None:
            raw.scatter = self.scatter.derivatives()
        if self.strayed:
            raw.left_out.append(f"{self.strayed} of {self.rays} rays, which could not be followed again in float64")
        return raw


class RimEnd:
    """
    Contribution to the metric of hits close to rims that move relative to the rim, see `mistray.gradients.edges`.

    Parameters
    ----------
    rim, joined : mi.UInt32
        See `EdgeEvents`.
    scale : mi.Float
        See `EdgeEvents`.
    c : mi.Float64
        Coefficients of `EdgeEvents` for one width.
    """

    def __init__(self, rim: mi.UInt32, joined: mi.UInt32, scale: mi.Float, c: mi.Float64) -> None:
        self._rim, self._joined, self._c = rim, joined, c
        self._scale = dr.select(rim >= SILHOUETTE, mi.Float64(scale), 1)  # rims leave it unset

    def __call__(
        self,
        surfaces: ReplaySurfaces,
        met: Hit,
        recorded: mi.Vector3d,
        split: Split,
        s: mi.UInt32,
        batch: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Float64:
        """Return the contribution to first order: its value is 0, its derivative that of c Δ."""
        # Rim, or jump without one: the distance Δ itself
        free, jumps = self._joined == NO_SURFACE, self._rim >= SILHOUETTE
        distance = surfaces.rim_distance(met, self._rim, s, batch, active & free & ~jumps)
        distance = dr.select(jumps, jump_distance(split, self._rim, self._scale), distance)
        # Concave edge: the distance is that from the adjoining surface
        corner = active & ~free
        apart = surfaces.distance_from(
            surfaces.world_point(met, s, corner), dr.select(free, 0, self._joined), batch, corner
        )
        value = self._c * dr.select(free, distance, apart)
        return value - dr.detach(value)


def each(function: Callable[[np.ndarray], Any], keys: np.ndarray) -> Any:
    """Return arrays for rays sorted by key, computed once for all rays of the same path."""
    if not len(keys):
        return function(keys)
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    times = np.diff(np.append(first, len(keys)))
    found = function(keys[first])
    if isinstance(found, tuple):
        return tuple(np.repeat(values, times, axis=0) for values in found)
    return np.repeat(found, times)


def branches(recorder: BranchRecorder, start: StartRays, rows: np.ndarray) -> Branches:
    """Return recorded rays of a portion, one lane for each row."""
    row = upload(mi.UInt32, rows)
    lane = dr.gather(mi.UInt32, recorder.lane, row) - dr.opaque(mi.UInt32, int(start.lane[0]))
    length = dr.gather(mi.UInt32, recorder.length, row)
    o, d = (mi.Vector3d(dr.gather(mi.Vector3f, v, lane)) for v in (start.o, start.d))
    d = dr.normalize(d)
    batch = dr.gather(mi.UInt32, start.batch, lane)
    dr.eval(row, length, o, d, batch)
    stride = dr.opaque(mi.UInt32, recorder.max_events)
    longest = max(1, int(np.array(length).max()))
    return Branches(o, d, batch, length, row, recorder.codes, recorder.nodes, stride, recorder.node_floats, longest)


def _check(table: SurfaceTable, settings: Settings) -> None:
    if settings.stokes:
        raise MistrayError(NO_STOKES)
    if table.mitsuba_scene is not None:
        raise MistrayError(
            f"shape '{table.ids[len(table.pieces)]}' is none of mistray's own; gradients by anything but coatings need "
            "'asphere' and 'frustum' shapes only"
        )
    if table.optics.scatters:
        raise MistrayError("a medium of the scene scatters; gradients by anything but coatings know surfaces only")
