"""
Derivatives of a metric of a PST: its rays are traced again, recorded, sorted and replayed by passes.

Where rays of both directions share the paths, they share the derivatives, too. Two kinds are told apart:

- Coatings and scatter change the flux of a path and leave it where it is. Each ray counts with its share of the value,
  see `mistray.sampling.sharing.balance`: shares of a path add up to 1, whatever is multiplied with them.
- Shapes and indices move paths and the rims that end them. Rays against the light keep their start on the detector,
  those with it their start in the sky: the same path moves in two ways, and shares that change along it do not cancel.
  So all paths of a family have one share, see `mistray.sampling.sharing.families`, and each direction finds the whole
  derivative of its part.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.all_cells import AllCells
from mistray.execute.backward import BackwardTrace
from mistray.gradients.edges import Edges
from mistray.gradients.path_replay import PathReplay
from mistray.gradients.replay import End, Exit
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.branch_recorder import BranchRecorder
from mistray.recorders.start_rays import StartRays
from mistray.sampling.sharing.light_vertices import LightVertices
from mistray.surfaces.gradient_columns import GEOMETRY, RIM_COLUMNS
from mistray.surfaces.upload import upload

CELL_BORDERS = "light whose direction of arrival moves across the border of a cell of angles"
DETECTOR_RIMS = "the size of the detector itself, within which rays start"
EXITS_PER_RAY, ARRIVALS_PER_RAY = 8.0, 1.0  # first guesses; portions that are too large are halved


@dataclass(frozen=True, eq=False)
class PstRays:
    """
    The rays that a PST was computed from.

    Attributes
    ----------
    trace : BackwardTrace
        Rays against the light.
    cells : AllCells or None
        Rays with it that share the paths with them; None: there are none.
    """

    trace: BackwardTrace
    cells: AllCells | None = None

    def gradient(
        self, derivative: np.ndarray, request: GradientRequest, groups: np.ndarray | None = None
    ) -> Iterator[TableGradient]:
        """
        Derivatives of a metric.

        Parameters
        ----------
        derivative : (CLASS_COUNT, n, m) float64
            Of the metric by PST_normal of each class in each cell.
        request : GradientRequest
        groups : (n, m) int, optional
            For each cell a number below BATCHES: the derivatives are those of the parts that the cells of each number
            have, instead of those that the batches have. Rims know no cells: without `request.edge_widths` only.

        Yields
        ------
        TableGradient
            For each wavelength and direction; they add up.

        Raises
        ------
        MistrayError
            If the trace has gone on from a saved run, whose rays are not known.
        """
        if self.trace.pass_rays is None:
            raise MistrayError("this PST goes on from a saved run, whose rays are gone; compute it without 'resume'")
        if groups is not None and request.edge_widths:
            raise MistrayError("derivatives by groups of cells do not know what rims take and give; use edges=False")
        numbers = None if groups is None else upload(mi.UInt32, np.asarray(groups, dtype=np.uint32))
        for band in range(len(self.trace.bands)):
            for part, moves in _parts(request) if self.trace.rivals else [(request, True)]:
                yield self._against(band, derivative, part, numbers, moves)
                if self.cells is not None:
                    yield self._along(band, derivative, part, numbers, moves)

    def _against(
        self, number: int, derivative: np.ndarray, request: GradientRequest, groups: mi.UInt32 | None, moves: bool
    ) -> TableGradient:
        """From rays against the light at a wavelength."""
        started = time.perf_counter()
        trace, band = self.trace, self.trace.bands[number]
        assert trace.pass_rays is not None
        derivative = trace.unit / float(trace.rays.sum()) * derivative
        path_replay = PathReplay(
            band.table, band.scattering, trace.settings, request, trace.settings.max_events, band.table.detector
        )
        recorder = path_replay.recorder
        sky = trace.make_directions()

        def end(row: mi.UInt32, keys: np.ndarray) -> Exit:
            gain = dr.gather(mi.Float64, recorder.weight, row)
            return Exit(gain, dr.zeros(mi.Vector3d, dr.width(row)), mi.Vector3d(_heading(recorder, row)))

        def group(row: mi.UInt32) -> mi.UInt32:
            return dr.gather(mi.UInt32, groups, sky.cell(_heading(recorder, row))[0])

        shares = trace.family_shares() if moves else None
        with dr.suspend_grad():
            edges = None
            if path_replay.edges:
                edges = Edges(trace.split_scene(number), trace.settings, request.edge_widths)
            for done, rays in enumerate(trace.pass_rays):
                whole = trace.start_pass(number, done, rays)
                vertices = None if moves else trace.light_vertices(number, (0, done), rays)
                weighing = shares if moves else trace.balance(number, vertices, same_rays=True)
                recorder.directions = trace.make_directions(derivative, weighing=weighing)

                def trace_again(start: StartRays, vertices: LightVertices | None = vertices) -> None:
                    if moves:
                        trace.trace_split(number, start, recorder)
                    else:
                        trace.trace_shared(number, start, vertices, recorder)

                if not request.only_rims:
                    for start in path_replay.portions(whole, EXITS_PER_RAY, trace_again):
                        path_replay.replay(start, _all, end, None if groups is None else group)
                if edges is not None:
                    for start, events in edges.events(whole, trace.adjoint(derivative, weighing)):
                        path_replay.replay_edges(start, events)
        raw = self._result(path_replay)
        raw.seconds = time.perf_counter() - started
        return raw

    def _along(
        self, number: int, derivative: np.ndarray, request: GradientRequest, groups: mi.UInt32 | None, moves: bool
    ) -> TableGradient:
        """From rays with the light at a wavelength."""
        started = time.perf_counter()
        trace, cells = self.trace, self.cells
        assert cells is not None
        table = trace.bands[number].table
        path_replay = PathReplay(
            table, trace.rivals[number].scattering, trace.settings, request, trace.settings.max_events
        )
        recorder = path_replay.recorder
        rays = np.sum([rays for _, rays in cells.rounds], axis=0)
        unit = np.divide(cells.unit, rays, out=np.zeros_like(cells.unit), where=rays > 0)
        weighing = trace.family_shares() if moves else trace.balance(number, None, same_rays=True)
        assert weighing is not None
        recorder.arrivals = cells.gains(unit * derivative.reshape(len(derivative), -1), weighing)

        def end(row: mi.UInt32, keys: np.ndarray) -> End:
            gain = dr.gather(mi.Float64, recorder.weight, row)
            return lambda *hit: gain  # wherever the detector is hit

        with dr.suspend_grad():
            edges = None
            if path_replay.edges:
                edges = Edges(trace.rival_scene(number), trace.settings, request.edge_widths)
                adjoint = Adjoint(0, trace.film, arrivals=recorder.arrivals)
            for round_number, of_cells in cells.rounds:
                for whole in cells.starts(number, of_cells, (0, round_number)):

                    def trace_again(start: StartRays) -> None:
                        cells.trace_trees(number, start, recorder)

                    parts = () if request.only_rims else path_replay.portions(whole, ARRIVALS_PER_RAY, trace_again)
                    for start in parts:

                        def group(row: mi.UInt32, start: StartRays = start) -> mi.UInt32:
                            lane = dr.gather(mi.UInt32, recorder.lane, row) - dr.opaque(mi.UInt32, int(start.lane[0]))
                            return dr.gather(mi.UInt32, groups, dr.gather(mi.UInt32, start.cell, lane))

                        path_replay.replay(start, _all, end, None if groups is None else group)
                    if edges is not None:
                        for start, events in edges.events(whole, adjoint):
                            path_replay.replay_edges(start, events)
        raw = self._result(path_replay)
        raw.seconds = time.perf_counter() - started
        return raw

    def _result(self, path_replay: PathReplay) -> TableGradient:
        """What has been gathered, without the part of the detector's own size, and what is left out."""
        raw, request = path_replay.result(), path_replay.request
        if request.moves:
            raw.left_out.append(CELL_BORDERS)
        if request.geometry & set(RIM_COLUMNS):
            raw.left_out.append(DETECTOR_RIMS)
            if self.cells is not None and raw.edges is not None:
                columns = [GEOMETRY.index(name) for name in RIM_COLUMNS]
                raw.edges[:, :, self.trace.table.detector, columns] = 0
        return raw


def _parts(request: GradientRequest) -> list[tuple[GradientRequest, bool]]:
    """What leaves paths where they are, and what moves them; the latter with reflectances as indices change them."""
    still = replace(request, geometry=frozenset(), indices=False, rows=request.rows and not request.indices)
    moving = replace(request, rows=request.indices, scatter=False)
    return [(still, False)] * (still.rows or still.scatter) + [(moving, True)] * moving.moves


def _all(keys: np.ndarray) -> np.ndarray:
    return np.ones(len(keys), dtype=bool)


def _heading(recorder: BranchRecorder, row: mi.UInt32) -> mi.Vector3f:
    return mi.Vector3f(*(dr.gather(mi.Float, recorder.heading, 3 * row + k) for k in range(3)))
