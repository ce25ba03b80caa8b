"""Plugin `surface_source`: a flat disc, ring or rectangle that emits light, Lambertian or with another law."""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.plugins.emitters.near_source import MOVES, ConeSource
from mistray.plugins.emitters.point_source import EXPONENT
from mistray.ranges import CONE_DEG, RADIUS_MM, SIZE_MM
from mistray.sampling.emission_laws import polar

SIZES = ("radius", "inner_radius", "half_width", "half_height")


class SurfaceSource(ConeSource):
    r"""
    Flat source (:monosp:`surface_source`): a screen, the chip of an LED, a lit slit, or the end of a fibre.

    It is a disc, a ring or a rectangle in the plane z = 0 of its frame, uniform over its area. Its intensity is
    proportional to cosⁿ θ within a cone about its normal, +z. With n = ``exponent`` = 1 it is Lambertian, with uniform
    radiance in all directions. A step-index fibre is a disc with n = 1 and the half angle of its numerical aperture.

    =================== ========= =================== ========= ===================================================
    parameter           unit      range               default   meaning
    =================== ========= =================== ========= ===================================================
    radius              mm        > 0                 none      radius of a disc (differentiable)
    inner_radius        mm        ≥ 0                 0         radius of its unlit centre
    half_width          mm        > 0                 none      half width of a rectangle in x (differentiable)
    half_height         mm        > 0                 none      half height of it in y (differentiable)
    x, y, z             mm        -1e12 … 1e12        0         position of its centre (differentiable)
    tilt_x, tilt_y      degree                        0         tilts of its normal, which is +z (differentiable)
    half_angle_deg      degree    1e-6 … 90           90        half angle of the cone (differentiable)
    exponent            1         0 … 10000           1         n of cosⁿ θ
    profile             string    angle:value, …      none      intensity against the angle from the normal instead of
                                                                cosⁿ θ: "0:1, 20:0.9, 25:0", degrees, linear between
    filename            string    a file              none      a measured intensity by direction instead: IES LM-63,
                                                                .ies, or .csv; see docs/sources.md
    power               W         > 0                 1         flux; by default of a file in candela or W/sr its own
    radiance            W/mm²/sr  > 0                 none      radiance on the normal, instead of power
    field_deg           degree    -90 < … < 90        0         displacement by z tan(field_deg) along y; at z = 0
                                                                rotation by that angle
    azimuth_deg         degree                        0         azimuth of that change about z, from +y towards -x
    wavelength_nm       nm        > 0                 550       one value or a list
    weights             1         ≥ 0                 equal     one weight for each wavelength; normalised
    spectrum            string    see docs/sources.md none      spectrum instead of wavelength_nm: lines "F d C",
                                                                blackbody:3000, am0, d65 or a .csv file
    band_nm             nm        two, rising         400, 700  traced band of a continuous spectrum; by default 400 to
                                                                700 nm, or all of a table
    bands               1         1 … 200             6         number of equal parts in which the band is traced
    stokes              1         degree ≤ 1          none      polarised light, "s1, s2, s3" over S0; or ``jones``,
                                                                "ex, ey"; or ``polarization_deg``, linear at an angle:
                                                                see docs/polarization.md
    to_world            mm        rigid               identity  the frame
    =================== ========= =================== ========= ===================================================

    If the radiance is given, the flux changes with the sizes and the cone, and these have no derivatives. The source
    has no body: light passes through it. A body that also blocks or scatters light is a shape with Mitsuba's ``area``
    emitter.

    .. code-block:: xml

        <emitter type="surface_source">
            <float name="radius" value="0.1"/>
            <float name="z" value="-20"/>
        </emitter>

    .. code-block:: python

        {"type": "surface_source", "half_width": 5.0, "half_height": 0.01, "z": -80.0, "half_angle_deg": 10.0}
    """

    own_ranges = {
        "radius": RADIUS_MM,
        "inner_radius": RADIUS_MM,
        "half_width": RADIUS_MM,
        "half_height": RADIUS_MM,
        "half_angle_deg": CONE_DEG,
        "exponent": EXPONENT,
    }
    own_defaults = {**dict.fromkeys(SIZES, 0.0), "half_angle_deg": 90.0, "exponent": 1.0}
    densities = ("radiance",)
    differentiable = (*MOVES, "radius", "half_width", "half_height", "half_angle_deg")
    tolerances = {"radius": 0.02, "half_width": 0.02, "half_height": 0.02}
    extended = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.rectangular = "half_width" in props or "half_height" in props
        if self.rectangular == ("radius" in props):
            self._fail("give either radius, or half_width and half_height")
        for key in ("half_width", "half_height") if self.rectangular else ("radius",):
            SIZE_MM.check(key, self.values[key], self.owner)
        if not self.rectangular and not self.values["inner_radius"] < self.values["radius"]:
            self._fail(f"inner_radius is {self.values['inner_radius']:g} mm; it must be less than radius")
        sizes = ("half_width", "half_height") if self.rectangular else ("radius",)
        self._limit_cone(props, sizes)
        self._keep_parameters(set(self.differentiable) - (set(SIZES) - set(sizes)))

    @property
    def area(self) -> float:
        """Area of the source, mm²."""
        n = self.values
        if self.rectangular:
            return 4 * n["half_width"] * n["half_height"]
        return float(np.pi * (n["radius"] ** 2 - n["inner_radius"] ** 2))

    def power_per(self, density: str) -> float:
        """Return the flux, W, for a radiance of 1 W/mm²/sr on the normal."""
        return self.area * self.solid_angle

    def offset(self, place: mi.Point2d, n: Mapping[str, mi.Float64]) -> mi.Vector3d:
        if self.rectangular:
            return mi.Vector3d(n["half_width"] * (2 * place.x - 1), n["half_height"] * (2 * place.y - 1), 0)
        square, cosine, sine = polar(place)
        inner, outer = n["inner_radius"], n["radius"]
        radius = dr.sqrt(inner * inner + square * (outer * outer - inner * inner))
        return mi.Vector3d(radius * cosine, radius * sine, 0)

    def offset_motion(self, name: str, o: mi.Vector3d) -> mi.Vector3d:
        n = self.values
        if name == "half_width":
            return mi.Vector3d(o.x / n["half_width"], 0, 0)
        if name == "half_height":
            return mi.Vector3d(0, o.y / n["half_height"], 0)
        # ρ² = r₀² + u (r² - r₀²): dρ/dr = u r / ρ at the same u
        square = o.x * o.x + o.y * o.y
        inner, outer = n["inner_radius"] ** 2, n["radius"] ** 2
        gain = (square - inner) / (outer - inner) * n["radius"] / dr.maximum(square, 1e-300)
        return mi.Vector3d(gain * o.x, gain * o.y, 0)


mi.register_emitter("surface_source", lambda props: SurfaceSource(props))
