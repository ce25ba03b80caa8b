"""Plugin `point_source`: light of one point, in all directions or in a cone."""

from __future__ import annotations

import mitsuba as mi

from mistray.param import Param, documented, fixed
from mistray.plugins.emitters.near_source import CONE, PLACE, ConeSource
from mistray.ranges import POSITIVE, Range

HALF_ANGLE_DEG = Range(1e-6, 180.0, unit="degrees")
EXPONENT = Range(0.0, 1e4)


@documented
class PointSource(ConeSource):
    r"""
    Point source (:monosp:`point_source`): a pinhole, a distant lamp, an LED, an object point of a near object.

    The intensity is proportional to cosⁿ θ within a cone about the axis, with n = ``exponent``; n = 0 is uniform in all
    directions. Most rays are sent to the first surface of the design path and to the scene, with weights that
    compensate for it. So a distant lamp costs no more than a parallel beam.

    The source is at ``x``, ``y``, ``z`` in the frame of ``to_world``, before the lens at ``z`` < 0. A field angle
    displaces it in its object plane, so that its light reaches the origin of that frame at the angle.

    .. parameters::

    If the intensity is given, the flux changes with the cone, which then has no derivative.

    Mitsuba's own integrators get no light from it, because rays cannot meet a point; only ``ptracer`` traces it.

    .. code-block:: xml

        <emitter type="point_source">
            <float name="z" value="-500"/>
            <float name="intensity" value="0.1"/>
        </emitter>

    .. code-block:: python

        {"type": "point_source", "z": -500.0, "half_angle_deg": 30.0, "power": 1e-3}
    """

    numbers = {
        **PLACE,
        "half_angle_deg": Param(
            "degree", HALF_ANGLE_DEG, "half angle of the cone; at most 90 with an exponent", default=180.0
        ),
        "exponent": fixed("1", EXPONENT, "n of cosⁿ θ; above 0 only within 90°", 0.0),
    }
    properties = {
        **numbers,
        "intensity": fixed("W/sr", POSITIVE, "intensity on the axis, instead of power", None),
        **CONE,
    }
    densities = ("intensity",)

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self._limit_cone(props)

    def power_per(self, density: str) -> float:
        """Return the flux, W, for an intensity of 1 W/sr on the axis; `density` is "intensity"."""
        return self.solid_angle


mi.register_emitter("point_source", lambda props: PointSource(props))
