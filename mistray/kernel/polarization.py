"""Stokes vectors along skew rays: polarisation axes by direction, and rotation into the plane of incidence.

A branch carries (q, u, v) = (Q, U, V)/I with respect to axes that follow from its direction d alone: the first is the
projection of the world's x axis onto the plane normal to d (of the y axis where d is within 26° of ±x), the second
d × first. A node stores only these three values. At a surface the Stokes vector is rotated into the plane of
incidence, with axes s = d × normal and d × s. There it is multiplied by the Mueller matrix of the coating, and then
rotated back.

Let E₁ and E₂ be the components of the field along these axes, I = |E₁|² + |E₂|², Q = |E₁|² - |E₂|² and
U + iV = 2 E₁ E₂*. Then the Mueller matrix of a coating with the amplitude coefficients j_s and j_p is

    I' = (S + P)/2 I + (S - P)/2 Q,   Q' = (S - P)/2 I + (S + P)/2 Q,   (U + iV)' = j_s j_p* (U + iV)

where S and P are the shares of flux of s and p light and |j_s j_p*|² = S P. Source: M. Born and E. Wolf, *Principles of
Optics*, 7th ed., sections 1.4.2 and 10.9.3; E. Collett, *Field Guide to Polarization* (2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.surfaces.extrema import larger

# Below this squared sine of the angle of incidence the plane of incidence is lost in rounding, and s and p are alike
NORMAL_INCIDENCE = 1e-8
NEAR_X = 0.9  # cosine of the angle between d and x above which the y axis gives the axes


def first_axis(d: Any) -> Any:
    """
    Return the first axis of the polarisation frame of a unit direction d: the world's x axis, projected normal to d.

    It is a unit vector. Where d is within 26° of ±x, the y axis takes the place of the x axis.
    """
    near = dr.abs(d.x) > NEAR_X
    axis = type(d)(dr.select(near, 0, 1), dr.select(near, 1, 0), 0)
    return dr.normalize(axis - dr.dot(axis, d) * d)


def carried(u: Any, axis: Any, d: Any) -> Any:
    """
    Return the vector u, normal to a source's axis, after the smallest rotation that takes the axis to direction d.

    An ideal lens rotates polarised light so when it spreads it over a cone, see R. A. Chipman, W.-S. T. Lam and G.
    Young, *Polarized Light and Optical Systems* (CRC Press, 2018), section 11.4 (double pole coordinates). Light that
    goes straight back keeps u.
    """
    both = axis + d
    square = dr.squared_norm(both)  # 2 (1 + cosine)
    turned = u - dr.select(square > 0, 2 * dr.dot(u, d) / square, 0) * both
    return dr.normalize(turned - dr.dot(turned, d) * d)


def plane_of_incidence(d: mi.Vector3f, normal: mi.Vector3f) -> mi.Vector3f:
    """
    Return the unit vector s along d × normal, across the plane of incidence of light along d.

    At normal incidence it is `first_axis` of d.
    """
    s = dr.cross(d, normal)
    square = dr.squared_norm(s)
    return dr.select(square > NORMAL_INCIDENCE, s * dr.rsqrt(square), first_axis(d))


def _turned(stokes: Any, d: Any, s: Any, sign: float) -> Any:
    axis = first_axis(d)
    c, n = dr.dot(axis, s), dr.dot(dr.cross(d, axis), s)
    # Stokes vectors rotate by twice the angle between the axes
    cos2, sin2 = c * c - n * n, sign * 2 * c * n
    return type(d)(cos2 * stokes.x + sin2 * stokes.y, cos2 * stokes.y - sin2 * stokes.x, stokes.z)


def to_plane(stokes: Any, d: Any, s: Any) -> Any:
    """Return the Stokes vector (q, u, v) in the axes s and d × s, from that in the axes of direction d."""
    return _turned(stokes, d, s, 1.0)


def from_plane(stokes: Any, d: Any, s: Any) -> Any:
    """Return the Stokes vector (q, u, v) in the axes of direction d, from that in the axes s and d × s."""
    return _turned(stokes, d, s, -1.0)


@dataclass
class Mueller:
    """
    Mueller matrix of a surface for reflected or for transmitted light, with respect to the plane of incidence.

    Attributes
    ----------
    coefficients : mi.Vector4f
        Reflected or transmitted fractions S and P of s and p light, real and imaginary part of j_s j_p*.
    """

    coefficients: mi.Vector4f

    def share(self, stokes: mi.Vector3f) -> mi.Float:
        """Return the outgoing flux over the incident flux; `stokes`, (q, u, v), refers to the plane of incidence."""
        s, p = self.coefficients.x, self.coefficients.y
        # Not as S + P + (S - P) q: where q is ±1 this leaves the rounding of the larger share on the smaller one
        return 0.5 * (s * larger(1 + stokes.x, 0) + p * larger(1 - stokes.x, 0))

    def apply(self, stokes: mi.Vector3f) -> mi.Vector3f:
        """Return the outgoing (q, u, v) for the incident one, both in the plane of incidence; 0 without any flux."""
        s, p, re, im = self.coefficients
        flux = self.share(stokes)
        scale = dr.select(flux > 0, 1 / flux, 0)  # not `dr.rcp`: polarised light must stay so by more than 1e-7
        q = 0.5 * (s * (1 + stokes.x) - p * (1 - stokes.x))
        out = mi.Vector3f(q, re * stokes.y - im * stokes.z, im * stokes.y + re * stokes.z) * scale
        # Rounding must not make the degree of polarisation larger than 1
        size = dr.norm(out)
        return dr.select(size > 1, out / size, out)
