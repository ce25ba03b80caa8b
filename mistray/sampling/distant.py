"""Start rays of distant light, such as the sun's or the sky's: its directions, and a disc across each of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.sampling.emission_laws import polar
from mistray.sampling.source import OPTICS, Emission, PluginRays, Sphere, across, on_host, turned
from mistray.sampling.strata import Strata, stratified_points
from mistray.settings import BATCHES
from mistray.surfaces.upload import opaque

AIMED = (OPTICS, 1 - OPTICS)  # shares of the rays that go to the first aperture, and to the rest of the scene
CLEARANCE = 1.01  # distance of the start of the rays from the middle of the scene, in radii


@dataclass(frozen=True, kw_only=True)
class DistantRays(PluginRays):
    """
    Distant source, such as the sun or the sky, whose directions are the same everywhere in the scene.

    The rays of a direction fill a disc across it, which covers the sphere around the scene. The rays through a sphere
    around the first aperture are a stratum of their own. That sphere may extend beyond the one around the scene, as at
    a lens at the end of a short system. Rays sampled outside the sphere around the scene carry no light.

    The sphere around the aperture has less than √½ of the radius of the sphere around the scene.
    """

    aims: ClassVar[bool] = True

    def aimed_at(self, aperture: Sphere, lit: Sphere | None = None) -> DistantRays:
        """
        Return a copy with more rays aimed at an aperture; the source itself if the aperture is too large.

        `lit` is ignored.
        """
        return replace(self, aperture=aperture) if aperture.radius < np.sqrt(0.5) * self.scene.radius else self

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """
        Return derivatives of rays with respect to the parameter `name`, see `SceneSource.motion`.

        Rays turn about the middle of the aperture: the light is the same everywhere, and rays move least there.
        """
        pivot = (self.aperture or self.scene).centre
        axes = [mi.Vector3d(*axis.tolist()) for axis in self._axes]
        by_d = turned(self.emitter.direction_motion(name, mi.Vector3d(*(dr.dot(d, axis) for axis in axes))), axes)
        turn = dr.cross(d, by_d)
        return dr.cross(turn, o - mi.Vector3d(*pivot.tolist())), by_d

    @property
    def middle(self) -> tuple[np.ndarray, np.ndarray]:
        """Ray along the axis through the middle of the disc: origin, mm, and unit direction, (1, 3) float64 each."""
        return self.through(np.zeros(1), np.zeros(1))

    def start(self, lane: mi.UInt32, batch: mi.UInt32, rays: int, rng: mi.PCG32, centre: np.ndarray) -> Emission:
        """Return the start rays of one pass: origins, mm, unit directions, relative flux; see `SceneSource.start`."""
        # Where batches have a single ray, the stratum of the aperture would get none
        if self.aperture is not None and rays < 2 * BATCHES:
            return replace(self, aperture=None).start(lane, batch, rays, rng, centre)
        strata = Strata(batch, (1.0,) if self.aperture is None else AIMED)
        sample = stratified_points(strata.group, rng)
        within = None if self.aperture is None else strata.number == 0
        o, d, light = self._rays(sample, mi.Point2f(rng.next_float32(), rng.next_float32()), rng, within)
        # Weight of a stratum: its share of the light over its share of the rays; in a small batch one may have no rays
        share = dr.select(within, strata.parts[0], strata.parts[1]) if within is not None else None
        w = None if share is None else strata.closed(light / share, strata.number, len(AIMED))
        o -= opaque(mi.Vector3d, centre)
        return Emission(mi.Vector3f(o), dr.normalize(mi.Vector3f(d)), w)

    def probes(self, sample: mi.Point2f) -> tuple[np.ndarray, np.ndarray]:
        """Return probe rays to the aperture, or else to the scene: origins, mm, and unit directions, (n, 3) each."""
        rng = mi.PCG32(size=dr.width(sample))
        within = None if self.aperture is None else mi.Bool(True)
        o, d, _ = self._rays(sample, mi.Point2f(rng.next_float32(), rng.next_float32()), rng, within)
        return on_host(o, d)

    def _rays(
        self, sample: mi.Point2f, towards: mi.Point2f, rng: mi.PCG32, within: mi.Bool | None
    ) -> tuple[mi.Vector3d, mi.Vector3d, mi.Float64]:
        """
        Return for each ray its origin, mm, unit direction, and the fraction of light for which its stratum stands.

        `sample` and `towards` are random points of the unit square, which choose the place on the disc and the
        direction. Rays `within` are aimed at the aperture, the others miss it; None: there is one stratum, with the
        fraction 1. It is 0 where an aimed ray starts outside the disc.
        """
        # Directions of the plugin
        local = self.emitter.directions(mi.Point2d(towards), self._numbers(mi.Float64))
        d = dr.zeros(mi.Vector3d, dr.width(sample)) + turned(local, self._device_axes)
        u, v = across(d)
        # Positions on the disc across the direction
        outer = dr.opaque(mi.Float64, self.scene.radius)
        point, light = self._on_disc(mi.Point2d(sample)) * outer, mi.Float64(1)
        if within is not None and self.aperture is not None:
            offset = opaque(mi.Vector3d, self.aperture.centre - self.scene.centre)
            aside = mi.Point2d(dr.dot(offset, u), dr.dot(offset, v))
            inner = dr.opaque(mi.Float64, self.aperture.radius)
            aimed = aside + point * (inner / outer)
            # Rejection sampling: at least half of the disc lies outside the aperture, by the limit on its radius
            point, _ = dr.while_loop(
                (point, rng),
                lambda point, rng: ~within & (dr.squared_norm(point - aside) < inner * inner),
                lambda point, rng: (self._on_disc(mi.Point2d(rng.next_float32(), rng.next_float32())) * outer, rng),
                labels=("point", "rng"),
            )
            point = dr.select(within, aimed, point)
            # Shares of both strata, by the areas of the discs and of their intersection
            whole = outer * outer
            passing = 1 - _common_area(dr.norm(aside), inner, outer) / (dr.pi * whole)
            light = dr.select(within, dr.select(dr.squared_norm(point) < whole, inner * inner / whole, 0), passing)
        middle = opaque(mi.Vector3d, self.scene.centre)
        return middle + point.x * u + point.y * v - CLEARANCE * outer * d, d, light

    @staticmethod
    def _on_disc(sample: mi.Point2d) -> mi.Point2d:
        """Return points of the unit disc, uniform for uniform points of the unit square."""
        square, cosine, sine = polar(sample)
        radius = dr.sqrt(square)
        return mi.Point2d(radius * cosine, radius * sine)


def _common_area(apart: mi.Float64, small: mi.Float64, large: mi.Float64) -> mi.Float64:
    """Return the area, mm², that two discs share, of radii `small` and `large` and centres `apart`, all in mm."""
    d = dr.clip(apart, large - small, large + small)  # below it the small disc lies within the large one
    sides = [(d * d + a * a - b * b) / (2 * d) for a, b in ((small, large), (large, small))]
    segments = zip((small, large), sides, strict=True)
    return sum(r * r * dr.safe_acos(x / r) - x * dr.safe_sqrt(r * r - x * x) for r, x in segments)
