"""Plan of a PST run: numbers of forward and backward rays, and where the forward ones start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from mistray.sampling.sharing.cell_waves import whole_batches
from mistray.sampling.sharing.mis_weights import Sharing
from mistray.sampling.sharing.start_map import MapSamples, StartMap

RESERVE = 1.4  # number of rays over that which the pilot's variances require
MOST_UNEVEN = 4.0  # largest cost of one direction over that of the other
LEVELS = 200  # number of levels of the relative variance that are compared
ARRAYS = ("light", "variance", "pilot_rays")
WINDOWS = ("windows", "forward_windows", "values")  # of weight windows, optional
OPTIONAL = (*WINDOWS, "unscattered")


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """
    Plan of a PST: numbers and starts of its forward rays, and the variance that a pilot has estimated.

    Attributes
    ----------
    sharing : Sharing
        Forward rays of the run, and their starts.
    light : (c,) float64
        PST_normal of each cell.
    variance : (c,) float64
        Variance of PST_normal of each cell times the number of backward rays, if the forward rays are traced as well.
    pilot_rays : (2,) float64
        Forward and backward rays of the pilot.
    samples : MapSamples
        Points at which forward rays would have to start to follow the paths that were found.
    """

    sharing: Sharing
    light: np.ndarray
    variance: np.ndarray
    pilot_rays: np.ndarray
    samples: MapSamples

    def rays_for(self, relative_error: float, counts: np.ndarray) -> int:
        """
        Return the number of backward rays that reach a relative error, together with their forward rays.

        It is larger by `RESERVE` than the variances require, and 0 if no cell that counts has light.

        Parameters
        ----------
        relative_error : float
            Relative standard error of the PST.
        counts : (c,) bool
            Cells in which the error is required; those without light are left out.
        """
        counts = counts & (self.light > 0)
        if not counts.any():
            return 0
        requested = np.square(relative_error * self.light[counts]) / RESERVE
        return int(np.ceil(np.max(self.variance[counts] / requested)))

    def beside(self, needed: int, rays: int) -> Plan:
        """Return a plan for `rays` backward rays whose forward rays do not exceed those for `needed` backward rays."""
        sharing = self.sharing
        return replace(self, sharing=replace(sharing, rays=sharing.rays * min(1.0, needed / rays)))

    def forward_rays(self, rays: float) -> np.ndarray:
        """Return the number of forward rays of each cell, (c,), that go with `rays` backward rays."""
        return whole_batches(self.sharing.rays * rays)

    def fits(self, cells: int, surfaces: int) -> bool:
        """True if the plan was made for this number of direction cells and, with weight windows, of surfaces."""
        windows = self.sharing.windows
        return len(self.sharing.rays) == cells and (windows is None or windows.shape[1] == surfaces)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the plan as named arrays, from which `of_arrays` restores it."""
        own = {name: np.asarray(getattr(self, name)) for name in ARRAYS}
        found = {f"samples_{name}": values for name, values in self.samples._asdict().items()}
        starts = {f"starts_{f.name}": getattr(self.sharing.starts, f.name) for f in fields(StartMap)}
        sharing = self.sharing
        if sharing.ends is not None:
            starts |= {f"ends_{f.name}": getattr(sharing.ends, f.name) for f in fields(StartMap)}
        shared = {"points_lit": sharing.points, "rays": sharing.rays, "linked": sharing.starts_per_connection}
        optional = {name: getattr(sharing, name) for name in OPTIONAL}
        return own | found | starts | shared | {name: values for name, values in optional.items() if values is not None}

    @classmethod
    def of_arrays(cls, arrays: dict[str, np.ndarray]) -> Plan:
        """Return the plan restored from arrays by name, which the method `arrays` has made."""
        starts = StartMap(**{f.name: arrays[f"starts_{f.name}"] for f in fields(StartMap)})
        own: dict[str, Any] = {name: arrays[name] for name in ARRAYS}
        samples = MapSamples(*(arrays[f"samples_{name}"] for name in MapSamples._fields))
        ends = (
            StartMap(**{f.name: arrays[f"ends_{f.name}"] for f in fields(StartMap)}) if "ends_axis" in arrays else None
        )
        optional: dict[str, Any] = {name: arrays.get(name) for name in OPTIONAL}
        sharing = Sharing(arrays["points_lit"], starts, arrays["rays"], arrays["linked"], ends=ends, **optional)
        return cls(sharing=sharing, samples=samples, **own)


def shared(plans: Sequence[Plan]) -> list[Plan]:
    """Return plans with equal forward rays for scenes to be compared: per cell, the largest number of any plan."""
    if len(plans) == 1:
        return list(plans)
    rays = np.max([plan.sharing.rays for plan in plans], axis=0)
    # Each scene has the same weight in the map
    parts = [plan.samples.times(1 / np.maximum(plan.light[plan.samples.cell], np.finfo(float).tiny)) for plan in plans]
    starts = StartMap.of(len(rays), MapSamples.of(parts))
    # Weight windows of the first for all, so that scenes which differ little are traced alike; their rows go by the
    # numbers of surfaces, which must agree
    windows = [plan.sharing.windows for plan in plans if plan.sharing.windows is not None]
    alike = len(windows) == len(plans) and len({one.shape for one in windows}) == 1
    ratios = [plan.sharing.unscattered for plan in plans if plan.sharing.unscattered is not None]
    same = {
        "starts": starts,
        "rays": rays,
        **{name: getattr(plans[0].sharing, name) if alike else None for name in WINDOWS},
        "unscattered": np.max(ratios, axis=0) if len(ratios) == len(plans) else None,
        "ends": plans[0].sharing.ends,
    }
    return [replace(plan, sharing=replace(plan.sharing, **same)) for plan in plans]


def variances_together(rounds: Sequence[tuple[float, np.ndarray, np.ndarray]], factors: np.ndarray) -> np.ndarray:
    """
    Return the relative variance of each cell, averaged over rounds of a pilot and scaled to the rays of the last one.

    Rounds are weighted by their backward rays. Rare light is found in few rounds.

    Parameters
    ----------
    rounds : sequence of tuple
        Backward rays of each round, forward rays of each cell per backward ray, (c,), and relative variance of each
        cell by the factor of its forward rays, (k, c); 0: no light was found.
    factors : (k,) float64
        Ascending factors of the forward rays.

    Returns
    -------
    (k, c) float64
        Relative variance by the factor of the forward rays of the last round.
    """
    rays, now, last = rounds[-1]
    total, weight = np.zeros_like(last), np.zeros(len(now))
    steps = np.log(factors)
    for count, then, relative in rounds:
        for c in np.flatnonzero(relative[0] > 0):
            # Variance times backward rays, at as many forward rays per backward ray as the last round has
            found = np.interp(steps + np.log(now[c] / then[c]), steps, np.log(count * relative[:, c]))
            total[:, c] += count * np.exp(found)
            weight[c] += count
    return np.divide(total, rays * weight, out=np.zeros_like(total), where=weight > 0)


def factors_of_equal_errors(
    relative: np.ndarray, factors: np.ndarray, cost_backward: float, cost_forward: np.ndarray
) -> np.ndarray:
    """
    Return the factor on each cell's number of forward rays that gives all cells one relative error at minimum cost.

    Backward rays serve all cells. At a level v of the relative variance each cell has the least factor that reaches
    this level. A run to a given error then takes v times as many rays of all kinds, and v is that of the least cost.

    Parameters
    ----------
    relative : (k, c) float64
        Relative variance of each cell by the factor of its forward rays, descending; 0: the cell is left out.
    factors : (k,) float64
        Ascending factors of the forward rays.
    cost_backward : float
        Cost of the backward rays, in ray segments.
    cost_forward : (c,) float64
        Cost of the forward rays of each cell at a factor of 1, in ray segments.

    Returns
    -------
    (c,) float64
        Factor of each cell.
    """
    lit = np.flatnonzero(relative[0] > 0)
    found = np.full(relative.shape[1], factors[0])
    if not len(lit):
        return found
    # Factor of each cell by the level of the relative variance
    rates = np.maximum.accumulate(np.log(relative[::-1, lit]), axis=0)
    least = float(rates[0].max())
    levels = np.linspace(least, max(float(rates[-1].max()), least), LEVELS)
    of_factor = np.log(factors[::-1])
    chosen = np.exp(np.stack([np.interp(levels, column, of_factor) for column in rates.T], axis=1))
    # Cost of a run by level
    forward = chosen @ cost_forward[lit]
    total = levels + np.log(cost_backward + forward)
    # A pilot's variances are unreliable where one direction finds little light
    uneven = np.abs(np.log(np.maximum(forward, 1e-300) / cost_backward))
    total[uneven > max(np.log(MOST_UNEVEN), float(uneven.min()))] = np.inf
    found[lit] = chosen[int(np.argmin(total))]
    return found


def factors_of_least_variance(
    relative: np.ndarray, factors: np.ndarray, cost_backward: float, cost_forward: np.ndarray, even: bool = False
) -> np.ndarray:
    """
    Return each cell's factor on its forward rays that minimises geometric-mean variance times total cost.

    The value λ of time decides how much is spent. Each cell has the factor of the least ln(variance) + λ · cost, with
    costs in units of that of the backward rays. The forward rays count as no cheaper than the backward ones, because a
    pilot's variances are unreliable where one direction finds little, and cost at most `MOST_UNEVEN` times as much.
    With `even`, λ is the one at which both directions cost the same. A cell whose variance does not fall takes no rays
    from others.

    Other parameters and the result are those of `factors_of_equal_errors`.
    """
    lit = np.flatnonzero(relative[0] > 0)
    found = np.full(relative.shape[1], factors[0])
    if not len(lit):
        return found
    rates, price = np.log(relative[:, lit]), factors[:, None] * cost_forward[lit] / cost_backward
    best = np.inf
    for importance in np.exp(np.linspace(12.0, -12.0, LEVELS)):
        chosen = np.argmin(rates + importance * price, axis=0)
        columns = np.arange(len(lit))
        forward = max(float(price[chosen, columns].sum()), 1e-300)
        score = rates[chosen, columns].mean() + np.log1p(max(forward, 1.0)) if forward <= MOST_UNEVEN else np.inf
        if even:
            score = abs(np.log(forward))
        if score < best:
            best, found[lit] = score, factors[chosen]
    return found
