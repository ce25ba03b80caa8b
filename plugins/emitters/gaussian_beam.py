"""Plugin `gaussian_beam`: a laser beam with its waists, its quality M² and its astigmatism."""

from __future__ import annotations

import math
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi

from mistray.param import Param, documented
from mistray.plugins.emitters.light_source import LIGHT
from mistray.plugins.emitters.near_source import PLACE, POWER, NearSource
from mistray.ranges import PLACE_MM, SIZE_MM, Range
from mistray.sampling.emission_laws import gaussian, polar

M2 = Range(1.0, 1e6)
NM = 1e-6  # mm


@documented
class GaussianBeam(NearSource):
    r"""
    Gaussian beam (:monosp:`gaussian_beam`): light of a laser or a single-mode fibre.

    Across the beam the irradiance is proportional to exp(-2 x²/w_x² - 2 y²/w_y²). Each of x and y has its own waist w₀,
    position z₀ of the waist and quality M², so that w(z)² = w₀² + (M² λ (z - z₀) / (π w₀))². The rays have the second
    moments of the beam everywhere. Position and slope at the waist are independent and normally distributed, with
    standard deviations w₀/2 and M² λ / (2 π w₀).

    .. parameters::

    Rays carry no phase: behind an aperture or in a focus they show the geometry of the beam without diffraction.

    .. code-block:: xml

        <emitter type="gaussian_beam">
            <float name="waist_x" value="0.4"/>
            <float name="waist_y" value="0.4"/>
            <float name="wavelength_nm" value="632.8"/>
            <float name="z" value="-200"/>
        </emitter>

    .. code-block:: python

        {"type": "gaussian_beam", "waist_x": 0.001, "waist_y": 0.003, "z": -50.0, "wavelength_nm": 905.0, "m2_x": 1.3}
    """

    numbers = {
        **PLACE,
        **dict.fromkeys(("waist_x", "waist_y"), Param("mm", SIZE_MM, "1/e² radius w₀ at the waist", absolute=0.001)),
        **dict.fromkeys(("m2_x", "m2_y"), Param("1", M2, "beam quality M²", default=1.0, absolute=0.05)),
        **dict.fromkeys(
            ("offset_x", "offset_y"),
            Param("mm", PLACE_MM, "position z₀ of the waist behind the start", default=0.0, absolute=0.1),
        ),
    }
    properties = {**numbers, "power": POWER, **LIGHT}
    extended = True

    @property
    def half_angle(self) -> float:
        nm, n = float(self.wavelengths_nm.min()), self.values
        return min(n[f"m2_{axis}"] * nm * NM / (math.pi * n[f"waist_{axis}"]) for axis in "xy")

    def local(
        self, place: mi.Point2d, sample: mi.Point2d, rng: mi.PCG32, n: Mapping[str, mi.Float64]
    ) -> tuple[mi.Vector3d, mi.Vector3d]:
        spots, slopes = ([radius * cosine, radius * sine] for radius, cosine, sine in map(_normal, (place, sample)))
        start, slope = [], []
        for axis, spot, angle in zip("xy", spots, slopes, strict=True):
            waist = n[f"waist_{axis}"]
            slope.append(0.5 * n[f"m2_{axis}"] * n["wavelength_nm"] * NM / (dr.pi * waist) * angle)
            start.append(0.5 * waist * spot - slope[-1] * n[f"offset_{axis}"])
        return mi.Vector3d(*start, 0), dr.normalize(mi.Vector3d(*slope, 1))

    def local_motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        kind, _, axis = name.partition("_")
        at = "xy".index(axis)
        slope, n = d[at] / d.z, self.values
        offset = n[f"offset_{axis}"]
        spot = o[at] + slope * offset  # at the waist
        shift, turn = {
            "waist": (spot / n[f"waist_{axis}"], -slope / n[f"waist_{axis}"]),
            "m2": (mi.Float64(0), slope / n[f"m2_{axis}"]),
            "offset": (-slope, mi.Float64(0)),
        }[kind]
        unit = mi.Vector3d(*(float(k == at) for k in range(3)))
        by_slope = turn * d.z * unit
        return (shift - turn * offset) * unit, by_slope - dr.dot(by_slope, d) * d


def _normal(point: mi.Point2d) -> tuple[mi.Float64, mi.Float64, mi.Float64]:
    """
    Return two independent standard normal variables for points of the unit square, in polar coordinates.

    They are the radius, and cosine and sine of the azimuth.
    """
    square, cosine, sine = polar(point)
    return gaussian(square), cosine, sine


mi.register_emitter("gaussian_beam", lambda props: GaussianBeam(props))
