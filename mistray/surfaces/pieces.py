"""The numbers of one analytic surface, as functions of the parameters of its plugin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.physics.sag import conic_end, sag
from mistray.surfaces.gradient_columns import COEFFICIENTS

NO_SURFACE = 0xFFFFFFFF
# A second hit of the surface just left must be this far away, in units of its size: nearer ones are rounding
SELF_HIT = 1e-5
# An asphere is hit through its conic if it departs from it by less than this, in units of its aperture and as a slope
MILD_DEPARTURE, MILD_SLOPE, MILD_MARGIN = 0.004, 0.03, 1.02


@dataclass
class Piece:
    """One analytic surface: static facts that shape the kernel's code, and its numbers in float64.

    Attributes
    ----------
    index : int
        Number of the surface in the scene.
    kind : str
        "plane", "conic", "asphere" or "cone" (a cylinder is a cone of no slope).
    frame : int
        Number of the orientation it shares with other pieces; 0 is unrotated.
    axis : int
        Number of the axis (orientation and lateral position) it shares with other pieces.
    z : float
        Position of the vertex along the axis, mm.
    quadric : (4,) float
        a, b, e, g.
    sign : float
        +1 or -1: grad F times this points along the surface's normal.
    coefficients : tuple of float
        a4, a6, … up to the last that is not zero.
    outer, inner : float
        Clear radii, mm; ``outer`` is 0 for a rectangle.
    half_size : (2,) float
        Rectangle, mm.
    z_range : (2,) float
        Extent along the axis from the vertex, mm.
    slope : float
        Largest |dz/dr| within the aperture (aspheres), dr/dz (cones).
    r0 : float
        Radius of a cone at the vertex, mm.
    wall : bool
        Made by `frustum`: mechanics, of which a ray meets little.
    departure : float
        Largest distance in z of an asphere from its conic, mm, if it is so small that the conic's hit is a safe start
        for Newton's method; 0 if not.
    """

    index: int
    kind: str
    frame: int
    axis: int
    z: float
    quadric: np.ndarray
    sign: float
    coefficients: tuple[float, ...]
    outer: float
    inner: float
    half_size: tuple[float, float]
    z_range: tuple[float, float]
    slope: float
    wall: bool
    r0: float = 0.0
    departure: float = 0.0

    @property
    def extent(self) -> tuple[float, float]:
        """Extent along the axis, mm."""
        return self.z + self.z_range[0], self.z + self.z_range[1]

    @property
    def size(self) -> float:
        """Largest distance from the axis, mm."""
        return self.outer or float(np.hypot(*self.half_size))

    @property
    def least_radius(self) -> float:
        """Distance from the axis that no point of the piece is nearer than, mm."""
        if self.kind == "cone":
            return min(self.r0 + self.slope * z for z in self.z_range)
        return self.inner if self.outer else 0.0

    @property
    def conic(self) -> tuple[float, float]:
        """Curvature (1/mm) and conic constant of an asphere; zeros of a plane."""
        a, b = (float(v) for v in self.quadric[:2])
        return a, b / a - 1 if a else 0.0

    @property
    def columns(self) -> dict[str, float]:
        """The numbers that its columns stand for, see `mistray.surfaces.gradient_columns`; the others are 0."""
        if self.kind == "cone":
            return {"r0": self.r0, "slope": self.slope, "z_low": self.z_range[0], "z_high": self.z_range[1]}
        shape = dict(zip(("curvature", "conic", *COEFFICIENTS), (*self.conic, *self.coefficients), strict=False))
        if self.outer:
            return {**shape, "outer": self.outer, "inner": self.inner}
        return {**shape, "half_width": self.half_size[0], "half_height": self.half_size[1]}


def vertex_frame(kind: str, values: Mapping[str, float], matrix: np.ndarray) -> np.ndarray:
    """Frame of the vertex of a surface, (4, 4) float64: a frustum's lies at its first rim, on the axis."""
    if kind != "frustum":
        return matrix
    vertex = matrix.copy()
    vertex[:3, 3] += matrix[:3, 2] * values["z0"]
    return vertex


def piece_numbers(kind: str, values: Mapping[str, float]) -> dict[str, Any]:
    """
    What a `Piece` has of its own, in the frame of its vertex.

    Parameters
    ----------
    kind : str
        "asphere" or "frustum".
    values : mapping of str to float
        Parameters of the plugin.
    """
    return _frustum(values) if kind == "frustum" else _asphere(values)


def _asphere(v: Mapping[str, float]) -> dict[str, Any]:
    coefficients = [v[key] for key in COEFFICIENTS]
    while coefficients and coefficients[-1] == 0:
        coefficients.pop()
    c, k = v["curvature"], v["conic"]
    rectangular = "half_width" in v
    outer = float(np.hypot(v["half_width"], v["half_height"])) if rectangular else v["semi_diameter"]
    kind = "asphere" if coefficients else "conic" if c else "plane"
    r = np.linspace(0.0, min(outer, conic_end(c, k)), 2001)
    z = np.asarray(sag(r * r, c, k, coefficients))
    if np.isnan(z[-1]):  # the rounding of the point where the conic stands upright
        z[-1] = 1 / (c * (1 + k)) + sag(r[-1] ** 2, 0.0, 0.0, coefficients)
    slope = np.gradient(z, r, edge_order=2) if kind != "plane" else np.zeros_like(r)
    span = max(float(np.ptp(z)), 1e-6 * outer)
    return {
        "kind": kind,
        "quadric": np.array([c, c * (1 + k), -2.0, 0.0]),
        "sign": -1.0,
        "coefficients": tuple(coefficients),
        "outer": 0.0 if rectangular else v["semi_diameter"],
        "inner": 0.0 if rectangular else v["inner_semi_diameter"],
        "half_size": (v["half_width"], v["half_height"]) if rectangular else (0.0, 0.0),
        "z_range": (float(z.min()) - 1e-3 * span, float(z.max()) + 1e-3 * span),
        "slope": 1.02 * float(np.max(np.abs(slope))),
        "wall": False,
        "departure": _mild_departure(c, k, coefficients, outer) if kind == "asphere" else 0.0,
    }


def _mild_departure(c: float, k: float, coefficients: list[float], outer: float) -> float:
    """`Piece.departure` of an asphere."""
    r = np.linspace(0.0, MILD_MARGIN * outer, 513)
    if c == 0 or (1 + k) * (c * r[-1]) ** 2 >= 1:
        return 0.0
    polynomial = np.asarray(sag(r * r, 0.0, 0.0, coefficients))
    departure, slope = np.max(np.abs(polynomial)), np.max(np.abs(np.gradient(polynomial, r)))
    return float(departure) if departure < MILD_DEPARTURE * outer and slope < MILD_SLOPE else 0.0


def _frustum(v: Mapping[str, float]) -> dict[str, Any]:
    length = v["z1"] - v["z0"]
    if length == 0:
        return {
            "kind": "plane",
            "quadric": np.array([0.0, 0.0, 1.0, 0.0]),
            "sign": 1.0,
            "coefficients": (),
            "outer": max(v["r0"], v["r1"]),
            "inner": min(v["r0"], v["r1"]),
            "half_size": (0.0, 0.0),
            "z_range": (0.0, 0.0),
            "slope": 0.0,
            "wall": True,
        }
    m = (v["r1"] - v["r0"]) / length
    return {
        "kind": "cone",
        "quadric": np.array([1.0, -m * m, -2 * v["r0"] * m, -(v["r0"] ** 2)]),
        "sign": 1.0,
        "coefficients": (),
        "outer": max(v["r0"], v["r1"]),
        "inner": 0.0,
        "half_size": (0.0, 0.0),
        "z_range": (min(0.0, length), max(0.0, length)),
        "slope": m,
        "r0": v["r0"],
        "wall": True,
    }
