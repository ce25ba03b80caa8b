r"""Baffles of a Cassegrain telescope: no straight line from the sky past the secondary to the detector.

Light that passes beside the secondary could reach the detector through the hole of the primary. Two rims stop it: A,
the rim of a cone around the secondary, and B, the mouth of a tube that stands in the hole. They are found as in A. T.
Young ("Design of Cassegrain light shields", Appl. Opt. 6, 1063, 1967) and D. D. Prescott ("Cassegrainian baffle
design", Appl. Opt. 7, 479, 1968), here with traced rays instead of paraxial ones. With the half field w, in a plane
through the axis:

- A lies on the outermost ray from the primary to the secondary, so that it does not cut the beam. It is the ray through
  the rims of both mirrors; where this one is outside the field, that of the field +w through the rim of the primary or
  that of the field -w through the rim of the secondary, whichever limits the beam;
- B lies on the outermost ray from the secondary to the detector, the ray of the field +w at the upper edge of the
  beam;
- the tube around B may not shadow more than A does: its outer wall at the mouth lies on the innermost ray from the
  primary to the secondary, which is the ray of the field -w that grazes A on its way in;
- the ray from the edge of the detector past the far side of B just meets A,

      r_A = τ r_B + (τ - 1) h,   τ = (z_D - z_A)/(z_D - z_B),

  h the radius of the detector. This holds for skew rays too: from all points of the detector through all points of B,
  the plane of A is met within this radius.

Each place of A on the first ray gives a B; the last condition selects the A nearest to the secondary, of the smallest
obscuration. Inside, the tube has vanes that end on the line from B to the edge of the detector, by
`mistray.prescription.baffles.vane_tube.vane_tube` with the detector as the optic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.sag import sag, sag_derivative
from mistray.prescription.baffles.vane_edges import VaneEdge
from mistray.prescription.baffles.vane_tube import BaffleTube, vane_tube
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.model import Detector, Structure, Surface
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import HALF_FIELD_DEG, SIZE_MM

_SCANNED = 400
_BISECTIONS = 60
_NEWTON_STEPS = 30


@dataclass(frozen=True)
class MeridionalRay:
    """Ray in a plane through the axis: a point (y, z), mm, and a unit direction (dy, dz)."""

    y: float
    z: float
    dy: float
    dz: float

    def height(self, z: float) -> float:
        """Return the height y of the ray at z, both in mm."""
        return self.y + (z - self.z) * self.dy / self.dz

    def reflected(self, mirror: Surface) -> MeridionalRay:
        """
        Return the ray after reflection at a coaxial mirror, whose surface is continued beyond its rim.

        Raises
        ------
        MistrayError
            If the ray does not meet the continued surface.
        """
        t = (mirror.z - self.z) / self.dz
        for _ in range(_NEWTON_STEPS):
            y = self.y + t * self.dy
            slope = 2 * y * sag_derivative(y * y, mirror.curvature, mirror.conic, mirror.coefficients)
            gap = self.z + t * self.dz - mirror.z - sag(y * y, mirror.curvature, mirror.conic, mirror.coefficients)
            t -= gap / (self.dz - slope * self.dy)
        y = self.y + t * self.dy
        if not math.isfinite(y):
            raise MistrayError(f"surface '{mirror.name}': a ray of the field misses it; make the field smaller")
        slope = 2 * y * sag_derivative(y * y, mirror.curvature, mirror.conic, mirror.coefficients)
        # Normal (-slope, 1), not of unit length
        along = 2 * (self.dz - slope * self.dy) / (1 + slope * slope)
        return MeridionalRay(y, self.z + t * self.dz, self.dy + along * slope, self.dz - along)


@dataclass(frozen=True, kw_only=True)
class CassegrainBaffles:
    """
    Baffles of a Cassegrain telescope: the cone around the secondary and the tube in front of the detector.

    Attributes
    ----------
    outer_rim : (float, float)
        Rim A of the cone around the secondary, (r, z) in mm.
    secondary_rim : (float, float)
        Rim of the secondary, where this cone begins, (r, z) in mm.
    tube : BaffleTube
        Tube from the mouth B to the detector.
    obscuration : float
        Area of a disc of the radius of A over that of the axial beam at the primary, holes included in both.

    Examples
    --------
    >>> from mistray.scenes.cassegrain.prescription import build
    >>> telescope = build()
    >>> baffles = mistray.prescription.cassegrain_baffles(
    ...     *telescope.surfaces, telescope.detector, field_deg=0.28, wall_depth=4, wall_rear=26
    ... )
    >>> print(f"{baffles.obscuration:.1%} of the primary, {len(baffles.tube.vanes)} vanes")
    13.6% of the primary, 5 vanes
    """

    outer_rim: tuple[float, float]
    secondary_rim: tuple[float, float]
    tube: BaffleTube
    obscuration: float

    @property
    def inner_rim(self) -> tuple[float, float]:
        """Rim B of the tube's front opening, (r, z) in mm."""
        return self.tube.vanes[0].radius, self.tube.z_front

    def structures(
        self,
        *,
        coating: Coating | None = BLACK,
        scatter: Scatter | Sequence[Scatter] = (),
        space: int = -1,
    ) -> tuple[Structure, ...]:
        """Return the cone ``secondary_baffle``, then the tube with its vanes; parameters are those of `Structure`."""
        own: dict[str, Any] = {"coating": coating, "scatter": SCATTER.check("scatter", scatter), "space": space}
        cone = Structure("secondary_baffle", *self.secondary_rim, *self.outer_rim, **own)
        return (cone, *self.tube.structures(**own))


# More than 8 parameters: the keywords of a call, each with a default and used one by one
def cassegrain_baffles(
    primary: Surface,
    secondary: Surface,
    detector: Detector,
    *,
    field_deg: float,
    wall_depth: float,
    wall_rear: float,
    clearance: float = 0.0,
    edge: VaneEdge | None = None,
    name: str = "inner_baffle",
) -> CassegrainBaffles:
    """
    Design baffles of the smallest obscuration that leave no straight line from the sky to the detector.

    Parameters
    ----------
    primary, secondary : Surface
        Coaxial mirrors, whose `sag` is left out. Light travels along +z to the primary. The rim of either mirror may
        limit the beam.
    detector : Detector
        Detector behind the primary.
    field_deg : float
        Half field that is not vignetted, degrees.
    wall_depth : float
        Radial distance between the mouth B and the outer wall of its tube, mm.
    wall_rear : float
        Radius of the wall of this tube at the detector, mm.
    clearance : float
        Distance between A and the beam, mm.
    edge : VaneEdge or None
        Edges of the vanes within the tube, as in `vane_tube`.
    name : str
        Name of the tube.

    Returns
    -------
    CassegrainBaffles
        Cone and tube.

    Raises
    ------
    MistrayError
        If a surface is off the axis, a size or the field is out of range, or a ray of the field misses a mirror that is
        continued beyond its rim. The error also says that no pair of baffles blocks all straight lines, or that the
        tube does not fit the detector or the hole.

    Examples
    --------
    >>> numbers = {"radius": -1000, "conic": -1, "semi_diameter": 100, "inner_semi_diameter": 26}
    >>> primary = mistray.Surface("primary", mirror=True, **numbers)
    >>> secondary = mistray.Surface("secondary", z=-370, radius=-346.67, conic=-2.78, semi_diameter=24, mirror=True)
    >>> detector = mistray.Detector(z=150, semi_diameter=10)
    >>> baffles = mistray.prescription.cassegrain_baffles(
    ...     primary, secondary, detector, field_deg=0.28, wall_depth=4, wall_rear=26
    ... )
    >>> [round(number, 1) for number in baffles.outer_rim]  # r and z, mm
    [34.0, -322.1]
    """
    for surface in (primary, secondary, detector):
        if not surface.coaxial:
            raise MistrayError(f"surface '{surface.name}': it is off the axis; Cassegrain baffles need coaxial mirrors")
    SIZE_MM.check_all(f"baffle '{name}'", wall_depth=wall_depth, wall_rear=wall_rear)
    HALF_FIELD_DEG.check("field_deg", field_deg, f"baffle '{name}'")
    w = math.radians(field_deg)
    towards = _outermost(primary, secondary, w)
    onwards = _upper_edge(primary, secondary, w).reflected(secondary)
    rim = secondary.rim

    def mouth(z_a: float) -> tuple[float, float, float]:
        """
        Return how far, mm, rim A lies outside the radius that blocks straight lines, and (r, z) of rim B, mm.

        The first is NaN if B does not lie between A and the primary or the detector.
        """
        r_a = towards.height(z_a) + clearance
        inmost = MeridionalRay(r_a, z_a, -math.sin(w), math.cos(w)).reflected(primary)
        # Where the innermost ray stands wall_depth above the outermost ray behind the secondary
        rise = inmost.dy / inmost.dz - onwards.dy / onwards.dz
        z_b = (wall_depth - inmost.height(0.0) + onwards.height(0.0)) / rise
        r_b = onwards.height(z_b)
        tau = (detector.z - z_a) / (detector.z - z_b)
        if not z_a < z_b < min(primary.z, detector.z):
            return math.nan, r_b, z_b
        return r_a - tau * r_b - (tau - 1) * detector.outer_radius, r_b, z_b

    z_a = _first_root(lambda z: mouth(z)[0], rim[1], primary.z)
    if z_a is None:
        raise MistrayError(
            f"baffle '{name}': no baffles keep the sky from detector '{detector.name}' of radius "
            f"{detector.outer_radius:g} mm at a half field of {field_deg:g}°; make field, detector or wall_depth "
            "smaller"
        )
    _, r_b, z_b = mouth(z_a)
    if r_b < detector.outer_radius:
        raise MistrayError(
            f"baffle '{name}': its mouth, {r_b:.6g} mm, is narrower than detector '{detector.name}', "
            f"{detector.outer_radius:g} mm; make the detector smaller or the field larger"
        )
    length = detector.z - z_b
    tube = vane_tube(
        name,
        optic_radius=detector.outer_radius,
        z_rear=detector.z,
        length=length,
        wall_radius=(r_b + wall_depth, wall_rear),
        field_deg=math.degrees(math.atan((r_b - detector.outer_radius) / length)),
        edge=edge,
    )
    r_a = towards.height(z_a) + clearance
    at_primary = tube.wall_radius(primary.z)
    if at_primary > r_a or at_primary > primary.inner_semi_diameter:
        raise MistrayError(
            f"baffle '{name}': its wall is {at_primary:g} mm wide at the primary, whose hole has "
            f"{primary.inner_semi_diameter:g} mm and the shadow {r_a:g} mm; make wall_rear smaller or the hole larger"
        )
    return CassegrainBaffles(
        outer_rim=(r_a, z_a),
        secondary_rim=rim,
        tube=tube,
        obscuration=(r_a / _upper_edge(primary, secondary, 0.0).y) ** 2,
    )


def _upper_edge(primary: Surface, secondary: Surface, field: float) -> MeridionalRay:
    """
    Return the ray after the primary along the edge at +y of the beam of a field.

    `field`, rad, is positive for light that travels towards +y. The rim of one mirror limits this edge.
    """
    ray = _from_primary(primary, primary.outer_radius, field)
    if ray.reflected(secondary).y <= secondary.outer_radius:
        return ray
    height = _bisected(
        lambda y: _from_primary(primary, y, field).reflected(secondary).y - secondary.outer_radius,
        0.0,
        primary.outer_radius,
    )
    return _from_primary(primary, height, field)


def _outermost(primary: Surface, secondary: Surface, field: float) -> MeridionalRay:
    """
    Return the ray after the primary that is farthest from the axis, over all fields from -`field` to `field`, rad.

    As the field grows, upper edges limited by the primary rotate outwards about its rim, and edges limited by the
    secondary rotate inwards about its rim. So the outermost edge passes both rims, or belongs to the last field.
    """

    def beyond(angle: float) -> float:
        edge = _from_primary(primary, primary.outer_radius, angle)
        return edge.reflected(secondary).y - secondary.outer_radius

    if beyond(field) <= 0:
        return _upper_edge(primary, secondary, field)
    if beyond(-field) >= 0:
        return _upper_edge(primary, secondary, -field)
    return _upper_edge(primary, secondary, _bisected(beyond, -field, field))


def _from_primary(primary: Surface, height: float, field: float) -> MeridionalRay:
    start = MeridionalRay(height, primary.z_at(height), math.sin(field), math.cos(field))
    return start.reflected(primary)


def _bisected(growing: Callable[[float], float], low: float, high: float) -> float:
    """Return the argument from `low` to `high` up to which an increasing function is at most 0; `low` if nowhere."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if growing(middle) > 0 else (middle, high)
    return low


def _first_root(surplus: Callable[[float], float], start: float, end: float) -> float | None:
    """Return the first z, mm, from `start` to `end`, at which the function `surplus` is at least 0; None if nowhere."""
    grid = np.linspace(start, end, _SCANNED, endpoint=False)
    good = next((k for k, z in enumerate(grid) if surplus(float(z)) >= 0), None)
    if not good:
        return None if good is None else float(grid[0])
    low, high = float(grid[good - 1]), float(grid[good])
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if surplus(middle) >= 0 else (middle, high)
    return high
