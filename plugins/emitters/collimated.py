"""Plugin `collimated`: a parallel beam with a given cross-section, field angle and wavelengths."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.param import documented, fixed, take
from mistray.plugins.emitters.light_source import LIGHT, LightSource
from mistray.ranges import POSITIVE, RADIUS_MM, SIZE_MM, Words
from mistray.sampling.beam import Beam
from mistray.sampling.source import SourceRequest
from mistray.surfaces.host_points import box_corners

STOCK_DISTANCE = 100.0  # start of the beam for Mitsuba's own integrators, in units of its size


@documented
class Collimated(LightSource):
    r"""
    Collimated beam (:monosp:`collimated`): light of a star, the sun or a laser, as in TracePro's grid source.

    The light travels along Rz(``azimuth_deg``) · (0, sin θ, cos θ) with θ = ``field_deg``, in the frame of
    ``to_world``. The axis of the beam passes through the origin of that frame, the *pivot*. It is usually the centre of
    the stop or of the entrance pupil. The rays start outside the scene unless ``distance`` is given.

    .. parameters::

    With ``plane="axis"`` the flux is irradiance · area · cos θ. A ``grid`` is an equal-area map of a square grid
    onto the cross-section; standard errors are then those of random positions, an upper bound.

    For Mitsuba's own integrators the beam has one direction. ``path`` and ``direct`` render surfaces that it lights
    without glass between, and ``ptracer`` also those that it lights through glass. None connects a camera or a detector
    to the beam itself. They start it 100 times its size upstream of the pivot unless ``distance`` is given.

    .. code-block:: xml

        <emitter type="collimated">
            <float name="radius" value="1.252"/>
            <float name="field_deg" value="10"/>
        </emitter>

    .. code-block:: python

        {"type": "collimated", "radius": 12.5, "field_deg": 3.0, "wavelength_nm": 546.1}
    """

    properties = {
        "radius": fixed("mm", SIZE_MM, "radius of a circular beam"),
        "inner_radius": fixed("mm", RADIUS_MM, "radius of its unlit centre", 0.0),
        "half_width": fixed("mm", SIZE_MM, "half width in x of a rectangular beam instead", otherwise="none"),
        "half_height": fixed("mm", SIZE_MM, "half height in y of a rectangular beam", otherwise="none"),
        "plane": fixed(
            "string",
            Words(("beam", "axis")),
            "plane of the cross-section: normal to the ``beam``, or to the local z ``axis`` through the pivot",
            "beam",
        ),
        "irradiance": fixed("W/mm²", POSITIVE, "irradiance on a plane normal to the beam", 1.0),
        "distance": fixed("mm", RADIUS_MM, "distance from the pivot upstream to the start; 0: automatic", 0.0),
        "pattern": fixed("string", Words(("random", "grid")), "positions of the rays in the cross-section", "random"),
        "pupil_area": fixed(
            "mm²",
            POSITIVE,
            "part of the cross-section whose light counts as launched in transmissions, see docs/import.md; by default "
            "all of it",
            None,
        ),
        **LIGHT,
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = +mi.EmitterFlags.DeltaDirection
        self.irradiance, self.distance = take(self, props, "irradiance"), take(self, props, "distance")
        self.plane, self.pattern = take(self, props, "plane"), take(self, props, "pattern")
        self.rectangular = "half_width" in props or "half_height" in props
        sizes = ("half_width", "half_height") if self.rectangular else ("radius", "inner_radius")
        self.size = take(self, props, sizes[0]), take(self, props, sizes[1])
        if self.rectangular and ("radius" in props):
            self._fail("give radius or half_width and half_height, not both")
        a, b = self.size
        if not self.rectangular and not b < a:
            self._fail(f"inner_radius is {b:g} mm; it must lie between 0 and radius = {a:g} mm")
        self.pupil_area = take(self, props, "pupil_area") or self.area

    @property
    def area(self) -> float:
        """Area of the cross-section in its own plane, mm²."""
        a, b = self.size
        return 4 * a * b if self.rectangular else float(np.pi * (a * a - b * b))

    @property
    def pupil_share(self) -> float:
        """Fraction of the beam's light that counts as launched in relative results, 0 … 1."""
        return min(self.pupil_area / self.area, 1.0)

    def power(self, field_deg: float | None = None) -> float:
        """Return the flux of the beam, W, at a field angle, degrees; None: its own."""
        theta = np.radians(self.field_deg if field_deg is None else field_deg)
        return float(self.irradiance * self.area * (np.cos(theta) if self.plane == "axis" else 1.0))

    def frame(self, field_deg: float | None = None, azimuth_deg: float | None = None) -> tuple[np.ndarray, ...]:
        """
        Return the beam at a field angle and azimuth, degrees, in world coordinates; None: those of the source.

        Returns
        -------
        pivot, direction, u, v : (3,) float64
            Pivot, mm; unit vector along which the light travels; unit vectors u and v that span the plane of the
            cross-section.
        """
        pivot, direction, u, v = super().frame(field_deg, azimuth_deg)
        if self.plane == "axis":
            v = super().frame(0.0, azimuth_deg)[3]
        return pivot, direction, u, v

    def source(self, request: SourceRequest, **facts: Any) -> Beam:
        """Return the beam as the start ray source of a trace at one wavelength, see `LightSource.source`."""
        return Beam(distance=self.start_distance(request.bounds, facts["direction"], facts["pivot"]), **facts)

    def positions(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Return coordinates along u and v, mm, by an equal-area map of the unit square to the cross-section."""
        # Opaque, so that a beam of another size compiles no other kernel
        a, b = (dr.opaque(mi.Float, size) for size in self.size)
        if self.rectangular:
            return a * (2 * sample.x - 1), b * (2 * sample.y - 1)
        disk = mi.warp.square_to_uniform_disk_concentric(sample)
        if self.size[1] == 0:
            return a * disk.x, a * disk.y
        r2 = dr.squared_norm(disk)
        ring = dr.opaque(mi.Float, self.size[0] ** 2 - self.size[1] ** 2)
        scale = dr.sqrt((b * b + r2 * ring) / dr.maximum(r2, 1e-12))
        return scale * disk.x, scale * disk.y

    def start_distance(self, bbox: mi.ScalarBoundingBox3f, direction: np.ndarray, pivot: np.ndarray) -> float:
        """
        Return the distance from the pivot upstream, mm, to the start of the rays: `distance` if it is given.

        The beam goes along the unit vector `direction` through `pivot`, mm. Without `distance`, a plane across it at
        the start clears the scene's bounding box. Raise `MistrayError` for a scene without shapes.
        """
        if self.distance > 0:
            return self.distance
        if not bbox.valid():
            raise MistrayError("the scene holds no shapes; add surfaces and a detector")
        corners = box_corners([bbox])
        upstream = float(np.max((pivot - corners) @ direction))
        return max(upstream, 0.0) + 1e-3 * float(np.linalg.norm(corners[-1] - corners[0]))

    # Mitsuba's own protocol, for its particle tracer

    def sample_ray(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f, active: mi.Mask = True
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        pivot, direction, u, v = self.frame()
        start = pivot - self._stock_distance * direction
        x, y = self.positions(sample2)
        ray = dr.zeros(mi.Ray3f, dr.width(sample2))
        ray.o = mi.Point3f(*start.tolist()) + mi.Vector3f(*u.tolist()) * x + mi.Vector3f(*v.tolist()) * y
        ray.d = mi.Vector3f(*direction.tolist())
        ray.maxt = dr.largest(mi.Float)
        ray.time = time
        return ray, mi.Spectrum(self.power())

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Mask = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """
        Return, for Mitsuba's integrators, a sample of the direction against the beam, and its irradiance, W/mm².

        The irradiance is that across the beam at the point of `it`, and 0 outside the beam.
        """
        pivot, direction, u, v = self.frame()
        normal = np.cross(u, v)
        d, n = mi.Vector3f(*direction.tolist()), mi.Normal3f(*normal.tolist())
        offset = it.p - mi.Point3f(*pivot.tolist())
        along = dr.dot(offset, n) / float(normal @ direction)  # from the cross-section at the pivot
        q = offset - along * d
        x, y = dr.dot(q, mi.Vector3f(*u.tolist())), dr.dot(q, mi.Vector3f(*v.tolist()))
        dist = along + self._stock_distance
        lit = mi.Mask(active) & self.within(x, y) & (dist > 0)
        ds = dr.zeros(mi.DirectionSample3f, dr.width(it))
        ds.p, ds.n, ds.d, ds.dist = it.p - dist * d, mi.Normal3f(d), -d, dist
        ds.time, ds.pdf, ds.delta, ds.emitter = it.time, dr.select(lit, mi.Float(1), 0), True, mi.EmitterPtr(self)
        return ds, dr.select(lit, mi.Spectrum(self.irradiance), 0)

    def within(self, x: mi.Float, y: mi.Float) -> mi.Mask:
        """Return a mask of coordinates along u and v, mm, that lie in the beam's cross-section."""
        a, b = (dr.opaque(mi.Float, size if self.rectangular else size**2) for size in self.size)
        if self.rectangular:
            return (dr.abs(x) <= a) & (dr.abs(y) <= b)
        r2 = x * x + y * y
        return (r2 <= a) & (r2 >= b)

    @property
    def _stock_distance(self) -> float:
        """Distance from the pivot upstream to the start of the beam, mm, for Mitsuba's own integrators."""
        return self.distance or STOCK_DISTANCE * max(self.size)


mi.register_emitter("collimated", lambda props: Collimated(props))
