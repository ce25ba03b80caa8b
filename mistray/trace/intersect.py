"""Exact nearest hit of rays with the analytic surfaces of a scene, unrolled into the caller's kernel.

Every number of a surface is an opaque scalar, so that the code is the same for all scenes of equal structure (no
recompilation when a parameter changes) and its loads broadcast over the lanes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.physics.sag import in_proportion, sag, sag_derivative
from mistray.trace.aspheres import AsphereSearch, stretch
from mistray.trace.extrema import larger, smaller
from mistray.trace.pieces import MILD_MARGIN, NO_SURFACE, SELF_HIT, Piece
from mistray.trace.surfaces import SurfaceTable

GROUP = 8  # walls that are looked at together
ONE_STEP = 1e-6  # error after one Newton step that is small enough, in units of the aperture
SLACK = 1e-5  # of the sizes of a group of walls, for rounding
FAR = 1e30  # stands for infinity where it may be multiplied by zero


@dataclass
class Numbers:
    """A `Piece` as opaque Dr.Jit scalars."""

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
    def of(cls, p: Piece) -> Numbers:
        """Opaque copies of the numbers of a piece."""

        def opaque(value: float) -> mi.Float:
            return dr.opaque(mi.Float, value)

        a, b = p.quadric[:2]
        conic = p.kind in ("conic", "asphere")
        size = p.size
        coefficients, per_area = in_proportion(p.coefficients, size)
        conic_constant = opaque(b / a - 1 if conic and a else 0.0)
        return cls(
            z=opaque(p.z),
            curvature=opaque(a),
            one_plus_conic=opaque(b / a if conic and a else 1.0),
            r0=opaque(p.r0),
            slope=opaque(p.slope),
            outer2=opaque(size**2),
            inner2=opaque(p.inner**2),
            half_width=opaque(p.half_size[0]),
            half_height=opaque(p.half_size[1]),
            z_low=opaque(p.z_range[0]),
            z_high=opaque(p.z_range[1]),
            self_hit=opaque(SELF_HIT * size),
            wide2=opaque((MILD_MARGIN * size) ** 2),
            departure=opaque(p.departure),
            shape=(opaque(a), conic_constant, [opaque(value) for value in coefficients], opaque(per_area)),
        )


class Intersector:
    """Nearest hit with the analytic pieces of a `SurfaceTable`."""

    def __init__(self, table: SurfaceTable) -> None:
        self.pieces = table.pieces
        self.aspheres = AsphereSearch(table)
        self.numbers = [Numbers.of(piece) for piece in table.pieces]
        walls = [k for k, p in enumerate(self.pieces) if p.wall]
        if len(walls) <= GROUP:
            walls = []
        aspheres = [k for k, p in enumerate(self.pieces) if p.kind == "asphere"]
        self.singles = [k for k, p in enumerate(self.pieces) if k not in walls and p.kind != "asphere"]
        self.groups = _groups(self.pieces, walls)
        self.stacks = _stacks(self.pieces, self.singles)
        self.main_axes = {self.pieces[k].axis for k in walls + aspheres}
        self.main_axes |= {group.axis for stack in self.stacks for group in stack.groups if len(group.members) == 1}
        self.bounds = {k: _Group.of(self.pieces, [k]) for k in aspheres}
        self.along_axis = sorted(aspheres, key=lambda k: self.pieces[k].z)
        self.frames = [[dr.opaque(mi.Float, float(x)) for x in frame.ravel()] for frame in table.frames]
        self.axes = [(frame, dr.opaque(mi.Float, x), dr.opaque(mi.Float, y), x == y == 0) for frame, x, y in table.axes]

    def nearest(self, o: mi.Vector3f, d: mi.Vector3f, last: mi.UInt32, active: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
        """
        First crossing of rays with a surface.

        Parameters
        ----------
        o, d : mi.Vector3f
            Origin (mm) and unit direction.
        last : mi.UInt32
            Number of the surface the origin lies on; it is hit again only where its shape allows it.

        Returns
        -------
        t : mi.Float
            Distance, mm; infinite if nothing is hit.
        surface : mi.UInt32
            Number of the surface, `NO_SURFACE` if none.
        """
        best, surface = mi.Float(dr.inf), mi.UInt32(NO_SURFACE)
        frames: dict[int, tuple[Any, Any]] = {}
        rays: dict[int, _AxisRay] = {}
        for p in self.pieces:
            if p.frame not in frames:
                frames[p.frame] = self._rotate(o, p.frame), self._rotate(d, p.frame)
            if p.axis not in rays and p.axis in self.main_axes:
                rays[p.axis] = self._axis_ray(*frames[p.frame], p.axis)

        def test(members: Sequence[int], best: mi.Float, surface: mi.UInt32) -> tuple[mi.Float, mi.UInt32]:
            here: dict[int, _AxisRay] = {}
            for k in members:
                p = self.pieces[k]
                ray = rays.get(p.axis) or here.get(p.axis)
                if ray is None:  # made where it is needed, see `_stacks`
                    ray = here[p.axis] = self._axis_ray(*frames[p.frame], p.axis)
                t = _CROSSINGS[p.kind](ray, p, self.numbers[k], last == p.index)
                nearer = t < best
                best, surface = dr.select(nearer, t, best), dr.select(nearer, mi.UInt32(p.index), surface)
            return best, surface

        def follow(
            stack: _Stack, backward: bool, here: mi.Bool, best: mi.Float, surface: mi.UInt32
        ) -> tuple[mi.Float, mi.UInt32]:
            """Test the pieces of a stack one after the other, as long as they may be nearer than the nearest hit."""
            o, d = frames[stack.frame]
            far = _z_at(o, d, best)
            for group in reversed(stack.groups) if backward else stack.groups:

                def search(
                    best: mi.Float, surface: mi.UInt32, far: mi.Float, members: Sequence[int] = group.members
                ) -> tuple[mi.Float, mi.UInt32, mi.Float]:
                    best, surface = test(members, best, surface)
                    return best, surface, _z_at(o, d, best)

                if backward:
                    between = (far <= group.z_high) & (o.z >= group.z_low)
                else:
                    between = (far >= group.z_low) & (o.z <= group.z_high)
                best, surface, far = dr.if_stmt(
                    (best, surface, far),
                    here & between,
                    search,
                    lambda *state: state,
                    arg_labels=("best", "surface", "far"),
                    mode="symbolic",
                )
            return best, surface

        for stack in self.stacks:
            forward = frames[stack.frame][1].z >= 0
            for backward in (False, True):
                here = active & (~forward if backward else forward)
                best, surface = dr.if_stmt(
                    (best, surface),
                    here,
                    partial(follow, stack, backward, here),
                    lambda *state: state,
                    arg_labels=("best", "surface"),
                    mode="symbolic",
                )
        entries: dict[int, mi.Float] = {}
        for k in self.along_axis:  # a ray along the axis passes by all aspheres behind the first that it meets
            p = self.pieces[k]
            if not p.departure:
                entries[k] = _asphere_entry(rays[p.axis], self.numbers[k], last == p.index)
                continue

            def search_asphere(
                best: mi.Float, surface: mi.UInt32, entry: mi.Float, k: int = k
            ) -> tuple[mi.Float, mi.UInt32, mi.Float]:
                p = self.pieces[k]
                t, unsure = _mild_asphere(rays[p.axis], p, self.numbers[k], last == p.index)
                nearer = t < best
                best, surface = dr.select(nearer, t, best), dr.select(nearer, mi.UInt32(p.index), surface)
                return best, surface, dr.select(unsure, mi.Float(0), dr.inf)

            best, surface, entries[k] = dr.if_stmt(
                (best, surface, dr.full(mi.Float, dr.inf, dr.width(last))),
                active & _reaches(rays[p.axis], best, self.bounds[k].z_low, self.bounds[k].z_high),
                search_asphere,
                lambda *state: state,
                arg_labels=("best", "surface", "entry"),
                mode="symbolic",
            )
        if entries:
            ordered = [entries[k] for k in sorted(entries)]
            best, surface = self.aspheres.nearest(o, d, last, ordered, best, surface, active)
        # Walls come last, in groups along the axis: most lanes have met a lens before they reach most groups
        for group in self.groups:
            ray = rays[group.axis]
            near = _reaches(ray, best, group.z_low, group.z_high) & (ray.widest2(best) >= group.inner2)

            def search(
                best: mi.Float, surface: mi.UInt32, members: list[int] = group.members
            ) -> tuple[mi.Float, mi.UInt32]:
                return test(members, best, surface)

            best, surface = dr.if_stmt(
                (best, surface),
                active & near,
                search,
                lambda best, surface: (best, surface),
                arg_labels=("best", "surface"),
                mode="symbolic",
            )
        return best, surface

    def _rotate(self, v: mi.Vector3f, frame: int) -> mi.Vector3f:
        if frame == 0:
            return v
        r = self.frames[frame]
        return mi.Vector3f(*(r[k] * v.x + r[3 + k] * v.y + r[6 + k] * v.z for k in range(3)))

    def _axis_ray(self, o: mi.Vector3f, d: mi.Vector3f, axis: int) -> _AxisRay:
        _, x, y, centred = self.axes[axis]
        ox, oy = (o.x, o.y) if centred else (o.x - x, o.y - y)
        return _AxisRay(
            ox,
            oy,
            o.z,
            d.x,
            d.y,
            d.z,
            dr.fma(d.x, d.x, d.y * d.y),
            dr.fma(ox, d.x, oy * d.y),
            dr.fma(ox, ox, oy * oy),
            dr.rcp(d.z),
        )


@dataclass
class _Group:
    """Pieces looked at together, their extent along the axis (mm) and the square of their least radius; opaque."""

    axis: int
    members: list[int]
    z_low: mi.Float
    z_high: mi.Float
    inner2: mi.Float

    @classmethod
    def of(cls, pieces: list[Piece], members: list[int]) -> _Group:
        """Group of the pieces with these numbers."""
        low, high = min(pieces[k].extent[0] for k in members), max(pieces[k].extent[1] for k in members)
        slack = SLACK * (1 + abs(low) + abs(high))
        inner = max(min(pieces[k].least_radius for k in members) - slack, 0.0)
        numbers = (dr.opaque(mi.Float, v) for v in (low - slack, high + slack, inner**2))
        return cls(pieces[members[0]].axis, members, *numbers)


@dataclass
class _Stack:
    """Pieces of one orientation that are no walls, from front to back."""

    frame: int
    groups: list[_Group]


def _stacks(pieces: list[Piece], singles: list[int]) -> list[_Stack]:
    """
    Stacks of the pieces with these numbers.

    Each is a group of its own, apart from rectangles with axes of their own: such are mostly the parts of the board
    around the detector, and looked at together.
    """
    on_axis = Counter(piece.axis for piece in pieces)
    stacks = []
    for frame in sorted({pieces[k].frame for k in singles}):
        here = sorted((k for k in singles if pieces[k].frame == frame), key=lambda k: pieces[k].z)
        boards = [k for k in here if not pieces[k].outer and on_axis[pieces[k].axis] == 1]
        groups = [[k] for k in here if k not in boards] + ([boards] if boards else [])
        groups.sort(key=lambda members: pieces[members[0]].z)
        stacks.append(_Stack(frame, [_Group.of(pieces, members) for members in groups]))
    return stacks


def _groups(pieces: list[Piece], walls: list[int]) -> list[_Group]:
    """Cut the walls on each axis into groups of `GROUP`, from front to back."""
    groups = []
    for axis in sorted({pieces[k].axis for k in walls}):
        here = [k for k in walls if pieces[k].axis == axis]
        members = sorted(here, key=lambda k: sum(pieces[k].extent))
        for first in range(0, len(members), GROUP):
            groups.append(_Group.of(pieces, members[first : first + GROUP]))
    return groups


def _z_at(o: mi.Vector3f, d: mi.Vector3f, t: mi.Float) -> mi.Float:
    """Place along the axis at the distance t, however far."""
    return dr.fma(smaller(t, FAR), d.z, o.z)


def _reaches(ray: _AxisRay, best: mi.Float, z_low: mi.Float, z_high: mi.Float) -> mi.Bool:
    """Whether a ray up to the distance `best` has a part between two planes."""
    far = dr.fma(smaller(best, FAR), ray.dz, ray.oz)
    forward = ray.dz >= 0
    return (dr.select(forward, far, ray.oz) >= z_low) & (dr.select(forward, ray.oz, far) <= z_high)


@dataclass
class _AxisRay:
    """A ray in the frame of an axis, with the products that all surfaces on that axis share."""

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

    def widest2(self, t: mi.Float) -> mi.Float:
        """Square of the greatest distance from the axis up to t: at one of the ends."""
        t = smaller(t, FAR)
        return larger(self.oo, dr.fma(t, dr.fma(t, self.dd, 2 * self.od), self.oo))

    def lateral(self, t: mi.Float) -> tuple[mi.Float, mi.Float]:
        return dr.fma(t, self.dx, self.ox), dr.fma(t, self.dy, self.oy)


def _inside(ray: _AxisRay, t: mi.Float, p: Piece, n: Numbers) -> mi.Bool:
    """Whether the point at t is within the aperture."""
    x, y = ray.lateral(t)
    if not p.outer:
        return (dr.abs(x) <= n.half_width) & (dr.abs(y) <= n.half_height)
    r2 = dr.fma(x, x, y * y)
    ok = r2 <= n.outer2
    return ok & (r2 >= n.inner2) if p.inner > 0 else ok


def _plane(ray: _AxisRay, p: Piece, n: Numbers, own: mi.Bool) -> mi.Float:
    t = (n.z - ray.oz) * ray.inv_dz
    ok = (t > 0) & ~own & _inside(ray, t, p, n)
    return dr.select(ok, t, dr.inf)


def _two_roots(a: mi.Float, b: mi.Float, c: mi.Float, own: mi.Bool) -> tuple[mi.Float, mi.Float, mi.Bool]:
    """Roots of a t² + 2 b t + c = 0 without cancellation; on the surface itself c is 0 exactly, and so is one root."""
    c = dr.select(own, 0, c)
    discriminant = dr.fma(b, b, -a * c)
    q = -(b + dr.mulsign(dr.sqrt(larger(discriminant, 0)), b))
    return q / a, c / q, discriminant >= 0


def _first(ta: mi.Float, tb: mi.Float, ok_a: mi.Bool, ok_b: mi.Bool) -> mi.Float:
    return smaller(dr.select(ok_a, ta, dr.inf), dr.select(ok_b, tb, dr.inf))


def _conic(ray: _AxisRay, p: Piece, n: Numbers, own: mi.Bool) -> mi.Float:
    oz, c, k1 = ray.oz - n.z, n.curvature, n.one_plus_conic
    a = c * dr.fma(k1 * ray.dz, ray.dz, ray.dd)
    b = dr.fma(c, dr.fma(k1 * oz, ray.dz, ray.od), -ray.dz)
    g = dr.fma(c, dr.fma(k1 * oz, oz, ray.oo), -2 * oz)
    ta, tb, real = _two_roots(a, b, g, own)
    nearest = dr.select(own, n.self_hit, 0)

    def ok(t: mi.Float) -> mi.Bool:
        z = dr.fma(t, ray.dz, oz)
        sheet = c * k1 * z < 1  # the half of the conic that holds the vertex
        return real & (t > nearest) & sheet & _inside(ray, t, p, n)

    return _first(ta, tb, ok(ta), ok(tb))


def _mild_asphere(ray: _AxisRay, p: Piece, n: Numbers, own: mi.Bool) -> tuple[mi.Float, mi.Bool]:
    """
    Hit of an asphere that is close to its conic: one or two Newton steps from the conic's hit.

    Also tells the rays for which that is not safe, because they meet the conic twice within the aperture, nearly touch
    it, could come back to the surface they leave, or because the steps do not settle; they need the full search.
    """
    oz, c, k1 = ray.oz - n.z, n.curvature, n.one_plus_conic
    a = c * dr.fma(k1 * ray.dz, ray.dz, ray.dd)
    b = dr.fma(c, dr.fma(k1 * oz, ray.dz, ray.od), -ray.dz)
    g = dr.fma(c, dr.fma(k1 * oz, oz, ray.oo), -2 * oz)
    ta, tb, real = _two_roots(a, b, g, own)
    # The conic is hit where the asphere is, but for the departure along the ray
    early = dr.select(own, n.self_hit, -4 * n.departure)

    def near(t: mi.Float) -> mi.Bool:
        x, y = ray.lateral(t)
        sheet = c * k1 * dr.fma(t, ray.dz, oz) < 1
        return real & (t > early) & sheet & (dr.fma(x, x, y * y) <= n.wide2)

    near_a, near_b = near(ta), near(tb)
    found = near_a | near_b
    touching = dr.abs(dr.fma(b, b, -a * g)) < 4 * n.departure * dr.abs(a)
    unsure = (near_a & near_b) | (own & found) | (touching & ~own)
    t = dr.select(near_a, ta, tb)
    # A step squares the error; the interaction at the hit adds one more
    for _ in range(1 if p.departure**2 * abs(p.quadric[0]) < ONE_STEP * p.outer else 2):
        x, y = ray.lateral(t)
        r2 = smaller(dr.fma(x, x, y * y), n.wide2)
        height = dr.fma(t, ray.dz, oz) - sag(r2, *n.shape)
        slope = ray.dz - 2 * sag_derivative(r2, *n.shape) * dr.fma(x, ray.dx, y * ray.dy)
        step = height / slope
        t -= step
    unsure |= found & ~(dr.abs(step) * dr.abs(slope) < 4 * n.departure)
    ok = found & ~unsure & (t > 0) & _inside(ray, t, p, n)
    return dr.select(ok, t, dr.inf), unsure


def _cone(ray: _AxisRay, p: Piece, n: Numbers, own: mi.Bool) -> mi.Float:
    oz = ray.oz - n.z
    r = dr.fma(n.slope, oz, n.r0)
    a = dr.fma(-n.slope * ray.dz, n.slope * ray.dz, ray.dd)
    b = dr.fma(-n.slope * r, ray.dz, ray.od)
    ta, tb, real = _two_roots(a, b, dr.fma(-r, r, ray.oo), own)
    nearest = dr.select(own, n.self_hit, 0)

    def ok(t: mi.Float) -> mi.Bool:
        z = dr.fma(t, ray.dz, oz)
        return real & (t > nearest) & (z >= n.z_low) & (z <= n.z_high)

    return _first(ta, tb, ok(ta), ok(tb))


def _asphere_entry(ray: _AxisRay, n: Numbers, own: mi.Bool) -> mi.Float:
    """Distance at which a ray enters the cylinder and the slab that hold an asphere; infinite if it misses them."""
    oz = ray.oz - n.z
    start, end = stretch(ray.ox, ray.oy, oz, ray.dz, ray.dd, ray.od, ray.oo, ray.inv_dz, n.outer2, n.z_low, n.z_high)
    # A ray steeper than the surface is anywhere cannot come back to it
    leaves = own & (dr.square(ray.dz) > dr.square(n.slope) * ray.dd)
    return dr.select((end > start) & ~leaves, start, dr.inf)


_CROSSINGS = {"plane": _plane, "conic": _conic, "cone": _cone}
