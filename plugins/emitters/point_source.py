"""Plugin `point_source`: light of one point, in all directions or in a cone."""

from __future__ import annotations

import mitsuba as mi

from mistray.plugins.emitters.near_source import MOVES, ConeSource
from mistray.ranges import Range

HALF_ANGLE_DEG = Range(1e-6, 180.0, unit="degrees")
EXPONENT = Range(0.0, 1e4)


class PointSource(ConeSource):
    r"""
    Point source (:monosp:`point_source`): a pinhole, a distant lamp, an LED, an object point of a near object.

    The intensity is proportional to cosⁿ θ within a cone about the axis, with n = ``exponent``; n = 0 is uniform in all
    directions. Most rays are sent to the first surface of the design path and to the scene, with weights that
    compensate for it. So a distant lamp costs no more than a parallel beam.

    The source is at ``x``, ``y``, ``z`` in the frame of ``to_world``, before the lens at ``z`` < 0. A field angle
    displaces it in its object plane, so that its light reaches the origin of that frame at the angle.

    =================== ========= =================== ========= ===================================================
    parameter           unit      range               default   meaning
    =================== ========= =================== ========= ===================================================
    x, y, z             mm        -1e12 … 1e12        0         position (differentiable)
    tilt_x, tilt_y      degree                        0         tilts of its axis, which is +z (differentiable)
    half_angle_deg      degree    1e-6 … 180          180       half angle of the cone; 90 with an exponent
                                                                (differentiable)
    exponent            1         0 … 10000           0         n of cosⁿ θ; above 0 only within 90°
    profile             string    angle:value, …      none      intensity against the angle from the axis instead of
                                                                cosⁿ θ: "0:1, 20:0.9, 25:0", degrees, linear between
    filename            string    a file              none      a measured intensity by direction instead: IES LM-63,
                                                                .ies, or .csv; see docs/sources.md
    power               W         > 0                 1         flux of all its light; by default of a file in candela
                                                                or W/sr its own flux
    intensity           W/sr      > 0                 none      intensity on the axis, instead of power
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

    own_ranges = {"half_angle_deg": HALF_ANGLE_DEG, "exponent": EXPONENT}
    own_defaults = {"half_angle_deg": 180.0, "exponent": 0.0}
    densities = ("intensity",)
    differentiable = (*MOVES, "half_angle_deg")

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self._limit_cone(props)

    def power_per(self, density: str) -> float:
        """Return the flux, W, for an intensity of 1 W/sr on the axis."""
        return self.solid_angle


mi.register_emitter("point_source", lambda props: PointSource(props))
