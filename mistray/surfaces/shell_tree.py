"""Many surfaces in a tree of bounds, so that a ray is tested against few of them and the kernel does not grow.

The bounds of a node are a shell about an axis: a stretch of the axis, with a least and a greatest distance from it. The
surfaces on one axis share a binary tree of such shells. So the bounds hold the wall of a barrel without the hole in it.
Surfaces on different axes are collected in cylinders, which are shells without a hole. Each node precedes the nodes
below it. A ray that misses the bounds of a node continues at the `skip` of the node and needs no memory of the nodes it
has visited.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mistray.surfaces.surface import TracedSurface

MOST_UNROLLED = 128  # surfaces of a kind that are tested one after the other; more are put into a tree
MOST_ASPHERES = 32  # aspheres that are tested one after the other, one bit of a word each
SLACK = 1e-5  # margin for rounding, in units of the sizes of a node

Axis = tuple[int, float, float]
"""Index of an orientation, and the two coordinates of the axis across it, mm; see `SurfaceTable.axes`."""


@dataclass(frozen=True)
class _Body:
    """Surfaces on one axis, by their positions in the tree, and the low and high corner of a box around them, mm."""

    axis: Axis
    members: np.ndarray
    box: np.ndarray


@dataclass
class _Nodes:
    """
    Nodes of a tree under construction, in the order in which rays visit them.

    Attributes
    ----------
    axes : list of Axis
        Axis of each node.
    shells : list of (4,) float64
        Least and greatest position along the axis, then least and greatest distance from it, mm.
    pieces : list of int
        Position of a node's only surface among the members of the tree; the number of members for other nodes.
    skips : list of int
        Index of the node that follows if a ray misses this one.
    """

    axes: list[Axis] = field(default_factory=list)
    shells: list[np.ndarray] = field(default_factory=list)
    pieces: list[int] = field(default_factory=list)
    skips: list[int] = field(default_factory=list)

    def add(self, axis: Axis, shell: np.ndarray, piece: int, below: int) -> None:
        self.axes.append(axis)
        self.shells.append(shell)
        self.pieces.append(piece)
        self.skips.append(len(self.skips) + 1 + below)


class ShellTree:
    """
    Bounding-volume tree of shells about axes, for many surfaces of a scene.

    Parameters
    ----------
    pieces : sequence of TracedSurface
        All analytic surfaces of the scene.
    members : sequence of int
        Indices of the surfaces in the tree.
    frames : sequence of (3, 3) float64
        Orientations of the scene, the first of them unrotated.
    axes : sequence of Axis
        Axes of the scene's surfaces.

    Attributes
    ----------
    members : list of int
        Indices of the surfaces in the tree.
    axes : list of Axis
        Axes of the nodes.
    axis : (n,) uint32
        Axis of each node as a position in `axes`; it is valid for both orders.
    bounds : (2, n, 4) float64
        Least and greatest position along the axis, mm, and squares of the least and the greatest distance from
        it, mm². The first row is in the order for rays along the axis, the second in that for rays against it.
    piece : (2, n) uint32
        Position in `members` of a node's only surface; the number of members for all other nodes.
    skip : (2, n) uint32
        Node that follows the last one below each node.
    """

    def __init__(
        self,
        pieces: Sequence[TracedSurface],
        members: Sequence[int],
        frames: Sequence[np.ndarray],
        axes: Sequence[Axis],
    ) -> None:
        self.members = list(members)
        self._shells = np.array([(*pieces[k].extent, pieces[k].least_radius, pieces[k].size) for k in self.members])
        numbers = np.array([pieces[k].axis for k in self.members])
        order = np.argsort(numbers, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1)
        bodies = [self._body(axes[numbers[group[0]]], group, frames) for group in groups]
        both = []
        for backwards in (False, True):
            nodes = _Nodes()
            self._gather(nodes, bodies, backwards)
            both.append(nodes)
        known = {axis: k for k, axis in enumerate(dict.fromkeys(both[0].axes))}
        self.axes = list(known)
        self.axis = np.array([known[axis] for axis in both[0].axes], dtype=np.uint32)
        self.piece, self.skip = (
            np.array([getattr(nodes, name) for nodes in both], dtype=np.uint32) for name in ("pieces", "skips")
        )
        shells = np.array([nodes.shells for nodes in both])
        slack = SLACK * (1 + np.abs(shells[..., :2]).sum(axis=-1))
        wide = SLACK * shells[..., 3] + slack
        inner, outer = np.maximum(shells[..., 2] - wide, 0), shells[..., 3] + wide
        self.bounds = np.stack([shells[..., 0] - slack, shells[..., 1] + slack, inner**2, outer**2], axis=-1)

    def _body(self, axis: Axis, group: np.ndarray, frames: Sequence[np.ndarray]) -> _Body:
        frame, x, y = axis
        low, high, _, radius = _around(self._shells[group])
        ends = np.array([(x, y, low), (x, y, high)]) @ frames[frame].T
        beside = radius * np.sqrt(np.maximum(1 - frames[frame][:, 2] ** 2, 0))
        return _Body(axis, group, np.array([ends.min(axis=0) - beside, ends.max(axis=0) + beside]))

    def _gather(self, nodes: _Nodes, bodies: Sequence[_Body], backwards: bool) -> None:
        """Add to `nodes` a subtree of the surfaces of several bodies; `backwards` for rays against the axes."""
        if len(bodies) == 1:
            self._divide(nodes, bodies[0].axis, bodies[0].members, backwards)
            return
        boxes = np.array([body.box for body in bodies])
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        x, y, _ = 0.5 * (low + high)
        shell = np.array([low[2], high[2], 0.0, 0.5 * np.hypot(*(high - low)[:2])])
        below = sum(2 * len(body.members) for body in bodies) - 2
        nodes.add((0, float(x), float(y)), shell, len(self.members), below)
        for half in _halves(boxes.mean(axis=1)):
            self._gather(nodes, [bodies[k] for k in half], backwards)

    def _divide(self, nodes: _Nodes, axis: Axis, members: np.ndarray, backwards: bool) -> None:
        """
        Add to `nodes` a subtree of surfaces on one axis, halved until each leaf has one surface.

        `backwards` turns the order for rays against the axis.
        """
        shells, single = self._shells[members], len(members) == 1
        nodes.add(axis, _around(shells), members[0] if single else len(self.members), 2 * len(members) - 2)
        if single:
            return
        halves = _halves(np.stack([shells[:, :2].mean(axis=1), shells[:, 2:].mean(axis=1)], axis=1))
        for half in reversed(halves) if backwards else halves:
            self._divide(nodes, axis, members[half], backwards)

    def candidates(self, o: np.ndarray, d: np.ndarray, frames: Sequence[np.ndarray]) -> dict[int, np.ndarray]:
        """
        Return the indices of the rays that enter the bounds of each surface, by surface index.

        Surfaces whose bounds no ray enters are left out.

        Parameters
        ----------
        o, d : (n, 3) float64
            Origins relative to `SurfaceTable.centre`, mm, and unit directions.
        frames : sequence of (3, 3) float64
            Orientations of the scene, as given to the tree.
        """
        found: dict[int, np.ndarray] = {}
        columns = np.array([*o.T, *d.T])
        waiting = [(0, np.arange(len(o)))]
        while waiting:
            node, rays = waiting.pop()
            frame, x, y = self.axes[self.axis[node]]
            here = columns[:, rays]
            if frame:
                here = np.concatenate([frames[frame].T @ here[:3], frames[frame].T @ here[3:]])
            rays = rays[_meets(here - [[x], [y], [0], [0], [0], [0]], self.bounds[0, node])]
            if not len(rays):
                continue
            if self.piece[0, node] < len(self.members):
                found[self.members[self.piece[0, node]]] = rays
            else:
                waiting += [(node + 1, rays), (int(self.skip[0, node + 1]), rays)]
        return found


def many(pieces: Sequence[TracedSurface]) -> list[int]:
    """
    Return the indices of surfaces to put into a tree: all of each kind that is too numerous to unroll.

    The kinds are walls, lens surfaces and aspheres. Surfaces of families that trees do not support are left out.
    """
    walls = [k for k, piece in enumerate(pieces) if piece.wall]
    aspheres = [k for k, piece in enumerate(pieces) if piece.searched]
    others = [k for k, piece in enumerate(pieces) if not piece.wall and not piece.searched]
    limits = (walls, MOST_UNROLLED), (others, MOST_UNROLLED), (aspheres, MOST_ASPHERES)
    return sorted(k for found, limit in limits if len(found) > limit for k in found if pieces[k].fours)


def _around(shells: np.ndarray) -> np.ndarray:
    """Return the smallest shell that holds the given shells, (n, 4): least and greatest z and radius, mm."""
    low, high = shells.min(axis=0), shells.max(axis=0)
    return np.array([low[0], high[1], low[2], high[3]])


def _halves(middles: np.ndarray) -> list[np.ndarray]:
    """Split points (n, k) in two halves along the coordinate with the widest range; return the indices of each."""
    order = np.argsort(middles[:, np.argmax(np.ptp(middles, axis=0))], kind="stable")
    return [order[: len(order) // 2], order[len(order) // 2 :]]


def _meets(rays: np.ndarray, shell: np.ndarray) -> np.ndarray:
    """
    Return a mask of rays that enter a shell about the z axis, neither missing it nor passing its hole.

    `rays`, (6, n), are points, mm, and directions; `shell` is a row of `ShellTree.bounds`.
    """
    x, y, z, dx, dy, dz = rays
    low, high, inner2, outer2 = shell
    with np.errstate(all="ignore"):
        first, second = (low - z) / dz, (high - z) / dz
        start, end = np.fmax(np.fmin(first, second), 0), np.fmax(first, second)
        closest = np.clip(-(x * dx + y * dy) / (dx * dx + dy * dy), start, end)

        def off2(t: np.ndarray) -> np.ndarray:
            return np.asarray((x + t * dx) ** 2 + (y + t * dy) ** 2)

        return np.asarray(~((start > end) | (np.fmax(off2(start), off2(end)) < inner2) | (off2(closest) > outer2)))
