"""
Targets of scattered rays on the device: sampling of a direction towards one, and the pdf of such directions.

Targets may overlap: the pdf of a direction ω, 1/sr, is Σ_k share_k p_k(ω) over all targets that it meets, with

    p = r²/(A |cos θ|)            of a flat target of area A, at the distance r and the angle θ from its normal,
    p = 1/(2π (1 - cos α))        of a cone of the half-angle α,
    p = 1/(2π w abc |M ω|³)       of an ellipsoid of half axes a, b, c, which M scales to the unit sphere,

where 2π w is the solid angle, sr, in which that sphere is seen. M takes dω to det M dω/|M ω|³, and det M = 1/(abc).
Lengths are in mm, areas in mm².
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.kernel.lobes import tangents
from mistray.kernel.targets import AimSet, AnyTarget, Ellipsoid, TargetCone
from mistray.surfaces.upload import upload

VECTORS = 6  # vectors of four floats for each target
DENSITY_VECTORS = 4  # number of the first of them, which say where a direction meets the target
SHARES = 19  # place of the sum of shares among the floats
# Codes of the shapes; that of an ellipse is its hole, 0 … 1
PARALLELOGRAM, TRIANGLE, ELLIPSOID = -1.0, -2.0, -3.0
CONES = {"direction": -4.0, "point": -5.0, "specular": -6.0}
MOST_SETS = 1024  # sets whose rows are kept from a trace to the next


class DeviceTargets:
    """
    Importance targets of scattered rays on the device: sampling of directions, and their pdf.

    Parameters
    ----------
    sets : sequence of AimSet
        Sets of targets, one after the other.
    centre : (3,) float64
        World point that is the origin of positions on the device, mm.
    """

    def __init__(self, sets: Sequence[AimSet], centre: np.ndarray) -> None:
        targets = [target for aim in sets for target in aim.targets]
        rows = [row for aim in sets for row in _rows(aim, tuple(centre.tolist()))]
        self._values = upload(mi.Float, np.array(rows if rows else [np.zeros(4 * VECTORS)]))
        # Kinds of target that do not occur take no code in the kernel
        self._ellipsoids = any(isinstance(target, Ellipsoid) for target in targets)
        self._cones = any(isinstance(target, TargetCone) for target in targets)

    def _row(self, number: mi.UInt32, count: int, active: mi.Bool) -> list[mi.Vector4f]:
        return [dr.gather(mi.Vector4f, self._values, VECTORS * number + k, active) for k in range(count)]

    def sample(
        self,
        aims: mi.Vector2u,
        choice: mi.Float,
        u: tuple[mi.Float, mi.Float],
        p: mi.Vector3f,
        specular: mi.Vector3f,
        active: mi.Bool,
    ) -> tuple[mi.Vector3f, mi.UInt32]:
        """
        Return a random unit direction to a target that is drawn by its share, and the index of that target in its set.

        Parameters
        ----------
        aims : mi.Vector2u
            Index of the first target and number of targets.
        choice : mi.Float
            Random number, 0 … 1, that chooses the target.
        u : tuple of mi.Float
            Two random numbers, 0 … 1, that choose the direction to it.
        p : mi.Vector3f
            Start of the ray, mm.
        specular : mi.Vector3f
            Unit direction of the specular beam, about which cones of the kind "specular" lie.
        active : mi.Bool
            Lanes that take part.
        """

        # Choose a target by the sums of the shares so far
        def later(k: mi.UInt32) -> mi.Bool:
            upto = dr.gather(mi.Float, self._values, 4 * VECTORS * (aims.x + k) + SHARES, active)
            return active & (k + 1 < aims.y) & (choice >= upto)

        # A loop, since surfaces have different numbers of targets
        (k,) = dr.while_loop(
            (dr.zeros(mi.UInt32, dr.width(choice)),),
            later,
            lambda k: (k + 1,),
            mode="symbolic",
            label="choose a target",
        )

        # Flat: a point, uniform over the area, as in `Target.points`
        rows = self._row(aims.x + k, VECTORS, active)
        centre, _, _, normal, first, second = rows
        hole = centre.w
        ellipse, triangle = hole >= 0, hole == TRIANGLE
        root = dr.sqrt(dr.select(ellipse, dr.lerp(hole * hole, 1, u[0]), u[0]))
        sine, cosine = dr.sincos(2 * dr.pi * u[1])
        a = dr.select(ellipse, root * cosine, dr.select(triangle, root * (1 - u[1]), 2 * u[0] - 1))
        b = dr.select(ellipse, root * sine, dr.select(triangle, root * u[1], 2 * u[1] - 1))
        point = centre.xyz + a * first.xyz + b * second.xyz
        # `normal.w` is -1 for a virtual target
        direction = (point - p) * normal.w
        if self._ellipsoids:
            # Ellipsoid: scaled to the unit sphere it fills a cone, in which directions are uniform in solid angle
            _, towards, width = _sphere(rows, p)
            mapped = _within(towards, width, u[0], sine, cosine) * normal.w
            to_world = sum(
                (c * v.xyz / dr.squared_norm(v.xyz) for c, v in zip(mapped, rows[1:4], strict=True)), mi.Vector3f(0)
            )
            direction = dr.select(hole == ELLIPSOID, to_world, direction)
        if self._cones:
            # Cone
            within = _within(_axis(centre, p, specular) * normal.w, first.x, u[0], sine, cosine)
            direction = dr.select(hole <= CONES["direction"], within, direction)
        return dr.normalize(direction), k

    def density(
        self,
        aims: mi.Vector2u,
        p: mi.Vector3f,
        direction: mi.Vector3f,
        specular: mi.Vector3f,
        aim: mi.Bool,
        own: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Float:
        """
        Return the pdf of aimed rays in a direction, 1/sr; `aims`, `p` and `specular` are as in `sample`.

        Where `aim` is set, the ray was aimed at the target with the index `own` in its set. That target counts even if
        rounding lets the direction miss it.
        """

        def step(k: mi.UInt32, density: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            going = active & (k < aims.y)
            rows = self._row(aims.x + k, DENSITY_VECTORS, going)
            centre, along, beside, normal = rows
            # Flat: where the line meets the plane, in the coordinates a, b of `Target`
            cosine = dr.dot(direction, normal.xyz)
            t = dr.dot(centre.xyz - p, normal.xyz) / cosine
            q = dr.fma(t, direction, p) - centre.xyz
            a, b = dr.dot(q, along.xyz), dr.dot(q, beside.xyz)
            radius = dr.sqrt(dr.fma(a, a, b * b))
            ring = (radius <= 1) & (radius >= centre.w)
            box = (dr.abs(a) <= 1) & (dr.abs(b) <= 1)
            inside = (a >= 0) & (b >= 0) & (a + b <= 1)
            on = dr.select(centre.w >= 0, ring, dr.select(centre.w == TRIANGLE, inside, box)) & (t * normal.w > 0)
            # r²/|cos θ|; the row holds 1/A
            each = t * t / dr.abs(cosine)
            # Ellipsoid: the line passes within 1 of the centre of the unit sphere, and ahead unless it starts within
            if self._ellipsoids:
                round_one = centre.w == ELLIPSOID
                start, towards, width = _sphere(rows, p)
                mapped = mi.Vector3f(*(dr.dot(direction, v.xyz) for v in rows[1:4])) * normal.w
                length = dr.norm(mapped)
                mapped /= length
                beside_centre = start - dr.dot(start, mapped) * mapped
                meets = (dr.squared_norm(beside_centre) <= 1) & ((dr.dot(mapped, towards) > 0) | (width == 2))
                on = dr.select(round_one, meets, on)
                each = dr.select(round_one, dr.rcp(2 * dr.pi * width * length * length * length), each)
            # Cone: |ω - axis|² = 2 (1 - cos), which rounds better than the cosine
            if self._cones:
                cone = centre.w <= CONES["direction"]
                apart = direction - _axis(centre, p, specular) * normal.w
                on = dr.select(cone, dr.squared_norm(apart) <= 2 * along.x, on)
                each = dr.select(cone, 1, each)
            # A ray that was aimed at a small or distant target need not find it again: its direction is rounded
            here = going & (on | (aim & (k == own)))
            density += dr.select(here, beside.w * along.w * each, 0)
            return k + 1, density

        width = dr.width(direction)
        _, density = dr.while_loop(
            (dr.zeros(mi.UInt32, width), dr.zeros(mi.Float, width)),
            lambda k, density: active & (k < aims.y),
            step,
            mode="symbolic",
            label="density of targets",
        )
        return density


def _sphere(rows: list[mi.Vector4f], p: mi.Vector3f) -> tuple[mi.Vector3f, mi.Vector3f, mi.Float]:
    """
    Scale space so that an ellipsoid becomes the unit sphere, and return how that sphere is seen from a point p (mm).

    The result is the point relative to the centre, the unit direction to the centre, and 1 - cos of the half-angle in
    which the sphere is seen: 2 from within.
    """
    start = mi.Vector3f(*(dr.dot(p - rows[0].xyz, v.xyz) for v in rows[1:4]))
    square = dr.squared_norm(start)
    sine2 = dr.rcp(square)
    # 1 - cos = sin²/(1 + cos), without the cancellation; a point within sees all directions, 1 - cos = 2
    return start, -start * dr.rsqrt(square), dr.select(square > 1, sine2 / (1 + dr.sqrt(1 - sine2)), 2)


def _axis(centre: mi.Vector4f, p: mi.Vector3f, specular: mi.Vector3f) -> mi.Vector3f:
    """
    Return the unit axis of a target cone: fixed, from p (mm) towards the cone's point, or the specular direction.

    `centre` is the first vector of the cone's row, see `_rows`.
    """
    to_point = dr.normalize(centre.xyz - p)
    axis = dr.select(centre.w == CONES["point"], to_point, centre.xyz)
    return dr.select(centre.w == CONES["specular"], specular, axis)


def _within(axis: mi.Vector3f, width: mi.Float, u: mi.Float, sine: mi.Float, cosine: mi.Float) -> mi.Vector3f:
    """
    Return a unit direction in a cone about an axis, uniform in solid angle; `width` is 1 - cos of the half-angle.

    `u` is a uniform random number, 0 … 1, `sine` and `cosine` are those of a random azimuth.
    """
    less = u * width
    aside = dr.sqrt(less * (2 - less))
    across, beside = tangents(axis)
    return (1 - less) * axis + aside * (cosine * across + sine * beside)


@lru_cache(maxsize=MOST_SETS)
def _rows(aim: AimSet, centre: tuple[float, ...]) -> list[np.ndarray]:
    """
    Return the rows of targets, (24,) float64 each, as the kernel reads them; positions in mm, areas in mm².

    - flat: centre, shape | dual of u, 1/area | dual of v, share | normal, -1 if reverse | u, sum of shares | v, 0;
    - ellipsoid: centre, shape | three inverse half axes, with 1/(a b c), share, -1 if reverse | 0, sum of shares | 0;
    - cone: centre or axis, kind | 1 - cos, 0, 0, 1/solid angle | 0, share | 0, -1 if reverse | 1 - cos, 0, 0, sum | 0.
    """
    rows, so_far = [], 0.0
    for target in aim.targets:
        so_far += target.share
        shape, one, two, three, first, second = _vectors(target, np.array(centre))
        sign = -1.0 if target.reverse else 1.0
        rows.append(
            np.concatenate([shape, one, [*two, target.share], [*three, sign], [*first, so_far], [*second, 0.0]])
        )
    return rows


def _vectors(target: AnyTarget, origin: np.ndarray) -> tuple[Any, ...]:
    """
    Return the six parts of a target's row, see `_rows`, without share, sign and sum of shares.

    Positions are relative to `origin`; lengths are in mm.
    """
    nothing = np.zeros(3)
    if isinstance(target, TargetCone):
        width = target.width
        return (
            [*(target.axis - origin if target.about == "point" else target.axis), CONES[target.about]],
            [width, 0.0, 0.0, 1 / target.solid_angle],
            nothing,
            nothing,
            [width, 0.0, 0.0],
            nothing,
        )
    if isinstance(target, Ellipsoid):
        one, two, three = (axis / np.dot(axis, axis) for axis in target.axes)
        lengths = np.linalg.norm(target.axes, axis=1)
        return [*(target.centre - origin), ELLIPSOID], [*one, 1 / np.prod(lengths)], two, three, nothing, nothing
    normal = np.cross(target.u, target.v)
    # Dual vectors of u and v within the plane, which give the coordinates a and b
    along, beside = np.cross(target.v, normal), np.cross(normal, target.u)
    along, beside = along / np.dot(along, target.u), beside / np.dot(beside, target.v)
    shape = {"parallelogram": PARALLELOGRAM, "triangle": TRIANGLE}.get(target.shape, target.hole)
    return [*(target.centre - origin), shape], [*along, 1 / target.area], beside, target.normal, target.u, target.v
