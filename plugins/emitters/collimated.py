"""Plugin `collimated`: a parallel beam with a given cross-section, field angle and wavelengths."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.plugins.emitters.light_source import LightSource
from mistray.ranges import POSITIVE, RADIUS_MM, SIZE_MM, Range
from mistray.sampling.beam import Beam
from mistray.sampling.source import SourceRequest
from mistray.surfaces.host_points import box_corners

STOCK_DISTANCE = 100.0  # start of the beam for Mitsuba's own integrators, in units of its size


class Collimated(LightSource):
    r"""
    Collimated beam (:monosp:`collimated`): light of a star, the sun or a laser, as in TracePro's grid source.

    The light travels along Rz(``azimuth_deg``) · (0, sin θ, cos θ) with θ = ``field_deg``, in the frame of
    ``to_world``. The axis of the beam passes through the origin of that frame, the *pivot*. It is usually the centre of
    the stop or of the entrance pupil. The rays start outside the scene unless ``distance`` is given.

    =================== ========= =================== ========= ===================================================
    parameter           unit      range               default   meaning
    =================== ========= =================== ========= ===================================================
    radius              mm        > 0                 required  radius of a circular beam
    inner_radius        mm        ≥ 0                 0         radius of its unlit centre
    half_width          mm        > 0                 none      half width in x of a rectangular beam instead
    half_height         mm        > 0                 none      half height in y of a rectangular beam
    plane               string    beam, axis          beam      plane of the cross-section: normal to the ``beam``,
                                                                or to the local z ``axis`` through the pivot
    field_deg           degree    -90 < … < 90        0         angle from the local z axis
    azimuth_deg         degree                        0         azimuth of the beam about z, from +y towards -x
    irradiance          W/mm²     > 0                 1         irradiance on a plane normal to the beam
    wavelength_nm       nm        > 0                 550       one value or a list, "486.1, 587.6, 656.3"
    weights             1         ≥ 0                 equal     one weight for each wavelength; normalised
    spectrum            string    see docs/sources.md none      spectrum instead of wavelength_nm: lines "F d C",
                                                                blackbody:3000, am0, d65 or a .csv file
    band_nm             nm        two, rising         400, 700  traced band of a continuous spectrum; by default 400 to
                                                                700 nm, or all of a table
    bands               1         1 … 200             6         number of equal parts in which the band is traced
    stokes              1         degree ≤ 1          none      polarised light, "s1, s2, s3" over S0; or ``jones``,
                                                                "ex, ey"; or ``polarization_deg``, linear at an angle:
                                                                see docs/polarization.md
    distance            mm        ≥ 0                 0         distance from the pivot upstream to the start; 0:
                                                                automatic
    pattern             string    random, grid        random    positions of the rays in the cross-section
    pupil_area          mm²       > 0                 none      part of the cross-section whose light counts as
                                                                launched in transmissions, see docs/import.md; by
                                                                default all of it
    to_world            mm        rigid               identity  the pivot and the axis
    =================== ========= =================== ========= ===================================================

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

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = +mi.EmitterFlags.DeltaDirection

        def number(key: str, within: Range, default: float = 0.0) -> float:
            return self._number(props, key, within, default)

        self.irradiance = number("irradiance", POSITIVE, 1.0)
        self.distance = number("distance", RADIUS_MM)
        self.plane = str(props.get("plane", "beam"))
        self.pattern = str(props.get("pattern", "random"))
        self.rectangular = "half_width" in props or "half_height" in props
        if self.rectangular:
            self.size = (number("half_width", SIZE_MM), number("half_height", SIZE_MM))
        else:
            self.size = (number("radius", SIZE_MM), number("inner_radius", RADIUS_MM))
        if self.rectangular and ("radius" in props):
            self._fail("give radius or half_width and half_height, not both")
        a, b = self.size
        if not self.rectangular and not b < a:
            self._fail(f"inner_radius is {b:g} mm; it must lie between 0 and radius = {a:g} mm")
        self.pupil_area = number("pupil_area", POSITIVE) if "pupil_area" in props else self.area
        if self.plane not in ("beam", "axis"):
            self._fail(f"plane is '{self.plane}'; use 'beam' or 'axis'")
        if self.pattern not in ("random", "grid"):
            self._fail(f"pattern is '{self.pattern}'; use 'random' or 'grid'")

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
        """Return the flux of the beam, W, at its own field angle or another one, degrees."""
        theta = np.radians(self.field_deg if field_deg is None else field_deg)
        return float(self.irradiance * self.area * (np.cos(theta) if self.plane == "axis" else 1.0))

    def frame(self, field_deg: float | None = None, azimuth_deg: float | None = None) -> tuple[np.ndarray, ...]:
        """
        Return the beam in world coordinates, float64.

        Returns
        -------
        pivot, direction, u, v : (3,) float
            Pivot, mm; unit vector along the beam; and vectors u and v that span the plane of the cross-section.
        """
        pivot, direction, u, v = super().frame(field_deg, azimuth_deg)
        if self.plane == "axis":
            v = super().frame(0.0, azimuth_deg)[3]
        return pivot, direction, u, v

    def source(self, request: SourceRequest, **facts: Any) -> Beam:
        """Return the beam as the source of a trace at one wavelength."""
        return Beam(distance=self.start_distance(request.bounds, facts["direction"], facts["pivot"]), **facts)

    def positions(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Return coordinates along u and v, mm, by an equal-area map of the unit square to the cross-section."""
        a, b = self.size
        if self.rectangular:
            return a * (2 * sample.x - 1), b * (2 * sample.y - 1)
        disk = mi.warp.square_to_uniform_disk_concentric(sample)
        if b == 0:
            return a * disk.x, a * disk.y
        r2 = dr.squared_norm(disk)
        scale = dr.sqrt((b * b + r2 * (a * a - b * b)) / dr.maximum(r2, 1e-12))
        return scale * disk.x, scale * disk.y

    def start_distance(self, bbox: mi.ScalarBoundingBox3f, direction: np.ndarray, pivot: np.ndarray) -> float:
        """Return the distance upstream of the pivot, mm, at which a plane across the beam clears the bounding box."""
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
        """Return the direction from which the beam lights a point, and its irradiance there; 0 outside the beam."""
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
        """Return whether coordinates along u and v, mm, lie in the cross-section."""
        a, b = self.size
        if self.rectangular:
            return (dr.abs(x) <= a) & (dr.abs(y) <= b)
        r2 = x * x + y * y
        return (r2 <= a * a) & (r2 >= b * b)

    @property
    def _stock_distance(self) -> float:
        """Distance from the pivot upstream to the start of the beam, mm, for Mitsuba's own integrators."""
        return self.distance or STOCK_DISTANCE * max(self.size)


mi.register_emitter("collimated", lambda props: Collimated(props))
