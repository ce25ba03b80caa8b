"""Plugin `distant_disc`: a small disc infinitely far away, such as the sun, the moon or a planet."""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.plugins.emitters.distant_source import DistantSource
from mistray.plugins.emitters.light_source import out_of, tilt_motion, tilted_axes
from mistray.ranges import FINITE, SHARE, Range
from mistray.sampling.emission_laws import direction, polar

DIAMETER_DEG = Range(1e-9, 90.0, unit="degrees")
STEPS = 6  # Newton steps from a start within 0.2, for the radius that holds a given fraction of the light


class DistantDisc(DistantSource):
    r"""
    Disc at infinity (:monosp:`distant_disc`): the sun (0.533°), the moon (0.518°), a planet.

    The light of its centre travels along Rz(``azimuth_deg``) · (0, sin θ, cos θ) with θ = ``field_deg``, as for
    `collimated`, and lights the whole scene. Towards the limb the radiance falls as 1 - ``limb`` (1 - μ) with μ = √(1 -
    (ρ/ρ₀)²). This is linear limb darkening, 0.6 for the sun in the green.

    =================== ========= =================== ========= ===================================================
    parameter           unit      range               default   meaning
    =================== ========= =================== ========= ===================================================
    diameter_deg        degree    1e-9 … 90           0.533     angular diameter (differentiable)
    limb                1         0 … 1               0         limb darkening
    tilt_x, tilt_y      degree                        0         tilts of the light's direction (differentiable)
    irradiance          W/mm²     > 0                 1         irradiance on a plane normal to the light
    radiance            W/mm²/sr  > 0                 none      radiance of the disc's centre, instead of irradiance
    field_deg           degree    -90 < … < 90        0         angle from the local z axis
    azimuth_deg         degree                        0         azimuth about z, from +y towards -x
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
    to_world            mm        rigid               identity  the axis
    =================== ========= =================== ========= ===================================================

    The flux of a trace is that through the sphere around the scene. Mitsuba's own integrators get no light from it; for
    them there is Mitsuba's ``directional``, ``constant`` or ``envmap``.

    .. code-block:: xml

        <emitter type="distant_disc">
            <float name="field_deg" value="35"/>
            <float name="irradiance" value="1.361e-3"/>
        </emitter>

    .. code-block:: python

        {"type": "distant_disc", "diameter_deg": 0.518, "field_deg": 20.0, "irradiance": 3e-9}
    """

    ranges = {"diameter_deg": DIAMETER_DEG, "limb": SHARE, "tilt_x": FINITE, "tilt_y": FINITE}
    defaults = {"diameter_deg": 0.533, "limb": 0.0, "tilt_x": 0.0, "tilt_y": 0.0}
    differentiable = ("diameter_deg", "tilt_x", "tilt_y")
    tolerances = {"diameter_deg": 0.01, "tilt_x": 0.1, "tilt_y": 0.1}

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if self.given[0] == "radiance":  # the flux changes with the size
            self._keep_parameters({"tilt_x", "tilt_y"})

    @property
    def solid_angle(self) -> float:
        """Effective solid angle of the disc, sr: π sin² ρ₀ (1 - ``limb``/3)."""
        return float(np.pi * np.sin(np.radians(self.values["diameter_deg"]) / 2) ** 2 * (1 - self.values["limb"] / 3))

    def directions(self, sample: mi.Point2d, n: Mapping[str, mi.Float64]) -> mi.Vector3d:
        share, cosine, sine = polar(sample)
        # F(s) = ((1 - c) s + 2c/3 (1 - (1 - s)^(3/2))) / (1 - c/3), the fraction of the light within ρ² = s ρ₀²
        limb, whole = n["limb"], 1 - n["limb"] / 3
        square = mi.Float64(share)
        for _ in range(STEPS):
            mu = dr.safe_sqrt(1 - square)
            excess = ((1 - limb) * square + limb * (2 / 3) * (1 - mu * mu * mu)) - share * whole
            square = dr.clip(square - excess / dr.maximum(1 - limb + limb * mu, 1e-6), 0, 1)
        # Uniform radiance is uniform in sin² ρ across the light
        size = dr.sin(dr.deg2rad(n["diameter_deg"]) / 2)
        squared = square * size * size
        return out_of(tilted_axes(n), direction(squared / (1 + dr.sqrt(1 - squared)), cosine, sine))

    def direction_motion(self, name: str, d: mi.Vector3d) -> mi.Vector3d:
        axes = tilted_axes(self.values)
        if name in ("tilt_x", "tilt_y"):
            return tilt_motion(name, axes, d)
        # sin ρ is proportional to sin(D/2) at a fixed fraction of the light: dρ/dD = tan ρ / (2 tan(D/2))
        along = dr.dot(d, axes[2])
        outward = d - along * axes[2]  # its length is sin ρ
        half = float(np.radians(self.values["diameter_deg"]) / 2)
        turn = float(np.pi / 360 / np.tan(half)) / along
        return turn * (along * outward - dr.squared_norm(outward) * axes[2])


mi.register_emitter("distant_disc", lambda props: DistantDisc(props))
