"""Path replay of the recorded rays of a pass, sorted by path, for forward and for backward traces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.edges import EdgeEvents, Edges
from mistray.gradients.full.full_rims import FullRims
from mistray.gradients.grazing import SILHOUETTE, jump_distance
from mistray.gradients.parameter_gradient import NO_STOKES
from mistray.gradients.recorded_rays import Portions, RecordedRays, Trace
from mistray.gradients.replay import End, Exit, replay_rays
from mistray.gradients.replay_surfaces import ReplaySurfaces
from mistray.gradients.replayed_event import ReplayedEvent
from mistray.gradients.scatter_replay import ScatterReplay
from mistray.gradients.table_gradient import Derivatives, GradientRequest, TableGradient
from mistray.kernel.kernel_scene import KernelScene
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.branch_recorder import BranchRecorder, as_many
from mistray.recorders.start_rays import StartRays
from mistray.sampling.source import SceneSource
from mistray.settings import Settings
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

CAPACITY = 1 << 17  # rays that are recorded at once
FIRST_RECORDS = 8.0  # guess of the records of a start ray
TOO_MANY = (
    "a single start ray has {count} ends, more than {capacity}; raise flux_threshold or lower max_reflections or "
    "max_scatters"
)


class Ends:
    """Base class of what recorded rays contribute to a metric at their ends, on the detector or out of the scene."""

    def counts(self, keys: np.ndarray) -> np.ndarray:
        """
        Return a mask of paths, (n,) bool: True where a path contributes to the metric. In this class all do.

        `keys`, (n,) uint64, are the keys of the paths in ascending order.
        """
        return np.ones(len(keys), dtype=bool)

    def group(self, rays: RecordedRays) -> mi.UInt32:
        """
        Return, for each ray, the index (below BATCHES) of the sum that its derivatives enter.

        By default this is the index of its batch.
        """
        return rays.batch

    def end(self, rays: RecordedRays, keys: np.ndarray, path: mi.UInt32) -> End | Exit:
        """
        Return the contribution of each ray to the metric: a function of its last hit, or a value at its exit.

        `keys`, (n,) uint64, are those of the paths, and `path` is the place of each ray's path among them.
        """
        raise NotImplementedError


class PathReplay:
    """
    Accumulator of the derivatives of a metric, by path replay of recorded rays.

    Parameters
    ----------
    scene : KernelScene
        Scene at the wavelength.
    settings : Settings
        Settings of the trace.
    request : GradientRequest
        Requested derivatives.
    longest : int
        Number of events of the longest path.
    start : SceneSource or int, optional
        Source of the rays, or the surface from which backward rays start; None: the start does not move.
    records : float
        Expected number of recorded rays for each start ray.

    Attributes
    ----------
    recorder : BranchRecorder
        Recorder of the rays that are replayed.
    scatter : ScatterReplay or None
        Scatter of the surfaces; None: no surface scatters.
    edges : Edges or None
        Boundary terms of rims; None: they are not requested, or no requested parameter moves hits or rims.

    Raises
    ------
    MistrayError
        For meshes and other shapes of Mitsuba's own, media that scatter, polarised light.
    """

    def __init__(
        self,
        scene: KernelScene,
        settings: Settings,
        request: GradientRequest,
        longest: int,
        start: SceneSource | int | None = None,
        records: float = FIRST_RECORDS,
    ) -> None:
        table, widths = scene.table, request.edge_widths if request.moves else ()
        _check(table, settings)
        self._scene, self.request = scene, request
        self.recorder = BranchRecorder(as_many(CAPACITY, longest), longest)
        self._portions = Portions.filling(self.recorder, records, TOO_MANY)
        self.scatter = ScatterReplay(scene.scattering) if scene.scattering.any else None
        # Of hits close to rims only the position moves: their coefficients already hold the change of flux
        places = replace(request, rows=False, scatter=False)
        # About its axis a freeform differs little from its rotated self: in float32 a small Zernike term on an off-axis
        # mirror gives an error of 2e-3 in its derivative, of all others at most 1e-5
        real = mi.Float64 if table.families and "tilt_z" in request.geometry else mi.Float
        requests = (request, *(places for _ in widths))
        self._surfaces = [ReplaySurfaces(table, one, start=start, real=real) for one in requests]
        # Rims; a beam that just fills one narrows its zone
        self._full, self.edges = [], None
        if widths:
            full = FullRims(start, table, widths[0]) if isinstance(start, SceneSource) else None
            self._full = [full] if full is not None and full.full else []
            self.edges = Edges(scene, settings, widths, None if full is None else full.limits)

    def replay_pass(self, start: StartRays, trace: Trace, ends: Ends, adjoint: Adjoint | None) -> None:
        """
        Trace start rays again and accumulate derivatives: with visibility held fixed, then boundary terms of rims.

        Either part is left out if the request does not ask for it.

        Parameters
        ----------
        start : StartRays
            Start rays of the pass.
        trace : callable
            Traces a portion of the start rays with a recorder.
        ends : Ends
            Contributions of the recorded rays to the metric.
        adjoint : Adjoint or None
            Adjoint of the metric for the boundary terms, without derivatives with respect to rows of coating tables;
            None: there are no boundary terms.

        Raises
        ------
        MistrayError
            If a single start ray has more records than the recorder has room for.
        """
        if not self.request.only_rims:
            for part, _ in self._portions.of(start, trace):
                self._replay(part, ends)
        if self.edges is not None and adjoint is not None:
            for part, events in self.edges.events(start, adjoint):
                self._replay_edges(part, events)

    def recorded(self, start: StartRays, trace: Trace) -> Iterator[RecordedRays]:
        """
        Trace start rays again in portions, and yield the recorded rays of each portion that has any.

        Raise `MistrayError` if a single start ray has more records than the recorder has room for.
        """
        for part, count in self._portions.of(start, trace):
            if count:
                yield RecordedRays.of(self.recorder, part, np.arange(count))

    def _replay(self, start: StartRays, ends: Ends) -> None:
        """
        Replay the recorded rays of one portion, and add derivatives with visibility held fixed.

        Rays on paths that do not contribute to the metric are left out.
        """
        keys = np.array(self.recorder.path)[: int(self.recorder.count[0])]
        # Sorted by path, so that the lanes of a warp run through the same events
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        first = np.diff(keys, prepend=~keys[:1]) != 0
        paths, path = keys[first], np.cumsum(first) - 1
        counts = ends.counts(paths)[path]
        order, path = order[counts], path[counts]
        if not len(order):
            return
        rays = RecordedRays.of(self.recorder, start, order)
        rays.batch = ends.group(rays)
        replay_rays(self._surfaces[0], rays, ends.end(rays, paths, upload(mi.UInt32, path)), self.scatter)

    def _replay_edges(self, start: StartRays, events: EdgeEvents) -> None:
        """Replay the hits close to rims of one portion, and add the boundary terms for each zone width."""
        rows = np.array(events.row)
        for surfaces, c in zip(self._surfaces[1:], events.c, strict=True):
            used = np.flatnonzero(np.array(c))
            if not len(used):
                continue
            chosen = used[np.argsort(np.array(events.paths.path)[rows[used]], kind="stable")]
            picked = upload(mi.UInt32, chosen)
            end = rim_end(*(dr.gather(type(v), v, picked) for v in (events.rim, events.joined, events.scale, c)))
            rays = RecordedRays.of(events.paths, start, rows[chosen])
            replay_rays(surfaces, rays, end)

    def result(self) -> TableGradient:
        """Return the derivatives of the metric accumulated so far, by batch of start rays."""
        inner, *rims = (surfaces.derivatives() for surfaces in self._surfaces)
        if self.request.scatter and self.scatter is not None:
            inner.scatter = self.scatter.derivatives()
        raw = TableGradient(self._scene.table, self._scene.scattering, inner, Derivatives.stacked(rims), self._full)
        raw.backward = self._scene.backward
        return raw


def rim_end(rim: mi.UInt32, joined: mi.UInt32, scale: mi.Float, c: mi.Float64) -> End:
    """
    Return the contribution to a metric of hits close to rims, as rim and hit move relative to each other.

    To first order its value is 0 and its derivative that of c Δ, see `mistray.gradients.edges`.

    Parameters
    ----------
    rim, joined : mi.UInt32
        See `EdgeEvents`.
    scale : mi.Float
        See `EdgeEvents`.
    c : mi.Float64
        Coefficients of `EdgeEvents` for one width.
    """
    radius = dr.select(rim >= SILHOUETTE, scale, 1)  # rims leave it unset

    def moved(surfaces: ReplaySurfaces, at: ReplayedEvent) -> mi.Float64:
        # Rim, or jump without one: the distance Δ itself
        free, jumps = joined == NO_SURFACE, rim >= SILHOUETTE
        distance, alone = surfaces.real(0), at.active & free & ~jumps
        for number, found in enumerate(surfaces.rim_distances(at.q, at.s, at.batch, alone)):
            distance = dr.select(alone & (rim == number), found, distance)
        distance = dr.select(jumps, jump_distance(at, rim, radius), distance)
        # Concave edge: the distance is that from the adjoining surface
        apart = surfaces.distance_from(at.p, dr.select(free, 0, joined), at.batch, at.active & ~free)
        value = c * dr.select(free, distance, apart)
        return value - dr.detach(value)

    return moved


def _check(table: SurfaceTable, settings: Settings) -> None:
    if settings.stokes:
        raise MistrayError(NO_STOKES)
    if table.mitsuba_scene is not None:
        raise MistrayError(
            f"shape '{table.ids[len(table.pieces)]}' is not one of mistray's own; gradients with respect to "
            "anything but coatings need 'asphere' and 'frustum' shapes only"
        )
    if table.optics.scatters:
        raise MistrayError("a medium of the scene scatters; only gradients by coatings allow that")
