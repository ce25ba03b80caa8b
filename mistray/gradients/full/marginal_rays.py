"""
Marginal rays: rays along the edge of a beam, followed on the host, with their distances from the rims that they pass.

Where such a ray comes very close to a rim, both branches are followed: it hits the surface, and it goes past.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mistray.surfaces.host_rays import crossings, first_hit, local, normals, onward
from mistray.surfaces.optics import DETECTOR, IDEAL, OPAQUE
from mistray.surfaces.surfaces import SurfaceTable

MOST_STEPS, MOST_FATES = 64, 2
BESIDE = 1e-9  # relative distance by which a surface in the place of a hit may lie behind it

Rim = tuple[int, int]
"""Index of the surface, place in `RIM_COLUMNS`."""
# Key of a passage by a rim: branches before it, hits since, the rim's two indices, index of the sheet's crossing
Key = tuple[tuple[int, ...], int, int, int, int]


class Meeting(NamedTuple):
    """
    Hits of the marginal rays along one closed line of a beam's edge, at one step of their path.

    Attributes
    ----------
    surface : (n,) int
        Surfaces; -1: none.
    point : (n, 3) float64
        Points of the hits, mm.
    """

    surface: np.ndarray
    point: np.ndarray

    @classmethod
    def of(cls, count: int, place: np.ndarray, surface: np.ndarray, point: np.ndarray) -> Meeting:
        """
        Return hits for all `count` rays of a line; only those in `place` have a surface and a point.

        The others have surface -1 and a NaN point.
        """
        found = cls(np.full(count, -1), np.full((count, 3), np.nan))
        found.surface[place], found.point[place] = surface, point
        return found


@dataclass
class Passage:
    """
    Depths and points at which the marginal rays of a closed line pass a rim.

    Attributes
    ----------
    depth : (n,) float64
        Distance within the rim at which they cross the surface, mm, negative beyond it; NaN if not near it.
    point : (n, 3) float64
        Points of the crossings, mm.
    counts : (n,) bool
        Whether light continues from there on at least one of the two branches, a hit or a miss; True for very near rays
        only.
    way : tuple of Meeting
        Hits of the rays before.
    """

    depth: np.ndarray
    point: np.ndarray
    counts: np.ndarray
    way: tuple[Meeting, ...]

    @property
    def slope(self) -> np.ndarray:
        """
        Absolute change of depth per length along the closed line, (n,), mm/mm.

        It is infinite for rays that are not near the rim themselves or have no near neighbours.
        """
        change = []
        for back, ahead in ((1, -1), (1, 0), (0, -1)):
            step = np.linalg.norm(np.roll(self.point, ahead, axis=0) - np.roll(self.point, back, axis=0), axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                change.append(np.abs(np.roll(self.depth, ahead) - np.roll(self.depth, back)) / step)
        both, before, behind = change
        found = np.where(np.isnan(both), np.fmin(np.fmin(before, behind), np.inf), both)
        return np.where(np.isnan(self.depth), np.inf, found)


class MarginalBundle(NamedTuple):
    """
    State of some marginal rays of a line on their way through the scene.

    Attributes
    ----------
    o, d : (n, 3) float64
        Origins (mm) and unit directions.
    last : (n,) int
        Surface that each ray comes from; -1: none.
    place : (n,) int
        Indices of the rays on the line.
    fates : tuple of int
        Surfaces at which they took the other branch: they hit one that they would have passed, or the reverse.
    way : tuple of Meeting
        Hits so far.
    """

    o: np.ndarray
    d: np.ndarray
    last: np.ndarray
    place: np.ndarray
    fates: tuple[int, ...] = ()
    way: tuple[Meeting, ...] = ()

    def take(self, some: np.ndarray) -> MarginalBundle:
        """Return the rays of the bundle that a mask or indices select."""
        return self._replace(o=self.o[some], d=self.d[some], last=self.last[some], place=self.place[some])


@dataclass
class MarginalRays:
    """
    Marginal rays along one closed line of a beam's edge, with the rims that they pass.

    Attributes
    ----------
    table : SurfaceTable
        Surfaces of the scene.
    zones : dict
        Widths of the zones within which a ray is near a rim, mm, by surface and place in `RIM_COLUMNS`.
    close : float
        Fraction of a zone within which both branches are followed.
    inside : (n,) bool
        Whether light continues from the end of the ray beside each, a little inside the edge: a move of a rim may let
        the light at the edge take the same path.
    passages : dict
        Key → `Passage`.
    met : set of int
        Surfaces that the rays have hit.
    """

    table: SurfaceTable
    zones: dict[Rim, float]
    close: float
    inside: np.ndarray
    passages: dict[Key, Passage] = field(default_factory=dict)
    met: set[int] = field(default_factory=set)

    @property
    def count(self) -> int:
        """Number of marginal rays of the line."""
        return len(self.inside)

    def follow(self, rays: MarginalBundle) -> np.ndarray:
        """
        Trace marginal rays to their ends, and record the rims that they pass.

        Returns
        -------
        (n,) bool
            Whether the light at the end of each ray counts: at a detector, even a black one, and at surfaces that
            scatter or reflect part of it, but not at other black surfaces nor outside the scene. Trapped light counts.
        """
        alive, lit, here = np.arange(len(rays.o)), np.zeros(len(rays.o), dtype=bool), rays
        legs, lengths, numbers, origins, way = [], [], [], [], rays.way
        # Trace all rays step by step, and keep their legs
        for number in range(MOST_STEPS):
            surface, p, normal = first_hit(self.table, here.o, here.d, here.last)
            met = surface >= 0
            legs.append(here)
            lengths.append(np.where(met, np.linalg.norm(p - here.o, axis=1), np.inf))
            numbers.append(np.full(len(p), number))
            origins.append(alive)
            alive, here = alive[met], here._replace(o=p, last=surface).take(met)
            way = (*way, Meeting.of(self.count, here.place, here.last, here.o))
            self.met |= set(here.last.tolist())
            after, ends = self._after(here, normal[met])
            lit[alive[ends]] = ~self._black(here.last[ends])
            alive, here = alive[~ends], here._replace(d=after).take(~ends)
            if not len(alive):
                break
        else:
            lit[alive] = True  # trapped light counts as light that continues
        # Rims near the legs, all legs together
        o, d, last, place = (np.concatenate(column) for column in zip(*(leg[:4] for leg in legs), strict=True))
        whole = MarginalBundle(o, d, last, place, rays.fates, way)
        length, step, origin = (np.concatenate(parts) for parts in (lengths, numbers, origins))
        for key, *passing in self._passing(whole, length):
            steps = step[passing[0]]
            for number in np.unique(steps):
                near = [values[steps == number] for values in passing]
                before = whole._replace(way=way[: len(rays.way) + number])
                self._note((rays.fates, int(number), *key), before, lit[origin], *near)
        return lit

    def _after(self, rays: MarginalBundle, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the directions of rays beyond their surface, (n, 3), and a mask of rays that end there.

        Rays end at the detector, and where they have no direction beyond the surface.
        """
        after, _ = onward(self.table, rays.last, rays.d, normal)
        detects = (self.table.optics.host_words[rays.last] & DETECTOR) != 0
        return after, detects | ~np.isfinite(after[:, 0])

    def _black(self, surface: np.ndarray) -> np.ndarray:
        """Return a mask of surfaces, (n,), that absorb all light without recording it."""
        optics = self.table.optics
        words, bsdfs = optics.host_words[surface], optics.bsdfs
        scatters = np.array([bool(bsdfs[k].scatter) for k in surface], dtype=bool)
        dark = ((words & OPAQUE) != 0) & ((words & 3) == IDEAL) & (optics.host_indices[surface, 2] == 0)
        return np.asarray(dark & ~scatters & ((words & DETECTOR) == 0))

    def _passing(
        self, legs: MarginalBundle, length: np.ndarray
    ) -> Iterator[tuple[tuple[int, int, int], np.ndarray, np.ndarray, np.ndarray]]:
        """
        Yield each rim that ray segments pass closely, with the segments, depths and points.

        `legs` are the starts of the segments, `length` their lengths, mm. The rim comes as the last three entries of
        `Key`, then the indices of the segments, (n,), depths, (n,), mm, and points, (n, 3), mm.
        """
        for piece in self.table.pieces:
            rims = [rim for rim in piece.rim_sizes if (piece.index, rim) in self.zones]
            least = np.where(legs.last == piece.index, piece.self_hit, 0.0)
            for k, way in enumerate(crossings(self.table, piece.index, legs.o, legs.d).T if rims else ()):
                with np.errstate(invalid="ignore"):
                    some = np.flatnonzero((way > least) & (way <= length * (1 + BESIDE)))
                if not len(some):  # Dr.Jit, which computes the depths of some rims, has no empty arrays
                    continue
                points = legs.o[some] + way[some, None] * legs.d[some]
                depths = piece.rim_depths(local(self.table, piece.index, points, points)[0])
                for rim in rims:
                    zone = self.zones[piece.index, rim]
                    # Near a side of a rectangle only if the crossing is not far beyond the other sides
                    others = [depth > -zone for other, depth in depths.items() if other != rim]
                    near = np.all([np.abs(depths[rim]) < zone, *others], axis=0)
                    if np.any(near):
                        yield (piece.index, rim, k), some[near], depths[rim][near], points[near]

    def _note(
        self,
        key: Key,
        legs: MarginalBundle,
        lit: np.ndarray,
        near: np.ndarray,
        depth: np.ndarray,
        point: np.ndarray,
    ) -> None:
        """
        Record depths and points, mm, at which ray segments pass a rim; trace the other branch of very close ones.

        `lit` says for each of the segments `legs` whether light continues from the end of its ray. `near` are the
        indices of the segments that pass, with a depth and a point each.
        """
        very = np.abs(depth) < self.close * self.zones[key[2:4]]
        place = legs.place[near]
        counts = very & (lit[near] | self.inside[place])
        # Other branch
        if np.any(very) and len(legs.fates) < MOST_FATES:
            at = legs.take(near[very])._replace(o=point[very], last=np.full(int(very.sum()), key[2]))
            counts[very] |= self._otherwise(at, depth[very] < 0)
        if key not in self.passages:
            lost = np.full((self.count, 4), np.nan)
            self.passages[key] = Passage(lost[:, 0], lost[:, 1:], np.zeros(self.count, dtype=bool), legs.way)
        passage = self.passages[key]
        passage.depth[place], passage.point[place], passage.counts[place] = depth, point, counts

    def _otherwise(self, rays: MarginalBundle, hits: np.ndarray) -> np.ndarray:
        """
        Return a mask of rays whose light goes on when they take the other branch at a rim.

        Rays hit the rim's surface where `hits` is True, else they go past it.
        """
        after, ends = self._after(rays, normals(self.table, int(rays.last[0]), rays.o))
        ends &= hits
        lit = ends & ~self._black(rays.last)
        met = Meeting.of(self.count, rays.place[hits], rays.last[hits], rays.o[hits])
        on = rays._replace(
            way=(*rays.way, met), d=np.where(hits[:, None], after, rays.d), fates=(*rays.fates, int(rays.last[0]))
        )
        if not np.all(ends):
            lit[~ends] = self.follow(on.take(~ends))
        return np.asarray(lit)


def depth_again(table: SurfaceTable, rim: Rim, passage: Passage, rays: MarginalBundle) -> np.ndarray:
    """
    Return the distances, mm, by which rays lie inside a rim after surfaces have moved; negative outside.

    Parameters
    ----------
    table : SurfaceTable
        Moved surfaces.
    rim : (int, int)
        Index of the surface, and place of the rim in `RIM_COLUMNS`.
    passage : Passage
        Passage before the move.
    rays : MarginalBundle
        Some of its rays at their start.

    Returns
    -------
    (n,) float64
        Depths; NaN for rays that miss a surface of their path.
    """
    o, d = rays.o.copy(), rays.d.copy()
    for meeting in passage.way:
        surfaces = meeting.surface[rays.place]
        for surface in np.unique(surfaces[surfaces >= 0]):
            some = np.flatnonzero(surfaces == surface)
            o[some] = _nearest(table, int(surface), o[some], d[some], meeting.point[rays.place[some]])
            normal = normals(table, int(surface), o[some])
            d[some] = onward(table, surfaces[some], d[some], normal)[0]
    o = _nearest(table, rim[0], o, d, passage.point[rays.place])
    return table.pieces[rim[0]].rim_depths(local(table, rim[0], o, o)[0])[rim[1]]


def _nearest(table: SurfaceTable, surface: int, o: np.ndarray, d: np.ndarray, then: np.ndarray) -> np.ndarray:
    """
    Return the points at which rays cross a surface, (n, 3), mm, nearest to those before its move.

    Mitsuba's own shapes do not move: for them the earlier points `then` are returned.
    """
    if surface >= len(table.pieces):
        return then
    # A ray may cross a quadric twice
    way = crossings(table, surface, o, d)
    points = o[:, None] + way[..., None] * d[:, None]
    away = np.linalg.norm(points - then[:, None], axis=2)
    return np.asarray(points[np.arange(len(o)), np.argmin(np.where(np.isnan(away), np.inf, away), axis=1)])
