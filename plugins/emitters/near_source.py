"""Base classes of sources with a position: a point, a surface, a fibre end, the waist of a laser beam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.files.intensities import CANDELA, read_intensities
from mistray.param import Param, fixed, take
from mistray.plugins.emitters.light_source import LIGHT, TILT, LightSource, out_of, tilt_motion, tilted_axes
from mistray.ranges import PLACE_MM, POSITIVE, TEXT
from mistray.sampling import emission_laws as laws
from mistray.sampling.emission_laws import perimeter

MIDDLE = Param("mm", PLACE_MM, "position of its middle", default=0.0, absolute=0.1)
PLACE = {**dict.fromkeys(("x", "y", "z"), MIDDLE), "tilt_x": TILT, "tilt_y": TILT}
POWER = fixed("W", POSITIVE, "flux of all its light", 1.0)
MOST_ASTRAY = 0.01  # fraction of the light's half angle; with a larger error of the axis a warning is given


class NearSource(LightSource):
    """
    Source whose rays start from the plane z = 0 of its own frame.

    This frame is that of ``to_world``, rotated by ``field_deg`` and ``azimuth_deg`` about its origin, or displaced
    across its z axis if the source is `in_object_plane`. Then it is displaced by ``x``, ``y``, ``z`` along its axes,
    and tilted by ``tilt_x``, ``tilt_y``. A subclass defines `local` and `local_motion` instead of `rays` and `motion`,
    and its flux.

    Attributes
    ----------
    densities : tuple of str
        Names of quantities that may give its flux, instead of ``power``, such as ``radiance``.
    given : tuple of (str, float)
        Quantity that gives its flux, and its value, of ``power`` in W, else in the unit of its property.
    in_object_plane : bool
        Whether a field angle displaces it in the plane of its ``z``, as an object of a lens, instead of rotating it.
    """

    in_object_plane: ClassVar[bool] = False
    precise = True
    densities: ClassVar[tuple[str, ...]] = ()

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.given = self._flux_given(props, ("power", *self.densities))

    @property
    def half_angle(self) -> float:
        """Half angle of the emitted cone, rad; for light that fades out, at 1/e² across the narrower section."""
        raise NotImplementedError

    def advice(self) -> str | None:
        """Return a remark if the light's cone is too narrow for the precision of its frame; None otherwise."""
        if self.pointing_error <= MOST_ASTRAY * self.half_angle:
            return None
        return (
            f"{self.owner}: to_world is in single precision, which gives the axis to {self.pointing_error:.0e} rad, "
            f"{100 * self.pointing_error / self.half_angle:.0f} % of the half angle of the light; use "
            "ScalarTransform4d or tilt_x and tilt_y"
        )

    def power_per(self, density: str) -> float:
        """Return the flux, W, that corresponds to 1 unit of `density`, one of `densities`."""
        raise NotImplementedError

    def frame(self, field_deg: float | None = None, azimuth_deg: float | None = None) -> tuple[np.ndarray, ...]:
        """Return the position and axes of the source at a field angle, see `LightSource.frame`."""
        z = self.values["z"]
        if not self.in_object_plane or z == 0:
            return super().frame(field_deg, azimuth_deg)
        theta = np.radians(self.field_deg if field_deg is None else field_deg)
        phi = np.radians(self.azimuth_deg if azimuth_deg is None else azimuth_deg)
        shift = z * np.tan(theta) * np.array([-np.sin(phi), np.cos(phi), 0.0])
        pivot, direction, u, v = super().frame(0.0, 0.0)
        return pivot + self.matrix[:3, :3] @ shift, direction, u, v

    def field_of(self, height_mm: float) -> float:
        """
        Return the field angle, degrees, that displaces the source by a height, mm, along y of its frame.

        Raise `MistrayError` if a field angle does not displace the source.
        """
        z = self.values["z"]
        if not self.in_object_plane or z == 0:
            self._fail("a field in mm needs an object plane at z other than 0; give it in degrees")
        return float(np.degrees(np.arctan(height_mm / z))) + 0.0

    def power(self, field_deg: float | None = None) -> float:
        """Return the emitted flux, W, which is equal at all field angles."""
        key, value = self.given
        return value if key == "power" else value * self.power_per(key)

    def local(
        self, place: mi.Point2d, sample: mi.Point2d, rng: mi.PCG32, n: Mapping[str, mi.Float64]
    ) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Return ray origins, mm, with z = 0, and directions in the source's own frame, see `LightSource.rays_from`."""
        raise NotImplementedError

    def local_motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """
        Return the derivatives of ray origins, mm, and directions with respect to the parameter `name` of the source.

        Origins, with z = 0, and directions are in the source's own frame.
        """
        raise NotImplementedError

    def rays_from(
        self, place: mi.Point2d, sample: mi.Point2d, rng: mi.PCG32, n: Mapping[str, mi.Float64]
    ) -> tuple[mi.Vector3d, mi.Vector3d]:
        o, d = self.local(place, sample, rng, n)
        shift = mi.Vector3d(n["x"], n["y"], n["z"])
        axes = tilted_axes(n)
        return shift + out_of(axes, o), out_of(axes, d)

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        if name in "xyz":
            return mi.Vector3d(*(float(name == axis) for axis in "xyz")), mi.Vector3d(0)
        n = self.values
        place, axes = mi.Vector3d(n["x"], n["y"], n["z"]), tilted_axes(n)
        if name in ("tilt_x", "tilt_y"):
            return tilt_motion(name, axes, o - place), tilt_motion(name, axes, d)
        p, heading = ([dr.dot(vector, axis) for axis in axes] for vector in (o - place, d))
        p, heading = mi.Vector3d(*p), mi.Vector3d(*heading)
        t = p.z / heading.z  # rays from far away start anew on their way
        by_p, by_d = self.local_motion(name, p - t * heading, heading)
        return out_of(axes, by_p + t * by_d), out_of(axes, by_d)


CONE = {
    "profile": fixed(
        "string",
        TEXT,
        'intensity against the angle from the axis instead of cosⁿ θ: "0:1, 20:0.9, 25:0", degrees, linear between',
        None,
        within="angle:value, …",
    ),
    "filename": fixed(
        "string",
        TEXT,
        "a measured intensity by direction instead: IES LM-63, .ies, or .csv; see docs/sources.md",
        None,
        within="a file",
    ),
    "power": fixed("W", POSITIVE, "flux of all its light; by default of a file in candela or W/sr its own flux", 1.0),
    **LIGHT,
    "field_deg": replace(
        LIGHT["field_deg"], doc="displacement by z tan(field_deg) along y; at z = 0 rotation by that angle"
    ),
    "azimuth_deg": replace(LIGHT["azimuth_deg"], doc="azimuth of that change about z, from +y towards -x"),
}


class ConeSource(NearSource):
    """
    Near source with an intensity proportional to cosⁿ θ in a cone about its axis, or given by a table.

    Its parameters ``half_angle_deg`` and ``exponent`` define the first, its properties ``profile`` and ``filename`` the
    second. `offset` determines where the rays start.

    Attributes
    ----------
    table : IntensityTable or None
        Measured or given intensity by direction; None for cosⁿ θ.
    """

    in_object_plane = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.table: laws.IntensityTable | None = None
        laws_given = [key for key in ("profile", "filename") if key in props]
        if not laws_given:
            return
        also = [key for key in ("profile", "filename", "half_angle_deg", "exponent") if key in props]
        if len(also) > 1:
            self._fail(f"{' and '.join(also)} are given; give one of them")
        self._keep_parameters(set(self.differentiable) - {"half_angle_deg"})
        if "profile" in props:
            angles, values = self._pairs(take(self, props, "profile"))
            self.table = laws.IntensityTable(angles, np.array([0.0, 360.0]), np.stack([values, values], axis=1))
            return
        try:
            found = read_intensities(str(mi.file_resolver().resolve(take(self, props, "filename"))))
        except MistrayError as error:
            self._fail(str(error))
        self.table = laws.IntensityTable(found.theta_deg, found.phi_deg, found.values)
        if found.unit and not any(key in props for key in ("power", *self.densities)):
            per_watt = self.light.lumens_per_watt if found.unit == CANDELA else 1.0
            if not per_watt > 0:
                self._fail("its file is in candela, and its wavelengths give no lumens; give power")
            self.given = "power", float(POSITIVE.check("power", self.table.flux / per_watt, self.owner))

    def _pairs(self, text: str) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the angles, degrees, and relative intensities, (n,) each, in the string of an intensity profile.

        Raise `MistrayError` if it is not valid.
        """
        try:
            pairs = [[float(word) for word in pair.split(":")] for pair in text.split(",")]
            angles, values = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
        except ValueError:
            self._fail(f"profile is '{text}'; give pairs of an angle and a value, '0:1, 20:0.9, 25:0'")
        rises = len(angles) > 1 and bool(np.all(np.diff(angles) > 0)) and angles[0] >= 0 and angles[-1] <= 180
        if not rises or not np.all((values >= 0) & (values < 1e30)) or not np.any(values > 0):
            self._fail(
                f"profile is '{text}'; let its angles rise within 0 … 180, and give values from 0, not all of them 0"
            )
        return angles, values

    def edge_samples(self, count: int, within: float) -> np.ndarray | None:
        """
        Return points along the edge of its cone, see `LightSource.edge_samples`.

        An extended source has no edge and returns None.
        """
        if self.extended:
            return None
        return perimeter(count, within) if self.table is None else self.table.edge_samples(count, within)

    def offset(self, place: mi.Point2d, n: Mapping[str, mi.Float64]) -> mi.Vector3d:
        """
        Return the start points of rays, mm, in the source's own frame, for points of the unit square.

        In the base class all rays start from the origin.
        """
        return mi.Vector3d(0)

    def offset_motion(self, name: str, o: mi.Vector3d) -> mi.Vector3d:
        """Return the derivatives of start points `o` of `offset`, mm, per unit of the source's parameter `name`."""
        raise NotImplementedError

    def _limit_cone(self, props: mi.Properties, sizes: Sequence[str] = ()) -> None:
        """
        Limit the half angle of the cone to 90° if the exponent is not 0.

        If a density sets the flux, the half angle and the parameters `sizes`, which change it, have no derivatives.
        Raise `MistrayError` if a scene gives a larger half angle, or for another reason of `check`.
        """
        exponent = self.values["exponent"]
        if exponent and "half_angle_deg" not in props:
            self.values["half_angle_deg"] = min(self.values["half_angle_deg"], 90.0)
        self.check()
        if self.given[0] != "power":
            self._keep_parameters(set(self.differentiable) - {"half_angle_deg", *sizes})
        elif self.values["half_angle_deg"] == 90.0 and exponent:
            self._keep_parameters(set(self.differentiable) - {"half_angle_deg"})  # a hemisphere cannot grow

    def check(self) -> None:
        exponent, angle = self.values["exponent"], self.values["half_angle_deg"]
        if exponent and angle > 90:
            self._fail(f"half_angle_deg is {angle:g} with an exponent of {exponent:g}; give at most 90")

    @property
    def half_angle(self) -> float:
        return float(np.radians(self.values["half_angle_deg"]) if self.table is None else self.table.half_angle)

    @property
    def solid_angle(self) -> float:
        """
        Effective solid angle ∫ I dΩ for an intensity of 1 on the axis, sr.

        Raise `MistrayError` if a table is 0 on the axis.
        """
        if self.table is not None:
            if not self.table.on_axis > 0:
                self._fail(f"{self.given[0]} is that on the axis, where its light is 0; give power")
            return self.table.flux / self.table.on_axis
        return laws.cosine_power_angle(self.values["exponent"], float(np.radians(self.values["half_angle_deg"])))

    def local(
        self, place: mi.Point2d, sample: mi.Point2d, rng: mi.PCG32, n: Mapping[str, mi.Float64]
    ) -> tuple[mi.Vector3d, mi.Vector3d]:
        if self.table is not None:
            return self.offset(place, n), self.table.directions(mi.Point2d(sample))
        square, cosine, sine = laws.polar(sample)
        height = laws.cosine_power(square, n["exponent"], laws.cone_height(dr.deg2rad(n["half_angle_deg"])))
        return self.offset(place, n), laws.direction(height, cosine, sine)

    def density(self, place: mi.Point2d, d: mi.Vector3d, n: Mapping[str, mi.Float64]) -> mi.Float64:
        """Return the pdf, 1/sr, of emission directions d, unit vectors in the frame of the source before the tilts."""
        local = mi.Vector3d(*(dr.dot(d, axis) for axis in tilted_axes(n)))
        if self.table is not None:
            return self.table.density(local)
        height, edge = laws.height_of(local), laws.cone_height(dr.deg2rad(n["half_angle_deg"]))
        law = dr.exp(n["exponent"] * laws.log_cosine(height))
        return dr.select(height <= edge, law / dr.opaque(mi.Float64, self.solid_angle), 0)

    def local_motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        if name != "half_angle_deg":
            return self.offset_motion(name, o), mi.Vector3d(0)
        # A ray keeps its fraction u of the flux within its angle θ, u = (1 - cosⁿ⁺¹ θ) / (1 - cosⁿ⁺¹ α)
        exponent, half_angle = self.values["exponent"], float(np.radians(self.values["half_angle_deg"]))
        edge, height = float(laws.cone_height(half_angle)), laws.height_of(d)
        across = dr.sqrt(d.x * d.x + d.y * d.y)
        if exponent == 0:
            turn = across / (1 + d.z) / edge
        else:
            ends, at = (mi.Float64(laws.log_cosine(mi.Float64(h))) for h in (edge, height))
            share = laws.rest_of_power((exponent + 1) * at) / laws.rest_of_power((exponent + 1) * ends)
            turn = dr.select(across > 0, share / across, 0) * dr.exp(exponent * (ends - at))
        turn *= np.sin(half_angle) * np.pi / 180
        outward = dr.select(across > 0, mi.Vector2d(d.x, d.y) / across, 0)
        return mi.Vector3d(0), turn * mi.Vector3d(d.z * outward.x, d.z * outward.y, -across)
