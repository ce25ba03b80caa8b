"""Recorder of the light that crosses a rectangle in space, without an effect on the rays."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import FILM_PIXELS, FILM_SIDE, FILM_SIDES, POINT_MM, SIZE_MM
from mistray.recorders.flux_maps.cells import MM2_PER_M2, PassingLight, cell_of
from mistray.recorders.recorder import Memory, Segment
from mistray.recorders.sampled import Sampled
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import opaque

PARALLEL = 1e-6  # sine of the angle below which two directions are parallel
# Distance in front of the rectangle at which light is recorded, relative to coordinates and to the way of the light. It
# exceeds their rounding, so that of two segments that meet on a surface there the first counts and the second does not
BEFORE = 2e-6


class Probe(PassingLight):
    """
    Recorder of light that crosses a rectangle towards its normal: irradiance by position, radiance by direction.

    It is given to `mistray.trace` among ``recorders``. It may be placed anywhere, also within glass, and does not
    affect the light, so that a ray that comes back contributes again. Where a medium absorbs or scatters light on the
    way, the flux is that at the rectangle. On a surface it records the light that arrives there, not the light that
    leaves or starts there.

    Parameters
    ----------
    name : str
        Name in the trace, see `mistray.trace.Trace.recorders`.
    centre : (3,) float
        Centre of the rectangle in the world, mm.
    normal : (3,) float
        Side towards which light must go to contribute; its length does not matter. Reverse it for light that comes
        back.
    half_width, half_height : float
        Half sides, mm.
    pixels : (2,) int
        Number of pixels across and down.
    directions : int
        Number of cells of direction along each of x and y, for `radiance`; 1: one cell holds all directions.
    up : (3,) float
        Direction whose projection into the plane of the rectangle is its y axis.

    Raises
    ------
    MistrayError
        For a blank name, a value out of range, or a `normal` and `up` that are 0 or parallel.

    Examples
    --------
    >>> probe = mistray.recorders.Probe("behind L1", centre=(0, 0, 50), half_width=15, half_height=15, pixels=(10, 10))
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[probe])
    >>> irradiance, error = probe.irradiance
    >>> print(f"{irradiance.sum() * 3 * 3:.0f} W of {t.energy.launched_W:.0f} W")
    188 W of 201 W
    """

    kind, unit = "probe", "W/mm²"

    kernel_by = ("directions",)

    # More than 8 parameters, because a rectangle in space and its cells have as many
    def __init__(
        self,
        name: str,
        centre: Sequence[float],
        normal: Sequence[float] = (0.0, 0.0, 1.0),
        half_width: float = 1.0,
        half_height: float = 1.0,
        pixels: Sequence[int] = (64, 64),
        directions: int = 1,
        up: Sequence[float] = (0.0, 1.0, 0.0),
    ) -> None:
        owner = f"probe '{name}'"
        for what, side in (("half_width", half_width), ("half_height", half_height)):
            SIZE_MM.check(what, side, owner)
        columns, rows = FILM_SIDES.check("pixels", pixels, owner)
        FILM_SIDE.check("number of directions", directions, owner)
        FILM_PIXELS.check("number of its cells", columns * rows * directions**2, owner)
        self._centre = vector_of("centre", centre, owner)
        self._axes = frame_of(vector_of("normal", normal, owner), vector_of("up", up, owner), owner)
        self._half = float(half_width), float(half_height)
        self._pixels, self.directions = (int(columns), int(rows)), int(directions)
        super().__init__(name, self._pixels[0] * self._pixels[1] * self.directions**2)

    def lay_out(self, table: SurfaceTable) -> None:
        """Upload the centre (mm), axes and half sides (mm) of the rectangle to the device."""
        self._optics = table.optics
        self._origin = table.upload_point(self._centre)
        reach = float(np.linalg.norm(self._centre - table.centre) + np.hypot(*self._half))
        self._before = dr.opaque(mi.Float, BEFORE * reach)
        self._on_device = [opaque(mi.Vector3f, axis) for axis in self._axes]
        self._scale = [
            dr.opaque(mi.Float, count / (2 * half)) for count, half in zip(self._pixels, self._half, strict=True)
        ]
        self._halves = [dr.opaque(mi.Float, half) for half in self._half]

    def travel(self, segment: Segment, memory: Memory) -> None:
        """Add the flux of rays that cross the rectangle towards its normal to cells of position and direction."""
        # Intersect with the plane, and test the rectangle
        right, up, normal = self._on_device
        away = self._origin - segment.origin
        along, ahead = dr.dot(segment.heading, normal), dr.dot(away, normal)
        distance = ahead / along
        # A little in front of the plane, on which a surface may lie
        before = self._before + BEFORE * ahead
        crosses = segment.active & (along > 0) & (ahead > before)
        crosses &= segment.leaves | (ahead - before <= along * segment.length)
        offset = dr.fma(distance, segment.heading, -away)
        x, y = dr.dot(offset, right), dr.dot(offset, up)
        crosses &= (dr.abs(x) <= self._halves[0]) & (dr.abs(y) <= self._halves[1])
        # Attenuate as far as the rectangle
        flux = segment.flux
        if self._optics.absorbs:
            flux, _, _ = self._optics.attenuate(flux, segment.medium, distance, crosses)
        # Cell, by pixel and by direction cosines
        columns, rows = self._pixels
        cell = cell_of((y + self._halves[1]) * self._scale[1], rows) * columns
        cell += cell_of((x + self._halves[0]) * self._scale[0], columns)
        if self.directions > 1:
            n = self.directions
            u, v = (cell_of((dr.dot(segment.heading, axis) + 1) * mi.Float(n / 2), n) for axis in (right, up))
            cell = (cell * n + v) * n + u
        self.add(segment.start, cell, flux, crosses)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Extent x0, x1, y0, y1 of the rectangle in its own frame, mm."""
        return -self._half[0], self._half[0], -self._half[1], self._half[1]

    @property
    def irradiance(self) -> tuple[np.ndarray, np.ndarray]:
        """Irradiance by pixel and its standard error, (height, width) each, W/mm²; row 0 is at the smallest y."""
        return self._by_pixel(self.flux)

    @property
    def illuminance(self) -> tuple[np.ndarray, np.ndarray]:
        """Illuminance by pixel and its standard error, (height, width) each, lx; row 0 is at the smallest y."""
        return self._by_pixel(self.luminous_flux.scaled(MM2_PER_M2))

    def _by_pixel(self, flux: Sampled) -> tuple[np.ndarray, np.ndarray]:
        columns, rows = self._pixels
        by_direction = flux.reshaped(rows, columns, self.directions**2)
        return by_direction.total(2).scaled(1 / self._pixel_area).with_se

    @property
    def _pixel_area(self) -> float:
        """Area of a pixel, mm²."""
        columns, rows = self._pixels
        return 4 * self._half[0] * self._half[1] / (columns * rows)

    image = irradiance

    @property
    def image_size(self) -> int:
        """Number of pixels of the rectangle."""
        return self._pixels[0] * self._pixels[1]

    @property
    def radiance(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Radiance by pixel and direction, and its standard error: (height, width, directions, directions), W/(mm² sr).

        The last two axes are uniform cells of the direction cosines along y and x, -1 … 1. The area du dv of a cell is
        its projected solid angle cos θ dΩ. So the flux, divided by the area of the pixel and by du dv, is the mean
        radiance.
        """
        return self._by_direction(self.flux)

    @property
    def luminance(self) -> tuple[np.ndarray, np.ndarray]:
        """Luminance by pixel and direction and its standard error, axes as those of `radiance`, cd/m²."""
        return self._by_direction(self.luminous_flux.scaled(MM2_PER_M2))

    def _by_direction(self, flux: Sampled) -> tuple[np.ndarray, np.ndarray]:
        columns, rows = self._pixels
        # du dv = (2/n)²
        n = self.directions
        return flux.scaled(1 / (self._pixel_area * (2 / n) ** 2)).reshaped(rows, columns, n, n).with_se


def vector_of(what: str, given: Sequence[float], owner: str) -> np.ndarray:
    """
    Return three numbers as a vector, (3,); raise `MistrayError` for another count or a number out of range.

    Messages name the vector by `owner` and `what`.
    """
    return np.array(POINT_MM.check(what, given, owner))


def frame_of(normal: np.ndarray, up: np.ndarray, owner: str) -> np.ndarray:
    """
    Return the unit vectors along x, y and the normal of a plane, as rows, (3, 3).

    Parameters
    ----------
    normal, up : (3,) float64
        Directions; `up` lies in the plane of y and the normal.
    owner : str
        Name in error messages.

    Raises
    ------
    MistrayError
        If a direction is 0, or both are parallel.
    """
    for what, vector in (("normal", normal), ("up", up)):
        if not np.linalg.norm(vector) > 0:
            raise MistrayError(f"{owner}: {what} is 0, 0, 0; give a direction")
    z = normal / np.linalg.norm(normal)
    x = np.cross(up / np.linalg.norm(up), z)
    if np.linalg.norm(x) < PARALLEL:
        raise MistrayError(f"{owner}: up is along {normal.tolist()}; give another up")
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])
