r"""Vane tubes by ray construction: the optic behind the tube sees no part of the wall that the sky lights.

A tube of revolution about the z axis, open at ``z_front``, ends at ``z_rear`` at a round aperture of radius r_o: the
first lens, a mirror, or the entrance of the next stage. Its vanes are rings whose inner edges ("tips") follow the
unobscured beam, tip(z) = r_o + c + (z_rear - z) tan w, with the half field w and a clearance c. The wall has the radius
R(z), constant or linear.

A first-order path is source → wall or vane → optic. It exists where a point is both lit from outside and seen from the
optic. Faces of vanes are never both: light from the front meets their front faces, the optic sees their rear faces.
What is left is the wall. In a plane through the axis, with vanes (a_j, z_j) counted from the front and the optic's rim
at -r_o:

- the optic sees nothing of the wall between the vane k and the point h where the ray from its far rim past the tip
  meets the wall, (R(h) + r_o)/(z_rear - h) = (a_k + r_o)/(z_rear - z_k);
- behind a vane k the wall is dark down to the point p where the steepest ray from outside past its tip arrives, that
  from the far edge -a_j of an opening j in front of it, the last such point over all j. Behind the opening itself,
  k = 0, light can be as steep as it likes and p = z_0;
- light at more than an exclusion angle ε does not reach the wall where a_j + R(z) < (z - z_j) tan ε for one opening j.

The first vane stands at the opening; the next so that its hidden zone begins where the wall begins to be lit,
h_{k+1} = p_k less an overlap; and so on until no light at more than ε reaches the wall behind the last one. This is the
construction of the textbooks (R. P. Breault in *Handbook of Optics* vol. II, ch. 38; E. Fest, *Stray Light Analysis and
Control*, SPIE 2013, ch. 9) with the exclusion angle added.

It is exact for skew rays too. Take a wall point Q on the +x side. Describe its rays to the optic by the point where
they meet it, and its rays from outside by their slopes. Those that pass an opening then fill a disc centred on the
meridional axis. Common points of such discs form a convex set that is symmetric about this axis. So if there are any,
there are some on the axis: a point that is lit or seen at all is so in its meridional plane. The steepest common slope
lies on the axis too, because the centres of all discs lie on one side of the origin. Along the arc that bounds the set,
the distance from the origin falls from the point on the axis on.

Lengths in mm, angles in degrees in names that end in ``_deg``; light travels +z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from mistray.errors import MistrayError
from mistray.prescription.baffles.vane_edges import Vane, VaneEdge, vane_faces
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.model import Structure
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import HALF_FIELD_DEG, RADIUS_MM, SIZE_MM

MOST_VANES = 200
OVERLAP = 0.01  # of hidden and lit zones, in units of the depth of a vane: covers the rounding of float32 rays


@dataclass(frozen=True, kw_only=True)
class BaffleTube:
    """
    Tube with vanes in front of an optic.

    Attributes
    ----------
    name : str
        Start of the names of its parts: ``<name>_wall``, ``<name>_vane_1`` (the opening), ``<name>_vane_2``, ….
    z_front, z_rear : float
        Positions of the opening and of the end of the tube, mm.
    wall_front, wall_rear : float
        Radii of the wall at the opening and at the end, mm.
    optic_radius : float
        Radius of the aperture at the end, from which no lit wall may be seen, mm.
    vanes : tuple of Vane
        Vanes from the front to the rear.

    Examples
    --------
    >>> tube = mistray.prescription.vane_tube(
    ...     "hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5
    ... )
    >>> [round(vane.z) for vane in tube.vanes]
    [-150, -128, -102, -72, -40, -5]
    >>> print(f"light beyond {tube.direct_deg:.1f}° meets no optic directly")
    light beyond 19.5° meets no optic directly
    """

    name: str
    z_front: float
    z_rear: float
    wall_front: float
    wall_rear: float
    optic_radius: float
    vanes: tuple[Vane, ...]

    def wall_radius(self, z: float) -> float:
        """Return the radius of the wall at z, both in mm."""
        share = (z - self.z_front) / (self.z_rear - self.z_front)
        return self.wall_front + share * (self.wall_rear - self.wall_front)

    @property
    def direct_deg(self) -> float:
        """Smallest field angle, degrees, beyond which no light reaches the optic without scatter."""
        slopes = ((v.radius + self.optic_radius) / (self.z_rear - v.z) for v in self.vanes)
        return math.degrees(math.atan(min(slopes)))

    def structures(
        self,
        *,
        coating: Coating | None = BLACK,
        scatter: Scatter | Sequence[Scatter] = (),
        wall_scatter: Scatter | Sequence[Scatter] | None = None,
        space: int = -1,
    ) -> tuple[Structure, ...]:
        """
        Return the wall and the faces of the vanes; every vane is its own part.

        Parameters
        ----------
        coating, scatter, space
            Coating, scatter models and space of all faces, as in `Structure`.
        wall_scatter : Scatter, sequence of Scatter or None
            Scatter models of the wall, for example with ``"side": "front"``, which is its inside; None: `scatter`.

        Returns
        -------
        tuple of Structure
            Wall first, then vanes from the front.
        """
        profiles = [list(vane_faces(vane, self.wall_radius)) for vane in self.vanes]
        # A plate may stand out of the front
        z_front = min(self.z_front, *(z for profile in profiles for _, _, z, _, _ in profile))
        ends = (self.wall_radius(z_front), z_front, self.wall_rear, self.z_rear)
        models = SCATTER.check("scatter", scatter, f"baffle '{self.name}'")
        kind: dict[str, Any] = {"coating": coating, "scatter": models, "space": space}
        on_wall = kind if wall_scatter is None else {**kind, "scatter": wall_scatter}
        wall = Structure(f"{self.name}_wall", *ends, part=self.name, **on_wall)
        faces = [
            Structure(f"{(part := f'{self.name}_vane_{k}')}{face}", *profile, part=part, **kind)
            for k, faces_of_one in enumerate(profiles, start=1)
            for face, *profile in faces_of_one
        ]
        return (wall, *faces)


def hood_length(optic_radius: float, field_deg: float, exclusion_deg: float) -> float:
    r"""
    Return the length, mm, of the shortest hood that keeps light beyond an exclusion angle off the optic.

    The hood clears the beam of the half field w, so its opening is a = r_o + L tan w; the flattest ray that is kept out
    goes from its edge to the opposite rim of the optic, tan ε = (a + r_o)/L. Hence L = 2 r_o/(tan ε - tan w).

    Parameters
    ----------
    optic_radius : float
        Semi-diameter r_o of the optic, mm.
    field_deg : float
        Unobscured half field w, degrees.
    exclusion_deg : float
        Exclusion angle ε, degrees, greater than w and less than 90.

    Raises
    ------
    MistrayError
        If the radius or an angle is out of range, so that no such hood exists.

    Examples
    --------
    >>> print(f"{mistray.prescription.hood_length(optic_radius=20, field_deg=5, exclusion_deg=30):.1f} mm")
    81.7 mm
    """
    SIZE_MM.check_all("hood", optic_radius=optic_radius)
    return 2 * optic_radius / slope_margin("hood", field_deg, exclusion_deg)


# More than 8 parameters: the keywords of a call, each with a default and used one by one
def vane_tube(
    name: str,
    *,
    optic_radius: float,
    z_rear: float,
    length: float,
    wall_radius: float | Sequence[float],
    field_deg: float,
    exclusion_deg: float = 0.0,
    clearance: float = 0.0,
    overlap: float | None = None,
    edge: VaneEdge | None = None,
) -> BaffleTube:
    """
    Design a tube whose vanes leave no first-order path by its wall from light beyond an exclusion angle to the optic.

    Parameters
    ----------
    name : str
        Start of the names of the parts.
    optic_radius : float
        Semi-diameter of the optic, mm; give that of the whole element, including unused zones.
    z_rear : float
        Position of the optic, the end of the tube, mm. For a convex lens give the position of its rim: light that would
        meet the bulge also meets the disc within the rim.
    length : float
        Distance from the opening to the optic, mm; see `hood_length`.
    wall_radius : float or (float, float)
        Radius of the wall, or its radii at the front and at the rear, mm.
    field_deg : float
        Half field that the vanes leave free, degrees.
    exclusion_deg : float
        Field angle, degrees, below which light may take first-order paths; 0 allows none.
    clearance : float
        Distance between the beam and the tips, mm.
    overlap : float or None
        Overlap of hidden and lit zones along the wall, mm; ``None``: 1 % of the depth of the vane.
    edge : VaneEdge or None
        Thickness, bevel and rounding of the vanes; ``None``: ideal knife edges of thickness zero.

    Returns
    -------
    BaffleTube
        Tube with its vanes.

    Raises
    ------
    MistrayError
        If a parameter is out of range, the beam does not fit into the tube, more than 200 vanes are needed, the bevel
        suits neither side of a vane, or vanes are thicker than their distance.

    Examples
    --------
    >>> tube = mistray.prescription.vane_tube(
    ...     "hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5
    ... )
    >>> for vane in tube.vanes[:2]:
    ...     print(f"z = {vane.z:.1f} mm, radius {vane.radius:.2f} mm")
    z = -150.0 mm, radius 33.12 mm
    z = -128.1 mm, radius 31.20 mm
    """
    owner = f"baffle '{name}'"
    SIZE_MM.check_all(owner, optic_radius=optic_radius, length=length)
    HALF_FIELD_DEG.check_all(owner, field_deg=field_deg, exclusion_deg=exclusion_deg)
    RADIUS_MM.check_all(owner, clearance=clearance, overlap=overlap)
    walls = SIZE_MM.check_each("wall_radius", wall_radius, owner)
    if len(walls) > 2:
        raise MistrayError(f"{owner}: wall_radius has {len(walls)} numbers; give one, or those of front and rear")
    front, rear = walls[0], walls[-1]
    slope = math.tan(math.radians(field_deg))
    opening = optic_radius + clearance + length * slope
    for end, wall, tip in (("front", front, opening), ("rear", rear, optic_radius + clearance)):
        if not wall > tip:
            raise MistrayError(
                f"baffle '{name}': wall radius {wall:g} mm at the {end}; the unobscured beam is {tip:g} mm wide there, "
                "make the tube wider, shorter, or the field smaller"
            )
    bare = BaffleTube(
        name=name,
        z_front=z_rear - length,
        z_rear=z_rear,
        wall_front=front,
        wall_rear=rear,
        optic_radius=optic_radius,
        vanes=(Vane(z_rear - length, opening),),
    )
    tips = _tips(bare, clearance, slope, math.tan(math.radians(exclusion_deg)), overlap)
    vanes = tuple(Vane(z, a, edge, _bevelled_side(name, edge, tips[:k], (z, a), bare)) for k, (z, a) in enumerate(tips))
    _check_plates(name, vanes, z_rear)
    return replace(bare, vanes=vanes)


def _tips(
    tube: BaffleTube, clearance: float, slope: float, steepness: float, overlap: float | None
) -> list[tuple[float, float]]:
    """
    Return positions z and tip radii, mm, of the vanes that a tube needs, its opening among them.

    `tube` has the opening as its only vane. `slope` is tan w, `steepness` tan ε; the others are those of `vane_tube`.
    Raise `MistrayError` if there are too many vanes, or the overlap is too large.
    """
    tips = [(vane.z, vane.radius) for vane in tube.vanes]
    at_optic = tube.optic_radius + clearance
    while True:
        lit = lit_from(tube, tips)
        if lit >= min(lit_until(tube, tips, steepness), tube.z_rear):
            return tips
        depth = tube.wall_radius(lit) - at_optic - (tube.z_rear - lit) * slope
        if len(tips) == MOST_VANES:
            raise MistrayError(
                f"baffle '{tube.name}': more than {MOST_VANES} vanes, because they are only {depth:.3g} mm deep; make "
                "the wall wider or choose an exclusion_deg"
            )
        shared = OVERLAP * depth if overlap is None else overlap
        hidden = lit - shared
        # The tip whose ray from the far rim of the optic meets the wall at `hidden`
        reach = tube.z_rear - hidden
        before = reach * (tube.optic_radius + at_optic) / (tube.wall_radius(hidden) + tube.optic_radius - reach * slope)
        if tube.z_rear - before <= tips[-1][0]:
            raise MistrayError(
                f"baffle '{tube.name}': overlap = {shared:g} mm; the vane behind z = {tips[-1][0]:g} mm would stand "
                "before it, make the overlap smaller"
            )
        tips.append((tube.z_rear - before, at_optic + before * slope))


def lit_from(tube: BaffleTube, tips: list[tuple[float, float]]) -> float:
    """
    Return the position z, mm, from which on light from outside can reach the wall behind the last vane; inf if nowhere.

    Parameters
    ----------
    tube : BaffleTube
        Tube that has the wall.
    tips : list of (float, float)
        Positions z and radii of the vanes, from the front, mm.
    """
    z, a = tips[-1]
    slope = steepest(tips[:-1], tips[-1])
    if math.isinf(slope):
        return z
    growth = (tube.wall_rear - tube.wall_front) / (tube.z_rear - tube.z_front)
    return z + (tube.wall_radius(z) - a) / (slope - growth) if slope > growth else math.inf


def lit_until(tube: BaffleTube, tips: list[tuple[float, float]], steepness: float) -> float:
    """
    Return the position z, mm, up to which light whose field angle has at least the tangent `steepness` meets the wall.

    It is infinite if the wall widens at least as steeply. `tube` and `tips` are those of `lit_from`.
    """
    growth = (tube.wall_rear - tube.wall_front) / (tube.z_rear - tube.z_front)
    if steepness <= growth:
        return math.inf
    # a_j + R(z) = (z - z_j) steepness, with R(z) linear
    return min(z + (a + tube.wall_radius(z)) / (steepness - growth) for z, a in tips)


def steepest(openings: list[tuple[float, float]], tip: tuple[float, float]) -> float:
    """
    Return the largest slope dr/dz, away from the axis, of rays past a tip that have passed earlier openings.

    Both are given as (z, radius), mm. The slope is infinite without earlier openings.
    """
    z, a = tip
    return min(((a + other) / (z - at) for at, other in openings), default=math.inf)


def _bevelled_side(
    name: str, edge: VaneEdge | None, before: list[tuple[float, float]], tip: tuple[float, float], tube: BaffleTube
) -> str:
    """
    Return the face of a vane on which its bevel is dark or unseen: "front" or "rear"; "front" without a bevel.

    A bevel rises from the tip by 1/tan β per mm along the axis. On the front face the optic does not see it if the ray
    from the optic's far rim past the tip is less steep. On the rear face no light meets it if the steepest ray from
    outside is less steep. Raise `MistrayError` if neither holds. `tip` and the tips `before` it are (z, radius), mm.
    """
    if edge is None or edge.bevel_deg is None:
        return "front"
    z, a = tip
    rise = 1 / math.tan(math.radians(edge.bevel_deg))
    seen = (a + tube.optic_radius) / (tube.z_rear - z)
    lit = steepest(before, tip)
    if rise >= seen:
        return "front"
    if rise >= lit:
        return "rear"
    most = math.degrees(math.atan(1 / min(seen, lit)))
    raise MistrayError(
        f"baffle '{name}': bevel_deg = {edge.bevel_deg:g} of the vane at z = {z:g} mm would be lit and seen; "
        f"make it at most {most:.4g}"
    )


def _check_plates(name: str, vanes: tuple[Vane, ...], z_rear: float) -> None:
    """Raise `MistrayError` if the plate of a vane overlaps the next vane, or extends beyond `z_rear`, mm."""
    for vane, end in [(a, b.plate[0]) for a, b in pairwise(vanes)] + [(vanes[-1], z_rear)]:
        if vane.plate[1] > end:
            assert vane.edge is not None
            raise MistrayError(
                f"baffle '{name}': thickness = {vane.edge.thickness:g} mm of the vane at z = {vane.z:g} mm; it reaches "
                f"beyond z = {end:g} mm, where the next vane or the optic begins, make it thinner"
            )


def slope_margin(what: str, field_deg: float, exclusion_deg: float) -> float:
    """
    Return tan ε - tan w for the exclusion angle ε = `exclusion_deg` and the half field w = `field_deg`, degrees.

    Raise `MistrayError` unless 0 ≤ w < ε < 90; `what` is the owner of the angles for its message.
    """
    if not 0 <= field_deg < exclusion_deg < 90:
        raise MistrayError(
            f"{what}: field_deg = {field_deg:g}, exclusion_deg = {exclusion_deg:g}; the exclusion angle must lie "
            "between the half field and 90"
        )
    return math.tan(math.radians(exclusion_deg)) - math.tan(math.radians(field_deg))
