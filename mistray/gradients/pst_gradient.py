"""
Derivatives of a metric of a PST: its rays are traced again, recorded, sorted and replayed by passes.

Where forward and backward rays share the paths by MIS, they share the derivatives, too. There are two kinds:

- Coatings and scatter change the flux of a path and leave it in place. Each ray contributes with its MIS weight, see
  `mistray.sampling.sharing.balance`: the weights of a path add up to 1 whatever factor they are multiplied by.
- Shapes and indices move paths and the rims that end them. Backward rays keep their start on the detector, forward rays
  theirs in the sky. The same path then moves in two ways, and MIS weights that vary along it do not cancel. So all
  paths of a path class have one weight, see `mistray.sampling.sharing.path_classes`, and each direction estimates the
  whole derivative of its part.
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
    Rays that a PST was computed from.

    Attributes
    ----------
    trace : BackwardTrace
        Backward rays.
    cells : AllCells or None
        Forward rays that share the paths with them by MIS; None: there are none.
    """

    trace: BackwardTrace
    cells: AllCells | None = None

    def gradient(
        self, derivative: np.ndarray, request: GradientRequest, groups: np.ndarray | None = None
    ) -> Iterator[TableGradient]:
        """
        Yield derivatives of a metric.

        Parameters
        ----------
        derivative : (CLASS_COUNT, n, m) float64
            Derivative of the metric by PST_normal of each class in each cell.
        request : GradientRequest
        groups : (n, m) int, optional
            A number below BATCHES for each cell: derivatives are kept by this number of their cell instead of by batch.
            Boundary terms of rims hold no cell, so this is for requests without `edge_widths` only.

        Yields
        ------
        TableGradient
            Gradients for each wavelength and direction, to be added.

        Raises
        ------
        MistrayError
            If the trace continues a saved run, whose rays are not available.
        """
        if self.trace.pass_rays is None:
            raise MistrayError("this PST goes on from a saved run, whose rays are gone; compute it without 'resume'")
        if groups is not None and request.edge_widths:
            raise MistrayError("derivatives by groups of cells do not know what rims take and give; use edges=False")
        numbers = None if groups is None else upload(mi.UInt32, np.asarray(groups, dtype=np.uint32))
        for band in range(len(self.trace.bands)):
            for part, moves in _parts(request) if self.trace.forward else [(request, True)]:
                yield self._against(band, derivative, part, numbers, moves)
                if self.cells is not None:
                    yield self._along(band, derivative, part, numbers, moves)

    def _against(
        self, number: int, derivative: np.ndarray, request: GradientRequest, groups: mi.UInt32 | None, moves: bool
    ) -> TableGradient:
        """Return the derivatives from backward rays at a wavelength."""
        started = time.perf_counter()
        trace, band = self.trace, self.trace.bands[number]
        assert trace.pass_rays is not None
        # The metric by the flux of a start ray instead of PST_normal
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

        # MIS weights: one per path class where paths move, else those of the balance heuristic
        shares = trace.path_class_shares() if moves else None
        with dr.suspend_grad():
            edges = None
            if path_replay.edges:
                edges = Edges(trace.split_scene(number), trace.settings, request.edge_widths)
            for done, rays in enumerate(trace.pass_rays):
                whole = trace.start_pass(number, done, rays)
                vertices = None if moves else trace.light_vertices(number, (0, done), rays)
                mis = shares if moves else trace.balance(number, vertices, same_rays=True)
                recorder.directions = trace.make_directions(derivative, mis=mis)

                def trace_again(start: StartRays, vertices: LightVertices | None = vertices) -> None:
                    if moves:
                        trace.trace_split(number, start, recorder)
                    else:
                        trace.trace_shared(number, start, vertices, recorder)

                # Paths with visibility held
                if not request.only_rims:
                    for start in path_replay.portions(whole, EXITS_PER_RAY, trace_again):
                        path_replay.replay(start, _all, end, None if groups is None else group)
                if edges is not None:
                    for start, events in edges.events(whole, trace.adjoint(derivative, mis)):
                        path_replay.replay_edges(start, events)
        raw = self._result(path_replay)
        raw.seconds = time.perf_counter() - started
        return raw

    def _along(
        self, number: int, derivative: np.ndarray, request: GradientRequest, groups: mi.UInt32 | None, moves: bool
    ) -> TableGradient:
        """Return the derivatives from forward rays at a wavelength."""
        started = time.perf_counter()
        trace, cells = self.trace, self.cells
        assert cells is not None
        table = trace.bands[number].table
        path_replay = PathReplay(
            table, trace.forward[number].scattering, trace.settings, request, trace.settings.max_events
        )
        recorder = path_replay.recorder
        # The metric by the flux of a start ray of each cell, with MIS weights
        rays = np.sum([rays for _, rays in cells.rounds], axis=0)
        unit = np.divide(cells.unit, rays, out=np.zeros_like(cells.unit), where=rays > 0)
        mis = trace.path_class_shares() if moves else trace.balance(number, None, same_rays=True)
        assert mis is not None
        recorder.arrivals = cells.gains(unit * derivative.reshape(len(derivative), -1), mis)

        def end(row: mi.UInt32, keys: np.ndarray) -> End:
            gain = dr.gather(mi.Float64, recorder.weight, row)
            return lambda *hit: gain  # the same anywhere on the detector

        with dr.suspend_grad():
            edges = None
            if path_replay.edges:
                edges = Edges(trace.forward_scene(number), trace.settings, request.edge_widths)
                adjoint = Adjoint(0, trace.film, arrivals=recorder.arrivals)
            # The same rays as in the trace, round by round
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
        """Return the accumulated derivatives without those by the detector's size, and notes on what is left out."""
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
    """
    Split a request by whether its parameters move paths.

    Returns
    -------
    list of (GradientRequest, bool)
        Parts, and whether they move paths. Coatings belong to the second part where indices change their reflectance.
    """
    still = replace(request, geometry=frozenset(), indices=False, rows=request.rows and not request.indices)
    moving = replace(request, rows=request.indices, scatter=False)
    return [(still, False)] * (still.rows or still.scatter) + [(moving, True)] * moving.moves


def _all(keys: np.ndarray) -> np.ndarray:
    return np.ones(len(keys), dtype=bool)


def _heading(recorder: BranchRecorder, row: mi.UInt32) -> mi.Vector3f:
    return mi.Vector3f(*(dr.gather(mi.Float, recorder.heading, 3 * row + k) for k in range(3)))
