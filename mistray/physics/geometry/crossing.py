"""Whether two surfaces of revolution about one axis cross or coincide."""

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
    How two surfaces meet where they must not.

    Attributes
    ----------
    coincide : bool
        The surfaces are one and the same throughout the aperture that they share.
    r : float
        Smallest radius at which they meet, to the spacing of the samples, mm.
    """

    coincide: bool
    r: float

    def between(self, first: str, second: str) -> str:
        """Say what is wrong between two named surfaces, and the remedy."""
        if self.coincide:
            return f"surfaces '{first}' and '{second}' coincide; remove one of them or move them apart"
        return f"surfaces '{first}' and '{second}' cross at r = {self.r:.4g} mm; move them apart or make one smaller"


def near(profiles: Sequence[tuple[Profile, float]]) -> Iterator[tuple[int, int]]:
    """
    Pairs of surfaces that share heights, so that they may meet: of many in a row, few.

    Parameters
    ----------
    profiles : sequence of (callable, float)
        Height along the common axis in mm at radii (n,) in mm, and the largest radius.

    Yields
    ------
    tuple of int
        Their places, the smaller one first, in the order of these.
    """
    heights = np.array([profile(np.linspace(0.0, outer, SAMPLES)) for profile, outer in profiles]).reshape(-1, SAMPLES)
    low, high = heights.min(axis=1, initial=np.inf), heights.max(axis=1, initial=-np.inf)
    # An extreme lies between two samples; what is no number may be anywhere
    spare = TOLERANCE_MM + 0.01 * (high - low)
    low, high = np.nan_to_num(low - spare, nan=-np.inf), np.nan_to_num(high + spare, nan=np.inf)
    for i in range(len(profiles)):
        behind = np.flatnonzero((low[i + 1 :] <= high[i]) & (high[i + 1 :] >= low[i]))
        yield from ((i, i + 1 + int(j)) for j in behind)


def meeting(
    z_first: Profile, z_second: Profile, inner: float, outer: float, tolerance: float = TOLERANCE_MM
) -> SurfaceCrossing | None:
    """
    Compare two profiles over the ring of radii that both surfaces cover.

    Surfaces that touch without changing sides, at the vertex or at the rim, do not count.

    Parameters
    ----------
    z_first, z_second : callable
        Height along the common axis in mm at radii (n,) in mm.
    inner, outer : float
        Ring, mm; nothing is found where ``outer`` ≤ ``inner``.
    tolerance : float
        Heights that differ by less are equal, mm.

    Returns
    -------
    Meeting or None
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
