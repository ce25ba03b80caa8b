"""
Aimed start rays of a near source: cones to spheres that hold what matters, seen from the origin of a ray.

A ray is drawn from the law of the source or uniformly from one of the cones, and weighted by the balance heuristic
(E. Veach and L. Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH 1995), see
`mistray.sampling.source`. The density in a cone of half angle α is 1/(2π (1 - cos α)), with sin α = radius/distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.sampling.emission_laws import direction, polar
from mistray.surfaces.upload import opaque


@dataclass(frozen=True, eq=False)
class Sphere:
    """Sphere at which start rays are aimed: centre (3,) and radius, mm."""

    centre: np.ndarray
    radius: float

    def contains(self, point: np.ndarray) -> bool:
        """Whether a point (3,), mm, lies within the sphere."""
        return bool(np.linalg.norm(point - self.centre) <= self.radius)


class AimedCone:
    """
    Cone of directions from each point to a sphere; from points within the sphere, all directions.

    Parameters
    ----------
    target : Sphere
    o : mi.Vector3d
        Points, mm.
    """

    def __init__(self, target: Sphere, o: mi.Vector3d) -> None:
        away = opaque(mi.Vector3d, target.centre) - o
        distance = dr.norm(away)
        self._axis = away / dr.maximum(distance, 1e-300)
        sine = dr.minimum(dr.opaque(mi.Float64, target.radius) / dr.maximum(distance, 1e-300), 1)
        within = distance <= dr.opaque(mi.Float64, target.radius)
        # 1 - cos of the half angle, exact for small ones
        self._height = dr.select(within, 2, sine * sine / (1 + dr.safe_sqrt(1 - sine * sine)))

    def directions(self, sample: mi.Point2d) -> mi.Vector3d:
        """Return unit directions within the cone, uniform in solid angle, for points of the unit square."""
        square, cosine, sine = polar(sample)
        local = direction(square * self._height, cosine, sine)
        u, v = across(self._axis)
        return local.x * u + local.y * v + local.z * self._axis

    def density(self, d: mi.Vector3d) -> mi.Float64:
        """Return the pdf of directions d that are uniform in the cone, 1/sr; 0 outside the cone."""
        # 1 - cos from the chord: exact in narrow cones
        apart = 0.5 * dr.squared_norm(d - self._axis)
        return dr.select(apart <= self._height * (1 + 1e-12), dr.rcp(2 * dr.pi * self._height), 0)


def across(axis: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
    """
    Return two unit vectors at right angles to a unit vector and to each other.

    T. Duff et al., "Building an orthonormal basis, revisited", J. Computer Graphics Techniques 6(1), 1-8 (2017).
    """
    # Without this sign the basis degenerates near axis.z = -1
    sign = dr.select(axis.z < 0, mi.Float64(-1), 1)
    a = -dr.rcp(sign + axis.z)
    b = axis.x * axis.y * a
    return (
        mi.Vector3d(1 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x),
        mi.Vector3d(b, sign + axis.y * axis.y * a, -axis.y),
    )
