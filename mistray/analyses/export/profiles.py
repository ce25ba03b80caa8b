"""Profiles of surfaces of revolution in forms that CAD programs support: lines, arcs of circles, conics and B-splines.

Lines, circles and conics are exact. An arc of a conic is a rational Bézier curve of degree 2 between its ends P0 and
P2, whose tangents meet in P1. Its weight there follows from the equation F = 0 of the conic,
w² = -F((P0 + P2)/2) / F(P1) (G. Farin, "Curves and Surfaces for CAGD", chapter 12). Aspheres are B-splines of degree 5
through points of their sag.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

from mistray.errors import MistrayError
from mistray.surfaces.families.cone import Cone
from mistray.surfaces.families.sag_surface import SagSurface

Array = npt.NDArray[np.float64]

DEGREE = 5
TOLERANCE_MM = 1e-6  # of B-splines
RELATIVE = 1e-7  # of the size, where that is less
FEWEST, MOST = 16, 4096  # points that a B-spline goes through
BETWEEN = 4  # points between two of these at which it is compared


@dataclass(frozen=True, eq=False)
class Profile:
    """
    Half of the cross-section of a surface of revolution, as a curve (r, z), mm.

    Attributes
    ----------
    name : str
        Id of the shape.
    kind : str
        "line", "circle" or "spline".
    poles : (n, 2) float64
        Distance from the axis and coordinate along it, mm; the first and the last are its ends.
    centre, radius : float
        For a circle: coordinate of its centre on the axis, and its radius, mm.
    degree : int
        Degree of a B-spline.
    knots : (n + degree + 1,) float64
        Knot vector of a B-spline; None for lines and circles.
    weights : (n,) float64 or None
        Weights of the poles of a rational B-spline; None if it is not rational.
    error_mm : float
        Largest distance of a B-spline from the surface, mm, measured between the points that it goes through.
    """

    name: str
    kind: str
    poles: Array
    centre: float = 0.0
    radius: float = 0.0
    degree: int = 1
    knots: Array | None = None
    weights: Array | None = None
    error_mm: float = 0.0

    @property
    def start(self) -> Array:
        """First end point (r, z), (2,), mm."""
        return np.asarray(self.poles[0])

    @property
    def end(self) -> Array:
        """Last end point (r, z), (2,), mm."""
        return np.asarray(self.poles[-1])

    def reversed(self) -> Profile:
        """Return the profile traversed in the opposite direction."""
        knots = None if self.knots is None else (self.knots[0] + self.knots[-1] - self.knots)[::-1]
        weights = None if self.weights is None else self.weights[::-1]
        return replace(self, poles=self.poles[::-1], knots=knots, weights=weights)

    def moved(self, along: float, shift: float) -> Profile:
        """Return the profile in another frame on the same axis, whose z is `along` (±1) times z plus `shift`, mm."""
        poles = self.poles * [1.0, along] + [0.0, shift]
        return replace(self, poles=poles, centre=along * self.centre + shift)

    def points(self, count: int = 33) -> Array:
        """Return points (r, z) along the profile at even steps of its parameter, (count, 2), mm."""
        u = np.linspace(0.0, 1.0, count)
        if self.kind == "line":
            return np.asarray(self.start + u[:, None] * (self.end - self.start))
        if self.kind == "circle":
            angles = [np.arctan2(p[1] - self.centre, p[0]) for p in (self.start, self.end)]
            turn = angles[0] + u * (angles[1] - angles[0])
            return self.radius * np.column_stack([np.cos(turn), np.sin(turn)]) + [0.0, self.centre]
        assert self.knots is not None
        weights = np.ones(len(self.poles)) if self.weights is None else self.weights
        u = self.knots[0] + u * (self.knots[-1] - self.knots[0])
        above = BSpline(self.knots, self.poles * weights[:, None], self.degree)(u)
        return np.asarray(above / BSpline(self.knots, weights, self.degree)(u)[:, None])


def profile_of(name: str, shape: Any) -> Profile:
    """
    Return the profile of a shape that is a surface of revolution, in the shape's own frame, mm.

    Raises
    ------
    MistrayError
        If no B-spline of reasonable size comes near enough to it.
    """
    piece = shape.surface(shape.values)
    if isinstance(piece, Cone) or (isinstance(piece, SagSurface) and piece.flat):
        return Profile(name, "line", np.asarray(shape.profile(2), dtype=np.float64))
    if not isinstance(piece, SagSurface):
        return _fitted(name, lambda count: np.asarray(shape.profile(count), dtype=np.float64), False)
    r = np.array([piece.inner, piece.outer])
    ends = np.column_stack([r, shape.sag(r)])
    if not piece.coefficients and piece.conic == 0:
        radius = 1 / piece.curvature
        return Profile(name, "circle", ends, centre=radius, radius=abs(radius))
    if not piece.coefficients:
        return _conic(name, ends, piece)
    return _fitted(name, lambda count: _even(shape, piece, count), piece.inner == 0)


def _conic(name: str, ends: Array, piece: SagSurface) -> Profile:
    """Return the exact arc of a conic between two ends (r, z), mm, as a rational Bézier curve."""
    a, b, e, _ = piece.quadric  # F = a r² + b z² + e z

    def residual(p: Array) -> float:
        return float(a * p[0] ** 2 + b * p[1] ** 2 + e * p[1])

    normals = np.array([[a * r, b * z + 0.5 * e] for r, z in ends])
    corner = np.linalg.solve(normals, np.einsum("ij,ij->i", normals, ends))
    weight = float(np.sqrt(-residual(ends.mean(axis=0)) / residual(corner)))
    poles = np.array([ends[0], corner, ends[1]])
    return Profile(
        name, "spline", poles, degree=2, knots=np.repeat([0.0, 1.0], 3), weights=np.array([1.0, weight, 1.0])
    )


def _even(shape: Any, piece: SagSurface, count: int) -> Array:
    """
    Return `count` points (r, z), mm, along an asphere.

    They are at even eccentric angles if its base conic is an ellipse, else at even steps of r.
    """
    product = (1 + piece.conic) * piece.curvature**2
    if product > 0:
        end = 1 / np.sqrt(product)
        low, high = (np.arcsin(min(r / end, 1.0)) for r in (piece.inner, piece.outer))
        r = end * np.sin(np.linspace(low, high, count))
        r[0], r[-1] = piece.inner, piece.outer
    else:
        r = np.linspace(piece.inner, piece.outer, count)
    return np.column_stack([r, shape.sag(r)])


def _fitted(name: str, points: Any, even: bool) -> Profile:
    """
    Return a B-spline through points of a profile, with as many of them as its tolerance requires.

    Parameters
    ----------
    name : str
        Id of the shape.
    points : callable
        Returns (n, 2) points (r, z), mm, at n even steps of a parameter.
    even : bool
        Whether the profile begins on the axis and meets it at a right angle: r is odd there, and z even.

    Raises
    ------
    MistrayError
        If no B-spline through `MOST` points comes near enough.
    """
    size = float(np.ptp(points(FEWEST), axis=0).max())
    tolerance = min(TOLERANCE_MM, RELATIVE * size)
    count = FEWEST
    while count <= MOST:
        known = points(count)
        u = np.linspace(0.0, 1.0, count)
        if even:
            knots = np.concatenate([np.zeros(DEGREE + 1), u[1:-3], np.ones(DEGREE + 1)])
            r = make_interp_spline(u, known[:, 0], DEGREE, t=knots, bc_type=([(2, 0.0), (4, 0.0)], None))
            z = make_interp_spline(u, known[:, 1], DEGREE, t=knots, bc_type=([(1, 0.0), (3, 0.0)], None))
            poles = np.column_stack([r.c, z.c])
        else:
            spline = make_interp_spline(u, known, DEGREE)
            poles, knots = spline.c, spline.t
        poles[0], poles[-1] = known[0], known[-1]
        fine = BETWEEN * (count - 1) + 1
        curve = BSpline(knots, poles, DEGREE)(np.linspace(0.0, 1.0, fine))
        error = float(np.abs(curve - points(fine)).max())
        if error <= tolerance:
            return Profile(name, "spline", poles, degree=DEGREE, knots=knots, error_mm=error)
        count *= 2
    raise MistrayError(
        f"shape '{name}': a B-spline through {MOST} points is {error:.2g} mm off its sag, more than {tolerance:.2g} "
        "mm; reduce its aperture or its coefficients"
    )
