"""
Derivatives of a metric of a point source transmittance (PST), from rays that are traced again and replayed.

Where forward and backward rays share the paths by MIS, they share the derivatives, too. There are two kinds:

- Coatings and scatter change the flux of a path and leave it in place. Each ray contributes with its MIS weight, see
  `mistray.sampling.sharing.mis_weights`: the weights of a path add up to 1 whatever factor they are multiplied by.
- Shapes and indices move paths and the rims that end them. Backward rays keep their start on the detector, forward rays
  theirs in the sky. The same path then moves in two ways, and MIS weights that vary along it do not cancel. So all
  paths of a path class have one weight, see `mistray.sampling.sharing.path_classes`, and each direction estimates the
  whole derivative of its part.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.all_cells import AllCells
from mistray.execute.backward import BackwardTrace
from mistray.gradients.path_replay import Ends, PathReplay
from mistray.gradients.recorded_rays import RecordedRays, Trace
from mistray.gradients.replay import End, Exit
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.kernel.light_vertices import LightVertices
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.branch_recorder import BranchRecorder
from mistray.recorders.direction_recorder import DirectionRecorder
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.gradient_columns import COEFFICIENTS, GEOMETRY, OWN, RIM_COLUMNS
from mistray.surfaces.upload import upload

CELL_BORDERS = "light whose direction of arrival moves across the border of a cell of angles"
DETECTOR_RIMS = "the size of the detector itself, within which rays start"
DETECTOR_SHAPE = "the curvature and figure of the detector itself, from which rays start"


@dataclass(frozen=True)
class PstEnds(Ends):
    """
    Contributions of the recorded rays of a PST to a metric: the weights that the recorder holds.

    Attributes
    ----------
    groups : mi.UInt32 or None
        For each cell, row by row, the index below BATCHES of the sum that its derivatives enter; None: derivatives are
        kept by batch.
    sky : DirectionRecorder or None
        Cells in which backward rays leave the scene; None: forward rays, which end at the detector.
    """

    groups: mi.UInt32 | None
    sky: DirectionRecorder | None

    def group(self, rays: RecordedRays) -> mi.UInt32:
        """Return, for each ray, the index below BATCHES of the sum it adds to: that of its cell, or its batch."""
        if self.groups is None:
            return rays.batch
        cell = dr.gather(mi.UInt32, rays.start.cell, rays.lane) if self.sky is None else self.sky.cell(rays.heading)[0]
        return dr.gather(mi.UInt32, self.groups, cell)

    def end(self, rays: RecordedRays, keys: np.ndarray, path: mi.UInt32) -> End | Exit:
        """
        Return the contribution of each ray to the metric: its recorded weight, wherever it hits or leaves.

        For backward rays it is an `Exit`, otherwise a function of the hit with the detector. Parameters are as in
        `Ends.end`.
        """
        gain = rays.weight  # the same anywhere on the detector
        return Exit(gain, rays.heading) if self.sky is not None else lambda *hit: gain


@dataclass(frozen=True, eq=False)
class PstRays:
    """
    Traces from which a PST was computed: backward rays, and forward rays if there are any.

    Attributes
    ----------
    trace : BackwardTrace
        Backward rays.
    cells : AllCells or None
        Forward rays that share the paths with them by MIS; None: there are none.
    """

    trace: BackwardTrace
    cells: AllCells | None = None

    def __reduce__(self) -> Any:
        return type(None), ()  # rays stay in the process that traced them

    def gradient(
        self, derivative: np.ndarray, request: GradientRequest, groups: np.ndarray | None = None
    ) -> Iterator[TableGradient]:
        """
        Yield derivatives of a metric of the PST with respect to scene parameters, in parts to be added.

        Parameters
        ----------
        derivative : (CLASS_COUNT, n, m) float64
            Derivative of the metric with respect to PST_normal of each path class in each of the n × m cells of angles.
        request : GradientRequest
            Requested derivatives.
        groups : (n, m) int, optional
            Index below BATCHES for each cell: derivatives are kept by this index of their cell instead of by batch.
            Boundary terms of rims hold no cell, so `groups` is for requests without `edge_widths` only.

        Yields
        ------
        TableGradient
            Gradients for each wavelength and tracing direction. Where there are forward rays, parameters that move
            paths come in a part of their own, after the others; a part without requested parameters is left out.

        Raises
        ------
        MistrayError
            If the trace continues a saved run, whose rays are not available, if `groups` come with `edge_widths`, or
            for the reasons of `PathReplay`.
        """
        if self.trace.pass_rays is None:
            raise MistrayError("this PST goes on from a saved run, whose rays are gone; compute it without 'resume'")
        if groups is not None and request.edge_widths:
            raise MistrayError("derivatives by groups of cells have no boundary terms of rims; use edges=False")
        numbers = None if groups is None else upload(mi.UInt32, np.asarray(groups, dtype=np.uint32))
        ends = [PstEnds(numbers, self.trace.make_directions())]
        ends += [PstEnds(numbers, None)] if self.cells is not None else []
        for band in range(len(self.trace.bands)):
            for part, moves in _parts(request) if self.trace.forward else [(request, True)]:
                for some in ends:
                    started = time.perf_counter()
                    raw = self._replayed(band, derivative, part, moves, some)
                    raw.seconds = time.perf_counter() - started
                    yield raw

    def _replayed(
        self, number: int, derivative: np.ndarray, request: GradientRequest, moves: bool, ends: PstEnds
    ) -> TableGradient:
        """
        Return derivatives of a metric by replay of rays at one wavelength, with notes on what they leave out.

        `number` is the index of the wavelength, and `derivative` that of `gradient`. The rays are the backward ones if
        `ends` has a sky, else the forward ones. `moves` says whether all paths of a path class have one MIS weight.
        Raise `MistrayError` as `PathReplay` does.
        """
        trace, backward = self.trace, ends.sky is not None
        scene = trace.split_scene(number) if backward else trace.forward_scene(number)
        start = scene.table.detector if backward else None
        with dr.suspend_grad():
            path_replay = PathReplay(scene, trace.settings, request, trace.settings.max_events, start)
            recorder = path_replay.recorder
            passes = (self._backward if backward else self._forward)(number, derivative, moves, recorder)
            for rays, trace_again in passes:
                adjoint = Adjoint(0, trace.film, light=recorder.light)
                path_replay.replay_pass(rays, trace_again, ends, adjoint)
        raw = path_replay.result()
        if request.moves:
            raw.left_out.append(CELL_BORDERS)
        if request.geometry & {"curvature", "conic", *COEFFICIENTS, *OWN}:
            raw.left_out.append(DETECTOR_SHAPE)
        if request.geometry & set(RIM_COLUMNS):
            raw.left_out.append(DETECTOR_RIMS)
            if self.cells is not None and raw.rims.geometry is not None:
                raw.rims.geometry[:, :, trace.table.detector, [GEOMETRY.index(name) for name in RIM_COLUMNS]] = 0
        return raw

    def _backward(
        self, number: int, derivative: np.ndarray, moves: bool, recorder: BranchRecorder
    ) -> Iterator[tuple[StartRays, Trace]]:
        """
        Yield the backward start rays of each pass, with a function that traces them again into a recorder.

        `number` and `derivative` are those of `_replayed`. The light of `recorder` is set for the pass. With `moves`
        all paths of a path class have one MIS weight, else each has that of the balance heuristic.
        """
        trace = self.trace
        assert trace.pass_rays is not None
        # The metric by the flux of a start ray instead of PST_normal
        derivative = trace.unit / float(trace.rays.sum()) * derivative
        # MIS weights: one per path class where paths move, else those of the balance heuristic
        of_class = trace.path_class_weights() if moves else None
        for done, rays in enumerate(trace.pass_rays):
            vertices = None if moves else trace.light_vertices(number, (0, done), rays)
            mis = of_class if moves else trace.balance(number, rays, vertices, same_rays=True)
            recorder.light = trace.make_directions(derivative, mis=mis)

            def trace_again(
                start: StartRays, recorder: BranchRecorder, vertices: LightVertices | None = vertices
            ) -> None:
                if moves:
                    trace.trace_split(number, start, recorder)
                else:
                    trace.trace_shared(number, start, vertices, recorder)

            yield trace.start_pass(number, done, rays), trace_again

    def _forward(
        self, number: int, derivative: np.ndarray, moves: bool, recorder: BranchRecorder
    ) -> Iterator[tuple[StartRays, Trace]]:
        """
        Yield the forward start rays of each pass, with a function that traces them again into a recorder.

        Parameters and MIS weights are as in `_backward`.
        """
        trace, cells = self.trace, self.cells
        assert cells is not None
        # The metric by the flux of a start ray of each cell, with MIS weights
        unit = cells.total.of_ray(cells.unit)
        mis = trace.path_class_weights() if moves else trace.balance(number, same_rays=True)
        assert mis is not None
        recorder.light = cells.gains(unit * derivative, mis)
        # The same rays as in the trace, round by round
        for round_number, of_cells in cells.rounds:
            for start in cells.starts(number, of_cells, (0, round_number)):
                yield start, partial(cells.trace_trees, number)


def _parts(request: GradientRequest) -> list[tuple[GradientRequest, bool]]:
    """
    Return a request split in two: parameters that leave ray paths in place, and parameters that move them.

    Returns
    -------
    list of (GradientRequest, bool)
        Parts that are not empty, and whether they move paths. Coatings belong to the second part where indices change
        their reflectance.
    """
    still = replace(request, geometry=frozenset(), indices=False, rows=request.rows and not request.indices)
    moving = replace(request, rows=request.indices, scatter=False)
    return [(still, False)] * (still.rows or still.scatter) + [(moving, True)] * moving.moves
