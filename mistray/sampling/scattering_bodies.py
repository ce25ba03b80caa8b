"""Bodies of scattering media, on the host: the sides of surfaces that bound them, and points within."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from mistray.kernel.targets import Inside
from mistray.surfaces.host_points import lambertian_directions, surface_points
from mistray.surfaces.host_rays import first_hit
from mistray.surfaces.optics import BACK_MEDIUM_SHIFT, FRONT_MEDIUM_SHIFT, MEDIUM_MASK, OPAQUE
from mistray.surfaces.surfaces import SurfaceTable

PROBES = 256  # rays into the medium from each side


@dataclass(frozen=True)
class ScatteringBody:
    """
    Connected region of one scattering medium, and the sides of surfaces that bound it.

    Attributes
    ----------
    medium : int
        Number of the medium.
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
        """Sides of surfaces at which a ray segment within the body may end, sorted."""
        return sorted(self.faces | self.walls, key=lambda side: (side.surface, side.at_back))


def medium_of(table: SurfaceTable, side: Inside) -> int:
    """Return the number of the medium on one side of a surface; 0 for an opaque surface."""
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
