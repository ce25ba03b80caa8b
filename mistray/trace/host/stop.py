"""Aperture stop of a scene, chief rays through its centre, and coordinates in its plane."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError, nearest
from mistray.sampling.design_path import DesignPath
from mistray.sampling.outlines import outline
from mistray.sampling.source import Sphere
from mistray.trace.host.bundle import PointBundle
from mistray.trace.host.design_light import stop_crossing

Array = npt.NDArray[np.float64]

LOOKS = (48, 192)  # cells across the first aperture in which light is looked for: the second where the first finds none
SECTORS = 24  # directions in which the rim of the stop is looked for
SECTIONS, REFINEMENTS = 32, 8  # parts of the way across the rim that it is looked for in, again and again
NEWTON_STEPS = 30
STEP = 1e-5  # of the differences that Newton's method takes its slopes from, in units of the pupil's size
SAME_RIM = 1e-4  # of its radius, by which a flange may lie beside the rim that it is around
MET = 1e-10  # of the stop's radius, by which a chief ray may miss its middle


@dataclass(frozen=True)
class Region:
    """
    Part of a field point's entrance beam that reaches the detector.

    Attributes
    ----------
    points : (n, 2) float64
        Coordinates of rays that get through: mm, or slopes for a near point, see `PointBundle`.
    cell : float
        Distance of neighbouring rays, in the same coordinates.
    """

    points: Array
    cell: float

    @property
    def middle(self) -> Array:
        """Centre of the region's bounding box, (1, 2), in the bundle's coordinates (mm or slopes)."""
        return np.asarray(0.5 * (self.points.min(axis=0) + self.points.max(axis=0)))[None]

    @property
    def size(self) -> float:
        """Longer side of the bounding box of the region's cells, in the bundle's coordinates (mm or slopes)."""
        return float(np.ptp(self.points, axis=0).max()) + self.cell


def lit_region(path: DesignPath, bundle: PointBundle, aperture: Sphere) -> Region | None:
    """
    Return the part of the entrance beam that reaches the detector; None if no light does.

    `aperture`, mm, contains the first surface of the path; light is looked for within it.
    """
    middle, radius = bundle.coordinates(aperture)
    for count in LOOKS:
        points, cell = _cells(middle, radius, count)
        found = points[path.unobstructed(*bundle.rays(points), beyond_end=True).passes]
        if not len(found):
            continue
        low, high = found.min(axis=0) - cell, found.max(axis=0) + cell
        half = 0.5 * float(np.max(high - low))
        if half < 0.7 * radius:
            points, cell = _cells(0.5 * (low + high), half, LOOKS[0])
            found = points[path.unobstructed(*bundle.rays(points), beyond_end=True).passes]
        return Region(found, cell) if len(found) else None
    return None


def _cells(middle: Array, half: float, count: int) -> tuple[Array, float]:
    """
    Return the centres, (count², 2), of count × count cells of a square, and the side of a cell.

    The square has its centre at `middle`, (2,), and half the side `half`, all in one unit.
    """
    axis = half * ((2 * np.arange(count) + 1) / count - 1)
    return middle + np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2), 2 * half / count


@dataclass(frozen=True)
class PupilStop:
    """
    Aperture stop of a design path: surface, centre, axes and radius, mm.

    Attributes
    ----------
    name : str
        Id of the surface at its rim.
    place : int
        Index of the step of the design path before which rays cross it.
    at_surface : bool
        Whether it is the surface of that step.
    centre, u, v : (3,) float64
        Centre of the surface's opening, mm, and unit vectors in its plane, roughly along x and y of the entering light.
    radius : float
        Largest distance from the centre at which the light that `find_stop` is given crosses the stop, mm.
    """

    name: str
    place: int
    at_surface: bool
    centre: Array
    u: Array
    v: Array
    radius: float

    def coordinates(self, path: DesignPath, bundle: PointBundle, x: Array) -> Array:
        """
        Return where rays cross the stop, (n, 2), along `u` and `v` in units of its radius; NaN for rays that fail.

        `x`, (n, 2), are coordinates of rays in the bundle: mm or slopes.
        """
        normal = np.cross(self.u, self.v)
        p = stop_crossing(path, *bundle.rays(x), self.place, self.at_surface, self.centre, normal) - self.centre
        return np.stack([p @ self.u, p @ self.v], axis=1) / self.radius

    def chief(self, path: DesignPath, bundle: PointBundle, start: Array, size: float) -> Array:
        """
        Return coordinates (1, 2) of the ray through the middle of the stop, by Newton's method; NaN if none is found.

        Parameters
        ----------
        path : DesignPath
            Design path of the scene.
        bundle : PointBundle
            Rays of the field.
        start : (1, 2) float64
            Coordinates of a ray that gets through (mm or slopes).
        size : float
            Size of the pupil, in coordinates of the bundle (mm or slopes).
        """
        x, step = start.copy(), STEP * size
        shifts = np.concatenate([np.zeros((1, 2)), step * np.eye(2), -step * np.eye(2)])
        for _ in range(NEWTON_STEPS):
            found = self.coordinates(path, bundle, x + shifts)
            if not np.all(np.isfinite(found)):
                break
            if np.linalg.norm(found[0]) < MET:
                return x
            slopes = (found[1:3] - found[3:5]).T / (2 * step)
            if abs(np.linalg.det(slopes)) < 1e-12 / size**2:
                break
            change = np.linalg.solve(slopes, found[0])
            x = x - change * min(1.0, size / max(float(np.linalg.norm(change)), 1e-300))
        return np.full((1, 2), np.nan)


def find_stop(path: DesignPath, bundle: PointBundle, region: Region, name: str | None) -> PupilStop:
    """
    Return the aperture stop: the surface that blocks most of the rays just outside a beam that gets through.

    If it is a mount around a lens or mirror, this lens or mirror is the stop.

    Parameters
    ----------
    path : DesignPath
        Design path of the scene.
    bundle : PointBundle
        Light on the axis, or at the first field if none on the axis gets through.
    region : Region
        Region of this light.
    name : str or None
        Id of the surface to use as the stop instead; None: it is found.

    Raises
    ------
    MistrayError
        If there is no surface of this name, no light ends at it, or no surface limits the light.
    """
    ids = path.table.ids
    count = 2 * LOOKS[0]
    half = 0.5 * region.size + 3 * region.cell
    points, _ = _cells(region.middle[0], half, count)
    found = path.unobstructed(*bundle.rays(points), beyond_end=True)
    lit = found.passes.reshape(count, count)
    near = np.zeros_like(lit)
    near[1:], near[:-1] = lit[:-1], lit[1:]
    near[:, 1:] |= lit[:, :-1]
    near[:, :-1] |= lit[:, 1:]
    rim = (near & ~lit).ravel()
    # What passes by a lens or mirror ends anywhere; its rim is what limits the light
    surfaces = np.array([step.surface for step in path.steps])
    limits = np.where(found.missed | (found.ends < 0), surfaces[found.place], found.ends)
    if name is not None:
        if name not in ids:
            raise MistrayError(f"stop '{name}': the scene has no such surface; {nearest(name, ids)}")
        surface = ids.index(name)
        places = found.place[limits == surface]
        on_path = np.flatnonzero(surfaces == surface)
        if not len(on_path) and not len(places):
            raise MistrayError(f"stop '{name}': no light ends at it, so that it limits none; name another surface")
        at_surface = bool(len(on_path))
        place = int(on_path[0]) if at_surface else int(Counter(places.tolist()).most_common(1)[0][0])
    else:
        if not rim.any():
            raise MistrayError(
                "no surface limits the light: it gets through everywhere; add an aperture, or name the stop"
            )
        pairs = Counter(zip(limits[rim].tolist(), found.place[rim].tolist(), strict=True))
        surface, place = pairs.most_common(1)[0][0]
        surface, place = _within_rim(path, surface, place)
        at_surface = surface == surfaces[place]
    opening = outline(path.table.shapes[surface])
    u = opening.u / np.linalg.norm(opening.u)
    rough = PupilStop(ids[surface], place, at_surface, opening.centre, u, np.cross(opening.normal, u), 1.0)
    return _sized(_turned(rough, path, bundle, region), path, bundle, region)


def _within_rim(path: DesignPath, surface: int, place: int) -> tuple[int, int]:
    """
    Return the indices of the stop's surface and of its step in the path, given for a surface that blocks light.

    For a mount they are those of the lens or mirror in it, else those given.
    """
    ring = outline(path.table.shapes[surface])
    for other in (place, place - 1):
        if not 0 <= other < len(path.steps) - 1:
            continue
        rim = outline(path.table.shapes[path.steps[other].surface])
        size = float(np.linalg.norm(rim.u))
        apart = np.linalg.norm(rim.centre - ring.centre) + abs(ring.hole * np.linalg.norm(ring.u) - size)
        if rim.shape == ring.shape == "ellipse" and apart < SAME_RIM * size:
            return path.steps[other].surface, other
    return surface, place


def _turned(stop: PupilStop, path: DesignPath, bundle: PointBundle, region: Region) -> PupilStop:
    """
    Return the stop with its axes along the images of the incoming light's x and y, as nearly as possible.

    It is returned unchanged where a ray close to the middle does not get through.
    """
    h = 1e-3 * region.size
    x = region.points[np.argmin(np.linalg.norm(region.points - region.middle, axis=1))]
    shifts = h * np.concatenate([np.eye(2), -np.eye(2)])
    at = stop.coordinates(path, bundle, x + shifts)
    slopes = (at[:2] - at[2:]).T
    if not np.all(np.isfinite(slopes)):
        return stop
    left, _, right = np.linalg.svd(slopes)
    axes = np.stack([stop.u, stop.v], axis=1) @ (left @ right)
    return PupilStop(stop.name, stop.place, stop.at_surface, stop.centre, axes[:, 0], axes[:, 1], stop.radius)


def _sized(stop: PupilStop, path: DesignPath, bundle: PointBundle, region: Region) -> PupilStop:
    """Return the stop with the radius, mm, that the light of `region` fills, the largest of `SECTORS` directions."""
    at = stop.coordinates(path, bundle, region.points)
    sector = np.floor((np.arctan2(at[:, 1], at[:, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    reach = np.linalg.norm(at, axis=1)
    outer = [np.flatnonzero(sector == k)[np.argmax(reach[sector == k])] for k in np.unique(sector)]
    inside = region.points[outer]
    away = inside - region.middle
    length = np.linalg.norm(away, axis=1, keepdims=True)
    outside = inside + 3 * region.cell * away / np.where(length > 0, length, 1.0)
    parts = (np.arange(1, SECTIONS + 1) / SECTIONS)[:, None]
    for _ in range(REFINEMENTS):
        tried = inside[:, None] + parts * (outside - inside)[:, None]
        good = path.unobstructed(*bundle.rays(tried.reshape(-1, 2)), beyond_end=True).passes.reshape(-1, SECTIONS)
        last = np.argmin(
            np.column_stack([good[:, :-1], np.zeros(len(good), dtype=bool)]), axis=1
        )  # first that does not
        step = (outside - inside) / SECTIONS
        inside, outside = inside + last[:, None] * step, inside + (last + 1)[:, None] * step
    radius = float(np.linalg.norm(stop.coordinates(path, bundle, inside), axis=1).max())
    return PupilStop(stop.name, stop.place, stop.at_surface, stop.centre, stop.u, stop.v, radius)
