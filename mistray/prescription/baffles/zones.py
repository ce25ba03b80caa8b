"""Zones of a tube's wall that are lit from outside or seen by the optic, for any set of vanes.

A wall point (R(z), z) between two vanes is lit if a slope s = -dr/dz of a ray towards the front passes all openings
before it, (R - a_j)/(z - z_j) ≤ s ≤ (R + a_j)/(z - z_j), and s is that of light beyond the exclusion angle. It is seen
if a ray to the optic passes all openings behind it and meets the optic within its radius: the same, with the optic as
the last opening. There is such a slope if each lower bound is below each upper bound. For R linear in z, the quadratic
terms of each condition cancel. So each condition is linear in z, and the zone between two vanes is one interval.
`mistray.prescription.baffles.vane_tube` shows why a plane through the axis is enough. The thickness of vanes is
ignored.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from mistray.prescription.baffles.vane_tube import BaffleTube

Zone = tuple[float, float]
"""First and last z, mm."""
Opening = tuple[float, float]
"""z and radius, mm."""


def lit_zones(tube: BaffleTube, exclusion_deg: float = 0.0) -> tuple[Zone, ...]:
    """
    Return the zones of the wall that light from outside, past all vanes before them, meets directly.

    Parameters
    ----------
    tube : BaffleTube
        Tube with its vanes.
    exclusion_deg : float
        Field angle above which light counts, degrees.

    Returns
    -------
    tuple of (float, float)
        First and last z of each zone, mm; at most one behind each vane.

    Examples
    --------
    >>> tube = mistray.prescription.vane_tube(
    ...     "hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5
    ... )
    >>> zones = mistray.prescription.lit_zones(tube)
    >>> [(round(first), round(last)) for first, last in zones][:2]
    [(-150, -128), (-125, -102)]
    """
    steepness = math.tan(math.radians(exclusion_deg))
    zones = []
    for k, (start, end) in enumerate(_gaps(tube)):
        before = [(vane.z, vane.radius) for vane in tube.vanes[: k + 1]]
        conditions = [*_crossing(tube, before, 1.0)]
        p, q = _wall(tube)
        # R + a_j ≥ tan ε (z - z_j)
        conditions += [(p + a + steepness * z, q - steepness) for z, a in before]
        zones.append(_interval(conditions, start, end))
    return tuple(zone for zone in zones if zone is not None)


def seen_zones(tube: BaffleTube) -> tuple[Zone, ...]:
    """
    Return zones of the wall that the optic sees, (first z, last z) in mm: at most one behind each vane.

    Examples
    --------
    >>> tube = mistray.prescription.vane_tube(
    ...     "hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5
    ... )
    >>> zones = mistray.prescription.seen_zones(tube)
    >>> [(round(first), round(last)) for first, last in zones][:2]
    [(-128, -125), (-102, -94)]
    """
    zones = []
    for k, (start, end) in enumerate(_gaps(tube)):
        behind = [(vane.z, vane.radius) for vane in tube.vanes[k + 1 :]]
        conditions = [*_crossing(tube, [*behind, (tube.z_rear, tube.optic_radius)], -1.0)]
        zones.append(_interval(conditions, start, end))
    return tuple(zone for zone in zones if zone is not None)


def first_order_zones(tube: BaffleTube, exclusion_deg: float = 0.0) -> tuple[Zone, ...]:
    """
    Return zones of the wall, (first z, last z) in mm, that are both lit and seen.

    From there light reaches the optic by one scatter. Parameters are those of `lit_zones`. A tube made by `vane_tube`
    has no such zones beyond its own exclusion angle.

    Examples
    --------
    >>> tube = mistray.prescription.vane_tube(
    ...     "hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5
    ... )
    >>> mistray.prescription.first_order_zones(tube)  # no wall is both lit and seen
    ()
    """
    both = [(max(a[0], b[0]), min(a[1], b[1])) for a in lit_zones(tube, exclusion_deg) for b in seen_zones(tube)]
    return tuple(zone for zone in both if zone[0] < zone[1])


def _gaps(tube: BaffleTube) -> Iterator[Zone]:
    """Yield the intervals in z, mm, between consecutive vanes, and from the last vane to the end of the tube."""
    places = [*(vane.z for vane in tube.vanes), tube.z_rear]
    yield from pairwise(places)


def _wall(tube: BaffleTube) -> tuple[float, float]:
    """Return the coefficients p, mm, and q of the tube wall's radius R = p + q z."""
    q = (tube.wall_rear - tube.wall_front) / (tube.z_rear - tube.z_front)
    return tube.wall_front - q * tube.z_front, q


def _crossing(tube: BaffleTube, openings: list[Opening], sign: float) -> Iterator[tuple[float, float]]:
    """
    Yield coefficients (c_0, mm², and c_1, mm) of conditions c_0 + c_1 z ≥ 0, one for each pair of openings.

    They hold if a ray from the wall at z passes all openings. `sign` is 1 for openings before the point and -1 for
    openings behind it.
    """
    p, q = _wall(tube)
    for z_low, a_low in openings:
        for z_high, a_high in openings:
            # (R + a_high)(z - z_low) ≥ (R - a_low)(z - z_high), where both differences have the sign of `sign`
            constant = -(p + a_high) * z_low + (p - a_low) * z_high
            linear = a_high + a_low + q * (z_high - z_low)
            yield sign * constant, sign * linear


def _interval(conditions: list[tuple[float, float]], start: float, end: float) -> Zone | None:
    """Return the part of `start` … `end`, z in mm, where all conditions c_0 + c_1 z ≥ 0 hold; None if there is none."""
    for constant, linear in conditions:
        if linear > 0:
            start = max(start, -constant / linear)
        elif linear < 0:
            end = min(end, -constant / linear)
        elif constant < 0:
            return None
    return (start, end) if start < end else None
