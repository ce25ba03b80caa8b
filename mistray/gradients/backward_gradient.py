"""Derivatives of a metric by geometry and all else for a backward trace: record, sort, replay by passes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.backward import BackwardTrace, Band
from mistray.gradients.edges import Edges
from mistray.gradients.path_replay import PathReplay
from mistray.gradients.replay import Exit
from mistray.gradients.table_gradient import GradientRequest, TableGradient
from mistray.recorders.branch_recorder import BranchRecorder
from mistray.recorders.start_rays import StartRays
from mistray.surfaces.gradient_columns import RIM_COLUMNS
from mistray.surfaces.upload import upload

CELL_BORDERS = "light whose direction of arrival moves across the border of a cell of angles"
DETECTOR_RIMS = "the size of the detector itself, within which rays start"
EXITS_PER_RAY = 8.0  # a first guess; portions that are too large are halved


def backward_gradient(
    trace: BackwardTrace, derivative: np.ndarray, request: GradientRequest, groups: np.ndarray | None = None
) -> Iterator[TableGradient]:
    """
    Derivatives of a metric of a backward trace, from the same rays traced again and replayed.

    Parameters
    ----------
    trace : BackwardTrace
    derivative : (CLASS_COUNT, n, m) float64
        Of the metric by the sums of the weights of each class in each cell.
    request : GradientRequest
    groups : (n, m) int, optional
        For each cell a number below BATCHES: the derivatives are those of the parts that the cells of each number have,
        instead of those that the batches have. Rims know no cells: without `request.edges` only.

    Yields
    ------
    TableGradient
        For each wavelength.

    Raises
    ------
    MistrayError
        If the trace has gone on from a saved run, whose rays are not known.
    """
    if trace.pass_rays is None:
        raise MistrayError("this PST goes on from a saved run, whose rays are gone; compute it without 'resume'")
    if groups is not None and request.edges:
        raise MistrayError("derivatives by groups of cells do not know what rims take and give; use edges=False")
    for number, band in enumerate(trace.bands):
        started = time.perf_counter()
        path_replay = PathReplay(
            band.table, band.scattering, trace.settings, request, trace.settings.max_events, band.table.detector
        )

        def trace_again(start: StartRays, band: Band = band, recorder: BranchRecorder = path_replay.recorder) -> None:
            recorder.directions = trace.make_directions(derivative)
            trace.trace_trees(band, start, recorder)

        def end(row: mi.UInt32, keys: np.ndarray, recorder: BranchRecorder = path_replay.recorder) -> Exit:
            gain = dr.gather(mi.Float64, recorder.weight, row)
            heading = mi.Vector3d(*(mi.Float64(dr.gather(mi.Float, recorder.heading, 3 * row + k)) for k in range(3)))
            return Exit(gain, dr.zeros(mi.Vector3d, dr.width(row)), heading)

        group = None if groups is None else _group_of(trace, groups, path_replay.recorder)
        with dr.suspend_grad():
            edges = None
            if path_replay.edges:
                edges = Edges(trace.scene(band), trace.settings, request.edge_width)
            for done, rays in enumerate(trace.pass_rays):
                whole = trace.start_pass(number, done, rays)
                if not request.only_rims:
                    for start in path_replay.portions(whole, EXITS_PER_RAY, trace_again):
                        path_replay.replay(start, lambda keys: np.ones(len(keys), dtype=bool), end, group)
                if edges is not None:
                    for start, events in edges.events(whole, trace.adjoint(derivative)):
                        path_replay.replay_edges(start, events)
        raw = path_replay.result()
        raw.left_out.append(CELL_BORDERS)
        if request.geometry & set(RIM_COLUMNS):
            raw.left_out.append(DETECTOR_RIMS)
        raw.seconds = time.perf_counter() - started
        yield raw


def _group_of(trace: BackwardTrace, groups: np.ndarray, recorder: BranchRecorder) -> Callable[[mi.UInt32], mi.UInt32]:
    """What tells the groups of recorded rays by the cells in which they leave."""
    sky = trace.make_directions()
    numbers = upload(mi.UInt32, np.asarray(groups, dtype=np.uint32))

    def group(row: mi.UInt32) -> mi.UInt32:
        cell, _ = sky.cell(mi.Vector3f(*(dr.gather(mi.Float, recorder.heading, 3 * row + k) for k in range(3))))
        found = dr.gather(mi.UInt32, numbers, cell)
        dr.eval(found)
        return found

    return group
