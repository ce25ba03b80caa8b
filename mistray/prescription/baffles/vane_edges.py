"""Cross-sections of vanes, which `vane_tube` places in tubes: knife edges, plates, bevels and rounded edges."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from mistray.errors import MistrayError
from mistray.ranges import SIZE_MM, Range, check_fields

ARC_FACETS = 6  # cones that stand for a rounded edge


@dataclass(frozen=True, kw_only=True)
class VaneEdge:
    """
    Cross-section of a vane at its inner edge.

    Attributes
    ----------
    thickness : float
        Thickness of the plate, mm.
    bevel_deg : float or None
        Angle β between the bevel and the plane of the vane, degrees; small is sharp. ``None``: a square edge, or a
        round one if the radius is half the thickness.
    radius : float
        Radius of the rounded edge, mm; 0: perfectly sharp. Real knife edges have 0.01 to 0.1 mm. A rounded edge is lit
        and seen, so its first-order path remains even in a good baffle.

    Raises
    ------
    MistrayError
        If a parameter is out of range, or a plate without bevel has another radius than 0 or half its thickness.

    Examples
    --------
    >>> edge = mistray.prescription.VaneEdge(thickness=0.5, bevel_deg=20, radius=0.02)
    >>> tube = mistray.prescription.vane_tube(
    ...     "hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5, edge=edge
    ... )
    >>> tube.vanes[0].edge.radius
    0.02
    """

    thickness: float = replace(SIZE_MM, remedy="for an ideal edge give none").field()
    bevel_deg: float | None = Range(0.0, 90.0, above=True, below=True, unit="degrees").field(None)
    radius: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "vane edge")
        Range(0.0, self.thickness / 2, unit="mm", remedy="half the thickness is the most").check(
            "radius", self.radius, "vane edge"
        )
        if self.bevel_deg is None and self.radius not in (0.0, self.thickness / 2):
            raise MistrayError(
                f"vane edge: radius = {self.radius:g} mm of a plate {self.thickness:g} mm thick without bevel; "
                "give 0 (square) or half the thickness (round), or a bevel_deg"
            )


@dataclass(frozen=True)
class Vane:
    """
    Ring-shaped vane inside a tube.

    Attributes
    ----------
    z : float
        Position of its tip, mm: of the edge nearest to the axis, or of the rear face of a square plate.
    radius : float
        Radius of its opening, mm.
    edge : VaneEdge or None
        Shape of the edge; ``None``: a plane ring of zero thickness.
    bevel : str
        Bevelled face: "front", with the plate before the tip, or "rear", with the plate behind it.

    Examples
    --------
    >>> edge = mistray.prescription.VaneEdge(thickness=1, bevel_deg=20)
    >>> vane = mistray.prescription.Vane(z=-50, radius=22, edge=edge)
    >>> vane.plate
    (-51, -50)
    """

    z: float
    radius: float
    edge: VaneEdge | None = None
    bevel: str = "front"

    @property
    def plate(self) -> tuple[float, float]:
        """First and last z of the vane's plate, mm."""
        thickness = 0.0 if self.edge is None else self.edge.thickness
        return (self.z, self.z + thickness) if self.bevel == "rear" else (self.z - thickness, self.z)


Profile = tuple[str, float, float, float, float]
"""Ending of a name; r0, z0, r1, z1 in mm."""


def vane_faces(vane: Vane, wall_radius: Callable[[float], float]) -> Iterator[Profile]:
    """
    Yield the faces of a vane as frusta, from the wall along its front to the tip and back along its rear.

    Parameters
    ----------
    vane : Vane
        Vane inside the tube.
    wall_radius : callable
        Function from z to the radius of the wall, both in mm.

    Yields
    ------
    Profile
        A single face with an empty ending for a plane ring; else ``_front``, ``_bevel``, ``_edge_1`` …, ``_rear``,
        without faces of zero width.

    Raises
    ------
    MistrayError
        If bevel and rounding are wider than the vane is deep.
    """
    if vane.edge is None:
        yield ("", wall_radius(vane.z), vane.z, vane.radius, vane.z)
        return
    points, names = _edge_profile(vane, vane.edge)
    if vane.bevel == "rear":
        points, names = [(r, 2 * vane.z - z) for r, z in reversed(points)], names[::-1]
    (first, z_first), (last, z_last) = points[0], points[-1]
    if max(first, last) >= min(wall_radius(z_first), wall_radius(z_last)):
        raise MistrayError(
            f"vane at z = {vane.z:g} mm: its edge reaches to r = {max(first, last):g} mm, beyond the wall; make "
            "bevel_deg larger or the thickness smaller"
        )
    yield ("_front", wall_radius(z_first), z_first, first, z_first)
    facet = 0
    for (r0, z0), (r1, z1), name in zip(points, points[1:], names, strict=False):
        if name == "_edge":
            facet += 1
            name += f"_{facet}"
        yield (name, r0, z0, r1, z1)
    yield ("_rear", last, z_last, wall_radius(z_last), z_last)


def _edge_profile(vane: Vane, edge: VaneEdge) -> tuple[list[tuple[float, float]], list[str]]:
    """
    Return points (r, z), mm, from front over tip to rear of a vane that is bevelled at the front.

    The second result has the ending of the name of each face between two points, without numbers.
    """
    a, z, rho = vane.radius, vane.z, edge.radius
    if edge.bevel_deg is None:
        if rho == 0:
            return [(a, z - edge.thickness), (a, z)], ["_edge"]
        middle = z - rho
        return _arc(a + rho, middle, rho, math.radians(180.0)), ["_edge"] * ARC_FACETS
    # The rounded edge touches the rear plane z and the bevel, whose outward normal is (-sin β, -cos β)
    beta = math.radians(edge.bevel_deg)
    centre = (a + rho, z - rho)
    arc = [(a, z)] if rho == 0 else _arc(*centre, rho, math.radians(180.0) - beta)
    r_bevel, z_bevel = arc[0]
    depth = edge.thickness - (z - z_bevel)
    return [(r_bevel + depth / math.tan(beta), z - edge.thickness), *arc], ["_bevel", *["_edge"] * (len(arc) - 1)]


def _arc(r: float, z: float, radius: float, turn: float) -> list[tuple[float, float]]:
    """Return points (r, z), mm, on an arc about the centre (r, z): `turn`, rad, around its side near the axis."""
    angles = [turn * (1 - k / ARC_FACETS) for k in range(ARC_FACETS + 1)]
    return [(r - radius * math.sin(angle), z + radius * math.cos(angle)) for angle in angles]
