"""Parts of a CAD or mesh file: triangles with the indices of their faces and, from STEP, the surfaces of the faces."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from mistray.errors import MistrayError
from mistray.materials.mate import shown

LONGEST_NAME = 50  # letters of an id from a title; the id is a part of the name of a file
LARGEST_MM = 1e7  # ten kilometres: beyond it a file is broken, or its unit is wrong
UNITS_MM: Mapping[str, float] = MappingProxyType(
    {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4, "ft": 304.8}
)


@dataclass(frozen=True, eq=False)
class RoundSurface:
    """
    Exact plane, cylinder or cone on which a face lies.

    Attributes
    ----------
    kind : str
        Kind of surface: "plane", "cylinder" or "cone".
    point : (3,) float64
        Point on the axis of a cylinder, apex of a cone, or any point of a plane, mm.
    axis : (3,) float64
        Unit vector along the axis, or along the normal of a plane.
    size : float
        Radius of a cylinder, mm; tangent of the half angle of a cone; 0 for a plane.
    """

    kind: Literal["plane", "cylinder", "cone"]
    point: np.ndarray
    axis: np.ndarray
    size: float = 0.0


@dataclass(frozen=True, eq=False)
class CadPart:
    """
    Part of a CAD or mesh file, in the frame of the file, or in that of the scene once it is `moved` there.

    Attributes
    ----------
    name : str
        Name that is unique in the file and valid as a shape id.
    title, product, path : str
        Names in the file: of the instance, of its product, and the path from the top of the assembly, separated by "/".
    vertices : (n, 3) float64
        Positions of the vertices, mm.
    triangles : (m, 3) int64
        Indices of the vertices of each triangle, counter-clockwise as seen from outside the body if the file is
        correct.
    faces : (m,) int64
        Index of the face of each triangle, from 0 in the order of the file.
    surfaces : mapping of int to RoundSurface
        Exact surfaces, keyed by the index of the face, of the faces whose surface is known.
    """

    name: str
    title: str
    product: str
    path: str
    vertices: np.ndarray
    triangles: np.ndarray
    faces: np.ndarray
    surfaces: Mapping[int, RoundSurface] = field(default_factory=dict)

    def face_name(self, face: int) -> str:
        """Return the name of the face with a given index, ``<part>_face_<index>``."""
        return f"{self.name}_face_{face}"

    def moved(self, matrix: np.ndarray) -> CadPart:
        """
        Return the part in another frame.

        Parameters
        ----------
        matrix : (4, 4) float64
            Affine transform from the present frame to the other one, translation in mm. If it mirrors, the order of
            vertices is reversed, so that normals still point outwards. Exact surfaces are kept only if it preserves
            angles.

        Raises
        ------
        MistrayError
            If the transform flattens the part.
        """
        linear, shift = matrix[:3, :3], matrix[:3, 3]
        scale = float(np.cbrt(abs(np.linalg.det(linear))))
        if not scale > 0:
            raise MistrayError(
                f"part '{shown([self.title])}': its placement flattens it (determinant 0); correct the file"
            )
        mirrors = np.linalg.det(linear) < 0
        surfaces: dict[int, RoundSurface] = {}
        if np.allclose(linear @ linear.T, scale**2 * np.eye(3), rtol=0, atol=1e-6 * scale**2):
            for face, s in self.surfaces.items():
                axis = linear @ s.axis
                size = s.size * scale if s.kind == "cylinder" else s.size
                surfaces[face] = RoundSurface(s.kind, linear @ s.point + shift, axis / np.linalg.norm(axis), size)
        return replace(
            self,
            vertices=self.vertices @ linear.T + shift,
            triangles=self.triangles[:, ::-1] if mirrors else self.triangles,
            surfaces=surfaces,
        )


def checked(part: CadPart) -> tuple[CadPart, int]:
    """
    Return a part without triangles of zero area, and the number of triangles removed.

    Raises
    ------
    MistrayError
        If it has no triangles or none with an area, coordinates that are not finite or beyond `LARGEST_MM`, or
        triangles that refer to missing vertices.
    """
    triangles, title = part.triangles, shown([part.title])
    if not len(triangles):
        raise MistrayError(f"part '{title}': it has no triangles; export it as a solid or a mesh")
    if triangles.min() < 0 or triangles.max() >= len(part.vertices):
        raise MistrayError(
            f"part '{title}': a triangle refers to vertex {int(triangles.max())} of {len(part.vertices)}; "
            "the file is damaged, export it again"
        )
    corners = part.vertices[triangles]
    if not np.all(np.isfinite(corners)):
        raise MistrayError(f"part '{title}': a vertex is not finite; the file is damaged, export it again")
    largest = float(np.abs(corners).max())
    if largest > LARGEST_MM:
        raise MistrayError(
            f"part '{title}': it reaches to {largest:.3g} mm; the most is {LARGEST_MM:g} mm, check the unit"
        )
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    good = np.any(cross != 0, axis=1)
    if not good.any():
        raise MistrayError(f"part '{title}': all its triangles have no area; export it again")
    return replace(part, triangles=triangles[good], faces=part.faces[good]), int(np.sum(~good))


def unique_names(titles: Iterable[str]) -> list[str]:
    """
    Return unique ids made from titles, in their order.

    Runs of characters other than letters, digits, _ and - become "_". Long ids are cut, and repeated ones numbered.
    """
    taken: set[str] = set()
    names = []
    for title in titles:
        base = re.sub(r"[^\w-]+", "_", title).lstrip("_-")[:LONGEST_NAME].rstrip("_") or "part"
        name, number = base, 2
        while name in taken:
            name, number = f"{base}_{number}", number + 1
        taken.add(name)
        names.append(name)
    return names
