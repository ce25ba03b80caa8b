"""Moving and copying of parts that have several faces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.pose import fixed_angles_deg
from mistray.prescription.model import Placed
from mistray.ranges import PLACE_MM, OfType, Several, several, shown

DECIMALS = 10  # of places (mm) and angles (degrees)
Part = TypeVar("Part", bound=Placed)
FACES = Several(OfType(Placed, "must be a Surface or a Structure, or several"), least=0)


def face_place(at: np.ndarray, axes: Sequence[np.ndarray]) -> dict[str, Any]:
    """
    Return the keywords x, y, z (mm) and tilt_deg (degrees) of `Placed` for a frame.

    Parameters
    ----------
    at : (3,) float64
        Origin of the frame, mm.
    axes : three (3,) float64
        Unit vectors along the x, y and z axes of the frame, in the world.
    """
    x, y, z = (round(float(v), DECIMALS) + 0.0 for v in at)
    tilt = tuple(round(v, DECIMALS) + 0.0 for v in fixed_angles_deg(np.column_stack(axes)))
    return {"x": x, "y": y, "z": z, "tilt_deg": tilt}


def moved_as_one(
    faces: Part | Iterable[Part],
    *,
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Part, ...]:
    """
    Return faces moved together: rotated about the world's origin, then shifted.

    Parameters
    ----------
    faces : Surface, Structure or iterable of them
        Faces of the part.
    x, y, z : float
        Displacement, mm.
    tilt_deg : tuple of three float
        Right-handed rotations about the world's x, y, z axes in this order, degrees.

    Returns
    -------
    tuple
        Moved faces, in order.

    Examples
    --------
    >>> cube = mistray.prescription.box("cube", (10, 10, 10))
    >>> turned = mistray.prescription.moved_as_one(cube, z=50, tilt_deg=(0, 45, 0))
    >>> front = turned[0]
    >>> round(front.x, 3), round(front.z, 3)
    (-3.536, 46.464)
    """
    motion = Placed(x=x, y=y, z=z, tilt_deg=tilt_deg).to_world()
    found = []
    for face in FACES.check("faces", faces, "moved_as_one"):
        frame = motion @ face.to_world()
        found.append(replace(face, **face_place(frame[:3, 3], frame[:3, :3].T)))
    return tuple(found)


def array(faces: Part | Sequence[Part], places: Sequence[Sequence[float]]) -> tuple[Part, ...]:
    """
    Return copies of a part at several places, for example lenslets, segments or rows of vanes.

    Parameters
    ----------
    faces : Surface, Structure or sequence of them
        Faces of one member, such as the two faces of a lenslet and its edge.
    places : sequence of (x, y) or (x, y, z)
        Displacement of each member, mm.

    Returns
    -------
    tuple
        All faces, member by member. For member k = 1, 2, … ``_<k>`` is appended to the names of faces and parts.

    Raises
    ------
    MistrayError
        If there is no place, or a place is not two or three numbers.

    Examples
    --------
    >>> lenslet = mistray.Surface("lenslet", radius=5, semi_diameter=0.5, back="N-BK7")
    >>> row = mistray.prescription.array([lenslet], [(x, 0) for x in (-1, 0, 1)])
    >>> [(face.name, face.x) for face in row]
    [('lenslet_1', -1.0), ('lenslet_2', 0.0), ('lenslet_3', 1.0)]
    """
    members, known = FACES.check("faces", faces, "array"), several(places)
    if not known:
        raise MistrayError("array: there are no places; give x and y of each member, mm")
    found: list[Part] = []
    for k, place in enumerate(known, start=1):
        numbers = PLACE_MM.check_each(f"place {k}", place, "array")
        if len(numbers) not in (2, 3):
            raise MistrayError(f"array: place {k} is {shown(place)}; give x and y, or x, y and z, mm")
        x, y, z = (*numbers, 0.0)[:3]
        for face in moved_as_one(members, x=x, y=y, z=z):
            named: Any = face
            part = f"{named.part}_{k}" if named.part else None
            found.append(replace(named, name=f"{named.name}_{k}", part=part))
    return tuple(found)
