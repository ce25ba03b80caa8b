"""Stokes vectors along skew paths.

A branch carries (q, u, v) = (Q, U, V)/I with respect to axes that follow from its direction d alone: the first is the
projection of the world's x axis onto the plane normal to d (of the y axis where d is within 26° of x), the second
d × first. Nothing but three numbers need be stored at a node. At a surface the Stokes vector is turned into the plane
of incidence, with axes s = d × normal and d × s, then multiplied by the Mueller matrix of the coating, and turned back.

With Q = |E₁|² - |E₂|² and U + iV = 2 E₁ E₂*, a coating of amplitudes j_s, j_p does

    I' = (S + P)/2 I + (S - P)/2 Q,   Q' = (S - P)/2 I + (S + P)/2 Q,   (U + iV)' = j_s j_p* (U + iV)

where S and P are the shares of the flux and |j_s j_p*|² = S P. Source: M. Born and E. Wolf, *Principles of Optics*,
7th ed., sections 1.4.2 and 10.9.3; E. Collett, *Field Guide to Polarization* (2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

# Below this squared sine of the angle of incidence the plane of incidence is lost in the rounding and does not matter
NORMAL_INCIDENCE = 1e-8
NEAR_X = 0.9  # cosine of the angle between d and x above which the y axis gives the axes


def first_axis(d: mi.Vector3f) -> mi.Vector3f:
    """First polarisation axis of a direction."""
    near = dr.abs(d.x) > NEAR_X
    axis = mi.Vector3f(dr.select(near, 0, 1), dr.select(near, 1, 0), 0)
    return dr.normalize(axis - dr.dot(axis, d) * d)


def plane_of_incidence(d: mi.Vector3f, normal: mi.Vector3f) -> mi.Vector3f:
    """Unit vector s normal to d and to the surface normal."""
    s = dr.cross(d, normal)
    square = dr.squared_norm(s)
    return dr.select(square > NORMAL_INCIDENCE, s * dr.rsqrt(square), first_axis(d))


def _turned(stokes: mi.Vector3f, d: mi.Vector3f, s: mi.Vector3f, sign: float) -> mi.Vector3f:
    axis = first_axis(d)
    c, n = dr.dot(axis, s), dr.dot(dr.cross(d, axis), s)
    cos2, sin2 = c * c - n * n, sign * 2 * c * n
    return mi.Vector3f(cos2 * stokes.x + sin2 * stokes.y, cos2 * stokes.y - sin2 * stokes.x, stokes.z)


def to_plane(stokes: mi.Vector3f, d: mi.Vector3f, s: mi.Vector3f) -> mi.Vector3f:
    """(q, u, v) with respect to s and d × s instead of the axes of d."""
    return _turned(stokes, d, s, 1.0)


def from_plane(stokes: mi.Vector3f, d: mi.Vector3f, s: mi.Vector3f) -> mi.Vector3f:
    """(q, u, v) with respect to the axes of d instead of s and d × s."""
    return _turned(stokes, d, s, -1.0)


@dataclass
class Mueller:
    """
    What a coating does to one of the children.

    Attributes
    ----------
    coefficients : mi.Vector4f
        Shares of the flux of s and of p, real and imaginary part of j_s j_p*.
    """

    coefficients: mi.Vector4f

    def share(self, stokes: mi.Vector3f) -> mi.Float:
        """Share of the flux that the child gets; `stokes` in the plane of incidence."""
        s, p = self.coefficients.x, self.coefficients.y
        return 0.5 * ((s + p) + (s - p) * stokes.x)

    def apply(self, stokes: mi.Vector3f) -> mi.Vector3f:
        """(q, u, v) of the child in the plane of incidence."""
        s, p, re, im = self.coefficients
        flux = self.share(stokes)
        scale = dr.select(flux > 0, dr.rcp(flux), 0)
        q = 0.5 * ((s - p) + (s + p) * stokes.x)
        out = mi.Vector3f(q, re * stokes.y - im * stokes.z, im * stokes.y + re * stokes.z) * scale
        # Rounding must not make more than fully polarised light of it
        size = dr.norm(out)
        return dr.select(size > 1, out / size, out)
