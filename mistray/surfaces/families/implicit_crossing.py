"""First crossing of rays with a surface given by a formula F = 0, within its bounds, in the kernel.

The ray's stretch through a cylinder and a slab around the surface is searched in equal intervals. The search stops
where F changes sign, or where an extremum of F within an interval lies beyond zero. Safeguarded Newton steps then find
the crossing. Crossings outside the bounds are passed. A part of the surface may be crossed twice within an interval. It
is found if the derivative of F along the ray shows the turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from mistray.surfaces.crossings import AxisRay, stretch
from mistray.surfaces.gradient_columns import HIGH, LOW

if TYPE_CHECKING:
    from mistray.surfaces.families.implicit_surface import ImplicitSurface

INTERVALS = 32
MOST_TRIES = 3 * INTERVALS  # intervals in all, with those searched again behind a crossing that was passed
STEPS = 24
CONVERGED = 1e-3  # last but one Newton step that is small enough, in units of the size: the last step squares the error
ON_IT = 1e-30  # stands for F on the surface itself, with the sign that the ray leaves with


@dataclass
class ImplicitNumbers:
    """
    Parameters of an implicit surface on the device; the bounds include its overlap with neighbours.

    Attributes
    ----------
    values : dict
        Values of the parameters of the family's formula, by name.
    z : mi.Float
        Position of the origin of its frame along the axis, mm.
    z_low, z_high : mi.Float
        Bounds along the axis, from that origin, mm.
    outer2 : mi.Float
        Square of the largest radius, mm².
    low, high : mi.Float
        Ends of the coordinate along the profile, mm.
    size : mi.Float
        Largest radius, mm.
    self_hit : mi.Float
        Least distance at which a ray that leaves the surface may meet it again, mm.
    """

    values: dict[str, mi.Float]
    z: mi.Float
    z_low: mi.Float
    z_high: mi.Float
    outer2: mi.Float
    low: mi.Float
    high: mi.Float
    size: mi.Float
    self_hit: mi.Float

    @classmethod
    def of(cls, surface: ImplicitSurface) -> ImplicitNumbers:
        """Return the parameters of a surface as opaque Dr.Jit variables, so that kernels do not hold their values."""
        more, (low, high) = surface.overlap, surface.z_range
        along = [more * surface.rim_stretch(surface.rim_point(rim)) for rim in (LOW, HIGH)]
        bounds = (
            low - more,
            high + more,
            (surface.size + more) ** 2,
            surface.ends[0] - along[0],
            surface.ends[1] + along[1],
        )
        numbers = (surface.z, *bounds, surface.size, surface.self_hit)
        return cls(
            {name: dr.opaque(mi.Float, value) for name, value in surface.values.items()},
            *(dr.opaque(mi.Float, value) for value in numbers),
        )


def first_crossing(ray: AxisRay, family: Any, n: ImplicitNumbers, own: mi.Bool) -> mi.Float:
    """
    Return the distance to a ray's first crossing with an implicit surface within its bounds, mm; infinite for none.

    Parameters
    ----------
    ray : AxisRay
        Rays in the frame of the surface's axis.
    family : type
        Has `residual`, `gradient` and `coordinate`, see `mistray.plugins.shapes.implicit.Implicit`.
    n : ImplicitNumbers
        Parameters of the surface.
    own : mi.Bool
        Whether the ray starts on the surface.
    """
    oz = ray.oz - n.z
    bounds = n.outer2, n.z_low, n.z_high
    start, end = stretch(ray, oz, *bounds)
    active = end > start
    length = dr.select(active, end - start, 0)
    stride = length / INTERVALS

    def point(s: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
        t = start + s
        return *ray.lateral(t), dr.fma(t, ray.dz, oz)

    def f(s: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Return F at a distance s, mm, from the start of the stretch, and its derivative along the ray."""
        at = point(s)
        gx, gy, gz = family.gradient(*at, n.values)
        return mi.Float(family.residual(*at, n.values)), gx * ray.dx + gy * ray.dy + gz * ray.dz

    def sign(v: mi.Float) -> mi.Float:
        return dr.mulsign(mi.Float(1), v)

    def root(low: mi.Float, high: mi.Float, side: mi.Float, going: mi.Bool) -> mi.Float:
        """Return the distance between `low` and `high`, mm, at which F changes its sign from `side`."""

        def newton(k, s, low, high, going):  # type: ignore[no-untyped-def]
            value, slope = f(s)
            before = sign(value) == side
            low, high = dr.select(before, s, low), dr.select(before, high, s)
            trial = s - value / slope
            within = (trial >= low) & (trial <= high)
            new = dr.select(within, trial, 0.5 * (low + high))
            # Half of a short bracket is a short step, too, and does not show how near the root is
            going = going & (~within | (dr.abs(new - s) > CONVERGED * n.size)) & (k < STEPS)
            return k + 1, new, low, high, going

        _, s, low, high, _ = dr.while_loop(
            (mi.UInt32(0), 0.5 * (low + high), mi.Float(low), mi.Float(high), mi.Bool(going)),
            lambda *v: v[4],
            newton,
            labels=("k", "s", "low", "high", "going"),
            mode="symbolic",
            label="newton",
        )
        value, slope = f(s)
        last = s - value / slope
        return dr.select((last >= low) & (last <= high), last, s)

    def walk(k, tries, s, fs, gs, best, going):  # type: ignore[no-untyped-def]
        after = dr.minimum((mi.Float(k) + 1) * stride, length)
        fa, ga = f(after)
        crossed = sign(fa) != sign(fs)
        dips = ~crossed & (gs * fs < 0) & (ga * fa > 0)
        turn = dr.clip(s + (after - s) * gs / dr.select(dips, gs - ga, 1), s, after)
        ft, _ = f(turn)
        dips &= sign(ft) != sign(fs)
        some = going & (crossed | dips)
        at = root(s, dr.select(crossed, after, turn), sign(fs), some)
        u = mi.Float(family.coordinate(*point(at), n.values))
        valid = (u >= n.low) & (u <= n.high) & (start + at > dr.select(own, n.self_hit, 0))
        found = some & valid
        best = dr.select(found, start + at, best)
        _, slope = f(at)
        passed = some & ~valid
        s, gs = dr.select(passed, at, after), dr.select(passed, slope, ga)
        fs = dr.select(passed, dr.mulsign(mi.Float(ON_IT), -fs), fa)
        k = dr.select(passed, k, k + 1)
        return k, tries + 1, s, fs, gs, best, going & ~found & (k < INTERVALS) & (tries < MOST_TRIES)

    f0, g0 = f(mi.Float(0))
    f0 = dr.select(own & (start <= 0), dr.mulsign(mi.Float(ON_IT), g0), f0)
    zero = dr.zeros(mi.UInt32, dr.width(own))
    *_, best, _ = dr.while_loop(
        (zero, mi.UInt32(zero), mi.Float(zero), f0, g0, dr.full(mi.Float, dr.inf, dr.width(own)), mi.Bool(active)),
        lambda *v: v[6],
        walk,
        labels=("k", "tries", "s", "fs", "gs", "best", "going"),
        mode="symbolic",
        label="implicit",
    )
    return best
