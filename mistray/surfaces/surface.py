"""Interface of an analytic surface to a trace. Each family of surfaces implements it in a file of its own.

`mistray.surfaces.families.sag_surface` has planes, conics and aspheres, `cone` has cones and tubes, and `freeform` has
all other sags. `mistray.surfaces.families.implicit_surface` has the surfaces that users define by a formula.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from mistray.physics.geometry.sag import sag, sag_derivative
from mistray.surfaces.crossings import Numbers
from mistray.surfaces.gradient_columns import HALF_HEIGHT, HALF_WIDTH, HIGH, INNER, LOW, OUTER

if TYPE_CHECKING:
    import mitsuba as mi

    from mistray.surfaces.crossings import AxisRay

NO_SURFACE = 0xFFFFFFFF
# A second hit of the surface just left must be at least this far away, in units of its size: nearer hits are rounding
SELF_HIT = 1e-5
# Coordinate in which rims lie: the distance from the axis, x and y, or one of the family (z for a cone)
ROUND, RECTANGLE, ENDS = range(3)
NEWTON_STEPS = 8  # onto an asphere
SAMPLES, MOST_WITHIN = 24, 3  # of a line's stretch by an asphere, and crossings between them that count
HALVINGS = 52  # of the interval between two samples, at most
SAME = 1e-7  # relative difference of distances below which they are of one crossing
SETTLED = 1e-10  # relative size of the last Newton step, below which a hit is found
AREA_STEPS = 64  # steps along a surface with uniformly drawn points, for its area


@dataclass(frozen=True)
class Opening:
    """
    Clear aperture of a surface as a flat ellipse or rectangle across the axis.

    Attributes
    ----------
    height : float
        Position along the axis from the vertex, mm.
    half_size : (2,) float
        Half axes or half sides, mm.
    hole : float
        Radius of a central hole, in units of the half axes; 0 for a rectangle.
    rectangular : bool
        Whether the opening is a rectangle.
    """

    height: float
    half_size: tuple[float, float]
    hole: float = 0.0
    rectangular: bool = False


class Bounds(NamedTuple):
    """
    Bounds of the points of a surface, in the frame of its vertex; infinite where there is none.

    Attributes
    ----------
    sheet : float
        Only points of a quadric with 1 - sheet z > 0 belong to the surface, 1/mm; 0 where both of its sheets do.
    low2, high2 : float
        Least and greatest squared distance from the axis, mm².
    half_x, half_y : float
        Greatest |x| and |y|, mm.
    low_z, high_z : float
        Least and greatest position along the axis, mm.
    """

    sheet: float = 0.0
    low2: float = -np.inf
    high2: float = np.inf
    half_x: float = np.inf
    half_y: float = np.inf
    low_z: float = -np.inf
    high_z: float = np.inf


@dataclass(kw_only=True)
class TracedSurface(ABC):
    """
    Analytic surface: static properties that determine the kernel's code, and parameters in float64.

    Points, directions and distances of methods are in the frame of the surface's vertex, mm, float64 on the host.

    Attributes
    ----------
    sign : float
        Sign, +1 or -1, that turns the gradient of F into the direction of the surface's normal.
    z_range : (2,) float
        Range of positions along the axis from the vertex, mm.
    wall : bool
        Whether the surface is mechanical and few rays meet it; all others are optical.
    index : int
        Index of the surface in the scene.
    frame : int
        Index of the orientation that the surface shares with others; 0 is unrotated.
    axis : int
        Index of the axis (orientation and lateral position) that the surface shares with others.
    z : float
        Position of the vertex along the axis, mm.
    overlap : float
        Width, mm, by which the kernel's bounds exceed those of the surface on each side. Otherwise rounding would let
        some rays pass between surfaces that meet.
    """

    sign: float
    z_range: tuple[float, float]
    wall: bool
    index: int = 0
    frame: int = 0
    axis: int = 0
    z: float = 0.0
    overlap: float = 0.0

    one_side_up: ClassVar[bool] = True
    """Whether the x axis of the frame has a projection onto the surface everywhere; on a tube it has none in places."""
    fours: ClassVar[tuple[int, ...]] = ()
    """Groups of four in `mistray.surfaces.crossings.ROW` that `crossing` reads in a tree; empty for no tree."""

    # ---- facts

    @property
    def extent(self) -> tuple[float, float]:
        """Least and greatest position of the surface along its axis in the device's frame, mm."""
        return self.z + self.z_range[0], self.z + self.z_range[1]

    @property
    @abstractmethod
    def size(self) -> float:
        """Largest distance of the surface's points from its axis, mm."""

    @property
    def self_hit(self) -> float:
        """Least distance, mm, at which a ray may hit the surface it starts from; nearer hits are rounding."""
        return SELF_HIT * self.size

    @property
    @abstractmethod
    def least_radius(self) -> float:
        """Lower bound of the distance of the surface's points from its axis, mm."""

    @property
    @abstractmethod
    def columns(self) -> dict[str, float]:
        """
        Values of the surface in the `GEOMETRY` columns of derivatives, by name; those of other columns are 0.

        See `mistray.surfaces.gradient_columns`.
        """

    @property
    def sort(self) -> tuple[object, ...]:
        """Hashable properties on which the kernel's code depends; surfaces of equal sort share that code."""
        return (type(self),)

    @property
    def searched(self) -> bool:
        """True if the kernel finds hits by the search in `mistray.surfaces.aspheres` and not by `crossing`."""
        return False

    @property
    def quadric(self) -> tuple[float, float, float, float]:
        """Coefficients a, b, e, g of F = a (x² + y²) + b z² + e z + g, see `SurfaceRow`; zeros for any other F."""
        return 0.0, 0.0, 0.0, 0.0

    @property
    def clip(self) -> tuple[float, float]:
        """
        Half width and half height (mm) of a rectangular aperture, else inner radius squared (mm²) and 0.

        The overlap with neighbours is included. Other surfaces have 0 and 0.
        """
        return 0.0, 0.0

    @property
    @abstractmethod
    def opening(self) -> Opening:
        """Clear aperture of the surface as a flat ellipse or rectangle across its axis."""

    @property
    def detector_half(self) -> tuple[float, float] | None:
        """Half width and half height, mm, of the image if this is a detector; None if it cannot be one."""
        return None

    # ---- rays on the host

    @property
    def bounds(self) -> Bounds | None:
        """Bounds of the surface's points, for tests of many quadrics at once; None if only `inside` can test them."""
        return None

    def crossings(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """
        Return the distances, (n, k), mm, of either sign, at which lines cross the unbounded sheet; NaN for none.

        `o` and `d` are (n, 3) origins, mm, and unit directions.
        """
        assert self.bounds is not None
        return quadric_crossings(self.quadric, self.bounds.sheet, o, d)

    def inside(self, q: np.ndarray) -> np.ndarray:
        """
        Return a mask of points (n, 3), mm, of the unbounded sheet that lie within the surface's bounds, (n,) bool.

        The result is False for NaN.
        """
        assert self.bounds is not None
        return within_bounds(self.bounds, q)

    def residual(self, q: np.ndarray) -> np.ndarray:
        """Return the implicit function F, (n,), at points (n, 3), mm; F = 0 on the surface."""
        a, b, e, g = self.quadric
        return np.asarray(a * (q[:, 0] ** 2 + q[:, 1] ** 2) + (b * q[:, 2] + e) * q[:, 2] + g)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """Return half the gradient of the implicit function F, (n, 3), at points (n, 3), mm."""
        a, b, e, _ = self.quadric
        return quadric_gradient(a, b, e, q)

    # ---- points and areas

    @abstractmethod
    def points(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return points of the surface, (n, 3), mm, about uniform over its area, for uniform u and v in 0 … 1."""

    def proposals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, 3), mm, for u and v in 0 … 1, and the area per unit of (u, v) there, mm²."""
        return self.points(u, v), np.full(len(u), self.areas(AREA_STEPS, 1).sum())

    @abstractmethod
    def unit_square(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return two coordinates, (n,) each, that run from 0 to 1 over the surface, of its points (n, 3), mm."""

    @abstractmethod
    def areas(self, first: int, second: int) -> np.ndarray:
        """Return the areas, (first, second), mm², of equal steps of the coordinates of `unit_square`."""

    def hull(self, polygon: np.ndarray) -> np.ndarray:
        """
        Return points (n, 3), mm, whose convex hull contains the surface.

        `polygon` holds the corners (m, 2) of a polygon around the unit circle.
        """
        return np.concatenate([np.column_stack([self.size * polygon, np.full(len(polygon), z)]) for z in self.z_range])

    # ---- rims

    @property
    @abstractmethod
    def rim_coordinate(self) -> int:
        """Kind of coordinate that is constant along each rim: radius (`ROUND`), x and y (`RECTANGLE`) or z (`ENDS`)."""

    @property
    @abstractmethod
    def rim_sizes(self) -> dict[int, float]:
        """Radius or half side of each rim, mm, by its position in `RIM_COLUMNS`; rims of size 0 are left out."""

    @property
    @abstractmethod
    def reach(self) -> tuple[float, float]:
        """Least and greatest value, mm, of the coordinate that defines the rims; for a rectangle, of the radius."""

    def rim_place(self, q: np.ndarray) -> np.ndarray:
        """Return the coordinate that defines the rims (radius or z), (n,), of points (n, 3), mm; not for rectangles."""
        return q[:, 2] if self.rim_coordinate == ENDS else np.hypot(q[:, 0], q[:, 1])

    def rim_depths(self, q: np.ndarray) -> dict[int, np.ndarray]:
        """
        Return the distances, (n,), mm, by which points (n, 3), mm, lie inside each rim; negative outside.

        They are listed by position in `RIM_COLUMNS`. Rims of size 0 are left out.
        """
        if self.rim_coordinate == RECTANGLE:
            sides = {HALF_WIDTH: q[:, 0], HALF_HEIGHT: q[:, 1]}
            return {rim: self.rim_sizes[rim] - np.abs(along) for rim, along in sides.items()}
        place, (low, high) = self.rim_place(q), self.reach
        first, second = (LOW, HIGH) if self.rim_coordinate == ENDS else (INNER, OUTER)
        depths = {first: place - low, second: high - place}
        return {rim: depth for rim, depth in depths.items() if rim in self.rim_sizes}

    circular_rims = True
    """Whether all curved rims are circles about the axis."""

    def zone_widths(self, width: float) -> dict[int, float]:
        """
        Return the widths of the boundary zones along the rims, mm, by position in `RIM_COLUMNS`.

        Parameters
        ----------
        width : float
            Width in units of the radius or half side; zones end where they would overlap.
        """
        half = 0.5 * (self.reach[1] - self.reach[0])
        return {rim: min(width * size, half) for rim, size in self.rim_sizes.items()}

    @abstractmethod
    def rim_point(self, rim: int) -> np.ndarray:
        """
        Return the radius of a circular rim and its position along the axis, (2,), mm.

        `rim` is its position in `RIM_COLUMNS`.
        """

    @abstractmethod
    def tangent(self, point: np.ndarray) -> np.ndarray:
        """
        Return the unit tangent (radial, axial) of the profile at a point (radius, z), mm, on it.

        The tangent points in the direction in which the coordinate of the rims grows.
        """

    def rim_stretch(self, point: np.ndarray) -> float:
        """Return how fast the coordinate of the rims changes along the profile at a point (radius, z), mm per mm."""
        return float(abs(self.tangent(point)[1 if self.rim_coordinate == ENDS else 0]))

    # ---- kernel

    def numbers(self) -> Any:
        """Return the surface's parameters that `crossing` needs, as Dr.Jit variables."""
        return Numbers.of(self)

    @abstractmethod
    def kernel_values(self) -> Mapping[str, Any]:
        """Return the parameters, by name, that `crossing` needs for this family alone."""

    @abstractmethod
    def crossing(self, ray: AxisRay, numbers: Any, own: mi.Bool) -> mi.Float:
        """
        Return the distance to rays' first crossing within the bounds, mm; infinite for none.

        `numbers` are those of the method `numbers`, and `own` is True for rays that start on this surface.
        """


# The numbers of surfaces in these functions are floats, or arrays (n,) with those of the surface that each ray may meet


def quadric_crossings(quadric: Sequence[Any], sheet: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """
    Return the distances, (n, 2), mm, at which lines cross a sheet of a quadric, without cancellation.

    They are NaN or infinite where a line does not cross the sheet. `quadric` holds a, b, e and g of
    `TracedSurface.quadric`, and `sheet` is that of `Bounds`; `o` and `d` are (n, 3) points, mm, and unit directions.
    """
    (a, b, e, g), (x, y, z), (dx, dy, dz) = quadric, o.T, d.T
    A = a * (dx**2 + dy**2) + b * dz**2
    B = a * (x * dx + y * dy) + (b * z + 0.5 * e) * dz
    C = a * (x**2 + y**2) + (b * z + e) * z + g
    q = -(B + np.copysign(np.sqrt(B * B - A * C), B))
    t = np.stack([C / q, q / A])
    return np.where(1 - sheet * (z + t * dz) > 0, t, np.nan).T


def within_bounds(bounds: Sequence[Any], q: np.ndarray) -> np.ndarray:
    """
    Return a mask of points (n, 3), mm, of a surface's sheet that lie within its `Bounds`, (n,) bool.

    The result is False for NaN.
    """
    (_, low2, high2, half_x, half_y, low_z, high_z), (x, y, z) = bounds, q.T
    r2 = x**2 + y**2
    beside = (np.abs(x) <= half_x) & (np.abs(y) <= half_y)
    return np.asarray((r2 >= low2) & (r2 <= high2) & beside & (z >= low_z) & (z <= high_z))


def quadric_gradient(a: Any, b: Any, e: Any, q: np.ndarray) -> np.ndarray:
    """Return half the gradient of F, (n, 3), at points (n, 3), mm; see `TracedSurface.quadric`."""
    x, y, z = q.T
    return np.stack([a * x, a * y, b * z + 0.5 * e], axis=1)


def asphere_crossings(shape: Sequence[Any], reach: Sequence[Any], o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """
    Return the distances, (n, 2 + `MOST_WITHIN`), mm, at which lines cross an even asphere; NaN for none.

    They are found from changes of sign within its aperture, and from crossings with its conic where Newton's method
    gets there within `NEWTON_STEPS`: those beyond the aperture, and two that lie close together.

    Parameters
    ----------
    shape : sequence
        Curvature, 1/mm, conic constant, and coefficients a4, a6, …, see `mistray.physics.geometry.sag.sag`.
    reach : sequence
        Radius of the aperture and ends of the sag within it, mm.
    o, d : (n, 3) float64
        Points on the lines, mm, and their unit directions.
    """
    near, within = _from_conic(shape, o, d), _within(shape, reach, o, d)
    again = np.abs(near[..., None] - within[:, None]) < SAME * (1 + np.abs(near[..., None]))
    near[again.any(axis=2)] = np.nan
    return np.concatenate([near, within], axis=1)


def _within(shape: Sequence[Any], reach: Sequence[Any], o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the first crossings of lines with an asphere in its aperture, (n, `MOST_WITHIN`), mm; NaN for none."""
    (outer, low, high), (x, y, z), (dx, dy, dz) = reach, o.T, d.T
    across, along = dx * dx + dy * dy, x * dx + y * dy
    half = np.sqrt(along * along - across * (x * x + y * y - np.square(outer)))
    ends = np.stack([(low - z) / dz, (high - z) / dz])
    start = np.fmax((-along - half) / across, np.fmin(*ends))
    end = np.fmin((half - along) / across, np.fmax(*ends))
    found = np.full((len(o), MOST_WITHIN), np.nan)
    beside = (across == 0) & (x * x + y * y > np.square(outer))  # parallel to the axis
    rays = np.flatnonzero((half >= 0) & (start < end) & ~beside)

    def numbers(rays: np.ndarray) -> list[Any]:
        return [number[rays] if np.ndim(number) else number for number in (*o.T, *d.T, outer, *shape)]

    # Between two samples with a change of sign lies a crossing; the start is where the chord between them has height 0
    t = start[rays] + np.linspace(0, 1, SAMPLES)[:, None] * (end - start)[rays]
    heights = _height(t, numbers(rays))
    above = heights > 0
    row, place = np.nonzero((above[1:] != above[:-1]).T)
    number = np.arange(len(row)) - np.searchsorted(row, row)
    row, place, number = (v[number < MOST_WITHIN] for v in (row, place, number))
    first, last, before = t[place, row], t[place + 1, row], above[place, row]
    at_first, at_last = heights[place, row], heights[place + 1, row]
    best = first - at_first * (last - first) / (at_last - at_first)
    best = np.where(np.isfinite(best), best, 0.5 * (first + last))
    going, lines = np.arange(len(row)), numbers(rays[row])
    for _ in range(HALVINGS):  # Newton's steps, and halves where they leave the bracket
        f = _height(best, lines)
        same = (f > 0) == before
        first, last = np.where(same, best, first), np.where(same, last, best)
        new = best - f / _slope(best, lines)
        new = np.where((new >= first) & (new <= last), new, 0.5 * (first + last))
        on = ~(np.abs(new - best) < SETTLED * (1 + np.abs(new)))
        found[rays[row[going]], number[going]] = new
        going, first, last, before, best = (v[on] for v in (going, first, last, before, new))
        if not len(going):
            break
        lines = [v[on] if np.ndim(v) else v for v in lines]
    return found


def _height(t: np.ndarray, line: Sequence[Any]) -> Any:
    """
    Return the heights, mm, over an asphere of points at distances t, mm, along lines; beyond its edge, over the edge's.

    `line` holds points, mm, unit directions, the radius of the edge, and the shape, see `asphere_crossings`.
    """
    x, y, z, dx, dy, dz, edge, c, k, *coefficients = line
    r2 = np.minimum((x + t * dx) ** 2 + (y + t * dy) ** 2, edge**2)
    return z + t * dz - sag(r2, c, k, coefficients)


def _slope(t: np.ndarray, line: Sequence[Any]) -> Any:
    """Return the derivative of `_height` with respect to t, as within the edge."""
    x, y, _, dx, dy, dz, edge, c, k, *coefficients = line
    x, y = x + t * dx, y + t * dy
    r2 = np.minimum(x**2 + y**2, edge**2)
    return dz - 2 * sag_derivative(r2, c, k, coefficients) * (x * dx + y * dy)


def _from_conic(shape: Sequence[Any], o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """
    Return the distances, (n, 2), mm, at which Newton's method finds crossings with an asphere from those of its conic.

    They are NaN where it fails. Parameters are those of `asphere_crossings`.
    """
    curvature, conic, *_ = shape
    t = quadric_crossings((curvature, curvature * (1 + conic), -2.0, 0.0), 0.0, o, d)
    t[:, 0] = np.where(np.isfinite(t[:, 0]), t[:, 0], -o[:, 2] / d[:, 2])  # of the vertex plane, where it is nearest
    found = np.full(t.shape, np.nan)
    going = np.flatnonzero(np.isfinite(t))  # few need more than some steps: the others are left out of the rest
    ray, t = going // t.shape[1], t.ravel()[going]
    lines = [v[ray] if np.ndim(v) else v for v in (*o.T, *d.T, *shape)]
    for _ in range(NEWTON_STEPS):
        x, y, z, dx, dy, dz, c, k, *coefficients = lines
        x, y = x + t * dx, y + t * dy
        r2 = x**2 + y**2
        slope = 2 * sag_derivative(r2, c, k, coefficients) * (x * dx + y * dy) - dz
        step = (sag(r2, c, k, coefficients) - z - t * dz) / slope
        t = t - step
        settled = np.abs(step) < SETTLED * (1 + np.abs(t))
        found.flat[going[settled]] = t[settled]
        on = ~settled & np.isfinite(step)
        going, t = going[on], t[on]
        if not len(going):
            break
        lines = [v[on] if np.ndim(v) else v for v in lines]
    return found


def asphere_gradient(shape: Sequence[Any], q: np.ndarray) -> np.ndarray:
    """Return half the gradient of F = 2 (sag - z), (n, 3), at points (n, 3), mm; see `asphere_crossings`."""
    c, k, *coefficients = shape
    x, y, _ = q.T
    slope = 2 * sag_derivative(x**2 + y**2, c, k, coefficients)
    return np.stack([slope * x, slope * y, -np.ones(len(q))], axis=1)
