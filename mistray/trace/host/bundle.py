"""Rays of one object point, at infinity or near, addressed by two coordinates across the beam: mm, or slopes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.sampling.source import SceneSource, Sphere
from mistray.sampling.sources import scene_sources

Array = npt.NDArray[np.float64]

WIDEST = 20.0  # tangent of the angle to the middle of the aperture at which light of a near point is looked for


@dataclass(frozen=True)
class PointBundle:
    """
    Rays of one object point, addressed by coordinates (x, y): mm for a distant point, slopes for a near one.

    For a point at infinity they are the position in a plane across the light, mm. For a near point they are
    the slopes dx/dz, dy/dz against the line to the middle of the first aperture.

    Attributes
    ----------
    origin : (3,) float64
        The near point, or the origin of the coordinates in the plane, mm.
    axis, u, v : (3,) float64
        Direction of the ray (0, 0), and the axes of the coordinates; unit vectors.
    near : bool
        Whether the object point is near, so that coordinates are slopes.
    along : (3,) float64
        Unit vector along which the field grows. For a distant point it is the change of the light's direction with the
        field angle. For a near point it is the direction of positive object heights: y of the object plane, turned by
        the azimuth.
    """

    origin: Array
    axis: Array
    u: Array
    v: Array
    near: bool
    along: Array

    def rays(self, x: Array) -> tuple[Array, Array]:
        """Return origins, mm, and unit directions, (n, 3) each, of the rays at coordinates x, (n, 2): mm or slopes."""
        if self.near:
            d = self.axis + x[:, :1] * self.u + x[:, 1:] * self.v
            return np.tile(self.origin, (len(x), 1)), d / np.linalg.norm(d, axis=1, keepdims=True)
        return self.origin + x[:, :1] * self.u + x[:, 1:] * self.v, np.tile(self.axis, (len(x), 1))

    def density(self, x: Array) -> Array:
        """
        Return the relative flux per area of the coordinates, (n,), at coordinates x, (n, 2): mm or slopes.

        The beam is uniform, or the near point radiates alike in all directions. It is 1 for a point at infinity. For a
        near one it is 1 at x = 0 and falls off as the slopes grow.
        """
        if not self.near:
            return np.ones(len(x))
        return np.asarray((1 + (x**2).sum(axis=1)) ** -1.5)

    def shifted(self, shift: Array) -> PointBundle:
        """
        Return the rays of a neighbouring object point.

        `shift`, (3,), is the displacement of a near point, mm. For a point at infinity it is the vector added to the
        unit direction of the light, before that is normalised again: tangents of small angles.
        """
        if self.near:
            return replace(self, origin=self.origin + shift)
        axis = self.axis + shift
        axis = axis / np.linalg.norm(axis)
        u = self.u - (self.u @ axis) * axis
        u = u / np.linalg.norm(u)
        return replace(self, axis=axis, u=u, v=np.cross(axis, u))

    def coordinates(self, sphere: Sphere) -> tuple[Array, float]:
        """
        Return centre, (2,), and radius of a sphere in the bundle's coordinates: mm, or slopes if the point is near.

        For a near point the radius is an upper limit of the slopes, at most `WIDEST`.
        """
        away = sphere.centre - self.origin
        across = np.array([away @ self.u, away @ self.v])
        if not self.near:
            return across, sphere.radius
        ahead = float(away @ self.axis)
        return across / ahead, min(sphere.radius / max(ahead - sphere.radius, sphere.radius / WIDEST), WIDEST)


def field_bundle(scene: Any, field_deg: float, azimuth_deg: float | None, aperture: Sphere) -> PointBundle:
    """
    Return the rays of a field point of the first source of a scene as a bundle.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    field_deg : float
        Field angle, degrees.
    azimuth_deg : float or None
        Azimuth of the field, degrees; None: that of the source.
    aperture : Sphere
        Sphere that contains the first surface of the design path, mm.

    Raises
    ------
    MistrayError
        If the source is neither far away nor a point of an object plane.
    """
    source = scene_sources(scene, field_deg=field_deg, azimuth_deg=azimuth_deg)[0]
    azimuth = np.radians(source.emitter.azimuth_deg if azimuth_deg is None else azimuth_deg)
    if source.middle is not None:
        start, d = source.middle
        v = np.cross(d[0], source.u)  # that of the source may lie in the plane of an aperture, aslant to the light
        return PointBundle(start[0], d[0], source.u, v, False, v)
    if not getattr(source.emitter, "in_object_plane", False):
        raise MistrayError(
            f"source '{source.name}': it is neither far away nor a point of an object plane, so that it has no image; "
            "put 'collimated' or 'point_source' in its place"
        )
    place = object_point(source)
    axis = aperture.centre - place
    axis = axis / np.linalg.norm(axis)
    u = source.u - (source.u @ axis) * axis
    u = u / np.linalg.norm(u)
    along = np.cos(azimuth) * source.v - np.sin(azimuth) * source.u
    return PointBundle(place, axis, u, np.cross(axis, u), True, along)


def object_point(source: SceneSource) -> Array:
    """Return the centre of a near source in world coordinates, (3,), mm."""
    x, y, z = (source.emitter.values[key] for key in "xyz")
    return np.asarray(source.pivot + x * source.u + y * source.v + z * source.direction)
