"""Spiders that hold a secondary mirror: vanes with thickness and depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.pose import fixed_angles_deg
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.model import Surface
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import SIZE_MM, Range

DECIMALS = 9  # of places (mm) and angles (degrees)


# More than 8 parameters: each is one dimension of the part
def spider(
    name: str,
    *,
    vanes: int,
    inner_radius: float,
    outer_radius: float,
    thickness: float,
    depth: float,
    z: float,
    offset: float = 0.0,
    start_deg: float = 90.0,
    coating: Coating | None = BLACK,
    scatter: Scatter | Sequence[Scatter] = (),
) -> tuple[Surface, ...]:
    """
    Return the faces of all vanes of a spider: their two sides, and their front and rear edges.

    Parameters
    ----------
    name : str
        Name of the part; faces are ``<name>_<k>_front`` (-z), ``_rear`` (+z), ``_left`` (towards growing azimuth) and
        ``_right`` for vane k = 1, 2, ….
    vanes : int
        Number of vanes, at equal angles.
    inner_radius, outer_radius : float
        Start and end of a vane, measured along it, mm.
    thickness, depth : float
        Size across the vane and along z, mm.
    z : float
        Position of the edges on the -z side, mm.
    offset : float
        Distance by which the middle plane of each vane passes beside the axis, mm, for tangential vanes; if > 0, on the
        side of growing azimuth.
    start_deg : float
        Azimuth of the first vane from x to y, degrees.
    coating, scatter
        Coating (None: bare Fresnel interface) and scatter models of all faces.

    Returns
    -------
    tuple of Surface
        Faces for `Prescription.structures`.

    Raises
    ------
    MistrayError
        If a dimension or the number of vanes is out of range, or vanes overlap at their inner end.

    Examples
    --------
    >>> vanes = mistray.prescription.spider(
    ...     "spider", vanes=4, inner_radius=30, outer_radius=105, thickness=1, depth=20, z=-400
    ... )
    >>> len(vanes), vanes[0].name
    (16, 'spider_1_front')
    """
    owner = f"spider '{name}'"
    SIZE_MM.check_all(owner, outer_radius=outer_radius, thickness=thickness, depth=depth)
    Range(1, whole=True).check("vanes", vanes, owner)
    Range(0.0, outer_radius, below=True, unit="mm").check("inner_radius", inner_radius, owner)
    least = _least_inner_radius(vanes, 0.5 * thickness, abs(offset))
    if inner_radius < least:
        raise MistrayError(
            f"{owner}: its vanes overlap within {least:.6g} mm; begin them farther out or make them thinner"
        )
    faces = []
    half, middle = 0.5 * (outer_radius - inner_radius), 0.5 * (outer_radius + inner_radius)
    common: dict[str, Any] = {"coating": coating, "scatter": SCATTER.check("scatter", scatter, owner), "part": name}
    up = np.array([0.0, 0.0, 1.0])
    for k in range(vanes):
        angle = math.radians(start_deg + 360.0 * k / vanes)
        along = np.array([math.cos(angle), math.sin(angle), 0.0])
        aside = np.array([-math.sin(angle), math.cos(angle), 0.0])
        centre = middle * along + offset * aside + z * up
        edge, side = np.column_stack([along, aside, up]), np.column_stack([along, up, -aside])
        for face, turn, at, size in (
            ("front", edge, centre, thickness),
            ("rear", edge, centre + depth * up, thickness),
            ("left", side, centre + 0.5 * depth * up + 0.5 * thickness * aside, depth),
            ("right", side, centre + 0.5 * depth * up - 0.5 * thickness * aside, depth),
        ):
            x, y, height = (round(float(v), DECIMALS) + 0.0 for v in at)
            tilt = [round(v, DECIMALS) + 0.0 for v in fixed_angles_deg(turn)]
            own: dict[str, Any] = {"x": x, "y": y, "z": height, "tilt_deg": (tilt[0], tilt[1], tilt[2])}
            faces.append(Surface(f"{name}_{k + 1}_{face}", half_width=half, half_height=0.5 * size, **own, **common))
    return tuple(faces)


def _least_inner_radius(vanes: int, half: float, offset: float) -> float:
    """
    Return the distance along neighbouring vanes at which they part, mm; 0 or below if none of them meet.

    `half` is half the thickness and `offset`, at least 0, the distance of their middle planes from the axis, mm.
    """
    if vanes < 3:
        return 0.0
    turn = math.pi / vanes  # half the angle between neighbours
    # Where both strips end: the side of one towards the other. Of three vanes another corner comes first
    return (half - offset) / math.tan(turn) if vanes == 3 else half / math.tan(turn) - offset * math.tan(turn)
