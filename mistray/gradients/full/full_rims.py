"""Search for rims that the edge of a beam runs along, where a metric has only one-sided derivatives.

Where a beam just fills a rim, a move of the rim into the beam removes light, and a move out of it has no effect: there
is no derivative, but one on either side. The estimator of `mistray.gradients.edges` would find no hit, and return 0.
The rays along the edge of a source find such rims: these rays pass by the rim within a small part of the zone in which
hits are recorded, and run along it. Where the edge of the beam crosses a rim at an angle, the density on the rim is as
smooth as anywhere, and the boundary kernel is exact for slopes. Where it runs along a rim farther away, but within the
zone, the zone is narrowed so that it ends before the edge of the beam.

Rims that the shadow of another rim just fills are not found.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.gradients.coating_gradient import SHIFTS
from mistray.gradients.edge_widths import rim_zones
from mistray.gradients.full.marginal_rays import Key, MarginalBundle, MarginalRays, Passage, Rim, depth_again
from mistray.physics.geometry.pose import moved
from mistray.sampling.source import SceneSource
from mistray.surfaces.gradient_columns import HALF_HEIGHT, HALF_WIDTH, HIGH, INNER, LOW, OUTER, POSE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import download

RAYS = 64  # number of rays along the edge of a beam
CLOSE = 0.1  # distance of the edge of a beam, in units of the zone, within which it just fills a rim
INSIDE = 2.0  # distance inside the edge, in units of `CLOSE` times the width, at which light must continue
ARC = 3  # rays in a row that must run along a rim: an edge that touches it in a point has no first-order effect
ALONG = 0.1  # change of the distance per length along the edge, below which the edge runs along the rim
EXACT = 0.03  # in units of the zone: an edge that stays this near to a rim counts as lying on it
BEFORE = 0.9  # width of a narrowed zone, in units of the distance of the edge
SAME = 1e-9  # move in units of the size of a rim that counts as none
WORDS = {
    OUTER: "outer rim",
    INNER: "inner rim",
    HALF_WIDTH: "sides in x",
    HALF_HEIGHT: "sides in y",
    LOW: "end at its low side",
    HIGH: "end at its high side",
}


@dataclass(frozen=True, eq=False)
class FullRims:
    """
    Rims of a scene that the beam of a source just fills, where a metric has only one-sided derivatives.

    Attributes
    ----------
    source : SceneSource
        Source of the beam.
    table : SurfaceTable
        Surfaces of the scene.
    width : float
        Width of the zones along the rims, in units of their radius or half side.
    """

    source: SceneSource
    table: SurfaceTable
    width: float

    @cached_property
    def zones(self) -> dict[Rim, float]:
        """Widths of the boundary zones along the rims, mm, by surface and place in `RIM_COLUMNS`."""
        return rim_zones(self.table, self.width)

    @cached_property
    def full(self) -> list[tuple[int, Key, np.ndarray]]:
        """Rims that the beam exactly fills: index of the edge line, key of the passage, mask of rays there, (n,)."""
        found = []
        for line, key, passage in self._along():
            here = passage.counts & (passage.slope < ALONG)
            if np.any(np.all([np.roll(here, k) for k in range(ARC)], axis=0)):
                found.append((line, key, here))
        return found

    @property
    def reach(self) -> float:
        """
        Largest shift of a rim relative to the beam for which a one-sided derivative holds, in zone widths.

        It is half a zone where the edge of the beam lies on the rim. Where the edge is a little off, along a part of
        the rim or all of it, it is half of `CLOSE` times the zone.
        """
        off = 0.0
        for line, key, _ in self.full:
            passage = self._passages[line].passages[key]
            along = passage.slope < ALONG
            off = max(off, float(np.max(np.abs(passage.depth[along]))) / self.zones[key[2], key[3]])
        return 0.5 * (1.0 if off < EXACT else CLOSE)

    @property
    def names(self) -> list[str]:
        """Descriptions of the just-filled rims, each once, as in `name`."""
        return list(dict.fromkeys(self.name(key) for _, key, _ in self.full))

    def name(self, key: Key) -> str:
        """Return the description of a rim for messages, such as "the outer rim of 'stop'"."""
        return f"the {WORDS[key[3]]} of '{self.table.ids[key[2]]}'"

    @cached_property
    def limits(self) -> dict[Rim, float]:
        """
        Widths, mm, of boundary zones narrowed to end before a beam edge that runs beside the rim.

        The keys are surface and place in `RIM_COLUMNS`; zones that keep their width are left out.
        """
        found: dict[Rim, float] = {}
        for _, key, passage in self._along():
            rim = key[2], key[3]
            here = (passage.slope < ALONG) & ~passage.counts
            if np.any(here):
                nearest = float(np.min(np.abs(passage.depth[here])))
                limit = max(BEFORE * nearest, CLOSE * self.zones[rim])
                found[rim] = min(limit, found.get(rim, np.inf))
        return found

    def moved_by(self, owner: Any, name: str, step: float) -> tuple[float, str]:
        """
        Return the largest shift of a just-filled rim relative to the beam when a parameter takes a step.

        The description of that rim comes with it.

        Parameters
        ----------
        owner : plugin
            Plugin that has the parameter.
        name : str
            Name of the parameter.
        step : float
            Step in the unit of the parameter.

        Returns
        -------
        share : float
            Largest shift, in units of the zone of the rim; 0 if no rim moves. Rays that no longer reach the rim count
            as a shift by a whole zone.
        rim : str
            Description of the rim that moves most; "" if none moves.
        """
        largest, rim = 0.0, ""
        if not any(owner is one for one in self._owners):
            return largest, rim
        # Follow the rays along each rim again, with the parameter changed
        table = self._with(owner, name, step)
        for line, key, here in self.full:
            passage, place = self._passages[line].passages[key], np.flatnonzero(here)
            o, d = self._edges[line]
            rays = self._moved(MarginalBundle(o[place], d[place], place, place), owner, name, step)
            move = np.abs(depth_again(table, (key[2], key[3]), passage, rays) - passage.depth[place])
            zone = self.zones[key[2], key[3]]
            farthest = float(np.max(np.where(np.isnan(move), zone, move)))
            if farthest > SAME * self.table.pieces[key[2]].rim_sizes[key[3]] and farthest / zone > largest:
                largest, rim = farthest / zone, self.name(key)
        return largest, rim

    @cached_property
    def _owners(self) -> list[Any]:
        """Plugins whose parameters can move a just-filled rim, or the rays on their way to it."""
        met = set().union(*(rays.met for rays in self._passages)) | {key[2] for _, key, _ in self.full}
        table = self.table
        return [self.source.emitter, *(part[k] for k in sorted(met) for part in (table.shapes, table.optics.bsdfs))]

    def _along(self) -> Iterator[tuple[int, Key, Passage]]:
        for line, rays in enumerate(self._passages):
            for key, passage in rays.passages.items():
                yield line, key, passage

    @cached_property
    def _edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        return self.source.edges(RAYS)

    @cached_property
    def _passages(self) -> list[MarginalRays]:
        """Marginal rays, traced along each closed line of the beam's edge, with the rims that they pass."""
        found = []
        last = self.table.ids.index(self.source.shape) if self.source.shape else -1
        for edge, within in zip(self._edges, self.source.edges(RAYS, INSIDE * CLOSE * self.width), strict=True):
            line, inside = (MarginalBundle(*rays, np.full(RAYS, last), np.arange(RAYS)) for rays in (edge, within))
            nothing = MarginalRays(self.table, {}, CLOSE, np.zeros(RAYS, dtype=bool))
            rays = MarginalRays(self.table, self.zones, CLOSE, nothing.follow(inside))
            rays.follow(line)
            found.append(rays)
        return found

    def _moved(self, rays: MarginalBundle, owner: Any, name: str, step: float) -> MarginalBundle:
        """
        Return start rays after parameter `name` of `owner` changes by `step`.

        Rays of a source other than `owner` stay as they are.
        """
        if owner is not self.source.emitter:
            return rays
        by_o, by_d = self.source.motion(name, mi.Vector3d(*rays.o.T), mi.Vector3d(*rays.d.T))
        zero = np.zeros_like(rays.o)
        o, d = (now + step * (zero + download(by)) for now, by in ((rays.o, by_o), (rays.d, by_d)))
        return rays._replace(o=o, d=d / np.linalg.norm(d, axis=1, keepdims=True))

    def _with(self, owner: Any, name: str, step: float) -> SurfaceTable:
        """
        Return the surface table on the host after parameter `name` of plugin `owner` changes by `step`.

        Parameters of shapes and shifts of indices have an effect; all others leave the table as it is.
        """
        table = copy(self.table)
        table.shared, table.kept = {}, {}
        table.pieces, table.vertices, table.rotations = (
            list(table.pieces),
            table.vertices.copy(),
            table.rotations.copy(),
        )
        for piece in self.table.pieces:
            if table.shapes[piece.index] is owner:
                values = {**owner.values, name: owner.values[name] + step}
                frame = owner.vertex_frame(values, moved(owner.base, *(values[key] for key in POSE)))
                changed = owner.surface(values)
                changed.index, changed.overlap = piece.index, piece.overlap
                table.pieces[piece.index] = changed
                table.vertices[piece.index], table.rotations[piece.index] = frame[:3, 3], frame[:3, :3]
        if name in SHIFTS:
            table.optics = copy(table.optics)
            table.optics.host_indices = table.optics.host_indices.copy()
            own = [k for k, bsdf in enumerate(table.optics.bsdfs) if bsdf is owner]
            table.optics.host_indices[own, SHIFTS.index(name)] += step
        return table
