"""
Sampling of directions by laws of emission about an axis: maps of the unit square, for Dr.Jit in any precision.

Heights h = 1 - cos θ replace the angle θ from the axis, since dΩ = dh dφ, and h keeps its digits near the axis.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.upload import upload

LEAST_LOG = -80.0  # its exp is negligible beside 1, and still a normal float32
EDGE = 1e-6  # distance of rays along the edge of a source from that edge, as a share of its size
PROFILE_STEPS, LEAST_STEPS = 4096, 512  # steps in angle of a table, divided by its azimuths, and fewest


def polar(sample: Any) -> tuple[Any, Any, Any]:
    """
    Return points of the unit disc in polar form, mapped concentrically from points of the unit square.

    P. Shirley and K. Chiu, "A low distortion map between disk and square", J. Graphics Tools 2(3), 45-52 (1997).

    Parameters
    ----------
    sample : mi.Point2f or mi.Point2d
        Points of the unit square.

    Returns
    -------
    square, cosine, sine
        Square of the radius, 0 … 1, which is uniform, and cosine and sine of the azimuth.
    """
    # Triangles of the square become sectors of the disc: the larger coordinate is the radius
    a, b = 2 * sample.x - 1, 2 * sample.y - 1
    first = dr.abs(a) > dr.abs(b)
    radius = dr.select(first, a, b)
    ratio = dr.select(first, b, a) / dr.select(radius == 0, 1, radius)
    angle = 0.25 * dr.pi * dr.select(first, ratio, 2 - ratio)
    sine, cosine = dr.sincos(angle)
    sign = dr.select(radius < 0, -1, 1)
    return radius * radius, sign * cosine, sign * sine


def perimeter(count: int, within: float = EDGE) -> np.ndarray:
    """Return points, (2, count), evenly spaced along the perimeter of the unit square, inside it by `within` / 2."""
    along = 4 * (np.arange(count) + 0.5) / count
    side, place = np.divmod(along, 1.0)
    edges = np.array([[place, 0 * place], [1 + 0 * place, place], [1 - place, 1 + 0 * place], [0 * place, 1 - place]])
    points = edges[side.astype(int), :, np.arange(count)].T
    return np.asarray(0.5 + (1 - within) * (points - 0.5))


def direction(height: Any, cosine: Any, sine: Any) -> Any:
    """Return the unit vector with 1 - cos θ = `height` from the z axis and an azimuth of this cosine and sine."""
    across = dr.safe_sqrt(height * (2 - height))
    vector = mi.Vector3d if dr.type_v(height) == dr.VarType.Float64 else mi.Vector3f
    return vector(across * cosine, across * sine, 1 - height)


def height_of(d: Any) -> Any:
    """Return 1 - cos θ of a unit direction at the angle θ from the z axis, without cancellation near that axis."""
    across = d.x * d.x + d.y * d.y
    return dr.select(d.z > 0, across / (1 + d.z), 1 - d.z)


def cone_height(half_angle: Any) -> Any:
    """Return 1 - cos α for the half angle α of a cone, radians, exact for small angles."""
    sine = dr.sin(0.5 * half_angle)
    return 2 * sine * sine


def log_cosine(height: Any) -> Any:
    """
    Return ln cos θ for 1 - cos θ = `height`, exact near 0; a large negative number where cos θ ≤ 0.

    With x = 1 - h as rounded, ln(1 - h) = h ln x/(1 - x): D. Goldberg, "What every computer scientist should know about
    floating-point arithmetic", ACM Computing Surveys 23(1), 5-48 (1991), theorem 4.
    """
    least = 1e-300 if dr.type_v(height) == dr.VarType.Float64 else 1e-37
    cosine = 1 - height
    lost = 1 - cosine
    return dr.select(lost == 0, -height, dr.log(dr.maximum(cosine, least)) * height / dr.select(lost == 0, 1, lost))


def rest_of_power(log: Any) -> Any:
    """Return 1 - exp(log) for logarithms up to 0, exact near 0; the counterpart of `log_cosine`."""
    log = dr.maximum(log, LEAST_LOG)
    power = dr.exp(log)
    return dr.select(power == 1, -log, (1 - power) * log / dr.select(power == 1, 1, dr.log(power)))


def cosine_power(square: Any, exponent: Any, edge: Any) -> Any:
    """
    Return 1 - cos θ of sampled directions, for an intensity in proportion to cosⁿ θ within a cone.

    The share u of the flux within θ is u = (1 - cosⁿ⁺¹ θ)/(1 - cosⁿ⁺¹ α), with the half angle α of the cone.

    Parameters
    ----------
    square : array
        Share u, 0 … 1, uniform for random directions; see `polar`.
    exponent : array
        n ≥ 0; 0 is the same intensity in all directions, 1 a Lambertian surface.
    edge : array
        `cone_height` of the cone's half angle; above 1 only with n = 0.
    """
    power = exponent + 1
    curved = rest_of_power(log_cosine(square * rest_of_power(power * log_cosine(edge))) / power)
    return dr.select(exponent == 0, square * edge, curved)


def cosine_power_angle(exponent: float, half_angle: float) -> float:
    """
    Return the effective solid angle ∫ cosⁿ θ dΩ of a cone, sr: 2π (1 - cosⁿ⁺¹ α) / (n + 1).

    `half_angle`, α, is in radians. Directions beyond 90° count only for n = 0.
    """
    edge = cone_height(half_angle)
    if exponent == 0 or edge >= 1:
        return float(2 * dr.pi * min(edge, 2.0 if exponent == 0 else 1.0) / (exponent + 1))
    return float(-2 * dr.pi * np.expm1((exponent + 1) * np.log1p(-edge)) / (exponent + 1))


def gaussian(square: Any) -> Any:
    """Return the radius that encloses the fraction `square` of a 2-D normal distribution, in units of its σ."""
    return dr.sqrt(-2 * dr.log(dr.maximum(1 - square, 1e-30)))


class IntensityTable:
    """
    Intensity tabulated over the angle from an axis and the azimuth, linear between given angles.

    Within fine steps of the angle it is linear in 1 - cos θ instead. The solid angle is uniform in that, so that
    samples follow the intensity exactly.

    Parameters
    ----------
    theta_deg : (t,) float
        Angles from the axis, degrees, ascending within 0 … 180; the intensity is 0 below the first and above the last.
    phi_deg : (p,) float
        Azimuths from x towards y, degrees, ascending from 0 to 360.
    values : (t, p) float
        Intensities, in any unit; the first and last column are the same.

    Attributes
    ----------
    flux : float
        ∫ I dΩ, in that unit · sr.
    half_angle : float
        The last of the angles from the axis, rad.
    on_axis : float
        Intensity at 0, mean of all azimuths; 0 if the first angle is above 0.
    """

    def __init__(self, theta_deg: np.ndarray, phi_deg: np.ndarray, values: np.ndarray) -> None:
        # Fine steps in angle, the given angles among them
        given, phi = np.radians(theta_deg), np.radians(phi_deg)
        steps = max(PROFILE_STEPS // (len(phi) - 1), LEAST_STEPS)
        theta = np.unique(np.concatenate([np.linspace(given[0], given[-1], steps), given]))
        self._height = 2 * np.sin(0.5 * theta) ** 2  # 1 - cos θ
        self._phi, self.half_angle = phi, float(given[-1])
        self._intensity = np.stack([np.interp(theta, given, column) for column in values.T], axis=1)
        # ∫ I dφ up to each azimuth, and then the flux up to each angle: both exact, as I is linear in either
        parts = 0.5 * (self._intensity[:, 1:] + self._intensity[:, :-1]) * np.diff(phi)
        self._around = np.concatenate([np.zeros((len(theta), 1)), np.cumsum(parts, axis=1)], axis=1)
        whole = self._around[:, -1]
        flux = 0.5 * (whole[1:] + whole[:-1]) * np.diff(self._height)
        self.flux = float(flux.sum())
        self.on_axis = float(values[0, :-1] @ np.diff(phi)) / (2 * np.pi) if theta_deg[0] == 0 else 0.0
        self._ends = np.concatenate([[0.0], np.cumsum(flux) / flux.sum()])

    def edge_samples(self, count: int, within: float = EDGE) -> np.ndarray | None:
        """
        Return points of the unit square, (2, count), that `directions` maps to directions just below the last angle.

        The fraction `within` of the flux lies beyond them. The result is None if the intensity is 0 there.
        """
        if not np.any(self._intensity[-1] > 0):
            return None
        return np.stack([np.full(count, 1 - within), (np.arange(count) + 0.5) / count])

    @cached_property
    def _tables(self) -> list[mi.Float64]:
        """Device tables: cumulative flux, heights 1 - cos θ, ∫ I dφ, azimuths (rad), intensities, cumulative ∫ I dφ."""
        rows = (self._ends, self._height, self._around[:, -1], self._phi, self._intensity, self._around)
        return [upload(mi.Float64, row.ravel()) for row in rows]

    def directions(self, sample: mi.Point2d) -> mi.Vector3d:
        """Return unit directions distributed as the intensity per solid angle, for points of the unit square."""
        # Angle: the step by its share of the flux, and within it from the flux per azimuth, which is linear
        ends, heights, wholes, phis, intensities, around = self._tables
        k, part = step_of(ends, len(self._ends), sample.x)
        i0, i1 = (dr.gather(mi.Float64, wholes, k + j) for j in range(2))
        h0, h1 = (dr.gather(mi.Float64, heights, k + j) for j in range(2))
        t = _linear(i0, i1, part)
        width = len(self._phi)

        def blend(table: mi.Float64, j: mi.UInt32) -> mi.Float64:
            low, high = (dr.gather(mi.Float64, table, (k + row) * width + j) for row in range(2))
            return dr.fma(high - low, t, low)

        # Azimuth: the same at that angle, by ∫ I dφ
        share = sample.y * blend(around, mi.UInt32(width - 1))
        j = dr.binary_search(0, width - 2, lambda i: blend(around, i + 1) <= share)
        low, high = blend(around, j), blend(around, j + 1)
        part = dr.clip((share - low) / dr.maximum(high - low, 1e-300), 0, 1)
        p0, p1 = (dr.gather(mi.Float64, phis, j + step) for step in range(2))
        sine, cosine = dr.sincos(dr.fma(p1 - p0, _linear(blend(intensities, j), blend(intensities, j + 1), part), p0))
        return direction(dr.fma(h1 - h0, t, h0), cosine, sine)

    def density(self, d: mi.Vector3d) -> mi.Float64:
        """Return the pdf, 1/sr, of unit directions d that `directions` samples."""
        # Bilinear in height and azimuth, as `directions` draws
        _, heights, _, phis, intensities, _ = self._tables
        height = height_of(d)
        phi = dr.atan2(d.y, d.x)
        phi = dr.select(phi < 0, phi + 2 * dr.pi, phi)
        k, t = step_of(heights, len(self._height), height)
        j, u = step_of(phis, len(self._phi), phi)
        width = len(self._phi)
        (a, b), (c, e) = (
            [dr.gather(mi.Float64, intensities, (k + row) * width + j + column) for column in range(2)]
            for row in range(2)
        )
        found = dr.lerp(dr.lerp(a, b, u), dr.lerp(c, e, u), t)
        within = (height >= self._height[0]) & (height <= self._height[-1])
        return dr.select(within, dr.maximum(found, 0) / self.flux, 0)


def step_of(nodes: mi.Float64, count: int, value: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
    """Return the index of the interval of ascending nodes that holds each value, and the position within it, 0 … 1."""
    k = dr.binary_search(0, count - 2, lambda i: dr.gather(mi.Float64, nodes, i + 1) <= value)
    low, high = (dr.gather(mi.Float64, nodes, k + j) for j in range(2))
    return k, dr.clip((value - low) / dr.maximum(high - low, 1e-300), 0, 1)


def _linear(first: mi.Float64, last: mi.Float64, share: mi.Float64) -> mi.Float64:
    """Return the x, 0 … 1, below which the fraction `share` of a density linear from `first` to `last` lies."""
    # The form of the quadratic's root without cancellation
    root = dr.safe_sqrt(first * first + share * (last * last - first * first))
    return share * (first + last) / dr.maximum(first + root, 1e-300)
