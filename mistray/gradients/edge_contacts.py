"""Edges of surfaces next to ray hits: other surfaces that touch them, and what a ray that just misses an edge meets.

At a contact no gap opens when the rim alone moves: the edge that light sees is the line in which the two surfaces meet.
Nothing changes along the edge, so the plane across it decides. Let u be the direction in which the rim ends the
surface, v the direction from the edge along the other surface and d the ray's direction. The ray η u + t d meets the
other surface at τ v for

    τ = η (u × d)/(v × d),   t = -η (u × v)/(d × v)

that is, if τ > 0; before it passes the rim (a concave corner) if t < 0, behind it (a convex one) if t > 0. The ray that
hits at the same distance within the rim has the opposite τ and t: where its τ > 0 and t < 0, it comes from the other
surface. Such rays do not sample the edge, because their paths begin on one side of it only.

Rims are circles about an axis, sides of rectangles, and edges of outlines. The surfaces that may touch a rim are found
once, by boxes. Whether one touches it next to a hit, and whether it ends there too, is found for each hit in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.gradients.replay_surfaces import ReplaySurfaces
from mistray.gradients.table_gradient import GradientRequest
from mistray.surfaces.gradient_columns import HALF_HEIGHT, HALF_WIDTH, HIGH, INNER, LOW, OUTER, RIM_COLUMNS
from mistray.surfaces.surface import NO_SURFACE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

TOUCH = 1e-4  # distance of surfaces that touch, in units of the radius or half side of the rim
THIN = 0.1  # upper limit of that distance, in units of the half width of the other surface
PROBE = 2.0  # distance from the edge at which the other surface is probed, in units of the tolerance of a contact
PARALLEL = 1e-7  # sine of the angle up to which axes count as parallel
ALONG = 1e-2  # sine of the angle between an edge and a surface up to which the edge lies in it
FLAT = 1e-3  # sine of the angle up to which one surface continues the other
PAST = 1e-4  # distance from the rim at which rays go past it, in units of its radius or half side
NEWTON_STEPS = 4  # along the axis, onto the surface
CIRCLE_FLOATS = 5
CORNERS = 8  # of a polygon around a circle


@dataclass
class Edge:
    """
    Points on rims near hits, one per lane, with unit vectors along and across the rim; axes are those of the world.

    Attributes
    ----------
    point : mi.Vector3d
        Point of the edge relative to the centre of the scene, mm.
    along : mi.Vector3d
        Unit vector along the edge.
    outward, across : mi.Vector3d
        Unit vectors at right angles to the edge: u, which points out of the surface, and along × u, a normal of the
        surface.
    stretch : mi.Float64
        Component of `outward` along the coordinate in which distances from the rim are measured.
    real : mi.Bool
        Whether the surface ends there: it does not where figures of an outline overlap.
    """

    point: mi.Vector3d
    along: mi.Vector3d
    outward: mi.Vector3d
    across: mi.Vector3d
    stretch: mi.Float64
    real: mi.Bool


@dataclass
class Corner:
    """
    Start data of rays that just miss a rim: the surfaces beside their origin, a factor and an offset.

    Attributes
    ----------
    at, left : mi.UInt32
        Surface that they meet at their origin, or that they leave; `NO_SURFACE`: none.
    joined : mi.UInt32
        Surface whose distance replaces that from the rim, see `mistray.gradients.edges`; `NO_SURFACE`: none.
    factor : mi.Float64
        Factor on the coefficient of Δ, see `mistray.gradients.edges`.
    step : mi.Vector3d
        Unit vector from the edge to the origin of the rays.
    """

    at: mi.UInt32
    left: mi.UInt32
    joined: mi.UInt32
    factor: mi.Float64
    step: mi.Vector3d


class EdgeContacts:
    """
    Rims of a scene's surfaces, each with the other surfaces that may touch it.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene.

    Attributes
    ----------
    some : bool
        Whether any surface may touch a rim.
    """

    def __init__(self, table: SurfaceTable) -> None:
        self._surfaces = ReplaySurfaces(table, GradientRequest(rows=False))
        shape = table.count, len(RIM_COLUMNS)
        sizes, circles, least = np.zeros(shape), np.zeros((*shape, CIRCLE_FLOATS)), np.zeros(table.count)
        for piece in table.pieces:
            least[piece.index] = min(piece.zone_widths(1.0).values(), default=0.0)
            for rim, size in piece.rim_sizes.items():
                sizes[piece.index, rim] = size
                if piece.circular_rims and rim in (OUTER, INNER, LOW, HIGH):
                    point = piece.rim_point(rim)
                    outward = piece.tangent(point) * (1 if rim in (OUTER, HIGH) else -1)
                    circles[piece.index, rim] = *point, *outward, piece.rim_stretch(point)
        # Candidates of each rim, in one list
        found = may_touch(table)
        self.some = bool(found)
        counts = np.zeros(shape, dtype=np.uint32)
        for place, others in found.items():
            counts[place] = len(others)
        starts = np.cumsum(counts, dtype=np.uint32).reshape(shape) - counts
        self._sizes, self._circles, self._least = (upload(mi.Float64, v) for v in (sizes, circles, least))
        self._counts, self._starts = upload(mi.UInt32, counts), upload(mi.UInt32, starts)
        listed = [k for place in sorted(found) for k in found[place]]
        self._others = upload(mi.UInt32, np.array([*listed, NO_SURFACE], dtype=np.uint32))

    def past(
        self, s: mi.UInt32, rim: mi.UInt32, p: mi.Vector3f, d: mi.Vector3f, starts: mi.Bool, active: mi.Bool
    ) -> tuple[Corner, mi.Vector3f]:
        """
        Return start data of rays that pass just outside rims, and their origins, mm.

        Origins and hits are relative to the centre of the scene, along the axes of the world.

        Parameters
        ----------
        s, rim : mi.UInt32
            Surfaces and their rims, as places in `RIM_COLUMNS`.
        p, d : mi.Vector3f
            Hits close to the rims, mm, and directions of arrival.
        starts : mi.Bool
            Whether the hit is the first one of the ray.
        active : mi.Bool
            Lanes that have such a hit.
        """
        place = s * len(RIM_COLUMNS) + rim
        size = dr.gather(mi.Float64, self._sizes, place, active)
        edge = self.edge(s, rim, mi.Vector3d(p), size, active)
        corner = self.corner(place, edge, mi.Vector3d(d), size, starts, active)
        corner.factor = dr.select(edge.real, corner.factor, 0)
        return corner, mi.Vector3f(edge.point + PAST * size * corner.step)

    def edge(self, s: mi.UInt32, rim: mi.UInt32, p: mi.Vector3d, size: mi.Float64, active: mi.Bool) -> Edge:
        """
        Return the points of rims nearest to hits at p, mm; `size` is the rim's radius or half side, mm.

        The other parameters are those of `past`.
        """
        surfaces = self._surfaces
        q = surfaces.local_point(p, s, active)
        numbers = surfaces.numbers(s, mi.UInt32(0), active, still=True)
        rims = surfaces.rims(s, mi.UInt32(0), active)
        # Nearest point of the rim in x and y, and the direction `out` in which Δ is measured
        wide, high = rim == HALF_WIDTH, rim == HALF_HEIGHT
        x = dr.select(wide, dr.mulsign(rims["half_width"], q.x), q.x)
        y = dr.select(high, dr.mulsign(rims["half_height"], q.y), q.y)
        out = mi.Vector3d(dr.select(wide, dr.sign(q.x), 0), dr.select(high, dr.sign(q.y), 0), 0)
        real = mi.Bool(True)
        for here, family, own in numbers["families"]:
            if hasattr(family, "edge"):
                found = family.edge(q.x, q.y, own, PAST * size)
                x, y, real = (dr.select(here, *pair) for pair in ((found.x, x), (found.y, y), (found.real, real)))
                out = dr.select(here, mi.Vector3d(found.out_x, found.out_y, 0), out)
        # Onto the surface, along its axis
        point = mi.Vector3d(x, y, q.z)
        for _ in range(NEWTON_STEPS):
            value, gradient = surfaces.implicit(point, numbers)
            point.z -= 0.5 * value / gradient.z
        across = dr.normalize(surfaces.implicit(point, numbers)[1])
        along = dr.normalize(dr.cross(out, across))
        outward = dr.cross(across, along)
        stretch = dr.dot(outward, out)
        # Circular rims come from a table: point and outward direction in the meridional plane
        place = s * len(RIM_COLUMNS) + rim
        radius, height, out_r, out_z, of_circle = (
            dr.gather(mi.Float64, self._circles, CIRCLE_FLOATS * place + j, active) for j in range(CIRCLE_FLOATS)
        )
        radial = dr.normalize(mi.Vector3d(q.x, q.y, 0))
        circle, ahead = radius > 0, mi.Vector3d(0, 0, 1)
        point = dr.select(circle, radius * radial + height * ahead, point)
        outward = dr.select(circle, out_r * radial + out_z * ahead, outward)
        along = dr.select(circle, dr.cross(ahead, radial), along)
        along, outward = (surfaces.to_world(v, s, active) for v in (along, outward))
        return Edge(
            surfaces.to_world(point, s, active) + surfaces.vertex(s, active),
            along,
            outward,
            dr.cross(along, outward),
            dr.select(circle, of_circle, stretch),
            real,
        )

    def corner(
        self, place: mi.UInt32, edge: Edge, d: mi.Vector3d, size: mi.Float64, starts: mi.Bool, active: mi.Bool
    ) -> Corner:
        """
        Return start data of rays along d that just miss a rim's edge; `place` indexes (surfaces, rims) tables.

        Where no surface touches the edge, they start beside it, at no surface, with the factor 1. `size` is that
        of `edge`, mm; `starts` and `active` are those of `past`.
        """
        count = dr.width(place)
        none, one = dr.full(mi.UInt32, NO_SURFACE, count), dr.full(mi.Float64, 1, count)
        found = Corner(mi.UInt32(none), mi.UInt32(none), mi.UInt32(none), one, mi.Vector3d(edge.outward))
        if not self.some:
            return found
        first = dr.gather(mi.UInt32, self._starts, place, active)
        end = first + dr.gather(mi.UInt32, self._counts, place, active)
        ray = mi.Vector2d(dr.dot(d, edge.outward), dr.dot(d, edge.across))

        # Each candidate that touches the edge is a half plane in the plane across it, or two of them
        def step(k: mi.UInt32, nearest: mi.Float64, *state: Any) -> tuple[Any, ...]:
            going = active & (k < end)
            other = dr.gather(mi.UInt32, self._others, k, going)
            tolerance = dr.minimum(TOUCH * size, THIN * dr.gather(mi.Float64, self._least, other, going))
            distance, gradient = self._surfaces.sheet(edge.point, other, going)
            steep = mi.Vector2d(dr.dot(gradient, edge.outward), dr.dot(gradient, edge.across))
            touches = going & (dr.abs(distance) <= tolerance) & (dr.abs(dr.dot(gradient, edge.along)) < ALONG)
            v = dr.normalize(mi.Vector2d(-steep.y, steep.x))
            along = v.x * edge.outward + v.y * edge.across
            probe = PROBE * tolerance * along
            # The surface may extend to one side of the edge, or to both
            ahead, behind = (self._holds(edge.point + way * probe, other, touches) for way in (1, -1))
            found, on = Corner(*state), ahead & behind
            for there, way in ((ahead, 1), (behind, -1)):
                half, aside, ends = way * v, way * along, ~on
                apart = -edge.stretch / steep.x  # turns the coefficient of Δ into that of the distance from `other`
                across = half.x * ray.y - half.y * ray.x
                t = half.y / across  # distance along the ray
                is_corner = dr.abs(half.y) > FLAT
                # Rays parallel to the other surface pass its far end before they meet it. If they come along it, those
                # past the rim have been on its other side all the way
                oblique = dr.abs(across) > PAST * dr.norm(ray)
                aligned = ~oblique & (dr.dot(half, ray) < 0)
                beyond = ray.y * across > 0
                # The ray that hit has just left the other surface: rays that arrive there hold the light that moves
                # from one to the other. But on both sides of the rim the surface may emit rays of its own
                left = there & is_corner & (aligned | (oblique & ~beyond & (t > 0)))
                near = there & oblique & beyond & (t < nearest)
                concave = is_corner & (t < 0)
                share = mi.Float64(dr.select(ends, 0.5, 1))
                nearest = dr.select(left, -dr.inf, dr.select(near, t, nearest))
                found = Corner(
                    at=dr.select(near, other, dr.select(left, NO_SURFACE, found.at)),
                    left=dr.select(left, other, dr.select(near, NO_SURFACE, found.left)),
                    joined=dr.select(left | (near & concave), other, dr.select(near, NO_SURFACE, found.joined)),
                    factor=dr.select(
                        left,
                        dr.select(starts & oblique & ~ends, apart, 0),
                        dr.select(near, dr.select(concave, share * apart, share), found.factor),
                    ),
                    step=dr.select(left, -aside, dr.select(near, aside, found.step)),
                )
            return k + 1, nearest, *vars(found).values()

        _, _, *state = dr.while_loop(
            (first, dr.full(mi.Float64, dr.inf, count), *vars(found).values()),
            lambda k, *_: active & (k < end),
            step,
            mode="symbolic",
            label="contacts",
        )
        return Corner(*state)

    def _holds(self, p: mi.Vector3d, s: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """Return a mask of points, mm, close to surfaces s that lie inside all rims of these surfaces."""
        distances = self._surfaces.rim_distances(self._surfaces.local_point(p, s, active), s, mi.UInt32(0), active)
        for rim, distance in enumerate(distances):
            exists = dr.gather(mi.Float64, self._sizes, s * len(RIM_COLUMNS) + rim, active) > 0
            active = active & (~exists | (distance > 0))  # not in place: the mask belongs to the caller
        return active


def may_touch(table: SurfaceTable) -> dict[tuple[int, int], list[int]]:
    """
    Return, by surface and rim (place in `RIM_COLUMNS`), the indices of other surfaces that may touch that rim.

    Bounding boxes, and radii about a common axis, decide. Rims that no surface may touch are left out.
    """
    pieces, found = table.pieces, dict[tuple[int, int], list[int]]()
    if not pieces:
        return found
    # Hulls of all surfaces in the world
    turn = 2 * np.pi * np.arange(CORNERS) / CORNERS
    polygon = np.stack([np.cos(turn), np.sin(turn)], axis=1) / np.cos(np.pi / CORNERS)
    hulls = [piece.hull(polygon) for piece in pieces]
    first = np.cumsum([0, *map(len, hulls[:-1])])
    world = np.concatenate([h @ table.rotations[k].T + table.vertices[k] for k, h in enumerate(hulls)])
    axes, vertices = table.rotations[: len(pieces), :, 2], table.vertices[: len(pieces)]
    holes = np.array([piece.least_radius for piece in pieces])
    # Boxes in the frame of each surface; about the axis of a circular rim also the largest and the least radius
    for piece in pieces:
        own, vertex = table.rotations[piece.index], vertices[piece.index]
        q = (world - vertex) @ own
        low, high = np.minimum.reduceat(q, first), np.maximum.reduceat(q, first)
        farthest = np.maximum.reduceat(np.hypot(q[:, 0], q[:, 1]), first)
        beside = np.linalg.norm(np.cross(vertices - vertex, axes[piece.index]), axis=1)
        turned = np.linalg.norm(np.cross(axes, axes[piece.index]), axis=1)
        for rim, size in piece.rim_sizes.items():
            tolerance, ends = TOUCH * size, (low[piece.index], high[piece.index])
            apart = np.zeros(len(pieces), dtype=bool)
            if piece.circular_rims and rim in (OUTER, INNER, LOW, HIGH):
                radius, z = piece.rim_point(rim)
                ends = np.array([-radius, -radius, z]), np.array([radius, radius, z])
                coaxial = (beside <= tolerance) & (turned <= PARALLEL)
                apart = (farthest < radius - tolerance) | (coaxial & (holes > radius + tolerance))
            near = np.all((low <= ends[1] + tolerance) & (high >= ends[0] - tolerance), axis=1) & ~apart
            near[piece.index] = False
            if near.any():
                found[piece.index, rim] = np.flatnonzero(near).tolist()
    return found
