"""Plane waves from all cells of a grid of directions, on the device: start rays from places in a cell, and inverse."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.directions import DirectionGrid
from mistray.recorders.sampler import tree_seeds
from mistray.recorders.start_rays import StartRays, generators
from mistray.sampling.plane_wave import Entrance, PlaneWaves, wave_rays
from mistray.sampling.sharing.start_map import DeviceMap
from mistray.sampling.strata import curve_points
from mistray.settings import BATCHES
from mistray.surfaces.upload import upload, upload_rows


class CellWaves:
    """
    Plane waves that cover a scene, one from each cell of a direction grid, on the device.

    Parameters
    ----------
    points : (p, 3) float64
        Hull of the scene, from `mistray.sampling.plane_wave.hull_points`.
    grid : DirectionGrid
        Cells of directions.
    centre : (3,) float64
        Origin of positions on the device, mm.
    entrance : Entrance, optional
        Disc that the waves cover instead of the scene; None: they cover the scene.

    Attributes
    ----------
    areas : (c,) float64
        Areas of the waves' cross-sections, mm².
    etendue : (c,) float64
        Cross-section times solid angle, mm² sr.
    extent : float
        Extent of the scene, mm.
    """

    def __init__(
        self, points: np.ndarray, grid: DirectionGrid, centre: np.ndarray, entrance: Entrance | None = None
    ) -> None:
        waves = PlaneWaves(points, grid, entrance)
        cells = [waves.at(i, j) for i, j in np.ndindex(*grid.shape)]
        self.areas = np.array([wave.area for wave in cells])
        self.etendue = self.areas * np.repeat(grid.solid_angle, grid.shape[1])
        self.extent = float(np.ptp(points, axis=0).max())
        self._numbers = [upload_rows(mi.Float, column) for column in np.array([wave.numbers for wave in cells]).T]
        self._rotation, self._centre = cells[0].rotation, cells[0].centre - centre

    def rays(self, cell: mi.UInt32, place: list[mi.Float]) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Return ray origins, mm from `centre`, and unit directions for four coordinates in the unit cube of cells."""
        numbers = [dr.gather(mi.Float, column, cell) for column in self._numbers]
        return wave_rays(numbers, self._rotation, self._centre, mi.Point2f(*place[:2]), *place[2:])

    def place(self, cell: mi.UInt32, p: mi.Vector3f, d: mi.Vector3f, active: mi.Bool) -> list[mi.Float]:
        """
        Return the place in a cell's unit cube of the ray that passes p, mm, along d: the inverse of `rays`.

        Coordinates are clipped to 0 … 1.
        """
        low, high, azimuth, half_azimuth, middle_x, middle_y, half_x, half_y, is_round, _ = (
            dr.gather(mi.Float, column, cell, active) for column in self._numbers
        )
        x_axis, y_axis, z_axis = (
            mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in column)) for column in self._rotation.T
        )
        # Direction: uniform in sin²(θ/2) and in azimuth
        x, y, z = (dr.dot(d, axis) for axis in (x_axis, y_axis, z_axis))
        sine2 = dr.fma(x, x, y * y)
        sine = dr.sqrt(sine2)
        u = (sine2 / (2 * (1 + z)) - low) / (high - low)
        there = sine > 1e-12
        s, c = dr.select(there, -x / sine, 0), dr.select(there, y / sine, 1)
        turn = dr.atan2(s, c) - azimuth
        turn = turn - 2 * dr.pi * dr.round(turn / (2 * dr.pi))
        v = 0.5 * (turn / half_azimuth + 1)
        # Position in the cross-section, whose axes turn with the direction
        radial = c * y_axis - s * x_axis
        across, along = c * x_axis + s * y_axis, z * radial - sine * z_axis
        q = p - mi.Vector3f(*(dr.opaque(mi.Float, float(value)) for value in self._centre))
        a, b = (dr.dot(q, across) - middle_x) / half_x, (dr.dot(q, along) - middle_y) / half_y
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(a, b))
        a, b = dr.select(is_round > 0, square.x, 0.5 * (a + 1)), dr.select(is_round > 0, square.y, 0.5 * (b + 1))
        return [dr.clip(value, 0, 1 - 2.0**-24) for value in (a, b, u, v)]


def cell_starts(
    waves: CellWaves,
    starts: DeviceMap | None,
    seed: tuple[int, ...],
    lanes: np.ndarray,
    weight: np.ndarray,
    medium: int = 0,
) -> StartRays:
    """
    Return the forward start rays of a pass, cell by cell; the rays of each cell are stratified in each batch.

    Parameters
    ----------
    waves : CellWaves
        Plane waves from all cells.
    starts : DeviceMap or None
        Start map of all cells. None: rays start uniformly, and the random numbers of a cell do not depend on the rays
        of other cells.
    seed : tuple of int
        Seeds of the random numbers.
    lanes : (c,) int
        Number of rays of each cell, multiples of `BATCHES`.
    weight : (c,) float64
        Throughput of a ray that starts at density 1, the mean.
    medium : int
        Position in `Optics.media` of the medium outside of the scene; 0 if it is unknown.
    """
    # Cell of each ray, and its index there
    cell = upload(mi.UInt32, np.repeat(np.arange(len(lanes)), lanes))
    index = upload(mi.UInt32, np.arange(lanes.sum()) - np.repeat(np.cumsum(lanes) - lanes, lanes))
    strata = dr.gather(mi.UInt32, upload_rows(mi.UInt32, lanes // BATCHES), cell)
    lane = dr.arange(mi.UInt32, int(lanes.sum()))
    stream = int(np.random.SeedSequence(seed).generate_state(1)[0])
    rng, _ = generators(stream, lane) if starts is not None else generators(stream, index, cell)
    # One stratum of 0 … 1 for each ray of a batch
    batch = index // strata
    within = mi.Float64(index - batch * strata) + mi.Float64(rng.next_float32())
    position = dr.minimum(within / mi.Float64(strata), 1 - 1e-12)
    if starts is not None:
        place, density = starts.sample(cell, position, rng)
    else:
        place = [*curve_points(position, 2, rng), rng.next_float32(), rng.next_float32()]
        density = dr.full(mi.Float, 1, dr.width(lane))
    o, d = waves.rays(cell, place)
    # A ray carries the inverse of the density with which it was drawn
    scale = dr.rcp(density)
    w = scale * dr.gather(mi.Float, upload_rows(mi.Float, weight), cell)
    seeds = tree_seeds(stream, batch + BATCHES * cell)
    dr.eval(lane, batch, seeds, o, d, w, cell, scale, place)
    outside = dr.full(mi.UInt32, medium, dr.width(lane))
    return StartRays(lane, batch, seeds, o, d, w, index=index, cell=cell, scale=scale, place=place, medium=outside)


def whole_batches(rays: np.ndarray) -> np.ndarray:
    """Return ray counts rounded up to multiples of the number of batches, `BATCHES`."""
    return np.asarray(-(-np.asarray(rays, dtype=np.int64) // BATCHES) * BATCHES)
