"""Rays along the edge of a beam, followed on the host by what they meet first, and how far from rims they pass.

Where such a ray comes very close to a rim, both of its fates are followed: it hits the surface, and it goes past.
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
BESIDE = 1e-9  # share of the way to a hit by which a surface in the same place may lie behind it

Rim = tuple[int, int]
"""Number of the surface, place in `RIM_COLUMNS`."""
# What tells passages by a rim apart: the fates before it, the hits since, the rim, which of the crossings of its sheet
Key = tuple[tuple[int, ...], int, int, int, int]


class Meeting(NamedTuple):
    """
    What the rays of a line meet at a step.

    Attributes
    ----------
    surface : (n,) int
        -1: nothing.
    point : (n, 3) float64
        Where, mm.
    """

    surface: np.ndarray
    point: np.ndarray

    @classmethod
    def of(cls, count: int, place: np.ndarray, surface: np.ndarray, point: np.ndarray) -> Meeting:
        """Of some rays of a line of `count`."""
        found = cls(np.full(count, -1), np.full((count, 3), np.nan))
        found.surface[place], found.point[place] = surface, point
        return found


@dataclass
class Passage:
    """
    How the rays of a closed line pass by a rim.

    Attributes
    ----------
    depth : (n,) float64
        How far within the rim they cross the surface, mm, less than 0 beyond it; NaN of those that are not near it.
    point : (n, 3) float64
        Where, mm.
    counts : (n,) bool
        Whether light goes on from there by one of both fates; known of those very near.
    way : tuple of Meeting
        What the rays have met before.
    """

    depth: np.ndarray
    point: np.ndarray
    counts: np.ndarray
    way: tuple[Meeting, ...]

    @property
    def slope(self) -> np.ndarray:
        """Change of the depth by the way along the line, (n,); infinite of a ray that is near without neighbours."""
        change = []
        for back, ahead in ((1, -1), (1, 0), (0, -1)):
            step = np.linalg.norm(np.roll(self.point, ahead, axis=0) - np.roll(self.point, back, axis=0), axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                change.append(np.abs(np.roll(self.depth, ahead) - np.roll(self.depth, back)) / step)
        both, before, behind = change
        return np.where(np.isnan(both), np.fmin(np.fmin(before, behind), np.inf), both)


class Bundle(NamedTuple):
    """
    Some rays of a line on their way.

    Attributes
    ----------
    o, d : (n, 3) float64
        Origins (mm) and unit directions.
    last : (n,) int
        Surface that each ray comes from; -1: none.
    place : (n,) int
        Where they are in the line.
    fates : tuple of int
        Surfaces that they have met, or passed, otherwise than they would.
    way : tuple of Meeting
        What they have met.
    """

    o: np.ndarray
    d: np.ndarray
    last: np.ndarray
    place: np.ndarray
    fates: tuple[int, ...] = ()
    way: tuple[Meeting, ...] = ()

    def take(self, some: np.ndarray) -> Bundle:
        """Those of some places."""
        return self._replace(o=self.o[some], d=self.d[some], last=self.last[some], place=self.place[some])


class _Near(NamedTuple):
    """Legs that pass near a rim: their numbers, the depths (mm) and the points (mm)."""

    legs: np.ndarray
    depth: np.ndarray
    point: np.ndarray

    def take(self, some: np.ndarray) -> _Near:
        """Some of them."""
        return _Near(self.legs[some], self.depth[some], self.point[some])


@dataclass
class MarginalRays:
    """
    The rays of one closed line, and the rims that they pass by.

    Attributes
    ----------
    table : SurfaceTable
    zones : dict
        Widths of the zones within which a ray is near a rim, mm.
    close : float
        Share of a zone within which both fates are followed.
    inside : (n,) bool
        Whether light goes on from the end of the ray next to each, a little inside of the edge: what moves a rim may
        let the light at the edge go that way.
    passages : dict
    met : set of int
        Surfaces that they have met.
    """

    table: SurfaceTable
    zones: dict[Rim, float]
    close: float
    inside: np.ndarray
    passages: dict[Key, Passage] = field(default_factory=dict)
    met: set[int] = field(default_factory=set)

    @property
    def count(self) -> int:
        """Number of rays of the line."""
        return len(self.inside)

    def follow(self, rays: Bundle) -> np.ndarray:
        """
        Follow rays to their end, and note which rims they pass by.

        Returns
        -------
        (n,) bool
            Whether light goes on from the end of each: it is no black surface, and not the open.
        """
        alive, lit, here = np.arange(len(rays.o)), np.zeros(len(rays.o), dtype=bool), rays
        legs, lengths, numbers, origins, way = [], [], [], [], rays.way
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
            lit[alive] = True  # round and round
        o, d, last, place = (np.concatenate(column) for column in zip(*(leg[:4] for leg in legs), strict=True))
        whole = Bundle(o, d, last, place, rays.fates, way)
        length, step, origin = (np.concatenate(parts) for parts in (lengths, numbers, origins))
        for key, near in self._passing(whole, length):
            for number in np.unique(step[near.legs]):
                here = step[near.legs] == number
                before = whole._replace(way=way[: len(rays.way) + number])
                self._note((rays.fates, int(number), *key), near.take(here), before, lit[origin])
        return lit

    def _after(self, rays: Bundle, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions behind the surface that rays are at, and whether they end there."""
        after, _ = onward(self.table, rays.last, rays.d, normal)
        detects = (self.table.optics.host_words[rays.last] & DETECTOR) != 0
        return after, detects | ~np.isfinite(after[:, 0])

    def _black(self, surface: np.ndarray) -> np.ndarray:
        """Whether surfaces that end light send none on, and record none."""
        optics = self.table.optics
        words, bsdfs = optics.host_words[surface], optics.bsdfs
        scatters = np.array([bool(bsdfs[k].scatter) for k in surface], dtype=bool)
        dark = ((words & OPAQUE) != 0) & ((words & 3) == IDEAL) & (optics.host_indices[surface, 2] == 0)
        return np.asarray(dark & ~scatters & ((words & DETECTOR) == 0))

    def _passing(self, legs: Bundle, length: np.ndarray) -> Iterator[tuple[tuple[int, int, int], _Near]]:
        """Rims, with the number of the crossing of their sheet, and the legs that pass near them."""
        for piece in self.table.pieces:
            rims = [rim for rim in piece.rim_sizes if (piece.index, rim) in self.zones]
            least = np.where(legs.last == piece.index, piece.self_hit, 0.0)
            for k, way in enumerate(crossings(self.table, piece.index, legs.o, legs.d).T if rims else ()):
                with np.errstate(invalid="ignore"):
                    some = np.flatnonzero((way > least) & (way <= length * (1 + BESIDE)))
                if not len(some):  # Dr.Jit, which knows some rims, has no empty arrays
                    continue
                points = legs.o[some] + way[some, None] * legs.d[some]
                depths = piece.rim_depths(local(self.table, piece.index, points, points)[0])
                for rim in rims:
                    zone = self.zones[piece.index, rim]
                    # Beside a side of a rectangle only where the other one is not far
                    others = [depth > -zone for other, depth in depths.items() if other != rim]
                    near = np.all([np.abs(depths[rim]) < zone, *others], axis=0)
                    if np.any(near):
                        yield (piece.index, rim, k), _Near(some[near], depths[rim][near], points[near])

    def _note(self, key: Key, near: _Near, legs: Bundle, lit: np.ndarray) -> None:
        """Keep how legs pass a rim, and send those that are very near to their other fate."""
        very = np.abs(near.depth) < self.close * self.zones[key[2:4]]
        counts = very & (lit[near.legs] | self.inside[legs.place[near.legs]])
        if np.any(very) and len(legs.fates) < MOST_FATES:
            at = legs.take(near.legs[very])._replace(o=near.point[very], last=np.full(int(very.sum()), key[2]))
            counts[very] |= self._otherwise(at, near.depth[very] < 0)
        if key not in self.passages:
            lost = np.full((self.count, 4), np.nan)
            self.passages[key] = Passage(lost[:, 0], lost[:, 1:], np.zeros(self.count, dtype=bool), legs.way)
        passage, place = self.passages[key], legs.place[near.legs]
        passage.depth[place], passage.point[place], passage.counts[place] = near.depth, near.point, counts

    def _otherwise(self, rays: Bundle, hits: np.ndarray) -> np.ndarray:
        """Whether light goes on from the end of rays that now hit the surface they have passed, or the other way."""
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


def depth_again(table: SurfaceTable, rim: Rim, passage: Passage, rays: Bundle) -> np.ndarray:
    """
    Depths of rays within a rim where surfaces stand otherwise, mm.

    Parameters
    ----------
    table : SurfaceTable
        As it is now.
    rim : (int, int)
    passage : Passage
        As it was.
    rays : Bundle
        Some of its rays at their start.

    Returns
    -------
    (n,) float64
        NaN of those that miss a surface of their way.
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
    """Where rays cross a surface, nearest to where they did; of stock shapes, which do not move, where they did."""
    if surface >= len(table.pieces):
        return then
    way = crossings(table, surface, o, d)
    points = o[:, None] + way[..., None] * d[:, None]
    away = np.linalg.norm(points - then[:, None], axis=2)
    return np.asarray(points[np.arange(len(o)), np.argmin(np.where(np.isnan(away), np.inf, away), axis=1)])
