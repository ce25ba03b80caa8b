"""Distance of points from the edge of a freeform's outline, mm, for derivatives with respect to its parameters.

Added figures combine by the greater of two depths; cuts and intersections by the lesser. Close to the edge the depth is
the distance from it, except at corners; for an ellipse it is so to first order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.physics.geometry.outline import Outline
from mistray.surfaces.families.freeform_sag import FreeformSag

TINY = 1e-20  # mm², added so that no square root has an infinite slope
STEPS = 3  # Newton steps onto the edge
DIFFERENCE = 0.01  # spacing of finite differences for the outward direction, in units of the step beyond the edge


@dataclass(frozen=True)
class FreeformFamily:
    """
    Form of a freeform's sag and outline, on which its kernel code depends.

    Methods take points x, y, z, mm, in the frame about the middle of the outline, and a mapping `n` from the names in
    `numbers` to values: lengths in mm, curvatures in 1/mm, angles in degrees.

    Attributes
    ----------
    sag : FreeformSag
        Form of the sag.
    outline : tuple
        `Outline.form`: kind, sign, number of sizes, and whether it is rotated, for each figure.
    names : tuple of str
        Names of the outline's parameters, such as "clip_1_radius".
    """

    sag: FreeformSag
    outline: tuple[tuple[str, str, int, bool], ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, sag: FreeformSag, outline: Outline) -> FreeformFamily:
        """Create the family of surfaces with a given form of sag and outline."""
        return cls(sag, outline.form, tuple(outline.numbers()))

    @cached_property
    def numbers(self) -> tuple[str, ...]:
        """Names of all parameters of the sag and the outline."""
        return (*self.sag.numbers, *self.names)

    def residual(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> Any:
        """Return F = z - sag(x, y), mm, at points, mm; 0 on the surface."""
        return self.sag.residual(x, y, z, n)

    def gradient(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """Return the derivatives of F = z - sag with respect to x, y and z, dimensionless, at points, mm."""
        return self.sag.gradient(x, y, z, n)

    def coordinate(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> Any:
        """Return how far points lie beyond the outline's edge, mm: minus their `depth`; negative inside."""
        return -self.depth(x, y, n)

    def depth(self, x: Any, y: Any, n: Mapping[str, Any]) -> Any:
        """
        Return the depth of points within the outline, mm: distance to its edge, negative outside.

        Near the edge the depth is the distance from it, except at corners; for an ellipse it is so to first order.
        Farther away only its sign is exact.
        """
        found: Any = None
        for k, (kind, sign, sizes, turned) in enumerate(self.outline, start=1):
            start = f"clip_{k}_"
            own = {name[len(start) :]: n[name] for name in self.names if name.startswith(start)}
            u, v = x - own["x"], y - own["y"]
            if turned:
                angle = own["angle_deg"] * (dr.pi / 180)
                c, s = dr.cos(angle), dr.sin(angle)
                u, v = u * c + v * s, v * c - u * s
            here = _DEPTHS[kind](u, v, own) if kind != "polygon" else _polygon(u, v, own, sizes // 2)
            here = -here if sign == "-" else here
            join = dr.maximum if sign == "+" else dr.minimum
            found = here if found is None else join(found, here)
        return found

    def edge(self, x: Any, y: Any, n: Mapping[str, Any], step: Any) -> EdgePoint:
        """
        Return the points of the outline's edge nearest to points x, y inside, with the outward directions.

        Parameters
        ----------
        x, y : mi.Float64
            Coordinates of the points inside, mm.
        n : mapping
            Values of the family's parameters, by name.
        step : mi.Float64
            Distance beyond the edge, mm, at which it is tested whether the outline ends there.
        """
        h = DIFFERENCE * step

        def nearer(
            k: mi.UInt32, x: mi.Float64, y: mi.Float64, out_x: mi.Float64, out_y: mi.Float64
        ) -> tuple[mi.UInt32, mi.Float64, mi.Float64, mi.Float64, mi.Float64]:
            x, y = x - 2 * h * out_x, y - 2 * h * out_y  # inside, where no seam of figures lies between the differences
            depth = self.depth(x, y, n)
            out_x, out_y = (depth - self.depth(x + h, y, n)) / h, (depth - self.depth(x, y + h, n)) / h
            square = dr.maximum(out_x * out_x + out_y * out_y, TINY)
            x, y = x + depth * out_x / square, y + depth * out_y / square
            return k + 1, x, y, out_x * dr.rsqrt(square), out_y * dr.rsqrt(square)

        start = (
            dr.zeros(mi.UInt32, dr.width(x)),
            x,
            y,
            dr.zeros(mi.Float64, dr.width(x)),
            dr.zeros(mi.Float64, dr.width(x)),
        )
        _, x, y, out_x, out_y = dr.while_loop(start, lambda k, *_: k < STEPS, nearer, mode="symbolic", label="edge")
        ends = (dr.abs(self.depth(x, y, n)) < step) & (self.depth(x + step * out_x, y + step * out_y, n) < 0)
        return EdgePoint(x, y, out_x, out_y, ends)


@dataclass
class EdgePoint:
    """
    Point on the edge of an outline, with the outward direction.

    Attributes
    ----------
    x, y : mi.Float64
        Coordinates of the point, mm.
    out_x, out_y : mi.Float64
        Components of the unit vector out of the outline.
    real : mi.Bool
        Whether the outline ends there; it does not where two of its figures overlap or abut.
    """

    x: mi.Float64
    y: mi.Float64
    out_x: mi.Float64
    out_y: mi.Float64
    real: mi.Bool


def _circle(u: Any, v: Any, n: Mapping[str, Any]) -> Any:
    return n["radius"] - dr.sqrt(u * u + v * v + TINY)


def _ellipse(u: Any, v: Any, n: Mapping[str, Any]) -> Any:
    a, b = n["half_width"], n["half_height"]
    u, v = u / a, v / b
    level = dr.sqrt(u * u + v * v + TINY)
    return (1 - level) * level * dr.rsqrt((u / a) * (u / a) + (v / b) * (v / b) + TINY)


def _rectangle(u: Any, v: Any, n: Mapping[str, Any]) -> Any:
    return dr.minimum(n["half_width"] - dr.abs(u), n["half_height"] - dr.abs(v))


_DEPTHS = {"circle": _circle, "ellipse": _ellipse, "rectangle": _rectangle}


def _polygon(u: Any, v: Any, n: Mapping[str, Any], count: int) -> Any:
    """
    Return the signed distance of points from the nearest side of a polygon of `count` corners, mm; positive inside.

    If a corner is nearest, the sign is that of the corner and not of the lines beyond it. Points next to a convex
    corner lie outside, points next to a concave one inside.
    """
    corners = [(n[f"x{k}"], n[f"y{k}"]) for k in range(1, count + 1)]
    sides = [(x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True)]
    area: Any = 0
    nearest: Any = None
    depth: Any = None
    for k, ((x0, y0), (along, across)) in enumerate(zip(corners, sides, strict=True)):
        area = area + x0 * across - y0 * along
        before, after = sides[k - 1], sides[(k + 1) % count]
        x, y = u - x0, v - y0
        square = along * along + across * across + TINY
        t = dr.detach((x * along + y * across) / square)
        off_x, off_y = x - dr.clip(t, 0, 1) * along, y - dr.clip(t, 0, 1) * across
        distance2 = off_x * off_x + off_y * off_y
        left = (along * y - across * x) * dr.rsqrt(square)  # of the side's line
        turn = dr.select(t < 0, before[0] * across - before[1] * along, along * after[1] - across * after[0])
        at_corner = -dr.sign(dr.detach(turn)) * dr.sqrt(distance2 + TINY)
        here, distance2 = dr.select((t < 0) | (t > 1), at_corner, left), dr.detach(distance2)
        if nearest is None:
            nearest, depth = distance2, here
        else:
            closer = distance2 < nearest
            nearest, depth = dr.select(closer, distance2, nearest), dr.select(closer, here, depth)
    return depth * dr.sign(dr.detach(area))
