"""Planes, conics and even aspheres, given by their sag within a round or a rectangular aperture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mistray.physics.geometry.sag import conic_end, sag, sag_derivative, trimmed
from mistray.surfaces.crossings import conic_crossing, plane_crossing
from mistray.surfaces.gradient_columns import COEFFICIENTS, HALF_HEIGHT, HALF_WIDTH, INNER, OUTER
from mistray.surfaces.surface import (
    RECTANGLE,
    ROUND,
    Bounds,
    Opening,
    TracedSurface,
    asphere_crossings,
    asphere_gradient,
)

if TYPE_CHECKING:
    import mitsuba as mi

    from mistray.surfaces.crossings import AxisRay, Numbers

# An asphere is hit through its conic if it departs from it by less than this, in units of its aperture and as a slope
MILD_DEPARTURE, MILD_SLOPE, MILD_MARGIN = 0.004, 0.03, 1.02
STEEP = 2.0  # |dz/dr| above which points are proposed more densely towards the rim
# Gauss-Legendre quadrature over 0 … 1, for each direction of a part of a curved surface
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
NODES, WEIGHTS = 0.5 * (_NODES + 1), 0.5 * _WEIGHTS


@dataclass(kw_only=True)
class SagSurface(TracedSurface):
    """
    Surface z = sag(r) within an aperture; F = c r² + c (1 + k) z² - 2 z, or 2 (sag - z) with aspheric terms.

    Attributes
    ----------
    curvature, conic : float
        Curvature at the vertex, 1/mm, and conic constant.
    coefficients : tuple of float
        Aspheric coefficients a4, a6, … up to the last that is not zero, in mm^-3, mm^-5, ….
    outer, inner : float
        Clear radius and radius of a central hole, mm; ``outer`` is 0 for a rectangle.
    half_size : (2,) float
        Half width and half height of a rectangle, mm; 0 for a round aperture.
    slope : float
        Upper bound of the slope |dz/dr|.
    bend : float
        Upper bound of the second derivative of the sag along any direction across the axis, 1/mm.
    departure : float
        Largest axial distance of an asphere from its conic, mm, if the conic's hit is close enough to start Newton's
        method from; else 0.
    """

    curvature: float = 0.0
    conic: float = 0.0
    coefficients: tuple[float, ...] = ()
    outer: float = 0.0
    inner: float = 0.0
    half_size: tuple[float, float] = (0.0, 0.0)
    slope: float = 0.0
    bend: float = 0.0
    departure: float = 0.0

    fours: ClassVar[tuple[int, ...]] = (0, 2)

    @classmethod
    def of(
        cls,
        curvature: float,
        conic: float,
        coefficients: tuple[float, ...],
        outer: float = 0.0,
        inner: float = 0.0,
        half_size: tuple[float, float] = (0.0, 0.0),
    ) -> SagSurface:
        """Create an optical surface from curvature, 1/mm, conic constant, aspheric coefficients and aperture, mm."""
        coefficients = trimmed(coefficients)
        size = outer or float(np.hypot(*half_size))
        z_range, steepest, bend = _reach(curvature, conic, coefficients, size)
        return cls(
            sign=-1.0,
            z_range=z_range,
            wall=False,
            curvature=curvature,
            conic=conic if curvature else 0.0,
            coefficients=coefficients,
            outer=outer,
            inner=inner,
            half_size=half_size,
            slope=1.02 * steepest,
            bend=1.02 * bend,
            departure=_mild_departure(curvature, conic, coefficients, size) if coefficients else 0.0,
        )

    @classmethod
    def annulus(cls, outer: float, inner: float) -> SagSurface:
        """Create a flat mechanical ring between two radii, mm, whose normal points to +z."""
        return cls(sign=-1.0, z_range=(0.0, 0.0), wall=True, outer=outer, inner=inner)

    # ---- facts

    @property
    def flat(self) -> bool:
        """True if the surface is a plane."""
        return self.curvature == 0 and not self.coefficients

    @property
    def sort(self) -> tuple[object, ...]:
        kind = "asphere" if self.coefficients else "conic" if self.curvature else "plane"
        return kind, bool(self.outer), self.inner > 0

    @property
    def searched(self) -> bool:
        return bool(self.coefficients)

    @property
    def size(self) -> float:
        return self.outer or float(np.hypot(*self.half_size))

    @property
    def least_radius(self) -> float:
        return self.inner if self.outer else 0.0

    @property
    def columns(self) -> dict[str, float]:
        numbers = self.curvature, self.conic, *self.coefficients
        shape = dict(zip(("curvature", "conic", *COEFFICIENTS), numbers, strict=False))
        if self.outer:
            return {**shape, "outer": self.outer, "inner": self.inner}
        return {**shape, "half_width": self.half_size[0], "half_height": self.half_size[1]}

    @property
    def quadric(self) -> tuple[float, float, float, float]:
        return self.curvature, self.curvature * (1 + self.conic), -2.0, 0.0

    @property
    def clip(self) -> tuple[float, float]:
        more = self.overlap
        if self.outer:
            return max(self.inner - more, 0.0) ** 2, 0.0
        return self.half_size[0] + more, self.half_size[1] + more

    @property
    def opening(self) -> Opening:
        """Clear aperture as a flat figure: in the plane of the rim if round, in that of the vertex if rectangular."""
        if not self.outer:
            return Opening(0.0, self.half_size, rectangular=True)
        height = float(self.sag(min(self.outer, self._end) ** 2))
        return Opening(height, (self.outer, self.outer), self.inner / self.outer)

    @property
    def _end(self) -> float:
        """Radius, mm, at which the surface's conic becomes parallel to the axis, less a rounding error."""
        return (1 - 1e-15) * conic_end(self.curvature, self.conic)

    @property
    def host_reach(self) -> tuple[float, float, float]:
        """Radius up to which the sag is defined within the aperture, and its ends along z, mm."""
        return min(self.size, self._end), *self.z_range

    @property
    def detector_half(self) -> tuple[float, float]:
        return (self.outer, self.outer) if self.outer else self.half_size

    def sag(self, r2: Any) -> np.ndarray:
        """Return the height over the vertex, mm, at squared distances from the axis r2, mm²."""
        return np.asarray(sag(r2, self.curvature, self.conic, self.coefficients)) + np.zeros(np.shape(r2))

    def sag_derivative(self, r2: Any) -> np.ndarray:
        """Return the derivative of the sag with respect to r², 1/mm, at squared distances from the axis r2, mm²."""
        return np.asarray(sag_derivative(r2, self.curvature, self.conic, self.coefficients))

    # ---- rays on the host

    @property
    def bounds(self) -> Bounds:
        # A plane has one sheet
        sheet = self.quadric[1] if self.curvature else 0.0
        if self.outer:
            return Bounds(sheet, self.inner**2, self.outer**2)
        return Bounds(sheet, half_x=self.half_size[0], half_y=self.half_size[1])

    def crossings(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        if not self.coefficients:
            return super().crossings(o, d)
        return asphere_crossings((self.curvature, self.conic, *self.coefficients), self.host_reach, o, d)

    def residual(self, q: np.ndarray) -> np.ndarray:
        if self.coefficients:
            return 2 * (self.sag(q[:, 0] ** 2 + q[:, 1] ** 2) - q[:, 2])
        return super().residual(q)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        if self.coefficients:
            return asphere_gradient((self.curvature, self.conic, *self.coefficients), q)
        return super().gradient(q)

    # ---- points and areas

    def points(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        if self.outer:
            r = np.sqrt(self.inner**2 + u * (self.outer**2 - self.inner**2))
            x, y = r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v)
            return np.stack([x, y, self.sag(r * r)], axis=1)
        x, y = self.half_size[0] * (2 * u - 1), self.half_size[1] * (2 * v - 1)
        return np.stack([x, y, self.sag(x * x + y * y)], axis=1)

    def proposals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = np.full(len(u), np.pi * (self.outer**2 - self.inner**2) or 4 * self.half_size[0] * self.half_size[1])
        if self._steep:
            u, share = u * (2 - u), share * 2 * (1 - u)
        q = self.points(u, v)
        return q, share * self._stretch(q[:, 0] ** 2 + q[:, 1] ** 2)

    def unit_square(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not self.outer:
            return 0.5 + 0.5 * q[:, 0] / self.half_size[0], 0.5 + 0.5 * q[:, 1] / self.half_size[1]
        low, high = self.inner**2, self.outer**2
        return (q[:, 0] ** 2 + q[:, 1] ** 2 - low) / (high - low), azimuth(q)

    def areas(self, first: int, second: int) -> np.ndarray:
        if self.outer:
            low, high = self.inner**2, self.outer**2
            edges = np.arange(first + 1) / first
            edges = 1 - np.sqrt(1 - edges) if self._steep else edges
            width = np.diff(edges)
            w = edges[:-1, None] + width[:, None] * NODES
            u, share = (w * (2 - w), 2 * (1 - w)) if self._steep else (w, np.ones_like(w))
            rings = np.pi * (high - low) * width * ((share * self._stretch(low + (high - low) * u)) @ WEIGHTS)
            return np.repeat(rings[:, None] / second, second, axis=1)
        a, b = self.half_size
        x, y = a * (2 * _nodes(first) - 1), b * (2 * _nodes(second) - 1)
        r2 = x[:, None, :, None] ** 2 + y[None, :, None, :] ** 2
        return np.asarray(4 * a * b / (first * second) * (self._stretch(r2) @ WEIGHTS) @ WEIGHTS)

    @property
    def _steep(self) -> bool:
        """True if areas are integrated over w with u = w (2 - w): the stretch of a hemisphere grows as 1 / (1 - w)."""
        return bool(self.outer) and self.slope > STEEP

    def _stretch(self, r2: np.ndarray) -> np.ndarray:
        """Return the ratio of the surface's area to that of its projection along the axis, at squared radii, mm²."""
        return np.ones_like(r2) if self.flat else np.sqrt(1 + 4 * r2 * np.square(self.sag_derivative(r2)))

    def hull(self, polygon: np.ndarray) -> np.ndarray:
        corners = np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
        flat = self.outer * polygon if self.outer else corners * self.half_size
        return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in self.z_range])

    # ---- rims

    @property
    def rim_coordinate(self) -> int:
        return ROUND if self.outer else RECTANGLE

    @property
    def rim_sizes(self) -> dict[int, float]:
        if self.outer:
            found = {OUTER: self.outer, INNER: self.inner}
        else:
            found = {HALF_WIDTH: self.half_size[0], HALF_HEIGHT: self.half_size[1]}
        return {rim: size for rim, size in found.items() if size > 0}

    @property
    def reach(self) -> tuple[float, float]:
        return self.inner, self.size

    def zone_widths(self, width: float) -> dict[int, float]:
        if self.outer:
            return super().zone_widths(width)
        return {rim: min(width, 1.0) * size for rim, size in self.rim_sizes.items()}

    def rim_point(self, rim: int) -> np.ndarray:
        radius = self.outer if rim == OUTER else self.inner
        return np.array([radius, float(self.sag(min(radius, self._end) ** 2))])

    def tangent(self, point: np.ndarray) -> np.ndarray:
        slope = 2 * point[0] * self.sag_derivative(min(point[0], self._end) ** 2)
        tangent = np.array([1.0, float(slope)])
        return np.asarray(tangent / np.linalg.norm(tangent))

    # ---- kernel

    def kernel_values(self) -> dict[str, Any]:
        return {
            "curvature": self.curvature,
            "one_plus_conic": 1 + self.conic,
            "conic": self.conic,
            "coefficients": self.coefficients,
            "slope": self.slope,
            "inner2": max(self.inner - self.overlap, 0.0) ** 2,
            "half_width": self.half_size[0] + self.overlap,
            "half_height": self.half_size[1] + self.overlap,
            "wide2": (MILD_MARGIN * self.size) ** 2,
            "departure": self.departure,
        }

    def crossing(self, ray: AxisRay, numbers: Numbers, own: mi.Bool) -> mi.Float:
        return (conic_crossing if self.curvature else plane_crossing)(ray, self, numbers, own)


def azimuth(q: np.ndarray) -> np.ndarray:
    """Return the azimuths of points (n, 3) about the axis, (n,), as fractions of a turn: 0 at -x, 1/4 at -y."""
    return np.asarray(0.5 + np.arctan2(q[:, 1], q[:, 0]) / (2 * np.pi))


def _nodes(parts: int) -> np.ndarray:
    """Return quadrature nodes within each of `parts` equal intervals of 0 … 1, (parts, nodes)."""
    return (np.arange(parts)[:, None] + NODES) / parts


@lru_cache(maxsize=1024)
def _mild_departure(c: float, k: float, coefficients: tuple[float, ...], outer: float) -> float:
    """
    Return an asphere's largest axial distance from its conic, mm; 0 if it is not one for `mild_asphere`.

    That is if the distance or its slope is too large, the curvature `c` is 0, or the conic ends within `outer`, mm.
    """
    r = np.linspace(0.0, MILD_MARGIN * outer, 513)
    if c == 0 or (1 + k) * (c * r[-1]) ** 2 >= 1:
        return 0.0
    polynomial = np.asarray(sag(r * r, 0.0, 0.0, coefficients))
    departure, slope = np.max(np.abs(polynomial)), np.max(np.abs(np.gradient(polynomial, r)))
    return float(departure) if departure < MILD_DEPARTURE * outer and slope < MILD_SLOPE else 0.0


@lru_cache(maxsize=1024)
def _reach(
    curvature: float, conic: float, coefficients: tuple[float, ...], size: float
) -> tuple[tuple[float, float], float, float]:
    """
    Return the range of the sag up to radius `size`, mm, its largest slope, and its largest second derivative, 1/mm.

    All are taken from 2001 points, as far as the conic goes. The slope is |dz/dr|. The second derivative along any
    direction across the axis is between d²z/dr² and dz/dr/r.
    """
    r = np.linspace(0.0, min(size, conic_end(curvature, conic)), 2001)
    z = np.asarray(sag(r * r, curvature, conic, coefficients))
    if np.isnan(z[-1]):  # the rounding of the point where the conic stands upright
        z[-1] = 1 / (curvature * (1 + conic)) + sag(r[-1] ** 2, 0.0, 0.0, coefficients)
    flat = not curvature and not coefficients
    slope = np.zeros_like(r) if flat else np.gradient(z, r, edge_order=2)
    span = max(float(np.ptp(z)), 1e-6 * size)
    z_range = float(z.min()) - 1e-3 * span, float(z.max()) + 1e-3 * span
    bend = np.abs(np.gradient(slope, r)), np.abs(slope[1:] / r[1:])
    return z_range, float(np.max(np.abs(slope))), float(max(np.max(part) for part in bend))
