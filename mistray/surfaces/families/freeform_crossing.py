"""First crossing of rays with a freeform within its outline, in the kernel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from mistray.surfaces.crossings import AxisRay, stretch
from mistray.surfaces.families.first_zero import first_zero

if TYPE_CHECKING:
    from mistray.surfaces.families.freeform import Freeform

INTERVALS = 16  # pieces in which a crossing is looked for, where the ray could meet the surface more than once
MOST_PASSES = 4  # crossings outside of the outline that a ray may leave behind


def first_crossing(ray: AxisRay, piece: Freeform, n: Mapping[str, mi.Float], own: mi.Bool) -> mi.Float:
    """
    Distance to the first crossing within the outline, mm; infinite if there is none.

    Parameters
    ----------
    ray : AxisRay
    piece : Freeform
        Its forms; its numbers are not looked at.
    n : mapping of str to mi.Float
        Numbers of the sag and the outline, and z, z_low, z_high, size2, slope2, self_hit, half_x and half_y.
    own : mi.Bool
        The ray starts on the surface.
    """
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

            s, found = first_zero(beyond, ray.dz, monotonic, end - start - passed, size, own, going, INTERVALS)
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
        (start, end), some, search, nothing, arg_labels=("start", "end"), mode="symbolic", label="freeform"
    )
    return found
