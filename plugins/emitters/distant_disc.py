"""Plugin `distant_disc`: a small disc infinitely far away, such as the sun, the moon or a planet."""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.param import Param, documented, fixed
from mistray.plugins.emitters.distant_source import DistantSource
from mistray.plugins.emitters.light_source import LIGHT, TILT, out_of, tilt_motion, tilted_axes
from mistray.ranges import POSITIVE, SHARE, Range
from mistray.sampling.emission_laws import cone_height, direction, polar

DIAMETER_DEG = Range(1e-9, 90.0, unit="degrees")
STEPS = 6  # Newton steps from a start within 0.2, for the radius that holds a given fraction of the light


@documented
class DistantDisc(DistantSource):
    r"""
    Disc at infinity (:monosp:`distant_disc`): the sun (0.533°), the moon (0.518°), a planet.

    The light of its centre travels along Rz(``azimuth_deg``) · (0, sin θ, cos θ) with θ = ``field_deg``, as for
    `collimated`, and lights the whole scene. Towards the limb the radiance falls as 1 - ``limb`` (1 - μ). At the angle
    ρ from the centre of a disc of angular radius ρ₀, μ² is 1 - (1 - cos ρ)/(1 - cos ρ₀). This is linear limb
    darkening, 0.6 for the sun in the green.

    .. parameters::

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

    numbers = {
        "diameter_deg": Param("degree", DIAMETER_DEG, "angular diameter", default=0.533, absolute=0.01),
        "limb": fixed("1", SHARE, "limb darkening", 0.0),
        "tilt_x": TILT,
        "tilt_y": TILT,
    }
    properties = {
        **numbers,
        "irradiance": fixed("W/mm²", POSITIVE, "irradiance by all directions, each on a plane normal to it", 1.0),
        "radiance": fixed("W/mm²/sr", POSITIVE, "radiance of the disc's centre, instead of irradiance", None),
        **LIGHT,
    }

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if self.given[0] == "radiance":  # the flux changes with the size
            self._keep_parameters({"tilt_x", "tilt_y"})

    @property
    def solid_angle(self) -> float:
        """Effective solid angle of the disc, sr: 2π (1 - cos ρ₀) (1 - ``limb``/3) for the angular radius ρ₀."""
        height = cone_height(np.radians(self.values["diameter_deg"]) / 2)
        return float(2 * np.pi * height * (1 - self.values["limb"] / 3))

    def directions(self, sample: mi.Point2d, n: Mapping[str, mi.Float64]) -> mi.Vector3d:
        share, cosine, sine = polar(sample)
        # F(s) = ((1 - c) s + 2c/3 (1 - (1 - s)^(3/2))) / (1 - c/3), the fraction of the light within 1 - μ² = s
        limb, whole = n["limb"], 1 - n["limb"] / 3
        square = mi.Float64(share)
        for _ in range(STEPS):
            mu = dr.safe_sqrt(1 - square)
            excess = ((1 - limb) * square + limb * (2 / 3) * (1 - mu * mu * mu)) - share * whole
            square = dr.clip(square - excess / dr.maximum(1 - limb + limb * mu, 1e-6), 0, 1)
        # Uniform radiance is uniform in 1 - cos ρ, as the rays of each direction fill a disc across it
        height = square * cone_height(dr.deg2rad(n["diameter_deg"]) / 2)
        return out_of(tilted_axes(n), direction(height, cosine, sine))

    def direction_motion(self, name: str, d: mi.Vector3d) -> mi.Vector3d:
        axes = tilted_axes(self.values)
        if name in ("tilt_x", "tilt_y"):
            return tilt_motion(name, axes, d)
        # sin(ρ/2) is proportional to sin(D/4) at a fixed fraction of the light: dρ/dD = tan(ρ/2) / (2 tan(D/4))
        along = dr.dot(d, axes[2])
        outward = d - along * axes[2]  # its length is sin ρ, and tan(ρ/2) = sin ρ / (1 + cos ρ)
        half = float(np.radians(self.values["diameter_deg"]) / 2)
        turn = float(np.pi / 360 / np.tan(half / 2)) / (1 + along)
        return turn * (along * outward - dr.squared_norm(outward) * axes[2])


mi.register_emitter("distant_disc", lambda props: DistantDisc(props))
