"""Plugin `gaussian_beam`: a laser beam with its waists, its quality M² and its astigmatism."""

from __future__ import annotations

import math
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi

from mistray.plugins.emitters.near_source import MOVES, NearSource
from mistray.ranges import PLACE_MM, SIZE_MM, Range
from mistray.sampling.emission_laws import gaussian, polar

M2 = Range(1.0, 1e6)
NM = 1e-6  # mm


class GaussianBeam(NearSource):
    r"""
    Gaussian beam (:monosp:`gaussian_beam`): light of a laser or a single-mode fibre.

    Across the beam the irradiance is exp(-2 x²/w² - 2 y²/w²) with w(z)² = w₀² + (M² λ (z - z₀) / (π w₀))². Each of x
    and y has its own waist, position of the waist and quality. The rays have the second moments of the beam everywhere.
    Position and slope at the waist are independent and normal, of widths w₀/2 and M² λ / (2 π w₀).

    =================== ========= =================== ========= ===================================================
    parameter           unit      range               default   meaning
    =================== ========= =================== ========= ===================================================
    waist_x, waist_y    mm        > 0                 required  1/e² radius w₀ at the waist (differentiable)
    m2_x, m2_y          1         1 … 1e6             1         beam quality M² (differentiable)
    offset_x, offset_y  mm        -1e12 … 1e12        0         position z₀ of the waist behind the start
                                                                (differentiable)
    x, y, z             mm        -1e12 … 1e12        0         start of the rays (differentiable)
    tilt_x, tilt_y      degree                        0         tilts of its axis, which is +z (differentiable)
    power               W         > 0                 1         flux of the beam
    field_deg           degree    -90 < … < 90        0         angle of a rotation about the origin of to_world
    azimuth_deg         degree                        0         azimuth of that rotation
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

    own_ranges = {
        "waist_x": SIZE_MM,
        "waist_y": SIZE_MM,
        "m2_x": M2,
        "m2_y": M2,
        "offset_x": PLACE_MM,
        "offset_y": PLACE_MM,
    }
    own_defaults = {"m2_x": 1.0, "m2_y": 1.0, "offset_x": 0.0, "offset_y": 0.0}
    differentiable = (*MOVES, *own_ranges)
    tolerances = {"waist_x": 0.001, "waist_y": 0.001, "m2_x": 0.05, "m2_y": 0.05, "offset_x": 0.1, "offset_y": 0.1}
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
    """Return radius and azimuth (cosine, sine) of two independent normal variables, for a point of the unit square."""
    square, cosine, sine = polar(point)
    return gaussian(square), cosine, sine


mi.register_emitter("gaussian_beam", lambda props: GaussianBeam(props))
