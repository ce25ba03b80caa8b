"""How many rays of each direction a PST takes, and where those with the light start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from mistray.sampling.sharing.balance import Sharing
from mistray.sampling.sharing.cell_starts import whole_batches
from mistray.sampling.sharing.map_samples import MapSamples
from mistray.sampling.sharing.start_map import StartMap

RESERVE = 1.4  # rays above what the pilot's variances ask for
MOST_UNEVEN = 4.0  # cost of one direction over that of the other
LEVELS = 200  # of the relative variance that are tried
ARRAYS = ("light", "variance", "pilot_rays")


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """
    What a pilot has found.

    Attributes
    ----------
    sharing : Sharing
        Of the run.
    light : (c,) float64
        PST_normal of each cell.
    variance : (c,) float64
        Of PST_normal, times the rays against the light, with those of the other direction beside them.
    pilot_rays : (2,) float64
        Of the pilot, with the light and against it.
    samples : MapSamples
        Where light that arrives would start.
    """

    sharing: Sharing
    light: np.ndarray
    variance: np.ndarray
    pilot_rays: np.ndarray
    samples: MapSamples

    def rays_for(self, relative_error: float, counts: np.ndarray) -> int:
        """
        Rays against the light that a relative error takes, with those of the other direction beside them.

        Parameters
        ----------
        relative_error : float
        counts : (c,) bool
            Cells whose error counts; those without light are left out.
        """
        counts = counts & (self.light > 0)
        if not counts.any():
            return 0
        wanted = np.square(relative_error * self.light[counts]) / RESERVE
        return int(np.ceil(np.max(self.variance[counts] / wanted)))

    def beside(self, needed: int, rays: int) -> Plan:
        """Of a run with more rays against the light than it needs: no more with it than beside those it needs."""
        sharing = self.sharing
        return replace(self, sharing=replace(sharing, rays=sharing.rays * min(1.0, needed / rays)))

    def forward_rays(self, rays: float) -> np.ndarray:
        """(c,) rays with the light beside so many against it."""
        return whole_batches(self.sharing.rays * rays)

    def again(self) -> Plan:
        """For another run, which spends no rays on a pilot."""
        return replace(self, pilot_rays=np.zeros(2))

    def fits(self, cells: int, surfaces: int) -> bool:
        """Whether it is one for a scene of so many surfaces that is lit from so many cells."""
        windows = self.sharing.windows
        return len(self.sharing.rays) == cells and (windows is None or windows.shape[1] == surfaces)

    def arrays(self) -> dict[str, np.ndarray]:
        """All of it as arrays."""
        own = {name: np.asarray(getattr(self, name)) for name in ARRAYS}
        found = {f"samples_{name}": values for name, values in self.samples._asdict().items()}
        starts = {f"starts_{f.name}": getattr(self.sharing.starts, f.name) for f in fields(StartMap)}
        sharing = self.sharing
        shared = {"points_lit": sharing.points, "rays": sharing.rays, "linked": sharing.linked}
        optional = {name: getattr(sharing, name) for name in ("windows", "unscattered")}
        return own | found | starts | shared | {name: values for name, values in optional.items() if values is not None}

    @classmethod
    def of_arrays(cls, arrays: dict[str, np.ndarray]) -> Plan:
        """What `arrays` gave."""
        starts = StartMap(**{f.name: arrays[f"starts_{f.name}"] for f in fields(StartMap)})
        own: dict[str, Any] = {name: arrays[name] for name in ARRAYS}
        samples = MapSamples(*(arrays[f"samples_{name}"] for name in MapSamples._fields))
        windows, unscattered = arrays.get("windows"), arrays.get("unscattered")
        sharing = Sharing(arrays["points_lit"], starts, arrays["rays"], arrays["linked"], windows, unscattered)
        return cls(sharing=sharing, samples=samples, **own)


def shared(plans: Sequence[Plan]) -> list[Plan]:
    """Plans of scenes that are compared: the same rays with the light, which are those that each of them needs."""
    if len(plans) == 1:
        return list(plans)
    rays = np.max([plan.sharing.rays for plan in plans], axis=0)
    # Each scene counts as much in the map
    parts = [plan.samples.times(1 / np.maximum(plan.light[plan.samples.cell], np.finfo(float).tiny)) for plan in plans]
    starts = StartMap.of(len(rays), MapSamples.of(parts))
    # Those of one for all, so that scenes which differ little are traced alike; they go by the numbers of the surfaces
    windows = [plan.sharing.windows for plan in plans if plan.sharing.windows is not None]
    alike = len(windows) == len(plans) and len({one.shape for one in windows}) == 1
    ratios = [plan.sharing.unscattered for plan in plans if plan.sharing.unscattered is not None]
    same = {
        "starts": starts,
        "rays": rays,
        "windows": windows[0] if alike else None,
        "unscattered": np.max(ratios, axis=0) if len(ratios) == len(plans) else None,
    }
    return [replace(plan, sharing=replace(plan.sharing, **same)) for plan in plans]


def variances_together(rounds: Sequence[tuple[float, np.ndarray, np.ndarray]], factors: np.ndarray) -> np.ndarray:
    """
    Relative variances of several rounds of a pilot, as if all had had as many rays as the last one.

    What is rare is met in few rounds.

    Parameters
    ----------
    rounds : sequence of tuple
        Of each round its rays against the light, the rays with it of each cell for one of those, (c,), and the relative
        variance of each cell by the factor of its rays with the light, (k, c); 0 where no light was found.
    factors : (k,) float64
        Rising.

    Returns
    -------
    (k, c) float64
        By the factor of the rays of the last round.
    """
    rays, now, last = rounds[-1]
    total, weight = np.zeros_like(last), np.zeros(len(now))
    steps = np.log(factors)
    for count, then, relative in rounds:
        for c in np.flatnonzero(relative[0] > 0):
            # Variances fall as rays grow: that of a round with so many rays, in units of one of them
            found = np.interp(steps + np.log(now[c] / then[c]), steps, np.log(count * relative[:, c]))
            total[:, c] += count * np.exp(found)
            weight[c] += count
    return np.divide(total, rays * weight, out=np.zeros_like(total), where=weight > 0)


def factors_of_equal_errors(
    relative: np.ndarray, factors: np.ndarray, cost_against: float, cost_along: np.ndarray
) -> np.ndarray:
    """
    By which factor each cell's rays with the light change, so that all cells get the same relative error at least cost.

    Rays against the light serve all cells. At a level v of the relative variance each cell takes the least factor
    that brings it there; a run to a given error then takes v times as many rays of all kinds, and v is that of the
    least cost.

    Parameters
    ----------
    relative : (k, c) float64
        Relative variance of each cell by the factor of its rays with the light, falling; 0: the cell does not count.
    factors : (k,) float64
        Rising.
    cost_against : float
        Of the rays against the light.
    cost_along : (c,) float64
        Of the rays with the light of each cell, at a factor of 1.

    Returns
    -------
    (c,) float64
    """
    lit = np.flatnonzero(relative[0] > 0)
    found = np.full(relative.shape[1], factors[0])
    if not len(lit):
        return found
    rates = np.maximum.accumulate(np.log(relative[::-1, lit]), axis=0)
    least = float(rates[0].max())
    levels = np.linspace(least, max(float(rates[-1].max()), least), LEVELS)
    of_factor = np.log(factors[::-1])
    chosen = np.exp(np.stack([np.interp(levels, column, of_factor) for column in rates.T], axis=1))
    along = chosen @ cost_along[lit]
    total = levels + np.log(cost_against + along)
    # A pilot knows variances badly where one direction sees little
    uneven = np.abs(np.log(np.maximum(along, 1e-300) / cost_against))
    total[uneven > max(np.log(MOST_UNEVEN), float(uneven.min()))] = np.inf
    found[lit] = chosen[int(np.argmin(total))]
    return found


def factors_of_equal_cost(
    relative: np.ndarray, factors: np.ndarray, cost_against: float, cost_along: np.ndarray
) -> np.ndarray:
    """
    Factors at which both directions cost the same and the product of all cells' variances is least.

    Parameters and result are those of `factors_of_equal_errors`. A cell that gains nothing takes no rays from others.
    """
    return _factors_by_worth(relative, factors, cost_against, cost_along, lambda _, along: abs(np.log(along)))


def factors_of_least_variance(
    relative: np.ndarray, factors: np.ndarray, cost_against: float, cost_along: np.ndarray
) -> np.ndarray:
    """
    Factors at which the mean variance of all cells, times the cost of all rays together, is least.

    Parameters and result are those of `factors_of_equal_errors`. The mean is a geometric one. Rays with the light cost
    as much as those against it at least, for a pilot knows variances badly where one direction sees little.
    """

    def score(variance: float, along: float) -> float:
        return variance + np.log1p(max(along, 1.0)) if along <= MOST_UNEVEN else np.inf

    return _factors_by_worth(relative, factors, cost_against, cost_along, score)


def _factors_by_worth(
    relative: np.ndarray,
    factors: np.ndarray,
    cost_against: float,
    cost_along: np.ndarray,
    score: Callable[[float, float], float],
) -> np.ndarray:
    """
    Factors for the worth of the time at which a score is least.

    The worth decides how much is spent: each cell takes the factor of the least sum of the logarithm of its variance
    and its cost in units of that. `score` has the mean of the logarithms, and the cost of the rays with the light
    over that of those against it.
    """
    lit = np.flatnonzero(relative[0] > 0)
    found = np.full(relative.shape[1], factors[0])
    if not len(lit):
        return found
    rates, price = np.log(relative[:, lit]), factors[:, None] * cost_along[lit] / cost_against
    best = np.inf
    for worth in np.exp(np.linspace(12.0, -12.0, LEVELS)):
        chosen = np.argmin(rates + worth * price, axis=0)
        columns = np.arange(len(lit))
        value = score(float(rates[chosen, columns].mean()), max(float(price[chosen, columns].sum()), 1e-300))
        if value < best:
            best, found[lit] = value, factors[chosen]
    return found
