"""First crossing of rays with even aspheres.

A ray usually runs through the bounds of many aspheres and meets one. So the kernel first computes where it enters the
bounds of each. Each lane then searches them in its own order of entry, until a crossing is nearer than the next entry.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from mistray.physics.geometry.sag import sag, sag_derivative
from mistray.surfaces.crossings import AxisRay, stretch
from mistray.surfaces.families.first_zero import first_zero
from mistray.surfaces.surface import SELF_HIT

if TYPE_CHECKING:
    from mistray.surfaces.families.sag_surface import SagSurface
    from mistray.surfaces.surfaces import SurfaceTable

INTERVALS = 12  # intervals searched for a crossing where the ray could meet the surface more than once


class AsphereSearch:
    """
    Search for the nearest hit of rays with the aspheres of a `SurfaceTable`.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    pieces : sequence of SagSurface
        Aspheres that are searched.
    """

    def __init__(self, table: SurfaceTable, pieces: Sequence[SagSurface]) -> None:
        self.table, self.pieces = table, pieces
        self.rectangular = [piece for piece in self.pieces if not piece.outer]
        self.clipped = bool(self.rectangular) or any(piece.inner > 0 for piece in self.pieces)
        self.count = max((len(piece.coefficients) for piece in self.pieces), default=0)

    def nearest(
        self,
        o: mi.Vector3f,
        d: mi.Vector3f,
        last: mi.UInt32,
        entries: list[mi.Float],
        best: mi.Float,
        surface: mi.UInt32,
        active: mi.Bool,
    ) -> tuple[mi.Float, mi.UInt32]:
        """
        Return the nearest hits of rays after the aspheres are searched: distances, mm, and surface indices.

        Parameters
        ----------
        o, d : mi.Vector3f
            Origins relative to `SurfaceTable.centre`, mm, and unit directions of the rays.
        last : mi.UInt32
            Index of the surface that each ray starts on.
        entries : list of mi.Float
            Distance at which the ray enters the bounds of each asphere, mm; infinite if it need not be searched.
        best, surface : mi.Float, mi.UInt32
            Distance of the nearest hit so far, mm, and the index of its surface.
        active : mi.Bool
            Lanes that have a ray.
        """

        def choose(best: mi.Float, searched: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
            """
            Return the index and mask bit of the next asphere to search, and a mask of rays that have one left.

            The next asphere is the nearest one not yet searched that a ray enters before its best hit, at the distance
            `best`, mm.
            """
            nearest, number, bit = mi.Float(best), mi.UInt32(0), mi.UInt32(0)
            for k, (piece, entry) in enumerate(zip(self.pieces, entries, strict=True)):
                take = (entry < nearest) & ((searched & (1 << k)) == 0)
                nearest = dr.select(take, entry, nearest)
                number, bit = dr.select(take, mi.UInt32(piece.index), number), dr.select(take, mi.UInt32(1 << k), bit)
            return number, bit, bit != 0

        def step(best, surface, searched, number, bit, going):  # type: ignore[no-untyped-def]
            t = self.first(o, d, number, last == number, best, going)
            nearer = going & (t < best)
            best, surface = dr.select(nearer, t, best), dr.select(nearer, number, surface)
            searched |= bit
            number, bit, more = choose(best, searched)
            return best, surface, searched, number, bit, going & more

        number, bit, some = choose(best, mi.UInt32(0))
        best, surface, *_ = dr.while_loop(
            (mi.Float(best), mi.UInt32(surface), mi.UInt32(0), number, bit, active & some),
            lambda *v: v[5],
            step,
            labels=("best", "surface", "searched", "number", "bit", "going"),
            mode="symbolic",
            label="aspheres",
        )
        return best, surface

    def first(
        self, o: mi.Vector3f, d: mi.Vector3f, number: mi.UInt32, own: mi.Bool, best: mi.Float, active: mi.Bool
    ) -> mi.Float:
        """
        Return the distance, mm, to the first crossing within the aperture that is nearer than `best`; else infinity.

        `number` is the index of each lane's asphere, `own` is true for rays that start on it, and `best`, mm, bounds
        the search; other parameters as in `nearest`. A ray may cross the full surface outside a rectangular aperture,
        or in a central hole, before it crosses the aperture.
        """
        if not self.clipped:
            return self._crossing(o, d, number, own, best, active)[0]

        def step(t, passed, own, going):  # type: ignore[no-untyped-def]
            further, skipped = self._crossing(dr.fma(passed, d, o), d, number, own, best - passed, going)
            t = dr.select(going, passed + further, t)
            going = going & dr.isfinite(skipped)
            return t, dr.select(going, passed + skipped, passed), own | going, going

        t, *_ = dr.while_loop(
            (dr.full(mi.Float, dr.inf, dr.width(best)), mi.Float(0), mi.Bool(own), mi.Bool(active)),
            lambda *v: v[3],
            step,
            labels=("t", "passed", "own", "going"),
            mode="symbolic",
            label="aperture",
        )
        return t

    def _crossing(
        self, o: mi.Vector3f, d: mi.Vector3f, number: mi.UInt32, own: mi.Bool, best: mi.Float, active: mi.Bool
    ) -> tuple[mi.Float, mi.Float]:
        """
        Return the distance, mm, to the first crossing nearer than `best`, by bracketing and safeguarded Newton steps.

        It comes first if the crossing is within the aperture, second if it is outside; the other one is infinite.
        Without a crossing both are. Parameters as in `first`.

        Along the ray, f(t) = z - sag(r) is monotonic where the ray is steeper than the surface anywhere, |dz| > slope ·
        sqrt(dx² + dy²). It is, too, where its slope at the start cannot change sign on the way, as |f''| is at most
        bend · (dx² + dy²). Then the stretch holds one crossing at most. Otherwise it is walked in intervals until f
        changes sign, or until f turns back in an interval and its extremum lies beyond zero.
        """
        table = self.table
        vertex = dr.gather(mi.Vector4f, table.vertex, number, active)
        frame = table.frame(number, active)
        o, d = frame.inward(o - vertex.xyz), frame.inward(d)
        numbers = table.asphere_row(number, active)
        shape = numbers[0], numbers[1], numbers[2 : 2 + self.count], numbers[11]
        z_low, z_high, outer, slope = numbers[12:]
        size = outer
        if self.clipped:
            clip = dr.gather(mi.Vector2f, table.clip, number, active)
        if self.rectangular:
            rectangle = outer < 0
            size = dr.select(rectangle, dr.norm(clip), outer)
        outer2 = size * size

        ray = AxisRay.of(o.x, o.y, o.z, d)
        start, end = stretch(ray, o.z, outer2, z_low, z_high)
        end = dr.minimum(end, best)
        active &= end > start
        length = dr.select(active, end - start, 0)
        o = dr.fma(start, d, o)

        def f(s: mi.Float) -> tuple[mi.Float, mi.Float]:
            """Return the height over the surface, mm, at a distance s, mm, along the stretch, and its derivative."""
            x, y = dr.fma(s, d.x, o.x), dr.fma(s, d.y, o.y)
            r2 = dr.minimum(dr.fma(x, x, y * y), outer2)
            height = dr.fma(s, d.z, o.z) - sag(r2, *shape)
            return height, d.z - 2 * sag_derivative(r2, *shape) * dr.fma(x, d.x, y * d.y)

        monotonic = dr.square(d.z) > dr.square(slope) * ray.dd
        s, found = first_zero(f, monotonic, dr.abs(vertex.w) * ray.dd, length, size, own, active, INTERVALS)
        x, y = dr.fma(s, d.x, o.x), dr.fma(s, d.y, o.y)
        r2 = dr.fma(x, x, y * y)
        inside = r2 <= outer2
        if self.clipped:
            inside &= r2 >= clip.x
        if self.rectangular:
            within = (dr.abs(x) <= clip.x) & (dr.abs(y) <= clip.y)
            inside = dr.select(rectangle, within, inside)
        t = start + s
        found &= t > dr.select(own, SELF_HIT * size, 0)
        return dr.select(found & inside, t, dr.inf), dr.select(found & ~inside, t, dr.inf)
