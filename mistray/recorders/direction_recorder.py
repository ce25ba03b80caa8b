"""Recorders of MIS-weighted ray throughput by class of light (direct, stray, scattered) and cell of sky directions.

Backward rays contribute where they leave the scene, forward rays where they meet the detector. Paths that both find are
weighted by the balance heuristic (E. Veach, Robust Monte Carlo methods for light transport simulation, 1997, section
9.2), which recorders obtain through the protocol `MisWeighting`.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.film import Film
from mistray.recorders.path_key import COUNT_MASK, NOT_DIFFRACTED
from mistray.recorders.path_sums import REDUCE, PathSums
from mistray.recorders.recorder import Departure, Memory, Recorder, Visit
from mistray.recorders.start_rays import StartRays
from mistray.settings import BATCHES
from mistray.surfaces.upload import upload, upload_rows

# Classes of the light, in the order of their sums
CLASSES = ("direct", "straight_shot", "ghost", "single_scatter", "multiple_scatter", "edge_diffraction")
CLASS_COUNT = len(CLASSES)
DIRECT, STRAIGHT, GHOST, SINGLE, MULTIPLE, DIFFRACTED = range(CLASS_COUNT)
FAR_SIDE = 2.0  # more than any squared sine, so that the last cell includes 90°
ROWS = 64  # fewest rows of the table of angles, in powers of two: the steps of its search are in the kernel


def class_of_light(end: Visit | Departure, design: DesignKeys) -> mi.UInt32:
    """Return the class of light, an index into `CLASSES`, of rays that meet the detector or leave the scene."""
    if isinstance(end, Departure):
        key, reflections, scatters = end.key, end.reflections, end.scatters
    else:
        key, reflections, scatters = (end.state[name] for name in ("key", "reflections", "scatters"))
    # Departures are those of backward rays
    designed = design.hold(key, isinstance(end, Departure))
    stray = dr.select(reflections > 0, mi.UInt32(GHOST), mi.UInt32(STRAIGHT))
    unscattered = dr.select(designed, mi.UInt32(DIRECT), stray)
    count = scatters & COUNT_MASK
    scattered = dr.select(count == 1, mi.UInt32(SINGLE), mi.UInt32(MULTIPLE))
    scattered = dr.select((scatters & NOT_DIFFRACTED) == 0, mi.UInt32(DIFFRACTED), scattered)
    return dr.select(count == 0, unscattered, scattered)


class MisWeights(NamedTuple):
    """
    MIS weights of a path for the techniques that find it; they add up to 1.

    Attributes
    ----------
    forward : mi.Float
        MIS weight of forward rays.
    backward : mi.Float
        MIS weight of backward rays. It is also the factor of a connected ray, whose throughput f/p_backward is that of
        a backward ray on the same path: f/p_connected · w_connected = f/p_backward · w_backward. 0 for a connected ray
        that leaves on another path than that of its light vertex.
    connected : mi.Float
        MIS weight of connections of backward rays to light vertices; 0 where there are none.
    density : mi.Float or None
        Pdf of forward start rays at the start of the path, relative to its mean; None for weights by path class.
    place : list of mi.Float or None
        Point of that start in the unit cube of its cell, for a path that a backward ray has found. None for a path of a
        forward ray, which has that point itself, and for weights by path class.
    end : list of mi.Float or None
        Start of a backward ray on the path: its point in the unit cube of the detector, see
        `mistray.sampling.detector_start.DetectorStart.place`, and its weight. None for weights by path class.
    """

    # w_i = n_i p_i/Σ n_k p_k, see `mistray.sampling.sharing.mis_weights`

    forward: mi.Float
    backward: mi.Float
    connected: mi.Float
    density: mi.Float | None = None
    place: list[mi.Float] | None = None
    end: list[mi.Float] | None = None


class MisWeighting(Protocol):
    """Interface to MIS weights of paths; see `mistray.sampling.sharing.mis_weights.Balance`."""

    def backward(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> MisWeights:
        """Return the MIS weights, 0 … 1, of paths of backward rays that leave the scene within a cell of directions."""

    def forward(self, visit: Visit) -> MisWeights:
        """Return the MIS weights, 0 … 1, of paths of forward rays that start in a cell and meet the detector."""


class SkyContribution(NamedTuple):
    """
    Contributions of rays that end: class of light, cell of directions, and MIS-weighted throughput.

    Attributes
    ----------
    kind, cell : mi.UInt32
        Class of light, an index into `CLASSES`, and index of the cell of directions that it comes from.
    weight : mi.Float
        Throughput times MIS weight, in units of a start ray's flux.
    active : mi.Bool
        Lanes whose rays contribute.
    """

    kind: mi.UInt32
    cell: mi.UInt32
    weight: mi.Float
    active: mi.Bool


class SkyRecorder(Recorder):
    """
    Base class of recorders that sum MIS-weighted throughput by class of light and cell of directions.

    Parameters
    ----------
    shape : tuple of int
        Number of field angles n and of azimuths m of the cells.
    design : DesignKeys
        Sequences of the direct image.
    mis : MisWeighting, optional
        MIS weights of these rays, which compete with those of the other direction; without it, all weights are 1.
    paths : PathSums, optional
        Table of paths to which the contributions are added as well; None: no table of paths is kept.
    pixels : int
        Number of pixels of the detector map of each cell; 0: no maps.
    derivative : (CLASS_COUNT, n, m) float64, optional
        Derivative of a metric with respect to the sum of the contributions of each class in each cell, for `gain`;
        None: `gain` is not needed.
    """

    merges_aimed = True

    kernel_by: ClassVar[tuple[str, ...]] = ("_design", "_maps", "paths", "_mis", "_derivative")

    def __init__(
        self,
        shape: tuple[int, int],
        design: DesignKeys,
        mis: MisWeighting | None = None,
        paths: PathSums | None = None,
        pixels: int = 0,
        derivative: np.ndarray | None = None,
    ) -> None:
        self._shape, self._design, self._mis, self.paths, self._pixels = shape, design, mis, paths, pixels
        self._derivative = None if derivative is None else upload(mi.Float64, np.asarray(derivative, dtype=np.float64))
        cells = shape[0] * shape[1]
        self._cells = dr.opaque(mi.UInt32, cells)  # opaque, so that it makes no new kernel
        self._sums = dr.zeros(mi.Float64, CLASS_COUNT * cells * BATCHES)
        self._largest = dr.zeros(mi.UInt32, cells)  # bits of the largest contribution of a scattered ray
        self._maps = dr.zeros(mi.Float64, 2 * cells * pixels) if pixels else None
        dr.make_opaque(self._sums, self._largest, self._maps)

    def contribution(self, end: Any) -> SkyContribution:
        """
        Return the class of light, direction cell and MIS-weighted throughput of each ray.

        Forward rays count where they meet the detector, backward rays where they leave the scene. The throughput is
        in units of a start ray's flux.

        Subclasses implement it.
        """
        raise NotImplementedError

    def gain(self, end: Visit | Departure) -> mi.Float64:
        """
        Return each ray's contribution to a metric.

        The contribution is the MIS-weighted throughput times `derivative` of the ray's class and cell, in the metric's
        unit. It is 0 for rays in no cell. The recorder's sums do not change.
        """
        kind, cell, weight, active = self.contribution(end)
        derivative = dr.gather(mi.Float64, self._derivative, kind * self._cells + cell, active)
        return dr.select(active, mi.Float64(weight) * derivative, 0)

    def add(self, end: Visit | Departure, light: SkyContribution, pixel: mi.UInt32 | None) -> None:
        """
        Add the rays' MIS-weighted throughput to the sums by class and cell, the detector maps and the path table.

        `pixel` is the index of each ray's pixel in the map of its cell; None if there are no maps.
        """
        kind, cell, weight, active = light
        w = mi.Float64(weight)
        place = (kind * self._cells + cell) * BATCHES + end.start.batch
        dr.scatter_reduce(dr.ReduceOp.Add, self._sums, w, place, active, REDUCE)
        # The bits of positive floats are in the order of the floats
        bits = dr.reinterpret_array(mi.UInt32, weight)
        dr.scatter_reduce(dr.ReduceOp.Max, self._largest, bits, cell, active & (kind >= SINGLE), REDUCE)
        # Map of the cell: sum and sum of squares side by side in a pixel
        if self._maps is not None:
            place = 2 * (cell * self._pixels + pixel)
            for k, value in enumerate((w, w * w)):
                dr.scatter_reduce(dr.ReduceOp.Add, self._maps, value, place + k, active, REDUCE)
        if self.paths is not None:
            self.paths.record(end.key, end.depth + 1, end.event, cell, end.start.batch, weight, active)

    def read(self) -> dict[str, Any]:
        """
        Return the sums of MIS-weighted throughput on the host, in units of a start ray's flux.

        Returns
        -------
        dict
            ``cells`` (CLASS_COUNT, n, m, BATCHES): sums. ``largest`` (n, m): largest throughput of a scattered ray.
            With maps, ``maps`` (2, n, m, pixels): sums over all classes and batches, and sums of squares.
        """
        found = {
            "cells": np.array(self._sums).reshape(CLASS_COUNT, *self._shape, BATCHES),
            "largest": np.array(self._largest).view(np.float32).astype(np.float64).reshape(self._shape),
        }
        if self._maps is not None:
            found["maps"] = np.moveaxis(np.array(self._maps).reshape(*self._shape, self._pixels, 2), 3, 0)
        return found


class DirectionRecorder(SkyRecorder):
    """
    Recorder of backward rays that leave the scene: MIS-weighted throughput by class of light and cell.

    Parameters
    ----------
    grid : DirectionGrid
        Cells of directions.
    design, mis, paths, pixels, derivative
        See `SkyRecorder`.
    """

    def __init__(self, grid: DirectionGrid, design: DesignKeys, *arguments: Any, **options: Any) -> None:
        super().__init__(grid.shape, design, *arguments, **options)
        self.grid = grid
        angles, azimuths = grid.shape
        low, high = np.sin(np.radians(grid.edges_deg)).T ** 2
        # Upper borders are exclusive, but 90° belongs to the cell that ends there. Further rows hold no direction
        self._rows = max(ROWS, 1 << (angles - 1).bit_length())
        low, high = (np.pad(part, (0, self._rows - angles), constant_values=np.inf) for part in (low, high))
        self._low = upload(mi.Float, low)
        self._high = upload(mi.Float, np.where((high >= 1) & (high < np.inf), FAR_SIDE, high))
        # Numbers of cells are opaque, so that they make no new kernel
        self._azimuths, self._azimuth = dr.opaque(mi.UInt32, azimuths), upload_rows(mi.Float, grid.azimuths_deg)
        self._half = dr.opaque(mi.Float, grid.azimuth_cell_deg / 2)
        self._axes = [mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in column)) for column in grid.rotation.T]
        self.elsewhere = dr.zeros(mi.Float64, BATCHES)
        dr.make_opaque(self.elsewhere)

    def cell(self, d: mi.Vector3f) -> tuple[mi.UInt32, mi.Bool]:
        """
        Return the index of the cell of each backward ray, and a mask of rays that are in a cell.

        A ray along the unit vector `d`, in the world, stands for light along -d.
        """
        # Field angle: light travels along -d. sin² orders the angles of the front half space
        x, y, z = (-dr.dot(d, axis) for axis in self._axes)
        sine2 = dr.fma(x, x, y * y)
        index = mi.UInt32(dr.binary_search(0, self._rows - 1, lambda k: dr.gather(mi.Float, self._high, k) <= sine2))
        inside = (z >= 0) & (sine2 >= dr.gather(mi.Float, self._low, index))
        inside &= sine2 < dr.gather(mi.Float, self._high, index)
        if self.grid.azimuth_cell_deg == 360:
            return index, inside
        # Azimuth: the cells need not be evenly spaced, so the nearest is searched for
        azimuth = dr.atan2(-x, y) * (180 / dr.pi)

        def nearer(k: mi.UInt32, best: mi.UInt32, least: mi.Float) -> tuple[mi.UInt32, mi.UInt32, mi.Float]:
            apart = azimuth - dr.gather(mi.Float, self._azimuth, k)
            apart = dr.abs(apart - 360 * dr.round(apart * (1 / 360)))
            return k + 1, dr.select(apart < least, k, best), dr.minimum(apart, least)

        width = dr.width(d)
        _, best, least = dr.while_loop(
            (dr.zeros(mi.UInt32, width), dr.zeros(mi.UInt32, width), dr.full(mi.Float, 360, width)),
            lambda k, best, least: k < self._azimuths,
            nearer,
            mode="symbolic",
            label="azimuth",
        )
        return index * self._azimuths + best, inside & (least <= self._half)

    def depart(self, departure: Departure, memory: Memory) -> None:
        """
        Add the MIS-weighted throughput of rays that leave the scene to the sums of their class and direction cell.

        Throughput outside all cells is added to `elsewhere`, except that of connected rays.
        """
        start, weight, active = departure.start, departure.weight, departure.active
        cell, inside = self.cell(departure.heading)
        # Connected rays stand for light that other rays carry as well
        own = active if departure.light_vertex is None else active & (departure.light_vertex == 0)
        dr.scatter_reduce(dr.ReduceOp.Add, self.elsewhere, mi.Float64(weight), start.batch, own & ~inside)
        self.add(departure, self._within(departure, cell, inside), start.pixel)

    def contribution(self, end: Departure) -> SkyContribution:
        """Return the class of light, cell and MIS-weighted throughput of each backward ray that leaves the scene."""
        return self._within(end, *self.cell(end.heading))

    def _within(self, departure: Departure, cell: mi.UInt32, inside: mi.Bool) -> SkyContribution:
        """Return the contribution of rays that leave within a cell; `cell` and `inside` are those of `cell`."""
        weight, active = departure.weight, inside & departure.active
        if self._mis is not None:
            share = self._mis.backward(departure, cell, active).backward
            weight, active = weight * share, active & (share > 0)
        return SkyContribution(class_of_light(departure, self._design), cell, weight, active)

    def read(self) -> dict[str, Any]:
        """Return the sums of `SkyRecorder.read`, and ``elsewhere``, (BATCHES,), the throughput outside all cells."""
        return super().read() | {"elsewhere": np.array(self.elsewhere)}


class ArrivalRecorder(SkyRecorder):
    """
    Recorder of forward rays that meet the detector: MIS-weighted throughput by class of light and start cell.

    Parameters
    ----------
    shape, design, mis, paths, derivative
        See `SkyRecorder`.
    film : Film, optional
        Pixel grid, without tent filter, of a map of the detector for each cell; None: no maps.
    scattered_only : bool
        Whether only light that has been scattered is recorded.
    """

    incident = True

    kernel_by = (*SkyRecorder.kernel_by, "_scattered_only")

    def __init__(
        self,
        shape: tuple[int, int],
        design: DesignKeys,
        mis: MisWeighting | None,
        paths: PathSums | None = None,
        film: Film | None = None,
        scattered_only: bool = False,
        derivative: np.ndarray | None = None,
    ) -> None:
        super().__init__(shape, design, mis, paths, 0 if film is None else film.width * film.height, derivative)
        self._film, self._scattered_only = film, scattered_only
        self._segments = dr.zeros(mi.Float64, shape[0] * shape[1])
        dr.make_opaque(self._segments)

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add the MIS-weighted throughput of rays that meet the detector to the sums of class and start cell."""
        pixel = None if self._film is None else self._film.places(*visit.position)[0][0]
        self.add(visit, self.contribution(visit), pixel)

    def contribution(self, end: Visit) -> SkyContribution:
        """
        Return the class of light, start cell and MIS-weighted throughput of each ray that meets the detector.

        With `scattered_only`, rays that nothing has scattered are inactive.
        """
        cell, met, kind = end.start.cell, end.detected, class_of_light(end, self._design)
        assert cell is not None
        if self._scattered_only:
            met = met & (kind >= SINGLE)
        weight = end.weight if self._mis is None else end.weight * self._mis.forward(end).forward
        return SkyContribution(kind, cell, weight, met)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        """Add the number of segments of each finished ray tree to the start cell of its ray."""
        dr.scatter_reduce(dr.ReduceOp.Add, self._segments, mi.Float64(segments), start.cell, active, REDUCE)

    def read(self) -> dict[str, Any]:
        """Return the sums of `SkyRecorder.read`, and ``segments``, (n, m), the number of ray segments by start cell."""
        return super().read() | {"segments": np.array(self._segments).reshape(self._shape)}
