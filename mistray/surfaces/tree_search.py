"""Nearest hit of rays with the surfaces of a `ShellTree`, in a loop whose code does not grow with their number."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.aspheres import AsphereSearch
from mistray.surfaces.crossings import FAR, AxisRay, Numbers, turned
from mistray.surfaces.extrema import larger, smaller
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.surface import NO_SURFACE, TracedSurface
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

ROUNDING = 1e-6  # relative rounding error of distances along a ray


class TreeSearch:
    """
    Search for the nearest hit of rays with the surfaces in the tree of a `SurfaceTable`.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene, with a `tree`.
    """

    def __init__(self, table: SurfaceTable) -> None:
        tree = table.tree
        assert tree is not None
        pieces = [table.pieces[k] for k in tree.members]
        # One of each sort: all of a sort have the same code
        self._sorts: dict[tuple[object, ...], TracedSurface] = {}
        for piece in pieces:
            self._sorts.setdefault(piece.sort, piece)
        sorts = list(self._sorts)
        self._aspheres = AsphereSearch(
            table, [piece for piece in pieces if isinstance(piece, SagSurface) and piece.searched]
        )
        # Links of each node to its surface; the last row is for nodes without one
        facts = np.array(
            [*((piece.index, sorts.index(piece.sort)) for piece in pieces), (NO_SURFACE, len(sorts))], dtype=np.uint32
        )
        links = np.concatenate([tree.skip[..., None], tree.piece[..., None], facts[tree.piece]], axis=-1)
        self._bounds, self._links = upload(mi.Float, tree.bounds), upload(mi.UInt32, links)
        self._axis, self._nodes = upload(mi.UInt32, tree.axis), dr.opaque(mi.UInt32, len(tree.axis))
        self._rows = upload(mi.Float, np.array([Numbers.row(piece) for piece in pieces]))
        self._places = upload(mi.Float, np.array([(x, y) for _, x, y in tree.axes]))
        frames = np.array([frame for frame, _, _ in tree.axes], dtype=np.uint32)
        self._frames, self._turned = upload(mi.UInt32, frames), bool(frames.any())
        self._turns = upload(mi.Float, np.array([np.append(frame.ravel(), np.zeros(3)) for frame in table.frames]))

    def nearest(
        self, o: mi.Vector3f, d: mi.Vector3f, last: mi.UInt32, best: mi.Float, surface: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.Float, mi.UInt32]:
        """
        Return the nearest hits of rays after the tree is searched: distances, mm, and surface indices.

        Parameters
        ----------
        o, d : mi.Vector3f
            Origins relative to `SurfaceTable.centre`, mm, and unit directions of the rays.
        last : mi.UInt32
            Index of the surface that each ray starts on.
        best, surface : mi.Float, mi.UInt32
            Distance of the nearest hit so far, mm, and the index of its surface.
        active : mi.Bool
            Lanes that have a ray.
        """

        def step(k: mi.UInt32, best: mi.Float, surface: mi.UInt32) -> tuple[mi.UInt32, mi.Float, mi.UInt32]:
            going = active & (k < self._nodes)
            ray = self._axis_ray(o, d, dr.gather(mi.UInt32, self._axis, k, going), going)
            node = dr.select(ray.dz >= 0, k, k + self._nodes)
            near = going & _meets(ray, dr.gather(mi.Vector4f, self._bounds, node, going), best)
            skip, place, number, sort = dr.gather(mi.Vector4u, self._links, node, going)
            for number_of_sort, piece in enumerate(self._sorts.values()):

                def test(
                    best: mi.Float, surface: mi.UInt32, piece: TracedSurface = piece
                ) -> tuple[mi.Float, mi.UInt32]:
                    if piece.searched:
                        t = self._aspheres.first(o, d, number, last == number, best, mi.Bool(True))
                    else:
                        numbers = Numbers.read(self._rows, piece.fours, place)
                        t = piece.crossing(ray, numbers, last == number)
                    nearer = t < best
                    return dr.select(nearer, t, best), dr.select(nearer, number, surface)

                best, surface = dr.if_stmt(
                    (best, surface),
                    near & (sort == number_of_sort),
                    test,
                    lambda best, surface: (best, surface),
                    arg_labels=("best", "surface"),
                    mode="symbolic",
                )
            return dr.select(near, k + 1, skip), best, surface

        _, best, surface = dr.while_loop(
            (dr.zeros(mi.UInt32, dr.width(last)), mi.Float(best), mi.UInt32(surface)),
            lambda k, best, surface: active & (k < self._nodes),
            step,
            labels=("k", "best", "surface"),
            mode="symbolic",
            label="tree",
        )
        return best, surface

    def _axis_ray(self, o: mi.Vector3f, d: mi.Vector3f, axis: mi.UInt32, active: mi.Bool) -> AxisRay:
        """Return the rays, lengths in mm, each in the frame of the tree axis whose index `axis` gives for its lane."""
        if self._turned:
            frame = dr.gather(mi.UInt32, self._frames, axis, active)
            rows = [dr.gather(mi.Vector4f, self._turns, 3 * frame + k, active) for k in range(3)]
            turn = [component for row in rows for component in row]
            o, d = turned(turn, o), turned(turn, d)
        x, y = dr.gather(mi.Vector2f, self._places, axis, active)
        return AxisRay.of(o.x - x, o.y - y, o.z, d)


def _meets(ray: AxisRay, bounds: mi.Vector4f, best: mi.Float) -> mi.Bool:
    """
    Return a mask of rays that enter a shell nearer than `best`, mm, neither missing it nor passing its hole.

    `bounds` are those of `ShellTree`.
    """
    low, high, inner2, outer2 = bounds
    first, second = (low - ray.oz) * ray.inv_dz, (high - ray.oz) * ray.inv_dz
    start = larger(smaller(first, second) * (1 - ROUNDING), 0)
    end = smaller(smaller(larger(first, second), best) * (1 + ROUNDING), FAR)

    def off2(t: mi.Float) -> mi.Float:
        x, y = ray.lateral(t)
        return dr.fma(x, x, y * y)

    closest = smaller(larger(-ray.od / ray.dd, start), end)
    return (start <= end) & (larger(off2(start), off2(end)) >= inner2) & (off2(closest) <= outer2)
