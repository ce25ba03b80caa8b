"""How deep a point lies within an outline: what the derivative by its numbers needs where light passes its edge.

Figures add to the deeper of two depths, cut and intersect to the lesser. Close to the edge, where it counts, the depth
is the distance from it but at corners; of an ellipse to first order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr

from mistray.physics.geometry.outline import Outline
from mistray.surfaces.families.freeform_sag import FreeformSag

TINY = 1e-20  # mm², so that no root has an infinite slope
PROBE = 10.0  # of the differences that give the direction out of an outline, in units of the step


@dataclass(frozen=True)
class FreeformFamily:
    """
    What the code of a surface of any sag within any outline hangs on.

    Attributes
    ----------
    sag : FreeformSag
    outline : tuple
        `Outline.form`: kind, sign, number of sizes and whether it is turned, of each figure.
    names : tuple of str
        Of the outline's numbers, such as "clip_1_radius".
    """

    sag: FreeformSag
    outline: tuple[tuple[str, str, int, bool], ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, sag: FreeformSag, outline: Outline) -> FreeformFamily:
        """The family of a sag within an outline."""
        return cls(sag, outline.form, tuple(outline.numbers()))

    @cached_property
    def numbers(self) -> tuple[str, ...]:
        """Names of all numbers."""
        return (*self.sag.numbers, *self.names)

    def residual(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> Any:
        """F = z - sag, mm."""
        return self.sag.residual(x, y, z, n)

    def gradient(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> tuple[Any, Any, Any]:
        """The derivatives of F by x, y and z."""
        return self.sag.gradient(x, y, z, n)

    def coordinate(self, x: Any, y: Any, z: Any, n: Mapping[str, Any]) -> Any:
        """How far a point lies outside of the outline, mm; less than 0 inside."""
        return -self.depth(x, y, n)

    def depth(self, x: Any, y: Any, n: Mapping[str, Any]) -> Any:
        """How far a point lies within the outline, mm; less than 0 outside."""
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

    def beside(self, x: Any, y: Any, n: Mapping[str, Any], step: Any) -> tuple[Any, Any, Any]:
        """The point of the surface, continued, that lies `step` (mm) beyond the edge next to a point (x, y)."""
        h = PROBE * step
        out_x = self.depth(x - h, y, n) - self.depth(x + h, y, n)
        out_y = self.depth(x, y - h, n) - self.depth(x, y + h, n)
        way = (self.depth(x, y, n) + step) * dr.rsqrt(dr.maximum(out_x * out_x + out_y * out_y, TINY))
        x, y = x + way * out_x, y + way * out_y
        return x, y, self.sag.evaluate(x, y, n)[0]


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
    """Distance from the line of the next side; positive inside."""
    corners = [(n[f"x{k}"], n[f"y{k}"]) for k in range(1, count + 1)]
    area: Any = 0
    nearest: Any = None
    depth: Any = None
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        area = area + x0 * y1 - x1 * y0
        along, across = x1 - x0, y1 - y0
        square = along * along + across * across + TINY
        t = dr.clip(dr.detach(((u - x0) * along + (v - y0) * across) / square), 0, 1)
        off_x, off_y = u - x0 - t * along, v - y0 - t * across
        distance = dr.detach(off_x * off_x + off_y * off_y)
        side = (along * (v - y0) - across * (u - x0)) * dr.rsqrt(square)  # positive to the left
        if nearest is None:
            nearest, depth = distance, side
        else:
            closer = distance < nearest
            nearest, depth = dr.select(closer, distance, nearest), dr.select(closer, side, depth)
    return depth * dr.sign(dr.detach(area))
