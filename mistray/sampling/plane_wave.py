"""
Plane waves over the whole scene: the light of a distant source, as the point source transmittance (PST) assumes it.

A wave stands for one cell of a direction grid. Its directions are uniform in solid angle: with h = sin²(θ/2) the solid
angle is dΩ = 2 dh dφ, so that h and φ are uniform within the cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from mistray.errors import MistrayError
from mistray.recorders.directions import DirectionGrid
from mistray.surfaces.host_points import box_corners
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import opaque

RIM_POINTS = 24  # corners of the polygon around a rim
FIELD_STEPS, AZIMUTH_STEP_DEG = 8, 5.0  # directions of a cell for which the size of the beam is worked out
CLEARANCE = 1e-3  # of the start plane from the scene, in units of the scene's size


@dataclass(frozen=True)
class Entrance:
    """
    Disc across the beam that plane waves fill instead of the whole scene, where all relevant light passes it.

    Light that misses the disc is not traced: what would reach the detector from there is missing in the result.

    Attributes
    ----------
    centre : (3,) float
        Centre in the world, mm.
    radius : float
        Radius, mm, > 0.

    Raises
    ------
    MistrayError
        If the centre is not three finite numbers, or the radius is not positive and finite.
    """

    centre: tuple[float, float, float]
    radius: float

    def __post_init__(self) -> None:
        centre = np.asarray(self.centre, dtype=np.float64)
        if centre.shape != (3,) or not np.all(np.isfinite(centre)):
            raise MistrayError(f"entrance: centre is {self.centre}; give three coordinates in mm")
        if not 0 < self.radius < np.inf:
            raise MistrayError(f"entrance: radius is {self.radius:g} mm; it must be positive")


@dataclass(frozen=True)
class PlaneWave:
    """
    Plane waves from one cell of a direction grid, with an irradiance of 1 W/mm² on planes normal to the rays.

    A ray's direction is uniform in solid angle within the cell, and its position is uniform over a cross-section that
    turns with the direction: a rectangle along azimuth and field angle, or a disc, of the same size for all directions.

    Attributes
    ----------
    rotation : (3, 3) float64
        Columns: the axes of the grid.
    half_sine2 : (2,) float64
        sin²(θ/2) at the edges of the cell.
    azimuth : (2,) float64
        Middle and half width of the cell in azimuth, radians.
    centre : (3,) float64
        Point of the scene that the cross-section is measured from, mm.
    middle, half : (2,) float64
        Middle and half size of the cross-section along azimuth and field angle, mm; the radius twice for a disc.
    is_round : bool
        Whether a disc of radius ``half[0]`` replaces the rectangle.
    distance : float
        Distance from the cross-section back to the start of the rays, mm.
    """

    rotation: np.ndarray
    half_sine2: np.ndarray
    azimuth: np.ndarray
    centre: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    is_round: bool
    distance: float

    @property
    def area(self) -> float:
        """Area of the wave's cross-section, mm², which equals its flux in W."""
        a, b = self.half
        return float(np.pi * a * a if self.is_round else 4 * a * b)

    @property
    def numbers(self) -> list[float]:
        """Parameters of the wave that differ from cell to cell, (10,), in the order that `wave_rays` takes."""
        values = (*self.half_sine2, *self.azimuth, *self.middle, *self.half, self.is_round, self.distance)
        return [float(value) for value in values]


def wave_rays(
    numbers: Sequence[mi.Float],
    rotation: np.ndarray,
    centre: np.ndarray,
    sample: mi.Point2f,
    u: mi.Float,
    v: mi.Float,
) -> tuple[mi.Vector3f, mi.Vector3f]:
    """
    Return origins, mm, and unit directions of rays of plane waves.

    Parameters
    ----------
    numbers : sequence of mi.Float
        Parameters of each ray's wave, see `PlaneWave.numbers`.
    rotation, centre
        Axes of the grid and centre, mm, which all waves share, see `PlaneWave`; the centre is relative to the device's
        origin.
    sample : mi.Point2f
        Positions in the cross-section, in the unit square.
    u, v : mi.Float
        Random numbers, 0 … 1, for field angle and azimuth within the cell.
    """
    low, high, azimuth, half_azimuth, middle_x, middle_y, half_x, half_y, is_round, distance = numbers
    # Direction: sin²(θ/2) is uniform where the solid angle is, and keeps its digits near the axis
    h = dr.lerp(low, high, u)
    cosine, sine = 1 - 2 * h, 2 * dr.sqrt(h * (1 - h))
    s, c = dr.sincos(azimuth + half_azimuth * (2 * v - 1))
    x_axis, y_axis, z_axis = (opaque(mi.Vector3f, column) for column in rotation.T)
    radial = c * y_axis - s * x_axis
    d = dr.normalize(sine * radial + cosine * z_axis)
    across, along = c * x_axis + s * y_axis, cosine * radial - sine * z_axis

    # Position in the cross-section
    disk = mi.warp.square_to_uniform_disk_concentric(sample)
    x = dr.select(is_round > 0, disk.x, 2 * sample.x - 1) * half_x + middle_x
    y = dr.select(is_round > 0, disk.y, 2 * sample.y - 1) * half_y + middle_y
    return opaque(mi.Vector3f, centre) + across * x + along * y - distance * d, d


class PlaneWaves:
    """
    Plane waves of a direction grid that cover all surfaces of a scene, or of several scenes that are compared.

    Parameters
    ----------
    points : (p, 3) float64
        Points from `hull_points`.
    grid : DirectionGrid
        Cells of directions.
    entrance : Entrance, optional
        Disc that the waves cover instead of the scene; None: they cover the scene.
    """

    def __init__(self, points: np.ndarray, grid: DirectionGrid, entrance: Entrance | None = None) -> None:
        self.grid, self.entrance = grid, entrance
        self._points = _corners(points)
        self._centre = 0.5 * (self._points.min(axis=0) + self._points.max(axis=0))

    def at(self, i: int, j: int) -> PlaneWave:
        """Return the plane wave of the direction cell in row i (field angle) and column j (azimuth)."""
        grid = self.grid
        theta = np.radians(grid.edges_deg[i])
        azimuth = np.radians([grid.azimuths_deg[j], grid.azimuth_cell_deg / 2])
        return PlaneWave(
            np.asarray(grid.rotation, dtype=np.float64),
            np.sin(theta / 2) ** 2,
            azimuth,
            *self._cross_section(theta, azimuth),
        )

    def _cross_section(
        self, theta: np.ndarray, azimuth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool, float]:
        """
        Return centre, middle, half size, whether it is a disc, and start distance of a cell's cross-section; all in mm.

        Coordinates of a point along a direction are sine waves over field angle and azimuth. Between two samples such a
        wave exceeds the larger of them by at most (1 - cos(half a step)) of the point's distance.
        """
        # Directions of the cell, and the bound for directions between them
        q = (self._points - self._centre) @ self.grid.rotation
        size = float(np.linalg.norm(q, axis=1).max())
        count = max(3, int(np.ceil(np.degrees(2 * azimuth[1]) / AZIMUTH_STEP_DEG)) + 1)
        phi, step = np.linspace(azimuth[0] - azimuth[1], azimuth[0] + azimuth[1], count, retstep=True)
        field = np.linspace(theta[0], theta[1], FIELD_STEPS + 1)
        margin = size * (2 - np.cos(step / 2) - np.cos((field[1] - field[0]) / 2)) + 1e-6 * size
        s, c = np.sin(phi), np.cos(phi)
        # Coordinates of the hull across and along each of them
        x = q[:, :1] * c + q[:, 1:2] * s
        radial, z = (q[:, 1:2] * c - q[:, :1] * s)[..., None], q[:, 2, None, None]
        y = radial * np.cos(field) - z * np.sin(field)
        along = radial * np.sin(field) + z * np.cos(field)
        distance = float(margin + CLEARANCE * size - along.min())
        if self.entrance is not None:
            centre, radius = np.asarray(self.entrance.centre, dtype=np.float64), self.entrance.radius
            # From the start plane of the whole scene, wherever the disc lies
            distance += float(np.linalg.norm(centre - self._centre))
            return centre, np.zeros(2), np.full(2, radius), True, distance
        # The smaller of the rectangle and the disc
        low = np.array([x.min(), y.min()]) - margin
        high = np.array([x.max(), y.max()]) + margin
        radius = float(np.sqrt(np.max(x[..., None] ** 2 + y**2))) + margin
        if np.pi * radius**2 < np.prod(high - low):
            return self._centre, np.zeros(2), np.full(2, radius), True, distance
        return self._centre, 0.5 * (low + high), 0.5 * (high - low), False, distance


def hull_points(*tables: SurfaceTable) -> np.ndarray:
    """Return points, (p, 3) float64, mm, whose convex hull holds all surfaces; a polygon stands for a round rim."""
    turn = 2 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
    # Polygon around the unit circle, so that it holds the rim
    polygon = np.stack([np.cos(turn), np.sin(turn)], axis=1) / np.cos(np.pi / RIM_POINTS)
    points = []
    for table in tables:
        # Analytic surfaces in their own frames first, then bounding boxes
        for piece, rotation, vertex in zip(table.pieces, table.rotations, table.vertices, strict=False):
            points.append(piece.hull(polygon) @ rotation.T + vertex)
        points += [box_corners([shape.bbox()]) for shape in table.shapes[len(table.pieces) :]]
    return np.concatenate(points)


def _corners(points: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of points (p, 3), mm; all points if they have no hull."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # all of them lie in a plane
        return points
