r"""Two baffle tubes in series, so that light must be scattered four times before it reaches the optic.

The inner stage stands before the optic; its opening B of radius b is the optic's only view. The outer stage ends at B.

- The optic sees nothing of the outer stage: the vanes there stand outside the cone from the optic's rim past the far
  edge of B, of slope s = (r_o + b)/L_2.
- Light beyond the exclusion angle ε does not reach B directly: tan ε = (a + b)/L_1, a the radius of the opening.
- Within each stage, walls lit from its front are not seen from its end (`mistray.prescription.baffles.vane_tube`). For
  the inner stage, all light through B counts, from any direction.

So light from beyond ε meets a surface of the outer stage, then one that B sees, then one of the inner stage, then one
that the optic sees: four scatters. This is the scheme of star trackers and coronagraphs (C. Leinert and D. Klüppelberg,
"Stray light suppression in optical space experiments", Appl. Opt. 13, 556, 1974; J.-J. Arnoux, "Star sensor baffle
optimization", Proc. SPIE 2864, 1996).

The shortest one follows from the two conditions. With b = r_o + c + L_2 tan w, a = b + c + L_1 s, k = tan ε - tan w and
m = 2 r_o + c,

    L_1 = (2 b + c)/(tan ε - s) = (2 b + c) L_2/(k L_2 - m),

and L_1 + L_2 is least at L_2 = m/k + sqrt(m²/k² + 2 c m/(k (k + 2 tan w))). Without clearance, c = 0, this is
L_2 = 4 r_o/k, twice the length of a simple hood, L_1 = L_2 b/r_o and a = b (2 + b/r_o).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mistray.errors import MistrayError
from mistray.prescription.baffles.vane_edges import VaneEdge
from mistray.prescription.baffles.vane_tube import BaffleTube, slope_margin, vane_tube
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.model import Structure
from mistray.prescription.scatter import SCATTER, Scatter
from mistray.ranges import RADIUS_MM, SIZE_MM


@dataclass(frozen=True, kw_only=True)
class TwoStageBaffle:
    """
    Baffle of two tubes, the inner one closer to the optic.

    Attributes
    ----------
    name : str
        Name of the baffle; its stages are ``<name>_outer`` and ``<name>_inner``.
    outer, inner : BaffleTube
        Tubes of the two stages.

    Examples
    --------
    >>> baffle = mistray.prescription.two_stage_baffle(
    ...     "baffle", optic_radius=20, z_rear=0, field_deg=5, exclusion_deg=40, depth=10
    ... )
    >>> print(f"{baffle.length:.0f} mm, {len(baffle.outer.vanes)} and {len(baffle.inner.vanes)} vanes")
    262 mm, 5 and 5 vanes
    """

    name: str
    outer: BaffleTube
    inner: BaffleTube

    @property
    def length(self) -> float:
        """Total length of both stages, mm."""
        return self.inner.z_rear - self.outer.z_front

    def structures(
        self,
        *,
        coating: Coating | None = BLACK,
        scatter: Scatter | Sequence[Scatter] = (),
        wall_scatter: Scatter | Sequence[Scatter] | None = None,
        space: int = -1,
    ) -> tuple[Structure, ...]:
        """Return outer stage, ring ``<name>_bulkhead`` and inner stage; parameters as in `BaffleTube.structures`."""
        owner = f"baffle '{self.name}'"
        kind: dict[str, Any] = {"coating": coating, "scatter": SCATTER.check("scatter", scatter, owner), "space": space}
        on_walls = None if wall_scatter is None else SCATTER.check("wall_scatter", wall_scatter, owner)
        z = self.inner.z_front
        bulkhead = Structure(
            f"{self.name}_bulkhead", self.outer.wall_radius(z), z, self.inner.wall_radius(z), z, **kind
        )
        stages = (stage.structures(wall_scatter=on_walls, **kind) for stage in (self.outer, self.inner))
        outer, inner = stages
        return (*outer, bulkhead, *inner)


# More than 8 parameters: the keywords of a call, each with a default and used one by one
def two_stage_baffle(
    name: str,
    *,
    optic_radius: float,
    z_rear: float,
    field_deg: float,
    exclusion_deg: float,
    depth: float,
    clearance: float = 0.0,
    inner_length: float | None = None,
    edge: VaneEdge | None = None,
) -> TwoStageBaffle:
    """
    Design the shortest two-stage baffle for an exclusion angle, or the shortest with a given inner stage.

    Parameters
    ----------
    name : str
        Name of the baffle.
    optic_radius : float
        Semi-diameter of the optic, mm.
    z_rear : float
        Position of the optic, the end of the inner stage, mm.
    field_deg : float
        Half field that is left free, degrees.
    exclusion_deg : float
        Field angle beyond which light must be scattered four times, degrees.
    depth : float
        Radial distance between the widest opening of each stage and its wall, mm; the vanes are at least as deep.
    clearance : float
        Distance of the tips from the beam and from the optic's view, mm.
    inner_length : float or None
        Length of the inner stage, mm; ``None`` gives the shortest baffle.
    edge : VaneEdge or None
        Edges of the vanes, as in `vane_tube`.

    Raises
    ------
    MistrayError
        If a parameter is out of range, or the inner stage so short that no outer stage keeps light beyond the exclusion
        angle from its opening.

    Examples
    --------
    >>> for exclusion_deg in 30, 40, 50:
    ...     baffle = mistray.prescription.two_stage_baffle(
    ...         "baffle", optic_radius=20, z_rear=0, field_deg=5, exclusion_deg=exclusion_deg, depth=10
    ...     )
    ...     print(f"{exclusion_deg}°: {baffle.length:.0f} mm")
    30°: 443 mm
    40°: 262 mm
    50°: 168 mm
    """
    what = f"baffle '{name}'"
    SIZE_MM.check_all(what, optic_radius=optic_radius, depth=depth)
    RADIUS_MM.check("clearance", clearance, what)
    k = slope_margin(what, field_deg, exclusion_deg)
    slope = math.tan(math.radians(field_deg))
    m = 2 * optic_radius + clearance
    least = m / k
    best = least + math.sqrt(least**2 + 2 * clearance * m / (k * (k + 2 * slope)))
    length = best if inner_length is None else inner_length
    if length <= least:
        raise MistrayError(
            f"{what}: inner_length = {length:g} mm; it must be greater than {least:.6g} mm, {best:.6g} mm gives the "
            "shortest baffle"
        )
    opening = optic_radius + clearance + length * slope
    outer_length = (2 * opening + clearance) * length / (k * length - m)
    view = (optic_radius + opening) / length
    inner = vane_tube(
        f"{name}_inner",
        optic_radius=optic_radius,
        z_rear=z_rear,
        length=length,
        wall_radius=opening + depth,
        field_deg=field_deg,
        clearance=clearance,
        edge=edge,
    )
    outer = vane_tube(
        f"{name}_outer",
        optic_radius=opening,
        z_rear=z_rear - length,
        length=outer_length,
        wall_radius=opening + clearance + outer_length * view + depth,
        field_deg=math.degrees(math.atan(view)),
        exclusion_deg=exclusion_deg,
        clearance=clearance,
        edge=edge,
    )
    return TwoStageBaffle(name=name, outer=outer, inner=inner)
