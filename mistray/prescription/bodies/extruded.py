"""Prisms with a polygon as section, extruded along x; also boxes and beam-splitter cubes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.outline import polygon, signed_area
from mistray.prescription.bodies.placing import face_place, moved_as_one
from mistray.prescription.coating import BLACK, COATINGS, Coating
from mistray.prescription.model import Surface
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import POINT_MM, SIZE_MM, Each, several, shown

X = np.array([1.0, 0.0, 0.0])


# More than 8 parameters: each is one property of the body
def prism(
    name: str,
    corners: Sequence[Sequence[float]],
    width: float,
    *,
    material: str,
    outside: str = "air",
    faces: str | Sequence[str] | None = None,
    coatings: Mapping[str, Coating | None] | None = None,
    mirrors: str | Sequence[str] = (),
    ends: Coating | None = BLACK,
    scatter: Scatter | Sequence[Scatter] = (),
) -> tuple[Surface, ...]:
    """
    Return the faces of a glass body whose section is a polygon in the yz plane.

    Parameters
    ----------
    name : str
        Name of the part; faces are ``<name>_<face>``.
    corners : sequence of (y, z)
        Corners (y, z) of the section in the world, mm, in either sense; convex or not. Face k lies between corner k and
        the next.
    width : float
        Width along x, mm, from -width/2 to width/2.
    material, outside : str
        Materials of the body and around it, see `mistray.materials`.
    faces : sequence of str, optional
        Names of the faces; by default their indices, from 1.
    coatings : mapping of str to Coating or None
        Face → coating; faces without one are bare, with Fresnel and total reflection.
    mirrors : str or sequence of str
        Faces at which the design path reflects, totally or by their coating.
    ends : Coating or None
        Coating of the two ends, ``<name>_left`` (-x) and ``<name>_right`` (+x), black by default; None: bare.
    scatter : Scatter or sequence of Scatter
        Scatter models of all faces but the ends.

    Returns
    -------
    tuple of Surface
        Faces for `Prescription.surfaces` or `Prescription.structures`; `moved_as_one` moves the whole body.

    Raises
    ------
    MistrayError
        If the section crosses itself or has no area, the width is not above 0, the names do not match the faces, or a
        coating or mirror names no face.

    Examples
    --------
    >>> corners = [(-10, 0), (10, 0), (10, 20)]  # y and z, mm
    >>> prism = mistray.prescription.prism(
    ...     "fold", corners, 20, material="N-BK7", faces=("entrance", "exit", "hypotenuse"), mirrors="hypotenuse"
    ... )
    >>> [(face.name, face.mirror) for face in prism[:3]]
    [('fold_entrance', False), ('fold_exit', False), ('fold_hypotenuse', True)]
    """
    owner = f"prism '{name}'"
    section = _section(corners, owner)
    count = len(section)
    names = [str(k + 1) for k in range(count)] if faces is None else several(faces)
    if len(names) != count or len(set(names)) != count:
        raise MistrayError(f"{owner}: {names} are names of its {count} faces; give one to each")
    SIZE_MM.check("width", width, owner)
    models = SCATTER.check("scatter", scatter, owner)
    given = {} if coatings is None else COATINGS.check("coatings", coatings, owner)
    mirrors = several(mirrors)
    for face in (*given, *mirrors):
        if face not in names:
            raise MistrayError(f"{owner}: it has no face '{face}'; its faces are {', '.join(names)}")
    turned = signed_area(section) < 0
    common: dict[str, Any] = {"front": material, "back": outside, "part": name}
    found = []
    for k, face in enumerate(names):
        a, b = section[k], section[(k + 1) % count]
        along = (b - a) / np.linalg.norm(b - a)
        outward = np.array([along[1], -along[0]]) * (-1 if turned else 1)
        normal = np.array([0.0, *outward])
        place = face_place(np.array([0.0, *(a + b) / 2]), (X, np.cross(normal, X), normal))
        size: dict[str, Any] = {"half_width": width / 2, "half_height": float(np.linalg.norm(b - a)) / 2}
        found.append(
            Surface(f"{name}_{face}", **place, **size, coating=given.get(face), scatter=models, mirror=face in mirrors,
                    **common)
        )  # fmt: skip
    middle = section.mean(axis=0)
    for face, side in (("left", -1.0), ("right", 1.0)):
        # Seen from outside, y to the right: z goes up at the one end and down at the other
        axes = (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, side]), side * X)
        outline = polygon([(float(y), float(side * z)) for y, z in section - middle])
        place = face_place(np.array([side * width / 2, *middle]), axes)
        found.append(Surface(f"{name}_{face}", **place, outline=outline, coating=ends, **common))
    return tuple(found)


def box(
    name: str,
    size: Sequence[float],
    *,
    centre: Sequence[float] = (0.0, 0.0, 0.0),
    coating: Coating | None = BLACK,
    scatter: Scatter | Sequence[Scatter] = (),
) -> tuple[Surface, ...]:
    """
    Return the faces of an opaque box, such as a housing, an electronics box or a bracket.

    Parameters
    ----------
    name : str
        Name of the part; faces are ``<name>_front`` (-z), ``_top`` (+y), ``_rear`` (+z), ``_bottom`` (-y), ``_left``
        (-x) and ``_right`` (+x).
    size : (3,) float
        Sizes along x, y and z, mm.
    centre : (3,) float
        Position of the centre, mm.
    coating, scatter
        Coating (None: bare Fresnel interface) and scatter models of the faces; the ends at -x and +x have no scatter.

    Returns
    -------
    tuple of Surface
        Faces for `Prescription.structures`.

    Raises
    ------
    MistrayError
        If a size is not above 0.

    Examples
    --------
    >>> electronics = mistray.prescription.box("electronics", (40, 20, 30), centre=(0, -60, 10))
    >>> len(electronics), electronics[1].name
    (6, 'electronics_top')
    """
    owner = f"box '{name}'"
    width, *sides = Each(SIZE_MM, 3).check("size", size, owner)
    x, y, z = POINT_MM.check("centre", centre, owner)
    b, c = (side / 2 for side in sides)
    faces = ("front", "top", "rear", "bottom")
    found = prism(
        name, [(-b, -c), (b, -c), (b, c), (-b, c)], width, material="air", faces=faces, ends=coating,
        coatings=dict.fromkeys(faces, coating), scatter=scatter,
    )  # fmt: skip
    return moved_as_one(found, x=x, y=y, z=z)


def beam_splitter_cube(
    name: str,
    size: float,
    *,
    material: str,
    splitter: Coating,
    faces: Coating | None = None,
    outside: str = "air",
    ends: Coating | None = BLACK,
) -> tuple[Surface, ...]:
    """
    Return the faces of two right-angle prisms cemented at a coated diagonal, about the origin.

    Light along +z is reflected to +y.

    Parameters
    ----------
    name : str
        Name of the part; faces are ``<name>_entrance`` (-z), ``_exit`` (+z), ``_reflected`` (+y), ``_unused`` (-y),
        ``_splitter``, ``_left`` and ``_right``.
    size : float
        Length of an edge, mm.
    material, outside : str
        Materials of the cube and around it.
    splitter : Coating
        Coating of the diagonal.
    faces, ends : Coating or None
        Coating of the four polished faces, and of the ends ``_left`` (-x) and ``_right`` (+x); None: bare.

    Returns
    -------
    tuple of Surface
        Faces for `Prescription.surfaces`.

    Raises
    ------
    MistrayError
        If `size` is not above 0.

    Examples
    --------
    >>> half = mistray.Coating(R=0.5, T=0.5)
    >>> cube = mistray.prescription.beam_splitter_cube("cube", 25.4, material="N-BK7", splitter=half)
    >>> [face.name for face in cube]
    ['cube_entrance', 'cube_reflected', 'cube_exit', 'cube_unused', 'cube_left', 'cube_right', 'cube_splitter']
    """
    h = size / 2
    names = ("entrance", "reflected", "exit", "unused")
    body = prism(
        name, [(-h, -h), (h, -h), (h, h), (-h, h)], size, material=material, outside=outside, faces=names,
        coatings=dict.fromkeys(names, faces), ends=ends,
    )  # fmt: skip
    root = math.sqrt(0.5)
    normal = np.array([0.0, -root, root])  # half way between +z and back from +y
    diagonal = Surface(
        f"{name}_splitter", **face_place(np.zeros(3), (X, np.cross(normal, X), normal)), half_width=h,
        half_height=h / root, front=material, back=material, coating=splitter, part=name,
    )  # fmt: skip
    return (*body, diagonal)


def _section(corners: Sequence[Sequence[float]], owner: str) -> np.ndarray:
    """Return the corners (y, z) of a section, (n, 2), mm; raise `MistrayError` if they form no simple polygon."""
    try:
        section = np.array(several(corners), dtype=np.float64).reshape(len(corners), 2)
    except (TypeError, ValueError):
        raise MistrayError(f"{owner}: corners are {shown(corners)}; give y and z of each, mm") from None
    polygon([tuple(corner) for corner in section.tolist()]).check(owner)
    return section
