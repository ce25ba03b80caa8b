"""Check whether two surfaces of revolution about one axis cross or coincide."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

SAMPLES = 513
TOLERANCE_MM = 1e-9

Profile = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class SurfaceCrossing:
    """
    Unwanted crossing or coincidence of two surfaces of revolution on one axis.

    Attributes
    ----------
    coincide : bool
        Whether the surfaces coincide throughout the aperture that they share. Otherwise they cross.
    r : float
        Smallest radius at which the surfaces meet, mm. It is the inner radius of the shared ring if they coincide, and
        the first sampled radius beyond the crossing if they cross.
    """

    coincide: bool
    r: float

    def between(self, first: str, second: str) -> str:
        """Return a message that says what is wrong between two named surfaces, with a remedy."""
        if self.coincide:
            return f"surfaces '{first}' and '{second}' coincide; remove one of them or move them apart"
        return f"surfaces '{first}' and '{second}' cross at r = {self.r:.4g} mm; move them apart or make one smaller"


def near(profiles: Sequence[tuple[Profile, float]]) -> Iterator[tuple[int, int]]:
    """
    Yield pairs of surfaces, as positions in `profiles`, that share heights along the axis and may therefore meet.

    Parameters
    ----------
    profiles : sequence of (callable, float)
        Function from radii (n,), mm, to heights along the common axis, mm; and the largest radius, mm.

    Yields
    ------
    tuple of int
        Positions of both surfaces in `profiles`, the smaller one first.
    """
    heights = np.array([profile(np.linspace(0.0, outer, SAMPLES)) for profile, outer in profiles]).reshape(-1, SAMPLES)
    low, high = heights.min(axis=1, initial=np.inf), heights.max(axis=1, initial=-np.inf)
    # An extreme lies between two samples; a NaN may be anywhere
    spare = TOLERANCE_MM + 0.01 * (high - low)
    low, high = np.nan_to_num(low - spare, nan=-np.inf), np.nan_to_num(high + spare, nan=np.inf)
    for i in range(len(profiles)):
        behind = np.flatnonzero((low[i + 1 :] <= high[i]) & (high[i + 1 :] >= low[i]))
        yield from ((i, i + 1 + int(j)) for j in behind)


def meeting(
    z_first: Profile, z_second: Profile, inner: float, outer: float, tolerance: float = TOLERANCE_MM
) -> SurfaceCrossing | None:
    """
    Return the crossing or coincidence of two profiles in the ring of radii that both surfaces cover.

    Surfaces that touch or partly coincide without crossing do not count.

    Parameters
    ----------
    z_first, z_second : callable
        Functions from radii (n,), mm, to heights along the common axis, mm.
    inner, outer : float
        Inner and outer radius of the ring, mm; for ``outer`` ≤ ``inner`` the result is None.
    tolerance : float
        Difference of heights below which they count as equal, mm.

    Returns
    -------
    SurfaceCrossing or None
        Crossing or coincidence; None if the surfaces do not meet.
    """
    if outer <= inner:
        return None
    r = np.linspace(inner, outer, SAMPLES)
    gap = z_second(r) - z_first(r)
    if np.all(np.abs(gap) <= tolerance):
        return SurfaceCrossing(True, float(inner))
    if gap.min() < -tolerance and gap.max() > tolerance:
        # the first radius on the other side of where the surfaces first differ
        start = np.sign(gap[np.argmax(np.abs(gap) > tolerance)])
        return SurfaceCrossing(False, float(r[np.argmax(start * gap < -tolerance)]))
    return None
