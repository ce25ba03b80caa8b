"""Surfaces of revolution that users define by a formula F(x, y, z) = 0 and a coordinate along their profile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from mistray.surfaces.families.implicit_crossing import ImplicitNumbers, first_crossing
from mistray.surfaces.families.sag_surface import azimuth
from mistray.surfaces.families.sampled_crossings import sampled_crossings
from mistray.surfaces.gradient_columns import HIGH, LOW, OWN
from mistray.surfaces.surface import ENDS, Opening, TracedSurface

if TYPE_CHECKING:
    from mistray.surfaces.crossings import AxisRay

PROFILE = 2001  # points of the profile from which bounds and areas are computed
SAMPLES = 512  # samples of a line, between which the host looks for crossings
MOST_CROSSINGS = 8
MARGIN = 1e-3  # margin of the bounds around the profile, in units of its size


@dataclass(kw_only=True)
class ImplicitSurface(TracedSurface):
    """
    Surface of revolution given by an implicit formula of a family that a plugin defines.

    See `mistray.plugins.shapes.implicit.Implicit`.

    Attributes
    ----------
    family : type
        Class with `residual`, `gradient`, `coordinate` and `generatrix`.
    values : dict of str to float
        Values of the family's parameters, by name.
    ends : (2,) float
        Least and greatest coordinate along the profile, mm.
    radii : (2,) float
        Least and greatest distance from the axis, mm.
    """

    family: Any
    values: dict[str, float]
    ends: tuple[float, float]
    radii: tuple[float, float]

    @classmethod
    def of(cls, family: Any, values: Mapping[str, float], ends: tuple[float, float], wall: bool) -> ImplicitSurface:
        """Create a surface of a family from its parameter values, between two ends of its profile coordinate, mm."""
        own = {name: values[name] for name in family.numbers}
        r, z = family.generatrix(np.linspace(*ends, PROFILE), own)
        margin = MARGIN * float(max(np.ptp(r), np.ptp(z)))
        return cls(
            sign=1.0,
            z_range=(float(np.min(z)) - margin, float(np.max(z)) + margin),
            wall=wall,
            family=family,
            values=own,
            ends=ends,
            radii=(max(float(np.min(r)) - margin, 0.0), float(np.max(r)) + margin),
        )

    @property
    def size(self) -> float:
        return self.radii[1]

    @property
    def least_radius(self) -> float:
        return self.radii[0]

    @property
    def columns(self) -> dict[str, float]:
        numbers = dict(zip(OWN, self.values.values(), strict=False))
        return {**numbers, "low": self.ends[0], "high": self.ends[1]}

    @property
    def opening(self) -> Opening:
        """Clear aperture as a flat disc of the largest radius, half-way along the axis."""
        return Opening(0.5 * sum(self.z_range), (self.size, self.size))

    # ---- rays on the host

    def residual(self, q: np.ndarray) -> np.ndarray:
        return np.asarray(self.family.residual(*q.T, self.values))

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return 0.5 * np.stack([np.broadcast_to(g, len(q)) for g in self.family.gradient(*q.T, self.values)], axis=1)

    def coordinate(self, q: np.ndarray) -> np.ndarray:
        """Return the family's coordinate along the profile, (n,), mm, at points (n, 3)."""
        return np.asarray(self.family.coordinate(*q.T, self.values))

    def rim_place(self, q: np.ndarray) -> np.ndarray:
        return self.coordinate(q)

    def crossings(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        reach = np.hypot(self.size, np.abs(self.z_range).max())  # of a ball around it
        return sampled_crossings(self.residual, o, d, reach, SAMPLES, MOST_CROSSINGS)

    def inside(self, q: np.ndarray) -> np.ndarray:
        u = self.coordinate(q)
        return np.asarray((u >= self.ends[0]) & (u <= self.ends[1]))

    # ---- points and areas

    def _profile(self, u: Any) -> np.ndarray:
        """Return radius and position along the axis, (2, …), mm, at coordinates along the profile, mm."""
        return np.array(self.family.generatrix(u, self.values), dtype=np.float64)

    def _speed(self, u: Any) -> np.ndarray:
        """Return the derivatives, (2, …), of radius and axial position with respect to the profile coordinate."""
        step = 1e-4 * (self.ends[1] - self.ends[0])
        return np.asarray((self._profile(u + step) - self._profile(u - step)) / (2 * step))

    def points(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        along = np.linspace(*self.ends, PROFILE)
        density = self._profile(along)[0] * np.hypot(*self._speed(along))
        area = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
        r, z = self._profile(np.interp(u, area / area[-1], along))
        return np.stack([r * np.cos(2 * np.pi * v), r * np.sin(2 * np.pi * v), z], axis=1)

    def unit_square(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (self.coordinate(q) - self.ends[0]) / (self.ends[1] - self.ends[0]), azimuth(q)

    def areas(self, first: int, second: int) -> np.ndarray:
        parts = max(1, -(-PROFILE // first))
        step = (self.ends[1] - self.ends[0]) / (first * parts)
        along = self.ends[0] + step * (np.arange(first * parts) + 0.5)
        rings = 2 * np.pi * step * self._profile(along)[0] * np.hypot(*self._speed(along))
        return np.repeat(rings.reshape(first, parts).sum(axis=1)[:, None] / second, second, axis=1)

    # ---- rims

    @property
    def rim_coordinate(self) -> int:
        return ENDS

    @property
    def rim_sizes(self) -> dict[int, float]:
        sizes = {rim: float(self._profile(u)[0]) for rim, u in zip((LOW, HIGH), self.ends, strict=True)}
        return {rim: size for rim, size in sizes.items() if size > 0}

    @property
    def reach(self) -> tuple[float, float]:
        return self.ends

    def rim_point(self, rim: int) -> np.ndarray:
        return self._profile(self.ends[0 if rim == LOW else 1])

    def _place(self, point: np.ndarray) -> float:
        """Return the profile coordinate, mm, of a point given as (radius, z), mm."""
        return float(self.coordinate(np.array([[point[0], 0.0, point[1]]]))[0])

    def tangent(self, point: np.ndarray) -> np.ndarray:
        speed = self._speed(self._place(point))
        return np.asarray(speed / np.linalg.norm(speed))

    def rim_stretch(self, point: np.ndarray) -> float:
        return 1 / float(np.linalg.norm(self._speed(self._place(point))))

    # ---- kernel

    def numbers(self) -> ImplicitNumbers:
        return ImplicitNumbers.of(self)

    def kernel_values(self) -> dict[str, Any]:
        return dict(self.values)

    def crossing(self, ray: AxisRay, numbers: ImplicitNumbers, own: mi.Bool) -> mi.Float:
        return first_crossing(ray, self.family, numbers, own)
