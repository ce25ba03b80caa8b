"""Plugin `collimated`: a parallel beam of given cross-section, field angle and wavelengths."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, POSITIVE, RADIUS_MM, SIZE_MM, WAVELENGTH_NM, WEIGHT, Range
from mistray.surfaces.host_points import box_corners

STOCK_DISTANCE = 100.0  # start of the beam for stock integrators, in units of its size


class Collimated(mi.Emitter):
    r"""
    Collimated beam (:monosp:`collimated`): a star, the sun or a laser, as in TracePro's grid source.

    The light travels along Rz(``azimuth_deg``) · (0, sin θ, cos θ) with θ = ``field_deg``, in the frame of
    ``to_world``, and the axis of the beam passes through the origin of that frame, the *pivot* (usually the
    centre of the stop or of the entrance pupil). The rays start outside of the scene unless ``distance`` is
    given.

    =================== ========= =================== ========= ===================================================
    parameter           unit      range               default   meaning
    =================== ========= =================== ========= ===================================================
    radius              mm        > 0                 required  radius of a circular beam
    inner_radius        mm        ≥ 0                 0         radius of its unlit centre
    half_width          mm        > 0                 none      rectangular beam instead: half its size in x
    half_height         mm        > 0                 none      half its size in y
    plane               string    beam, axis          beam      plane of the cross-section: normal to the ``beam``,
                                                                or to the local z ``axis`` through the pivot
    field_deg           degree    -90 < … < 90        0         angle from the local z axis
    azimuth_deg         degree                        0         azimuth of the beam about z, from +y towards -x
    irradiance          W/mm²     > 0                 1         on a plane normal to the beam
    wavelength_nm       nm        > 0                 550       one value or a list, "486.1, 587.6, 656.3"
    weights             1         ≥ 0                 equal     one weight for each wavelength; normalised
    distance            mm        ≥ 0                 0         from the pivot upstream to the start; 0: automatic
    pattern             string    random, grid        random    positions of the rays in the cross-section
    to_world            mm        rigid               identity  the pivot and the axis
    =================== ========= =================== ========= ===================================================

    With ``plane="axis"`` the flux is irradiance · area · cos θ. A ``grid`` is an equal-area map of a square grid
    onto the cross-section; standard errors are then those of random positions, an upper bound.

    To stock integrators the beam has one direction, so that ``path`` and ``direct`` render what it lights in the open
    and ``ptracer`` what it lights through glass as well, but none connects a camera or a detector to the beam itself.
    They start it 100 times its size upstream of the pivot unless ``distance`` is given.

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
        self.name = str(props.id())
        owner = f"source '{self.name}'"

        def number(key: str, within: Range, default: float = 0.0) -> float:
            return float(within.check(key, props.get(key, default), owner))

        self.field_deg = number("field_deg", FIELD_DEG)
        self.azimuth_deg = number("azimuth_deg", AZIMUTH_DEG)
        self.irradiance = number("irradiance", POSITIVE, 1.0)
        self.distance = number("distance", RADIUS_MM)
        self.plane = str(props.get("plane", "beam"))
        self.pattern = str(props.get("pattern", "random"))
        self.matrix = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix, dtype=np.float64).reshape(4, 4)
        self.wavelengths_nm = _numbers(owner, "wavelength_nm", props.get("wavelength_nm", 550.0), WAVELENGTH_NM)
        weights = props.get("weights", None)
        self.weights = (
            np.ones(len(self.wavelengths_nm)) if weights is None else _numbers(owner, "weights", weights, WEIGHT)
        )
        self.rectangular = "half_width" in props or "half_height" in props
        if self.rectangular:
            self.size = (number("half_width", SIZE_MM), number("half_height", SIZE_MM))
        else:
            self.size = (number("radius", SIZE_MM), number("inner_radius", RADIUS_MM))
        if self.rectangular and ("radius" in props):
            raise MistrayError(f"source '{self.name}': give radius or half_width and half_height, not both")
        self._check()
        self.weights = self.weights / self.weights.sum()

    def _check(self) -> None:
        def fail(what: str) -> None:
            raise MistrayError(f"source '{self.name}': {what}")

        rotation = self.matrix[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5) or np.linalg.det(rotation) < 0:
            fail("to_world scales, shears or mirrors; use a rigid motion and set the size by radius or half widths")
        a, b = self.size
        if not self.rectangular and not b < a:
            fail(f"inner_radius is {b:g} mm; it must lie between 0 and radius = {a:g} mm")
        if self.plane not in ("beam", "axis"):
            fail(f"plane is '{self.plane}'; use 'beam' or 'axis'")
        if self.pattern not in ("random", "grid"):
            fail(f"pattern is '{self.pattern}'; use 'random' or 'grid'")
        if len(self.weights) != len(self.wavelengths_nm) or not self.weights.sum() > 0:
            fail(f"weights needs {len(self.wavelengths_nm)} values that are not all 0; give one for each wavelength")

    @property
    def area(self) -> float:
        """Area of the cross-section in its own plane, mm²."""
        a, b = self.size
        return 4 * a * b if self.rectangular else float(np.pi * (a * a - b * b))

    def power(self, field_deg: float | None = None) -> float:
        """Flux of the beam, W."""
        theta = np.radians(self.field_deg if field_deg is None else field_deg)
        return float(self.irradiance * self.area * (np.cos(theta) if self.plane == "axis" else 1.0))

    def frame(self, field_deg: float | None = None, azimuth_deg: float | None = None) -> tuple[np.ndarray, ...]:
        """
        Beam in world coordinates, float64.

        Returns
        -------
        pivot, direction, u, v : (3,) float
            u and v span the plane of the cross-section, mm; direction is a unit vector.
        """
        theta = np.radians(self.field_deg if field_deg is None else field_deg)
        phi = np.radians(self.azimuth_deg if azimuth_deg is None else azimuth_deg)
        c, s = np.cos(phi), np.sin(phi)
        spin = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        direction = spin @ [0.0, np.sin(theta), np.cos(theta)]
        u = spin @ [1.0, 0.0, 0.0]
        v = spin @ ([0.0, np.cos(theta), -np.sin(theta)] if self.plane == "beam" else [0.0, 1.0, 0.0])
        rotation = self.matrix[:3, :3]
        return self.matrix[:3, 3], rotation @ direction, rotation @ u, rotation @ v

    def positions(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Equal-area map of the unit square to the cross-section: coordinates along u and v, mm."""
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
        """Distance upstream of the pivot at which a plane normal to the beam clears the bounding box, mm."""
        if self.distance > 0:
            return self.distance
        if not bbox.valid():
            raise MistrayError("the scene holds no shapes; add surfaces and a detector")
        corners = box_corners([bbox])
        upstream = float(np.max((pivot - corners) @ direction))
        return max(upstream, 0.0) + 1e-3 * float(np.linalg.norm(corners[-1] - corners[0]))

    # Mitsuba's own protocol, so that a stock particle tracer can use the beam

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

    def sample_position(
        self, time: mi.Float, sample: mi.Point2f, active: mi.Mask = True
    ) -> tuple[mi.PositionSample3f, mi.Float]:
        # The beam comes from infinitely far away: no camera sees it
        return dr.zeros(mi.PositionSample3f, dr.width(sample)), mi.Float(0)

    def sample_wavelengths(  # type: ignore[no-untyped-def]
        self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Mask = True
    ):
        # Mitsuba's RGB and mono variants carry no wavelength; the spectral ones get the first of the beam
        wavelengths = dr.zeros(type(si.wavelengths), dr.width(sample))
        if mi.is_spectral:
            wavelengths += float(self.wavelengths_nm[0])
        return wavelengths, mi.Spectrum(self.power())

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Mask = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """The one direction from which the beam lights a point, and its irradiance there; 0 outside of the beam."""
        pivot, direction, u, v = self.frame()
        normal = np.cross(u, v)
        d, n = mi.Vector3f(*direction.tolist()), mi.Normal3f(*normal.tolist())
        offset = it.p - mi.Point3f(*pivot.tolist())
        along = dr.dot(offset, n) / float(normal @ direction)  # from the cross-section at the pivot
        q = offset - along * d
        x, y = dr.dot(q, mi.Vector3f(*u.tolist())), dr.dot(q, mi.Vector3f(*v.tolist()))
        dist = along + self._stock_distance
        lit = mi.Mask(active) & self._within(x, y) & (dist > 0)
        ds = dr.zeros(mi.DirectionSample3f, dr.width(it))
        ds.p, ds.n, ds.d, ds.dist = it.p - dist * d, mi.Normal3f(d), -d, dist
        ds.time, ds.pdf, ds.delta, ds.emitter = it.time, dr.select(lit, mi.Float(1), 0), True, mi.EmitterPtr(self)
        return ds, dr.select(lit, mi.Spectrum(self.irradiance), 0)

    def _within(self, x: mi.Float, y: mi.Float) -> mi.Mask:
        """Whether coordinates along u and v lie in the cross-section."""
        a, b = self.size
        if self.rectangular:
            return (dr.abs(x) <= a) & (dr.abs(y) <= b)
        r2 = x * x + y * y
        return (r2 <= a * a) & (r2 >= b * b)

    @property
    def _stock_distance(self) -> float:
        """From the pivot upstream to the start, mm, where stock integrators trace the beam."""
        return self.distance or STOCK_DISTANCE * max(self.size)

    def pdf_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Mask = True) -> mi.Float:
        return mi.Float(0)

    def eval_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Mask = True) -> mi.Spectrum:
        return mi.Spectrum(0)

    def pdf_position(self, ps: mi.PositionSample3f, active: mi.Mask = True) -> mi.Float:
        return mi.Float(0)

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Mask = True) -> mi.Spectrum:
        return mi.Spectrum(0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return mi.ScalarBoundingBox3f()

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Nothing here is a Dr.Jit variable: field angle and size are arguments of a trace."""

    def to_string(self) -> str:
        wavelengths = ", ".join(f"{value:g}" for value in self.wavelengths_nm)
        return f"Collimated[field = {self.field_deg:g} deg, {self.power():g} W, {wavelengths} nm]"


def _numbers(owner: str, key: str, value: object, within: Range) -> np.ndarray:
    try:
        found = [float(part) for part in str(value).replace(",", " ").split()]
    except ValueError:
        raise MistrayError(f"{owner}: {key} is '{value}'; give one number or a list separated by commas") from None
    return np.array([within.check(key, number, owner) for number in found], dtype=np.float64)


mi.register_emitter("collimated", lambda props: Collimated(props))
