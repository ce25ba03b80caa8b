"""Rays against the light that count all light, beside hardly any with it: what any way of sampling must come to."""

import mitsuba as mi
import numpy as np

from mistray.execute.all_cells import AllCells
from mistray.execute.backward import BackwardTrace
from mistray.recorders.direction_recorder import MULTIPLE, SINGLE
from mistray.recorders.directions import DirectionGrid
from mistray.sampling.plane_wave import hull_points
from mistray.sampling.sharing.mis_weights import Sharing
from mistray.sampling.sharing.start_map import StartMap
from mistray.settings import Settings


def against_alone(
    scene: mi.Scene, angle: float, width: float, rays: int, linked: float = 0.0, **windows: np.ndarray
) -> dict[int, tuple[float, float]]:
    """PST of light that is scattered once, and several times, of a cell of that width, and its error; by class."""
    return _backward(_shared(scene, angle, width, 1e-12, linked, **windows), rays)


def both_directions(
    scene: mi.Scene, angle: float, width: float, rays: int, linked: float, **windows: np.ndarray
) -> dict[int, tuple[float, float]]:
    """The same by as many forward rays as backward rays, and connections; the MIS weights of all must add up to 1."""
    trace = _shared(scene, angle, width, 1.0, linked, **windows)
    backward, forward = _backward(trace, rays), AllCells(trace)
    sums = forward.sums(np.array([rays]), 0).cells[:, 0, 0] * forward.unit.item() / rays
    by_class = {}
    for kind, (value, se) in backward.items():
        batches = sums[kind]
        by_class[kind] = value + batches.sum(), np.hypot(se, batches.std(ddof=1) * np.sqrt(len(batches)))
    return by_class


def _shared(
    scene: mi.Scene, angle: float, width: float, forward: float, linked: float, **windows: np.ndarray
) -> BackwardTrace:
    trace = BackwardTrace(scene, DirectionGrid.of([angle], cell_deg=width), Settings.of(scene, max_scatters=3))
    one = np.ones(1)
    trace.share_paths(Sharing(hull_points(trace.table), StartMap.uniform(1), forward * one, linked * one, **windows))
    return trace


def _backward(trace: BackwardTrace, rays: int) -> dict[int, tuple[float, float]]:
    found = trace.samples(rays, 0)[0]
    unit = trace.unit.item() / rays
    by_class = {}
    for kind in (SINGLE, MULTIPLE):
        # The rays of a start ray may have much in common
        of_lane = np.bincount(found.lane, found.weight * (found.kind == kind))
        by_class[kind] = unit * of_lane.sum(), unit * np.sqrt(np.sum(of_lane**2))
    return by_class
