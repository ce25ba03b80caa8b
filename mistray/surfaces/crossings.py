"""Crossings of a ray with one analytic surface within its bounds, in float32 in the kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from mistray.physics.geometry.sag import in_proportion, sag, sag_derivative
from mistray.surfaces.extrema import larger, smaller

if TYPE_CHECKING:
    from mistray.surfaces.families.cone import Cone
    from mistray.surfaces.families.sag_surface import SagSurface
    from mistray.surfaces.surface import TracedSurface

ONE_STEP = 1e-6  # error after one Newton step that is small enough, in units of the aperture
AXIAL = 1e-16  # sine squared to the axis below which a ray does not move sideways
FAR = 1e30  # stands for infinity where it may be multiplied by zero


# Numbers of a surface in a row of the table; four of them are read at a time
ROW = (
    *("z", "self_hit", "curvature", "one_plus_conic"),
    *("r0", "slope", "z_low", "z_high"),
    *("outer2", "inner2", "half_width", "half_height"),
)


@dataclass
class Numbers:
    """
    Shape and bounds of a plane, conic, asphere or cone as Dr.Jit variables. Bounds include the overlap with neighbours.

    Attributes
    ----------
    z : mi.Float
        Position of the vertex along the axis, mm.
    curvature, one_plus_conic : mi.Float
        Curvature, 1/mm, and 1 plus the conic constant.
    r0, slope : mi.Float
        Radius of a cone at its vertex, mm, and its slope dr/dz; for an asphere, the largest slope |dz/dr| of its sag.
    outer2, inner2 : mi.Float
        Squares of the outer radius (of a rectangle, half its diagonal) and of the inner radius, mm².
    half_width, half_height : mi.Float
        Half sides of a rectangular aperture, mm; not used for a round one.
    z_low, z_high : mi.Float
        Ends of the surface along the axis from the vertex, mm.
    self_hit : mi.Float
        Least distance at which a ray that leaves the surface may meet it again, mm.
    wide2, departure : mi.Float
        For a mild asphere: square of the radius within which steps stay, mm², and departure from its conic, mm; not
        used for other surfaces.
    shape : tuple
        Curvature, conic constant, coefficients and their unit, as parameters of `mistray.physics.geometry.sag`.
    """

    z: mi.Float
    curvature: mi.Float
    one_plus_conic: mi.Float
    r0: mi.Float
    slope: mi.Float
    outer2: mi.Float
    inner2: mi.Float
    half_width: mi.Float
    half_height: mi.Float
    z_low: mi.Float
    z_high: mi.Float
    self_hit: mi.Float
    wide2: mi.Float
    departure: mi.Float
    shape: tuple[Any, ...]

    @classmethod
    def of(cls, surface: TracedSurface) -> Numbers:
        """Return the parameters of a surface as opaque Dr.Jit variables, so that kernels do not hold their values."""

        def opaque(value: float) -> mi.Float:
            return dr.opaque(mi.Float, value)

        values = _values(surface)
        coefficients, per_area = in_proportion(values.pop("coefficients"), surface.size)
        numbers = values["curvature"], values.pop("conic"), per_area, *coefficients
        curvature, conic, unit, *rest = (opaque(value) for value in numbers)
        return cls(**{name: opaque(value) for name, value in values.items()}, shape=(curvature, conic, rest, unit))

    @staticmethod
    def row(surface: TracedSurface) -> list[float]:
        """Return the parameters of a surface as a row of the device table that `read` reads, in the order of `ROW`."""
        values = _values(surface)
        return [values[name] for name in ROW]

    @classmethod
    def read(cls, rows: mi.Float, fours: tuple[int, ...], place: mi.UInt32) -> Numbers:
        """
        Return the parameters of surfaces other than aspheres, read from the rows of a table; those not read are 0.

        `fours` are the groups of four parameters of `ROW` that the family of the surfaces needs. `place` is the row
        that each lane reads.
        """
        values = dict.fromkeys((field.name for field in fields(cls)), mi.Float(0))
        for four in fours:
            found = dr.gather(mi.Vector4f, rows, len(ROW) // 4 * place + four)
            values |= dict(zip(ROW[4 * four : 4 * four + 4], found, strict=True))
        return cls(**values)


def _values(surface: TracedSurface) -> dict[str, Any]:
    """
    Return the parameters of a surface by name: 0, or 1 for `one_plus_conic`, where its family has none.

    Bounds include the surface's overlap, mm.
    """
    values: dict[str, Any] = dict.fromkeys((field.name for field in fields(Numbers)), 0.0)
    del values["shape"]
    return {
        **values,
        "one_plus_conic": 1.0,
        "conic": 0.0,
        "coefficients": (),
        "z": surface.z,
        "outer2": (surface.size + surface.overlap) ** 2,
        "z_low": surface.z_range[0] - surface.overlap,
        "z_high": surface.z_range[1] + surface.overlap,
        "self_hit": surface.self_hit,
        **surface.kernel_values(),
    }


def turned(turn: Sequence[mi.Float], v: mi.Vector3f) -> mi.Vector3f:
    """
    Return a vector of the scene's frame in a local frame.

    `turn` has the nine elements, row by row, of a matrix whose columns are the local frame's axes.
    """
    return mi.Vector3f(*(turn[k] * v.x + turn[3 + k] * v.y + turn[6 + k] * v.z for k in range(3)))


@dataclass
class AxisRay:
    """
    Ray in the frame of a surface axis, with products that all surfaces on the axis share; lengths in mm.

    ox, oy, oz is its origin, and dx, dy, dz its unit direction; z runs along the axis.
    """

    ox: mi.Float
    oy: mi.Float
    oz: mi.Float
    dx: mi.Float
    dy: mi.Float
    dz: mi.Float
    dd: mi.Float  # dx² + dy²
    od: mi.Float  # ox dx + oy dy
    oo: mi.Float  # ox² + oy²
    inv_dz: mi.Float

    @classmethod
    def of(cls, ox: mi.Float, oy: mi.Float, oz: mi.Float, d: mi.Vector3f) -> AxisRay:
        """Return the ray with origin ox, oy, oz, mm, and unit direction d, both in the frame of an axis."""
        return cls(
            ox,
            oy,
            oz,
            d.x,
            d.y,
            d.z,
            dr.fma(d.x, d.x, d.y * d.y),
            dr.fma(ox, d.x, oy * d.y),
            dr.fma(ox, ox, oy * oy),
            dr.rcp(d.z),
        )

    def widest2(self, t: mi.Float) -> mi.Float:
        """Return the squared largest distance from the axis, mm², between the ray's origin and its point at t, mm."""
        t = smaller(t, FAR)
        return larger(self.oo, dr.fma(t, dr.fma(t, self.dd, 2 * self.od), self.oo))

    def closest(self) -> mi.Float:
        """Return the distance, mm, at which the ray is closest to the axis, negative before its origin; 0 along it."""
        return dr.select(self.dd < AXIAL, 0, -self.od / self.dd)

    def lateral(self, t: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return the x and y coordinates of the ray's point at the distance t, mm."""
        return dr.fma(t, self.dx, self.ox), dr.fma(t, self.dy, self.oy)


def _inside(ray: AxisRay, t: mi.Float, p: SagSurface, n: Numbers) -> mi.Bool:
    """Return a mask of rays whose point at the distance t, mm, lies within the surface's aperture."""
    x, y = ray.lateral(t)
    if not p.outer:
        return (dr.abs(x) <= n.half_width) & (dr.abs(y) <= n.half_height)
    r2 = dr.fma(x, x, y * y)
    ok = r2 <= n.outer2
    return ok & (r2 >= n.inner2) if p.inner > 0 else ok


def plane_crossing(ray: AxisRay, p: SagSurface, n: Numbers, own: mi.Bool) -> mi.Float:
    """
    Return the distance to a ray's crossing with a plane within its aperture, mm; infinite for none.

    `own` is true for rays that start on it and so do not meet it again.
    """
    t = (n.z - ray.oz) * ray.inv_dz
    ok = (t > 0) & ~own & _inside(ray, t, p, n)
    return dr.select(ok, t, dr.inf)


def _roots(
    t0: mi.Float, a: mi.Float, b: mi.Float, g: mi.Float, own: mi.Bool
) -> tuple[mi.Float, mi.Float, mi.Float, mi.Bool]:
    """
    Return two distances, mm, at which a ray crosses a quadric, the ratio (b² - a g)/a, and whether it crosses at all.

    The distances are from the ray's origin; for a ray that starts on the surface, `own`, the first is 0. `a`, `b` and
    `g` are the coefficients of a u² + 2 b u + g = 0. There u is the distance, mm, from the ray's point at `t0`, the one
    closest to the vertex or the axis.

    From a distant origin, the difference of two squares would round away what is small. A ray from 1 m away met a wall
    of 26 mm radius 1.5 µm behind it, and the end of a vane inside instead. See E. Haines et al., Precision improvements
    for ray/sphere intersection, Ray Tracing Gems (2019), chapter 7.
    """
    discriminant = dr.fma(b, b, -a * g)
    q = -(b + dr.mulsign(dr.sqrt(larger(discriminant, 0)), b))
    ta, tb = dr.select(own, 0, t0 + q / a), dr.select(own, 2 * (t0 - b / a), t0 + g / q)
    return ta, tb, discriminant / a, own | (discriminant >= 0)


def _conic_roots(ray: AxisRay, n: Numbers, own: mi.Bool) -> tuple[mi.Float, mi.Float, mi.Float, mi.Bool]:
    """Return `_roots` of a ray and a conic: distances from the ray's origin, mm, with `t0` nearest to the vertex."""
    oz, c, k1 = ray.oz - n.z, n.curvature, n.one_plus_conic
    t0 = -dr.fma(oz, ray.dz, ray.od)
    (x, y), z = ray.lateral(t0), dr.fma(t0, ray.dz, oz)
    a = c * dr.fma(k1 * ray.dz, ray.dz, ray.dd)
    b = dr.fma(c, dr.fma(k1 * z, ray.dz, dr.fma(x, ray.dx, y * ray.dy)), -ray.dz)
    return _roots(t0, a, b, dr.fma(c, dr.fma(k1 * z, z, dr.fma(x, x, y * y)), -2 * z), own)


def _first(ta: mi.Float, tb: mi.Float, ok_a: mi.Bool, ok_b: mi.Bool) -> mi.Float:
    return smaller(dr.select(ok_a, ta, dr.inf), dr.select(ok_b, tb, dr.inf))


def conic_crossing(ray: AxisRay, p: SagSurface, n: Numbers, own: mi.Bool) -> mi.Float:
    """
    Return the distance to a ray's first crossing with a conic within its aperture, mm; infinite for none.

    `own` is true for rays that start on it, which may meet it again.
    """
    oz, c, k1 = ray.oz - n.z, n.curvature, n.one_plus_conic
    ta, tb, _, real = _conic_roots(ray, n, own)
    nearest = dr.select(own, n.self_hit, 0)

    def ok(t: mi.Float) -> mi.Bool:
        z = dr.fma(t, ray.dz, oz)
        sheet = c * k1 * z < 1  # the half of the conic that holds the vertex
        return real & (t > nearest) & sheet & _inside(ray, t, p, n)

    return _first(ta, tb, ok(ta), ok(tb))


def mild_asphere(ray: AxisRay, p: SagSurface, n: Numbers, own: mi.Bool) -> tuple[mi.Float, mi.Bool]:
    """
    Return the distance, mm, at which a ray hits an asphere close to its conic, and a mask of unsafe rays.

    One or two Newton steps lead there from the conic's hit; the distance is infinite without a hit. A ray is unsafe if
    it meets the conic twice within the aperture, nearly touches it, or could come back to the asphere when it starts on
    it (`own`). It is unsafe, too, if the steps do not converge. Unsafe rays need the full search.
    """
    oz, c, k1 = ray.oz - n.z, n.curvature, n.one_plus_conic
    ta, tb, shallow, real = _conic_roots(ray, n, own)
    # The conic is hit where the asphere is, but for the departure along the ray
    early = dr.select(own, n.self_hit, -4 * n.departure)

    def near(t: mi.Float) -> mi.Bool:
        x, y = ray.lateral(t)
        sheet = c * k1 * dr.fma(t, ray.dz, oz) < 1
        return real & (t > early) & sheet & (dr.fma(x, x, y * y) <= n.wide2)

    near_a, near_b = near(ta), near(tb)
    found = near_a | near_b
    touching = dr.abs(shallow) < 4 * n.departure
    unsure = (near_a & near_b) | (own & found) | (touching & ~own)
    t = dr.select(near_a, ta, tb)
    # A step squares the error; the interaction at the hit adds one more
    for _ in range(1 if p.departure**2 * abs(p.curvature) < ONE_STEP * p.outer else 2):
        x, y = ray.lateral(t)
        r2 = smaller(dr.fma(x, x, y * y), n.wide2)
        height = dr.fma(t, ray.dz, oz) - sag(r2, *n.shape)
        slope = ray.dz - 2 * sag_derivative(r2, *n.shape) * dr.fma(x, ray.dx, y * ray.dy)
        step = height / slope
        t -= step
    unsure |= found & ~(dr.abs(step) * dr.abs(slope) < 4 * n.departure)
    ok = found & ~unsure & (t > 0) & _inside(ray, t, p, n)
    return dr.select(ok, t, dr.inf), unsure


def cone_crossing(ray: AxisRay, p: Cone, n: Numbers, own: mi.Bool) -> mi.Float:
    """
    Return the distance to a ray's first crossing with a cone between its ends, mm; infinite for none.

    `own` is true for rays that start on it, which may meet it again.
    """
    # Counted from the point between the ends of the cone that is closest to the axis
    oz = ray.oz - n.z
    low, high = (n.z_low - oz) * ray.inv_dz, (n.z_high - oz) * ray.inv_dz
    t0 = larger(smaller(ray.closest(), larger(low, high)), smaller(low, high))
    x, y = ray.lateral(t0)
    r = dr.fma(n.slope, dr.fma(t0, ray.dz, oz), n.r0)
    a = dr.fma(-n.slope * ray.dz, n.slope * ray.dz, ray.dd)
    b = dr.fma(-n.slope * r, ray.dz, dr.fma(x, ray.dx, y * ray.dy))
    ta, tb, _, real = _roots(t0, a, b, dr.fma(-r, r, dr.fma(x, x, y * y)), own)
    nearest = dr.select(own, n.self_hit, 0)

    def ok(t: mi.Float) -> mi.Bool:
        z = dr.fma(t, ray.dz, oz)
        return real & (t > nearest) & (z >= n.z_low) & (z <= n.z_high)

    return _first(ta, tb, ok(ta), ok(tb))


def stretch(
    ray: AxisRay, oz: mi.Float, outer2: mi.Float, z_low: mi.Float, z_high: mi.Float
) -> tuple[mi.Float, mi.Float]:
    """
    Return the distances, mm, at which a ray enters and leaves a cylinder about z with flat ends.

    `outer2` is the square of its radius, mm²; `z_low` and `z_high` are its ends, and `oz` is the z of the ray's origin
    over the same plane, mm. The first distance is 0 if the ray starts within. If the second is not greater than the
    first, the ray misses the cylinder.
    """
    t0 = ray.closest()
    x, y = ray.lateral(t0)
    inside2 = outer2 - dr.fma(x, x, y * y)
    half = dr.select(ray.dd < AXIAL, dr.inf, dr.sqrt(larger(inside2, 0) / ray.dd))  # a ray along the axis never leaves
    z0, z1 = (z_low - oz) * ray.inv_dz, (z_high - oz) * ray.inv_dz
    start = larger(larger(t0 - half, smaller(z0, z1)), 0)
    end = smaller(t0 + half, larger(z0, z1))
    return start, dr.select(inside2 >= 0, end, -1)


def asphere_entry(ray: AxisRay, n: Numbers, own: mi.Bool) -> mi.Float:
    """
    Return the distance, mm, at which a ray enters the cylinder that bounds an asphere; infinity if it misses.

    It is infinite, too, for rays that start on the asphere (`own`) and are too steep to come back to it.
    """
    oz = ray.oz - n.z
    start, end = stretch(ray, oz, n.outer2, n.z_low, n.z_high)
    # A ray steeper than the surface is anywhere cannot come back to it
    leaves = own & (dr.square(ray.dz) > dr.square(n.slope) * ray.dd)
    return dr.select((end > start) & ~leaves, start, dr.inf)
