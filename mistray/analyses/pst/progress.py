"""Progress of a PST run, which is reported after each pass."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class PstProgress:
    """
    Progress of a PST run: rays, relative error and time.

    Attributes
    ----------
    rays_done, rays_planned : int
        Start rays so far, including those of the saved run that it continues, and their largest number. 0 rays done:
        the pilot is done, and `seconds_left` is its estimate.
    worst_error : float
        Largest relative standard error of the PST in the cells that count; infinite before light is found. Rays from
        the detector leave out cells without light. With the method "forward" it is NaN unless an error is requested.
    requested_error : float or None
        Requested error: the run ends once the worst error is no larger. None: it traces all planned rays.
    seconds : float
        Time since this run began or was continued, s.
    seconds_left : float
        Estimate of the remaining time, s; NaN if it is unknown.
    """

    rays_done: int
    rays_planned: int
    worst_error: float
    requested_error: float | None
    seconds: float
    seconds_left: float

    @classmethod
    def after(
        cls,
        rays_done: int,
        rays_planned: int,
        worst_error: float,
        requested_error: float | None,
        seconds: float,
        rays_before: int = 0,
    ) -> PstProgress:
        """
        Return the progress after some rays, with an estimate of the remaining time, s.

        The error falls as 1/√rays, so that rays_done · (worst_error/requested_error)² rays are needed in all, but never
        more than `rays_planned`. Each takes as long as those since `rays_before`, the rays of the continued run.
        """
        here = rays_done - rays_before
        left = max(_rays_needed(rays_done, rays_planned, worst_error, requested_error) - rays_done, 0.0)
        seconds_left = seconds * left / here if here > 0 else math.nan
        return cls(rays_done, rays_planned, worst_error, requested_error, seconds, seconds_left)

    @property
    def share_done(self) -> float:
        """Fraction of the required rays that are traced, 0 … 1."""
        needed = _rays_needed(self.rays_done, self.rays_planned, self.worst_error, self.requested_error)
        return min(self.rays_done / needed, 1.0) if needed > 0 else 1.0


Progress = Callable[[PstProgress], None]


def _rays_needed(done: int, planned: int, worst_error: float, requested_error: float | None) -> float:
    if requested_error is None or not math.isfinite(worst_error):
        return float(planned)
    return min(float(planned), done * (worst_error / requested_error) ** 2)
