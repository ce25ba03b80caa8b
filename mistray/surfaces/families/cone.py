"""Cones and cylinders: lens edges, barrels and vanes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mistray.surfaces.crossings import cone_crossing
from mistray.surfaces.families.sag_surface import azimuth
from mistray.surfaces.gradient_columns import HIGH, LOW
from mistray.surfaces.surface import ENDS, Bounds, Opening, TracedSurface

if TYPE_CHECKING:
    import mitsuba as mi

    from mistray.surfaces.crossings import AxisRay, Numbers


@dataclass(kw_only=True)
class Cone(TracedSurface):
    """
    Part of a cone or cylinder between two planes across its axis, with the implicit function F = r² - (r0 + slope z)².

    Attributes
    ----------
    r0 : float
        Radius at the vertex, mm.
    slope : float
        Change of the radius along the axis, dr/dz.
    """

    r0: float
    slope: float

    one_side_up: ClassVar[bool] = False
    fours: ClassVar[tuple[int, ...]] = (0, 1)

    @classmethod
    def of(cls, r0: float, r1: float, length: float) -> Cone:
        """Create a mechanical wall with radius `r0` at z = 0 and `r1` at z = `length`, mm."""
        ends = min(0.0, length), max(0.0, length)
        return cls(sign=1.0, z_range=ends, wall=True, r0=r0, slope=(r1 - r0) / length)

    def radius(self, z: Any) -> Any:
        """Return the cone's radius, mm, at the coordinate z along its axis, mm; negative past its apex."""
        return self.r0 + self.slope * z

    @property
    def _rims(self) -> tuple[float, float]:
        """Radii, mm, of the cone's rims at its lower and its upper end."""
        return self.radius(self.z_range[0]), self.radius(self.z_range[1])

    @property
    def size(self) -> float:
        return max(self._rims)

    @property
    def least_radius(self) -> float:
        return min(self._rims)

    @property
    def columns(self) -> dict[str, float]:
        return {"r0": self.r0, "slope": self.slope, "low": self.z_range[0], "high": self.z_range[1]}

    @property
    def quadric(self) -> tuple[float, float, float, float]:
        m = self.slope
        return 1.0, -m * m, -2 * self.r0 * m, -(self.r0**2)

    @property
    def opening(self) -> Opening:
        """Clear aperture of the cone as a flat disc in the plane of its larger rim."""
        return Opening(self.z_range[int(self._rims[1] > self._rims[0])], (self.size, self.size))

    @property
    def bounds(self) -> Bounds:
        low, high = self.z_range
        return Bounds(low_z=low, high_z=high)

    def points(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        (first, last), (low, high) = self._rims, self.z_range
        r = np.sqrt(first**2 + u * (last**2 - first**2))
        z = (r - self.r0) / self.slope if self.slope else low + u * (high - low)
        return np.stack([r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v), z], axis=1)

    def unit_square(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along, (low, high) = q[:, 2], self.z_range  # the area is even in z of a tube, in r² of a cone
        if self.slope:
            along, (low, high) = q[:, 0] ** 2 + q[:, 1] ** 2, (r**2 for r in self._rims)
        return (along - low) / (high - low), azimuth(q)

    def areas(self, first: int, second: int) -> np.ndarray:
        low, high = self._rims
        whole = np.pi * (low + high) * np.hypot(high - low, self.z_range[1] - self.z_range[0])
        return np.full((first, second), whole / (first * second))

    def hull(self, polygon: np.ndarray) -> np.ndarray:
        ends = zip(self._rims, self.z_range, strict=True)
        return np.concatenate([np.column_stack([r * polygon, np.full(len(polygon), z)]) for r, z in ends])

    @property
    def rim_coordinate(self) -> int:
        return ENDS

    @property
    def rim_sizes(self) -> dict[int, float]:
        sizes = dict(zip((LOW, HIGH), map(abs, self._rims), strict=True))
        return {rim: size for rim, size in sizes.items() if size > 0}

    @property
    def reach(self) -> tuple[float, float]:
        return self.z_range

    def rim_point(self, rim: int) -> np.ndarray:
        z = self.z_range[0 if rim == LOW else 1]
        return np.array([abs(self.radius(z)), z])

    def tangent(self, point: np.ndarray) -> np.ndarray:
        tangent = np.array([self.slope, 1.0])
        return np.asarray(tangent / np.linalg.norm(tangent))

    def kernel_values(self) -> dict[str, Any]:
        return {"curvature": 1.0, "r0": self.r0, "slope": self.slope}

    def crossing(self, ray: AxisRay, numbers: Numbers, own: mi.Bool) -> mi.Float:
        return cone_crossing(ray, self, numbers, own)
