"""Exact nearest hit of rays with the analytic surfaces of a scene, in the caller's kernel.

The search is unrolled over the surfaces. Many surfaces lie in a tree, see `mistray.surfaces.shell_tree`; freeforms of
one sort lie in a mosaic, see `mistray.surfaces.mosaic_search`. Each parameter of an unrolled surface is an opaque
scalar. So all scenes of equal structure have the same code, without recompilation when a parameter changes, and a
parameter is loaded once for all lanes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.cache.remembered import remembered
from mistray.surfaces.aspheres import AsphereSearch
from mistray.surfaces.crossings import FAR, AxisRay, asphere_entry, mild_asphere, turned
from mistray.surfaces.extrema import smaller
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.mosaic_search import MosaicSearch, mosaics
from mistray.surfaces.surface import NO_SURFACE, RECTANGLE, TracedSurface
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.tree_search import TreeSearch

GROUP = 8  # walls tested together
SLACK = 1e-5  # margin for rounding, in units of the sizes of a group of walls


class Intersector:
    """Search for the nearest hit of rays with the analytic surfaces of a `SurfaceTable`, in the kernel."""

    @classmethod
    def of(cls, table: SurfaceTable) -> Intersector:
        """Return the search of a table, which all tables of the same geometry share."""
        return remembered(table.shared, "intersector", lambda: cls(table.without_scene()))

    def __init__(self, table: SurfaceTable) -> None:
        self.pieces = table.pieces
        looped = set(table.tree.members) if table.tree else set()
        unrolled = [k for k in range(len(self.pieces)) if k not in looped]
        groups = mosaics(self.pieces, unrolled)
        self.mosaics = [MosaicSearch(table, group) for group in groups]
        unrolled = sorted(set(unrolled).difference(*groups))
        self.numbers = {k: self.pieces[k].numbers() for k in unrolled}
        walls = [k for k in unrolled if self.pieces[k].wall]
        if len(walls) <= GROUP:
            walls = []
        searched = [p for k in unrolled if isinstance(p := self.pieces[k], SagSurface) and p.searched]
        aspheres = [p.index for p in searched]
        self.aspheres = AsphereSearch(table, searched)
        self.tree = TreeSearch(table) if table.tree else None
        self.singles = sorted(set(unrolled).difference(walls, aspheres))
        self.groups = _groups(self.pieces, walls)
        self.stacks = _stacks(self.pieces, self.singles)
        self.main_axes = {self.pieces[k].axis for k in walls + aspheres}
        self.main_axes |= {group.axis for stack in self.stacks for group in stack.groups if len(group.members) == 1}
        self.bounds = {k: _Group.of(self.pieces, [k]) for k in aspheres}
        self.along_axis = sorted(searched, key=lambda p: p.z)
        frames, axes = (sorted({getattr(self.pieces[k], name) for k in unrolled}) for name in ("frame", "axis"))
        self.frames = {k: [dr.opaque(mi.Float, float(x)) for x in table.frames[k].ravel()] for k in frames}
        self.axes = {k: tuple(dr.opaque(mi.Float, v) for v in table.axes[k][1:]) for k in axes}
        self.centred = {k for k in axes if table.axes[k][1:] == (0, 0)}

    def nearest(self, o: mi.Vector3f, d: mi.Vector3f, last: mi.UInt32, active: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
        """
        Return the distances to rays' nearest hits with analytic surfaces, mm, and the indices of the surfaces hit.

        Parameters
        ----------
        o, d : mi.Vector3f
            Origin, mm, relative to `SurfaceTable.centre`, and unit direction.
        last : mi.UInt32
            Index of the surface that the origin lies on; it is hit again only if its shape allows that.
        active : mi.Bool
            Lanes that have a ray.

        Returns
        -------
        t : mi.Float
            Distance, mm; infinite if nothing is hit.
        surface : mi.UInt32
            Index of the surface, `NO_SURFACE` if nothing is hit.
        """
        best, surface = mi.Float(dr.inf), mi.UInt32(NO_SURFACE)
        frames: dict[int, tuple[Any, Any]] = {}
        rays: dict[int, AxisRay] = {}
        for k in self.numbers:
            p = self.pieces[k]
            if p.frame not in frames:
                frames[p.frame] = self._rotate(o, p.frame), self._rotate(d, p.frame)
            if p.axis not in rays and p.axis in self.main_axes:
                rays[p.axis] = self._axis_ray(*frames[p.frame], p.axis)

        def test(members: Sequence[int], best: mi.Float, surface: mi.UInt32) -> tuple[mi.Float, mi.UInt32]:
            here: dict[int, AxisRay] = {}
            for k in members:
                p = self.pieces[k]
                ray = rays.get(p.axis) or here.get(p.axis)
                if ray is None:  # made where it is needed, see `_stacks`
                    ray = here[p.axis] = self._axis_ray(*frames[p.frame], p.axis)
                t = p.crossing(ray, self.numbers[k], last == p.index)
                nearer = t < best
                best, surface = dr.select(nearer, t, best), dr.select(nearer, mi.UInt32(p.index), surface)
            return best, surface

        def follow(
            stack: _Stack, backward: bool, here: mi.Bool, best: mi.Float, surface: mi.UInt32
        ) -> tuple[mi.Float, mi.UInt32]:
            """Return the nearest hit, mm, and its surface, after a stack's groups that may lie nearer than `best`."""
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
        for p in self.along_axis:  # a ray along the axis passes by all aspheres behind the first that it meets
            if not p.departure:
                entries[p.index] = asphere_entry(rays[p.axis], self.numbers[p.index], last == p.index)
                continue

            def search_asphere(
                best: mi.Float, surface: mi.UInt32, entry: mi.Float, p: SagSurface = p
            ) -> tuple[mi.Float, mi.UInt32, mi.Float]:
                t, unsure = mild_asphere(rays[p.axis], p, self.numbers[p.index], last == p.index)
                nearer = t < best
                best, surface = dr.select(nearer, t, best), dr.select(nearer, mi.UInt32(p.index), surface)
                return best, surface, dr.select(unsure, mi.Float(0), dr.inf)

            bounds = self.bounds[p.index]
            best, surface, entries[p.index] = dr.if_stmt(
                (best, surface, dr.full(mi.Float, dr.inf, dr.width(last))),
                active & _reaches(rays[p.axis], best, bounds.z_low, bounds.z_high),
                search_asphere,
                lambda *state: state,
                arg_labels=("best", "surface", "entry"),
                mode="symbolic",
            )
        if entries:
            ordered = [entries[k] for k in sorted(entries)]
            best, surface = self.aspheres.nearest(o, d, last, ordered, best, surface, active)
        # Walls come last, in groups along the axis: most lanes have met a lens before they come to most groups
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
        for mosaic in self.mosaics:
            best, surface = mosaic.nearest(o, d, last, best, surface, active)
        return self.tree.nearest(o, d, last, best, surface, active) if self.tree else (best, surface)

    def _rotate(self, v: mi.Vector3f, frame: int) -> mi.Vector3f:
        return turned(self.frames[frame], v) if frame else v

    def _axis_ray(self, o: mi.Vector3f, d: mi.Vector3f, axis: int) -> AxisRay:
        x, y = self.axes[axis]
        ox, oy = (o.x, o.y) if axis in self.centred else (o.x - x, o.y - y)
        return AxisRay.of(ox, oy, o.z, d)


@dataclass
class _Group:
    """Surfaces that the kernel tests together, with their range along the axis, mm, and least squared radius, mm²."""

    axis: int
    members: list[int]
    z_low: mi.Float
    z_high: mi.Float
    inner2: mi.Float

    @classmethod
    def of(cls, pieces: list[TracedSurface], members: list[int]) -> _Group:
        """Return the group of the surfaces with the indices `members`, which share one axis."""
        low, high = min(pieces[k].extent[0] for k in members), max(pieces[k].extent[1] for k in members)
        slack = SLACK * (1 + abs(low) + abs(high))
        inner = max(min(pieces[k].least_radius for k in members) - slack, 0.0)
        numbers = (dr.opaque(mi.Float, v) for v in (low - slack, high + slack, inner**2))
        return cls(pieces[members[0]].axis, members, *numbers)


@dataclass
class _Stack:
    """Groups of surfaces of one orientation, ordered along its z axis in ascending order of their vertices."""

    frame: int
    groups: list[_Group]


def _stacks(pieces: list[TracedSurface], singles: list[int]) -> list[_Stack]:
    """
    Return one stack of groups of the surfaces with the indices `singles` for each orientation.

    Each surface is a group of its own, except rectangles that share no axis with another surface. These mostly form the
    board around the detector and are tested together.
    """
    on_axis = Counter(piece.axis for piece in pieces)
    stacks = []
    for frame in sorted({pieces[k].frame for k in singles}):
        here = sorted((k for k in singles if pieces[k].frame == frame), key=lambda k: pieces[k].z)
        boards = [k for k in here if pieces[k].rim_coordinate == RECTANGLE and on_axis[pieces[k].axis] == 1]
        groups = [[k] for k in here if k not in boards] + ([boards] if boards else [])
        groups.sort(key=lambda members: pieces[members[0]].z)
        stacks.append(_Stack(frame, [_Group.of(pieces, members) for members in groups]))
    return stacks


def _groups(pieces: list[TracedSurface], walls: list[int]) -> list[_Group]:
    """Return groups of at most `GROUP` of the surfaces with the indices `walls` on each axis, in order along it."""
    groups = []
    for axis in sorted({pieces[k].axis for k in walls}):
        here = [k for k in walls if pieces[k].axis == axis]
        members = sorted(here, key=lambda k: sum(pieces[k].extent))
        for first in range(0, len(members), GROUP):
            groups.append(_Group.of(pieces, members[first : first + GROUP]))
    return groups


def _z_at(o: mi.Vector3f, d: mi.Vector3f, t: mi.Float) -> mi.Float:
    """Return a ray's z coordinate, mm, at the distance t, mm, which may be infinite."""
    return dr.fma(smaller(t, FAR), d.z, o.z)


def _reaches(ray: AxisRay, best: mi.Float, z_low: mi.Float, z_high: mi.Float) -> mi.Bool:
    """Return a mask of rays that cross the slab between `z_low` and `z_high`, mm, before the distance `best`, mm."""
    far = dr.fma(smaller(best, FAR), ray.dz, ray.oz)
    forward = ray.dz >= 0
    return (dr.select(forward, far, ray.oz) >= z_low) & (dr.select(forward, ray.oz, far) <= z_high)
