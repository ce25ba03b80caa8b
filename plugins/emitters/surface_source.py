"""Plugin `surface_source`: a flat disc, ring or rectangle that emits light, Lambertian or with another law."""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.param import Param, documented, fixed
from mistray.plugins.emitters.near_source import CONE, PLACE, ConeSource
from mistray.plugins.emitters.point_source import EXPONENT
from mistray.ranges import CONE_DEG, POSITIVE, RADIUS_MM, SIZE_MM
from mistray.sampling.emission_laws import polar

SIZES = ("radius", "inner_radius", "half_width", "half_height")


@documented
class SurfaceSource(ConeSource):
    r"""
    Flat source (:monosp:`surface_source`): a screen, the chip of an LED, a lit slit, or the end of a fibre.

    It is a disc, a ring or a rectangle in the plane z = 0 of its frame, uniform over its area. Its intensity is
    proportional to cosⁿ θ within a cone about its normal, +z. With n = ``exponent`` = 1 it is Lambertian, with uniform
    radiance in all directions. A step-index fibre is a disc with n = 1 and the half angle of its numerical aperture.

    .. parameters::

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

    numbers = {
        **PLACE,
        "radius": Param("mm", RADIUS_MM, "radius of a disc, > 0", default=0.0, otherwise="none", absolute=0.02),
        "inner_radius": fixed("mm", RADIUS_MM, "radius of its unlit centre", 0.0),
        "half_width": Param(
            "mm", RADIUS_MM, "half width of a rectangle in x, > 0", default=0.0, otherwise="none", absolute=0.02
        ),
        "half_height": Param(
            "mm", RADIUS_MM, "half height of it in y, > 0", default=0.0, otherwise="none", absolute=0.02
        ),
        "half_angle_deg": Param("degree", CONE_DEG, "half angle of the cone", default=90.0),
        "exponent": fixed("1", EXPONENT, "n of cosⁿ θ", 1.0),
    }
    properties = {
        **numbers,
        "radiance": fixed("W/mm²/sr", POSITIVE, "radiance on the normal, instead of power", None),
        **CONE,
    }
    densities = ("radiance",)
    extended = True

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.rectangular = "half_width" in props or "half_height" in props
        if self.rectangular == ("radius" in props):
            self._fail("give either radius, or half_width and half_height")
        if self.rectangular and "inner_radius" in props:
            self._fail("inner_radius is given with half_width and half_height; it is the hole of a disc, leave it out")
        self._limit_cone(props, self._sizes)
        self._keep_parameters(set(self.differentiable) - (set(SIZES) - set(self._sizes)))

    @property
    def _sizes(self) -> tuple[str, ...]:
        return ("half_width", "half_height") if self.rectangular else ("radius",)

    def check(self) -> None:
        for key in self._sizes:
            SIZE_MM.check(key, self.values[key], self.owner)
        if not self.rectangular and not self.values["inner_radius"] < self.values["radius"]:
            self._fail(f"inner_radius is {self.values['inner_radius']:g} mm; it must be less than radius")
        super().check()

    @property
    def area(self) -> float:
        """Area of the source, mm²."""
        n = self.values
        if self.rectangular:
            return 4 * n["half_width"] * n["half_height"]
        return float(np.pi * (n["radius"] ** 2 - n["inner_radius"] ** 2))

    def power_per(self, density: str) -> float:
        """Return the flux, W, for a radiance of 1 W/mm²/sr along the normal; `density` is "radiance"."""
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
