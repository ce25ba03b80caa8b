"""
Bodies of scattering media, and their importance targets: where a body should scatter light to reach the detector.

- Light that a body on the design path scatters is aimed at the image of the detector by the surfaces that follow. If
  too few rays to that image reach the detector, the body counts as any other.
- Light that any other body scatters is aimed at what can be seen from within: the detector, and the lenses and mirrors
  of the design path. Backward rays from these, refracted where they enter the body, show where each appears to be.
  Scatter of a surface that sees them only through another one, such as a face of a window, is aimed in the same way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mistray.kernel.targets import Inside, Target
from mistray.sampling.detector_images import FAR, DetectorImages
from mistray.sampling.outlines import outline
from mistray.surfaces.host_points import across, lambertian_directions, surface_points
from mistray.surfaces.host_rays import first_hit, onward
from mistray.surfaces.optics import BACK_MEDIUM_SHIFT, FRONT_MEDIUM_SHIFT, MEDIUM_MASK, OPAQUE
from mistray.surfaces.surfaces import SurfaceTable
from mistray.time_budget import fewer_rays

PROBES = 256  # rays into a medium from each side of its surfaces
PATH_RAYS = 4096  # rays from a body on the design path, by which the size of the image is fitted
SIGHT_RAYS = 4096  # backward rays from each sight
MOST_SURFACES = 6  # surfaces between a sight and the body
LEAST_SEEN = 16  # rays by which a target is fitted
LANDED = 0.02  # share of the rays to an image that must land on the detector
MOST_TARGETS = 4
PLANES = np.linspace(-2, 2, 33)  # vergences of planes, in units of that in which the rays are closest


@dataclass(frozen=True)
class ScatteringBody:
    """
    Connected region of one scattering medium, with the sides of surfaces that bound it.

    Attributes
    ----------
    medium : int
        Position of the medium in `Optics.media`.
    faces : frozenset of Inside
        Sides of transmitting surfaces that bound it.
    walls : frozenset of Inside
        Sides of opaque surfaces that are visible from within.
    points : (n, 3) float64
        Points within, mm.
    """

    medium: int
    faces: frozenset[Inside]
    walls: frozenset[Inside]
    points: np.ndarray

    @property
    def sides(self) -> list[Inside]:
        """Sorted sides of the surfaces at which a ray that travels within the body may end."""
        return sorted(self.faces | self.walls, key=lambda side: (side.surface, side.at_back))


def medium_of(table: SurfaceTable, side: Inside) -> int:
    """Return the position in `Optics.media` of the medium on one side of a surface; 0 for an opaque surface."""
    shift = BACK_MEDIUM_SHIFT if side.at_back else FRONT_MEDIUM_SHIFT
    return int(table.optics.host_words[side.surface] >> shift) & MEDIUM_MASK


def scattering_bodies(table: SurfaceTable) -> list[ScatteringBody]:
    """
    Return the connected bodies of scattering media in the scene.

    Sides that see each other through one medium bound one body. A body whose boundary no ray from within meets again,
    such as haze around everything, ends where the surfaces do.
    """
    # Faces of scattering media, each a set of its own at first (union-find)
    rng = np.random.default_rng(0)
    faces = [
        side
        for surface in range(table.count)
        for side in (Inside(surface, False), Inside(surface, True))
        if table.optics.host_scattering[medium_of(table, side)] > 0
    ]
    parent = {face: face for face in faces}

    def root(face: Inside) -> Inside:
        while parent[face] != face:
            face = parent[face]
        return face

    # Probes into the medium: faces that see each other are joined, opaque walls are noted
    within: dict[Inside, list[np.ndarray]] = {}
    seen: dict[Inside, Counter[Inside]] = {}
    for face in faces:
        o, normals = surface_points(table, face.surface, PROBES, rng)
        d = lambertian_directions(normals if face.at_back else -normals, rng)
        hit, p, normal = first_hit(table, o, d, np.full(PROBES, face.surface))
        from_front = np.einsum("ij,ij->i", d, normal) > 0
        medium, arrives = medium_of(table, face), np.zeros(PROBES, dtype=bool)
        for number, (surface, front) in enumerate(zip(hit.tolist(), from_front.tolist(), strict=True)):
            if surface < 0:
                continue
            other = Inside(surface, not front)
            if other in parent and medium_of(table, other) == medium:
                parent[root(other)] = root(face)
                arrives[number] = True
            elif table.optics.host_words[surface] & OPAQUE:
                seen.setdefault(other, Counter())[face] += 1
                arrives[number] = True
        # Points within: at random along the segments that end on the boundary
        depth = rng.random((PROBES, 1))
        within[face] = [(o + depth * (p - o))[arrives]]
    # A wall belongs to the body from which most probes meet it
    walls: dict[Inside, Inside] = {}
    for wall, counts in seen.items():
        together: Counter[Inside] = Counter()
        for face, count in counts.items():
            together[root(face)] += count
        walls[wall] = together.most_common(1)[0][0]
    # One body for each set of faces
    found = []
    for first in dict.fromkeys(root(face) for face in faces):
        own = [face for face in faces if root(face) == first]
        points = np.concatenate([part for face in own for part in within[face]])
        if len(points):
            its_walls = frozenset(wall for wall, body in walls.items() if body == first)
            found.append(ScatteringBody(medium_of(table, first), frozenset(own), its_walls, points))
    return found


class Sight(NamedTuple):
    """
    Surface or opening at which scattered light is aimed from every place that can see it.

    Attributes
    ----------
    target : Target
        Flat region that serves as target.
    surface : int
        Index of the surface; -1: the sight is an opening or the sky.
    light : (3,) float64 or None
        Unit direction of the design path's light there, which only targets in front of it may send; None: any.
    """

    target: Target
    surface: int
    light: np.ndarray | None = None


class Appearance(NamedTuple):
    """
    Surface or opening as it appears from a body or a surface, directly or through other surfaces.

    Attributes
    ----------
    target : Target
        Flat region that serves as target.
    number : int
        Index of the sight.
    by : int
        Index of the last surface that rays from the sight leave; that of the sight itself where nothing stands between,
        which is -1 for an opening.
    share : float
        Fraction of the rays from the sight that arrive by that surface.
    """

    target: Target
    number: int
    by: int
    share: float


def body_targets(
    table: SurfaceTable,
    body: ScatteringBody,
    images: DetectorImages | None,
    sights: Sequence[Sight],
    rng: np.random.Generator,
) -> list[Target]:
    """
    Return the importance targets of the light that a body of a scattering medium scatters, at most `MOST_TARGETS`.

    For a body on the design path they are the images of the detector through which enough rays land on it. If
    there are none, and for any other body, they are the sights as they appear from within.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    body : ScatteringBody
        Body that scatters.
    images : DetectorImages, optional
        Images of the detector by the surfaces of the design path; None: there is no path.
    sights : sequence of Sight
        Surfaces and openings to aim at, the most important first.
    rng : np.random.Generator
        Random number generator.
    """
    # On the path: the body lies before a step if the step, or the one before it, bounds it on that side
    found = []
    steps = images.path.steps if images else ()
    for number, step in enumerate(steps):
        ends = {Inside(step.surface, not step.from_front)}
        if number:
            ends.add(Inside(steps[number - 1].surface, steps[number - 1].to_back))
        if images is not None and not ends.isdisjoint(body.sides):
            rays = fewer_rays(PATH_RAYS)
            points = body.points[rng.integers(len(body.points), size=rays)]
            fitted = images.fitted(number, points, np.tile(step.before, (rays, 1)), rng)
            if fitted.landed > LANDED:
                found.append(fitted.target)
    # Off the path
    if not found:
        found = [one.target for one in apparent(table, body.points, body.faces, sights, rng)]
    return found[:MOST_TARGETS]


def arrivals(
    table: SurfaceTable,
    within: np.ndarray,
    faces: Set[Inside],
    sights: Sequence[Sight],
    rays: int,
    rng: np.random.Generator,
) -> dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]]:
    """
    Return backward rays from sights that arrive at points within a body or on a surface, grouped by path.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    within : (m, 3) float64
        Points, mm.
    faces : set of Inside
        Sides of surfaces at which a ray arrives: those of the body, or that of the surface.
    sights : sequence of Sight
        Surfaces and openings that are targets where they can be seen.
    rays : int
        Number of rays from each of them.
    rng : np.random.Generator
        Random number generator.

    Returns
    -------
    dict
        By the index of the sight and those of the surfaces on the way, its own first. Each entry has the points where
        the rays leave the last surface (mm), and unit directions back from the points `within`, (n, 3) float64 each.
    """
    # Start rays on the sights
    o = np.concatenate([sight.target.points(rng.random((rays, 2))) for sight in sights])
    number = np.repeat(np.arange(len(sights)), rays)
    last = np.array([sight.surface for sight in sights])[number]
    ends = within[rng.integers(len(within), size=len(o))]
    first, _, _ = first_hit(table, o, _towards(o, ends), last)
    # A lens bends rays to the points that would miss them in a straight line: every second ray is sent to a random
    # point of the surface that it meets first
    for surface in np.unique(first[(first >= 0) & (first < len(table.pieces))]):
        some = np.flatnonzero((first == surface) & (np.arange(len(o)) % 2 == 1))
        ends[some] = outline(table.shapes[surface]).points(rng.random((len(some), 2)))
    d = _towards(o, ends)
    lights = np.array([np.zeros(3) if sight.light is None else sight.light for sight in sights])[number]
    goes = (np.einsum("ij,ij->i", d, lights) < 0) | ~np.any(lights, axis=1)
    o, d, last, ways = o[goes], d[goes], last[goes], np.stack([number, last], axis=1)[goes]
    # Follow the rays through surfaces, and group those that arrive by the surfaces on their way
    lines: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]] = {}
    for _ in range(MOST_SURFACES):
        hit, p, normal = first_hit(table, o, d, last)
        from_front = np.einsum("ij,ij->i", d, normal) > 0
        sides = zip(hit.tolist(), from_front.tolist(), strict=True)
        arrives = np.array([Inside(s, not front) in faces for s, front in sides], dtype=bool)
        found, which = np.unique(ways[arrives], axis=0, return_inverse=True)
        for k, way in enumerate(found.tolist()):
            own = np.flatnonzero(arrives)[which.ravel() == k]
            lines[tuple(way)] = o[own], -d[own]
        going = (hit >= 0) & ~arrives
        after, _ = onward(table, hit[going], d[going], normal[going])
        whole = np.isfinite(after[:, 0])
        o, d, last = p[going][whole], after[whole], hit[going][whole]
        ways = np.concatenate([ways[going][whole], last[:, None]], axis=1)
        if not len(o):
            break
    return lines


def apparent(
    table: SurfaceTable, within: np.ndarray, faces: Set[Inside], sights: Sequence[Sight], rng: np.random.Generator
) -> list[Appearance]:
    """
    Return targets that cover the sights as seen from points within a body or on a surface; see `arrivals`.

    Returns
    -------
    list of Appearance
        One for each sight and way to it, in the order of the sights; of each sight, the way of most rays first.
    """
    found, rays = [], fewer_rays(SIGHT_RAYS)
    for (number, *way), (points, directions) in arrivals(table, within, faces, sights, rays, rng).items():
        if len(points) < LEAST_SEEN:
            continue
        target = sights[number].target if len(way) == 1 else _holding(points, directions, within)
        if target is not None:
            found.append(Appearance(target, number, way[-1], len(points) / rays))
    return sorted(found, key=lambda one: (one.number, -one.share))


def _towards(o: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the unit directions from points `o`, mm, to the points `ends`, mm, (n, 3)."""
    return np.asarray((ends - o) / np.linalg.norm(ends - o, axis=1, keepdims=True))


def _holding(points: np.ndarray, directions: np.ndarray, within: np.ndarray) -> Target | None:
    """
    Return the flat ellipse of least solid angle, seen from the body, that all given rays cross.

    The result is None if not all rays go ahead along their mean direction, or if every plane that was tried cuts the
    body.

    Parameters
    ----------
    points, directions : (n, 3) float64
        Points where the rays leave the body (mm), and unit directions in which they leave it.
    within : (m, 3) float64
        Points of the body, mm.
    """
    # Rays as positions and slopes in a plane across their mean direction
    axis = directions.mean(axis=0)
    axis /= np.linalg.norm(axis)
    ahead = directions @ axis
    if not np.all(ahead > 0):
        return None
    middle, frame = points.mean(axis=0), across(axis)
    height = (points - middle) @ axis
    slopes = directions @ frame / ahead[:, None]
    places = (points - middle) @ frame - height[:, None] * slopes  # in the plane through the middle
    # Distance at which the rays are closest together, by least squares
    depth = (within - middle) @ axis
    size = float(np.linalg.norm(np.ptp(within, axis=0)))
    spread = float(np.sum(np.var(slopes, axis=0)))
    together = -float(np.sum((places - places.mean(axis=0)) * (slopes - slopes.mean(axis=0)))) / len(points)
    far = FAR * size
    closest = together / spread if spread > abs(together) / far else np.copysign(far, together)
    # Planes about it, even in vergence; in each the ellipse along the principal axes of the crossings
    best: tuple[float, Target] | None = None
    for vergence in 1 / closest + max(abs(1 / closest), 1 / size) * PLANES if closest else 1 / size * PLANES:
        distance = 1 / vergence if abs(vergence) * far > 1 else far
        # A plane through the body has points of it on both sides
        if depth.min() <= distance <= depth.max():
            continue
        crossings = places + distance * slopes
        centre = crossings.mean(axis=0)
        _, _, turned = np.linalg.svd(crossings - centre, full_matrices=False)
        along = (crossings - centre) @ turned.T
        half = np.maximum(np.abs(along).max(axis=0), 1e-6 * abs(distance))
        half *= np.hypot(*(along / half).T).max() * (1 + 1 / np.sqrt(len(points)))
        u, v = (half[:, None] * turned) @ frame.T
        target = Target(
            "ellipse", middle + distance * axis + frame @ centre, u, v, reverse=bool(distance < depth.min())
        )
        solid_angle = float(np.mean(target.area / (distance - depth) ** 2))
        if best is None or solid_angle < best[0]:
            best = solid_angle, target
    return best[1] if best else None
