"""First crossing of rays with a freeform within its outline, in the kernel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from mistray.surfaces.crossings import AxisRay, stretch
from mistray.surfaces.families.first_zero import UNBOUNDED, first_zero

if TYPE_CHECKING:
    from mistray.surfaces.families.freeform import Freeform

INTERVALS = 16  # intervals searched for a crossing where the ray could meet the surface more than once
BESIDE = 1e-3  # distance outside the slab at which a root may lie, in units of the size
MOST_PASSES = 4  # crossings outside the outline that a ray may pass


def first_crossing(ray: AxisRay, piece: Freeform, n: Mapping[str, mi.Float], own: mi.Bool) -> mi.Float:
    """
    Return the distance to a ray's first crossing with a freeform within its outline, mm; infinite for none.

    Rays that travel against `Freeform.way` cross nothing.

    Parameters
    ----------
    ray : AxisRay
        Rays in the frame of the surface's axis.
    piece : Freeform
        Surface whose forms of sag and outline, and `way`, are used; its parameters come from `n`.
    n : mapping of str to mi.Float
        Values by name, see `Freeform.kernel_values`: parameters of the sag and the outline; z, the place of the sag's
        frame on the axis, mm; z_low and z_high, the ends of the slab that holds the surface, mm from there; half_x and
        half_y, half sizes of the outline's box, mm; size and size2, the surface's largest distance from the axis, mm,
        and its square, mm²; slope2, the square of the bound of the slope; self_hit, the least distance of a hit, mm.
    own : mi.Bool
        Whether the ray starts on the surface.
    """
    if piece.local.sag.quadric:
        return _of_quadric(ray, piece, n, own)
    start, end = stretch(ray, ray.oz - n["z"], n["size2"], n["z_low"], n["z_high"])
    monotonic = dr.square(ray.dz) > n["slope2"] * ray.dd
    # A ray steeper than the surface is anywhere cannot come back to it
    some = (end > start) & ~(own & monotonic)
    if piece.way:
        some &= ray.dz * piece.way > 0
    sag, outline = piece.local.sag, piece.outline

    def search(start: mi.Float, end: mi.Float) -> mi.Float:
        x0, y0 = ray.lateral(start)
        z0 = dr.fma(start, ray.dz, ray.oz - n["z"])
        size = dr.sqrt(n["size2"])

        def point(s: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
            return dr.fma(s, ray.dx, x0), dr.fma(s, ray.dy, y0), dr.fma(s, ray.dz, z0)

        def f(s: mi.Float) -> tuple[mi.Float, mi.Float]:
            x, y, z = point(s)
            x, y = dr.clip(x, -n["half_x"], n["half_x"]), dr.clip(y, -n["half_y"], n["half_y"])
            height, across, along = sag.evaluate(x, y, n)
            return z - height, ray.dz - across * ray.dx - along * ray.dy

        def step(k, t, passed, own, going):  # type: ignore[no-untyped-def]
            def beyond(s: mi.Float) -> tuple[mi.Float, mi.Float]:
                return f(passed + s)

            s, found = first_zero(
                beyond, monotonic, mi.Float(UNBOUNDED), end - start - passed, size, own, going, INTERVALS
            )
            found &= going & (start + passed + s > dr.select(own & (passed == 0), n["self_hit"], 0))
            x, y, _ = point(passed + s)
            inside = outline.contains(x, y, n)
            t = dr.select(found & inside, start + passed + s, t)
            further = found & ~inside & ~monotonic & (k < MOST_PASSES)
            return k + 1, t, dr.select(further, passed + s, passed), own | further, further

        state = (
            mi.UInt32(0), dr.full(mi.Float, dr.inf, dr.width(ray.dz)), mi.Float(0), mi.Bool(own), mi.Bool(some),
        )  # fmt: skip
        return dr.while_loop(
            state,
            lambda *v: v[4],
            step,
            labels=("k", "t", "passed", "own", "going"),
            mode="symbolic",
            label="freeform",
        )[1]

    def nothing(start: mi.Float, end: mi.Float) -> mi.Float:
        return dr.full(mi.Float, dr.inf, dr.width(ray.dz))

    found: Any = dr.if_stmt(
        (start, end),
        some,
        search,
        nothing,
        arg_labels=("start", "end"),
        mode="symbolic",
        label="freeform",
    )
    return found


def _of_quadric(ray: AxisRay, piece: Freeform, n: Mapping[str, mi.Float], own: mi.Bool) -> mi.Float:
    """Return the distance, mm, to a ray's first crossing with a quadric, by its roots; infinity if there is none."""
    sag, outline = piece.local.sag, piece.outline
    oz = ray.oz - n["z"]
    # From the point that is closest to the middle, which keeps the digits of rays that come from afar
    start = -dr.fma(oz, ray.dz, ray.od)
    x0, y0 = ray.lateral(start)
    z0 = dr.fma(start, ray.dz, oz)
    low, high = sag.roots((x0, y0, z0), (ray.dx, ray.dy, ray.dz), n)
    # A ray steeper than the surface is anywhere cannot come back to it
    some = ~(own & (dr.square(ray.dz) > n["slope2"] * ray.dd))
    if piece.way:
        some &= ray.dz * piece.way > 0
    least, slack = dr.select(own, n["self_hit"], 0) - start, BESIDE * n["size"]

    def candidate(s: mi.Float) -> mi.Bool:
        z = dr.fma(s, ray.dz, z0)
        return (s > least - slack) & (z > n["z_low"] - slack) & (z < n["z_high"] + slack)

    def crossing(s: mi.Float) -> mi.Float:
        """Return the distance, mm, of a root if it lies on the vertex's sheet and within the outline; else infinity."""
        x, y, z = dr.fma(s, ray.dx, x0), dr.fma(s, ray.dy, y0), dr.fma(s, ray.dz, z0)
        here = some & (s > least) & (n["a"] * z < n["b"]) & outline.contains(x, y, n)
        return dr.select(here, start + s, dr.inf)

    if not sag.curved:
        return crossing(low)
    early = candidate(low)
    t = crossing(dr.select(early, low, high))
    again = some & early & candidate(high) & ~dr.isfinite(t)
    found: mi.Float = dr.if_stmt(
        (t, high), again, lambda t, high: crossing(high), lambda t, high: t, arg_labels=("t", "high"),
        mode="symbolic", label="other crossing",
    )  # fmt: skip
    return found
