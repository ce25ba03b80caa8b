"""
The pilot of a PST: short traces in both directions that learn where light gets in and how many rays it takes.

Its own rays are in no result, so that the mean of a run is that of either direction alone, whatever the pilot says.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mistray.analysis.pst.plan import (
    Plan,
    factors_of_equal_cost,
    factors_of_equal_errors,
    factors_of_least_variance,
    variances_together,
)
from mistray.execute.all_cells import AllCells
from mistray.execute.backward import BackwardTrace
from mistray.recorders.direction_recorder import SINGLE
from mistray.recorders.start_samples import Samples
from mistray.sampling.sharing.balance import Sharing
from mistray.sampling.sharing.cell_starts import whole_batches
from mistray.sampling.sharing.families import FamilyVariances
from mistray.sampling.sharing.map_samples import MapSamples
from mistray.sampling.sharing.start_map import StartMap
from mistray.time_budget import time_is_up

FIRST_ROUND, LEAST_ROUNDS = 1 << 12, 5  # rays of the first round, each of the next takes twice as many
ROUNDS_TO_AN_ERROR = 6  # at least: what the pilot has not met makes the run too short
REMEMBERED = 3  # rounds whose samples the map is made of
SAMPLES_OF_CELL = 16000  # that are kept of a round
FACTORS = 2.0 ** np.arange(-4, 5.5, 0.5)  # of the rays with the light of a cell, that are looked at
LEAST_RAYS = 1 / 4  # of a cell in a pilot, by their cost, of its even share
# Of a cell in a run, for one of all against the light, and of all cells: without them what the pilot has not met in the
# other direction would be strong
LEAST_OF_CELL, LEAST_OF_ALL = 1 / 256, 1 / 6
STEP = 4.0  # by which the rays of a cell change from one round to the next at most
# Rounds after which the gain of connections is compared with the time that they take
JUDGED_AFTER, COST_OF_CONNECTIONS = 3, 1.8
LEAST_LEFT = 1e-6  # share of a path without connections that is made out
# Rays that are not scattered, beside one that may be: at first and at least, at most; the cost of a segment of theirs
LEAST_UNSCATTERED, MOST_UNSCATTERED, COST_UNSCATTERED = 4.0, 16.0, 1 / 3
BOUND = 3.0  # errors between what a weight brings and its upper bound
SMALLEST_SHARE = 1e-9  # of a path that either direction has
CLASS_SHARE = 0.1  # of a map's weights that is spread evenly over the classes of light


class Pilot:
    """
    Searches in both directions.

    Parameters
    ----------
    trace : BackwardTrace
    points : (p, 3) float64
        What the light covers.
    counts : (c,) bool
        Cells whose error counts.
    to_an_error : bool
        Whether the run shall have the same error in all cells; else as many rays as it is told.
    """

    def __init__(self, trace: BackwardTrace, points: np.ndarray, counts: np.ndarray, to_an_error: bool = False) -> None:
        self._trace, self._points, self._counts, self._to_an_error = trace, points, counts, to_an_error
        count = int(np.prod(trace.grid.shape))
        linked = np.full(count, 1 / count) if trace.may_connect else np.zeros(count)
        unscattered = np.full(count, LEAST_UNSCATTERED) if trace.scatters else None
        self._sharing = Sharing(
            points, StartMap.uniform(count), np.full(count, 1 / count), linked, unscattered=unscattered
        )
        trace.share_paths(self._sharing)
        self._cells = AllCells(trace)
        self._rounds = 0
        self._kept: list[tuple[MapSamples, float]] = []  # and the rays of their round
        self._seen: list[tuple[np.ndarray, ...]] = []  # cells, classes, families, weights, odds for families
        self._rays = np.zeros(2)
        self._plan: Plan | None = None
        self._light = np.zeros(count)  # of the round before
        self._parts: list[np.ndarray] = []  # see `_unscattered`
        self._variances: list[tuple[float, np.ndarray, np.ndarray]] = []  # see `variances_together`
        self._worth: list[tuple[np.ndarray, np.ndarray]] = []  # see `_windows`
        self._pace = np.zeros(2)  # s for a ray with the light, and against it

    @property
    def rays(self) -> float:
        """Rays against the light so far."""
        return float(self._rays[1])

    def seconds_for(self, plan: Plan, rays: float) -> float:
        """How long so many rays against the light take, with those of the other direction beside them."""
        return float(self._pace @ (plan.forward_rays(rays).sum(), rays))

    def search(self, rays: float) -> Plan:
        """
        Go on for `LEAST_ROUNDS` or `ROUNDS_TO_AN_ERROR` at least, and to so many rays against the light.

        A time budget ends it after any round.
        """
        least = ROUNDS_TO_AN_ERROR if self._to_an_error else LEAST_ROUNDS
        while self._plan is None or (not time_is_up() and (self._rounds < least or self.rays < rays)):
            self._plan = self._round(FIRST_ROUND << self._rounds)
        sharing = self._plan.sharing
        return replace(self._plan, sharing=replace(sharing, families=self._families(sharing.rays)))

    def _round(self, rays: int) -> Plan:
        """A round of so many rays against the light, and what follows from it and those before."""
        trace, sharing, cells = self._trace, self._sharing, self._cells
        with_light = whole_batches(sharing.rays * rays)
        counts = self._counts & (self._light > 0)
        values = np.divide(trace.unit.ravel(), self._light, out=np.zeros(len(counts)), where=counts)
        began = time.perf_counter()
        against = trace.samples(rays, self._rounds, values)
        then = time.perf_counter()
        along = cells.samples(with_light, self._rounds)
        # The last round is the longest, and compiles nothing
        self._pace = np.array([(time.perf_counter() - then) / max(with_light.sum(), 1), (then - began) / rays])
        self._rounds += 1
        self._rays += with_light.sum(), rays
        count = cells.cells
        windows = self._windows(against, values, rays)
        along = [one.times(cells.unit / np.maximum(with_light, 1)) for one in along]
        against = [one.times(trace.unit.ravel() / rays) for one in against]
        both = (*along, *against)
        light, relative, gain = _relative_variances((along, against), count)
        # With the variance of one round a cell would lose the rays that find what is rare, and get them back later
        self._variances = [*self._variances, (rays, sharing.rays, relative)][-REMEMBERED:]
        relative = variances_together(self._variances, FACTORS)
        relative[:, ~self._counts] = 0.0
        costs_along = self._costs_along(along)
        cost_along = costs_along.sum(axis=0)
        cost_against = sum(float(one.segments.sum()) for one in against)
        self._remember(both, light, rays)
        self._note_families(both)
        samples = self._together()
        # The next round, and the run, start where this one has found light
        starts = StartMap.of(count, samples.with_those_beside(trace.grid.shape))

        costs = cost_against, cost_along
        even = factors_of_equal_cost(relative, FACTORS, *costs)
        best = (factors_of_equal_errors if self._to_an_error else factors_of_least_variance)(relative, FACTORS, *costs)
        variance = np.array(
            [np.interp(np.log(f), np.log(FACTORS), column) for f, column in zip(best, relative.T, strict=True)]
        )
        least = np.where(self._counts, min(LEAST_OF_CELL, LEAST_OF_ALL / count), 0)
        plan = Plan(
            sharing=replace(sharing, starts=starts, rays=np.maximum(sharing.rays * best, least), windows=windows),
            light=light,
            variance=variance * light**2 * rays,
            pilot_rays=self._rays.copy(),
            samples=samples,
        )
        # A map is learned from rays of both directions alike
        fewest = LEAST_RAYS * cost_against / np.maximum(cost_along, 1e-300) / count
        rays_of_cell = sharing.rays * np.clip(np.maximum(even, fewest), 1 / STEP, STEP)
        self._light = light
        self._sharing = replace(
            plan.sharing,
            rays=rays_of_cell,
            linked=self._linked(light, relative, gain),
            unscattered=self._unscattered(both, light, costs_along),
        )
        trace.share_paths(self._sharing)
        return plan

    def _costs_along(self, along: Sequence[Samples]) -> np.ndarray:
        """(2, c) cost of the rays with the light, of those that may be scattered and of those that are not."""
        if self._sharing.unscattered is None:
            return np.array([np.sum([one.segments for one in along], axis=0), np.zeros(len(self._light))])
        parts = [np.sum([one.segments for one in part], axis=0) for part in (along[::2], along[1::2])]
        return np.array([parts[0], COST_UNSCATTERED * parts[1]])

    def _unscattered(self, samples: Sequence[Samples], light: np.ndarray, costs: np.ndarray) -> np.ndarray | None:
        """
        Of the next round, see `Sharing`.

        Of a variance a/m + b/n at a cost of m + c n, the least is at n/m = √(b/(a c)).
        """
        now = self._sharing.unscattered
        if now is None:
            return None
        parts = np.zeros((2, len(light)))  # of the variance by rays with the light: what is scattered, and what is not
        for one in samples:
            here = one.along * one.weight**2
            for part, kinds in enumerate((one.kind >= SINGLE, one.kind < SINGLE)):
                parts[part] += _sums(one.cell[kinds], here[kinds], len(light))
        # For one ray of each kind
        rays = self._sharing.rays
        parts = np.divide(parts * [rays, rays * now], light**2, out=np.zeros_like(parts), where=light > 0)
        self._parts = [*self._parts, parts][-REMEMBERED:]
        scattered, clear = np.sum(self._parts, axis=0)
        price = np.divide(costs[1] / now, costs[0], out=np.ones(len(light)), where=costs[0] > 0)
        best = np.sqrt(clear / np.maximum(scattered * np.maximum(price, 1e-3), 1e-300))
        best = np.where(clear + scattered > 0, np.clip(best, now / STEP, now * STEP), now)
        return np.clip(best, LEAST_UNSCATTERED, MOST_UNSCATTERED)

    def _windows(self, against: Sequence[Samples], values: np.ndarray, rays: int) -> np.ndarray:
        """
        Of rays against the light, from what the latest rounds have brought.

        A weight at a surface is worth as many rays as the root of the second moment of what it brings, over that of a
        start ray (A. Rath et al., EARS: efficiency-aware Russian roulette and splitting, ACM Trans. Graph. 41, 81
        (2022), with the same cost for all rays), or as the lower bound of its mean, over that of a start ray. Few of it
        are left only if the upper bound of the mean says so, too, since rare strong rays may not have been met.
        """
        brought = [one.weight * values[one.cell] for one in against]
        sums = np.array([sum(part.sum() for part in brought), sum(np.square(part).sum() for part in brought)])
        worth = np.sum([one.worth for one in against if one.worth is not None], axis=0)
        self._worth = [*self._worth, (worth, np.append(sums, rays))][-REMEMBERED:]
        (weight, weight_squares, follows, squares), (all_brought, all_squares, all_rays) = (
            np.sum(column, axis=0) for column in zip(*self._worth, strict=True)
        )
        if not all_brought > 0:
            return np.zeros((2, *weight.shape))
        mean, moment = all_brought / all_rays, all_squares / all_rays

        def of_weight(sums: np.ndarray, weights: np.ndarray) -> np.ndarray:
            return np.divide(sums, weights, out=np.zeros_like(sums), where=weights > 0)

        error = np.sqrt(squares)
        least, most = (of_weight(follows + errors * error, weight) / mean for errors in (-1, BOUND))
        many = np.maximum(np.sqrt(of_weight(squares, weight_squares) / moment), least)
        return _rounded(np.stack([many, np.where(squares > 0, np.maximum(most, many), 0)]))

    def _note_families(self, samples: Sequence[Samples]) -> None:
        """Keep what the shares of families follow from, of the latest rounds."""
        parts = []
        for one in samples:
            share = np.clip(one.along, SMALLEST_SHARE, 1 - SMALLEST_SHARE)
            # Rays with the light for one against it, if each cell had as many of them as there are of the others
            along = self._sharing.rays[one.cell]
            if self._sharing.unscattered is not None:  # derivatives have no rays of their own for these
                along = along * np.where(one.kind < SINGLE, self._sharing.unscattered[one.cell], 1)
            odds = share / (1 - share) / np.maximum(along, SMALLEST_SHARE)
            parts.append((one.cell, one.kind, one.family, one.weight, odds))
        columns = (np.concatenate(column) for column in zip(*parts, strict=True))
        self._seen = [*self._seen, tuple(columns)][-REMEMBERED:]

    def _families(self, rays: np.ndarray) -> FamilyVariances:
        """See `Sharing`, for so many rays with the light in each cell for one of all against it."""
        cell, kind, family, weight, odds = (np.concatenate(column) for column in zip(*self._seen, strict=True))
        odds = odds * np.maximum(rays[cell], SMALLEST_SHARE)
        return FamilyVariances.of(len(rays), (cell, kind, family), weight, odds / (1 + odds))

    def _linked(self, light: np.ndarray, relative: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """Of the next round, see `Sharing`: connections that do not pay are given up."""
        linked, counts = self._sharing.linked, self._counts & (light > 0)
        if self._rounds == 1:  # as many points as there are rays
            return linked / max(self._trace.points_of_ray, 1e-3)
        if self._rounds != JUDGED_AFTER or not linked.any():
            return linked
        now = relative[np.searchsorted(FACTORS, 1.0)][counts]
        without = gain[counts] * now
        if self._to_an_error:
            gained = without.max(initial=0.0) / now.max(initial=np.finfo(float).tiny)
        else:
            gained = np.exp(np.mean(np.log(gain[counts]))) if counts.any() else 0.0
        return linked if gained > COST_OF_CONNECTIONS else np.zeros_like(linked)

    def _remember(self, samples: Sequence[Samples], light: np.ndarray, rays: int) -> None:
        """Keep the samples of a round, in each cell as many as a map needs."""
        rng = np.random.default_rng(self._rounds)
        cell, kind, points, weights = (
            np.concatenate([getattr(one, name) for one in samples]) for name in ("cell", "kind", "points", "weight")
        )
        # Of ∫ f²/q, its derivative by the logarithm of the density of start rays, times that density
        resolved = np.concatenate([one.along * one.density for one in samples])
        # So that weak classes have errors that hold, too
        classes = int(kind.max(initial=0)) + 1
        of_class = _sums(kind * len(light) + cell, weights, classes * len(light)).reshape(classes, -1)
        present = np.maximum(np.count_nonzero(of_class, axis=0), 1)
        total = of_class.sum(axis=0)
        share = np.divide(of_class, total, out=np.ones_like(of_class), where=total > 0)
        factor = 1 - CLASS_SHARE + CLASS_SHARE / (present[cell] * np.maximum(share[kind, cell], 1e-6))
        found = MapSamples(cell, points, weights, np.square(weights) * resolved * rays).times(factor)
        self._kept = [*self._kept, (found.thinned(SAMPLES_OF_CELL, rng), float(rays))][-REMEMBERED:]

    def _together(self) -> MapSamples:
        """Those of the rounds that are remembered, each by its rays."""
        total = sum(rays for _, rays in self._kept)
        return MapSamples.of([samples.of_rays(rays / total) for samples, rays in self._kept])


def _rounded(values: np.ndarray) -> np.ndarray:
    """Values to 8 bits: lanes add up in any order, and the last bits of their sums shall change nothing."""
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.round(256 * mantissa) / 256, exponent))


def _sums(place: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums of the values of each place; floats for no values, too."""
    return np.bincount(place, values, count).astype(np.float64)


def _relative_variances(
    samples: tuple[Sequence[Samples], Sequence[Samples]], cells: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Light of the cells; its relative variance by the factor of the rays with the light, (`FACTORS`, c); what it gains.

    With a density q of all rays together the variance is ∫ f²/q. Each sample has f/q, and the share of its path that
    rays with the light have says how q changes with these. Rays that bring several samples to a cell add to it what
    these have in common, in each direction by another factor. The third result, (c,), is the variance without
    connections over that with them.
    """
    light = np.zeros(cells)
    cell, brought, along, connected, common = [], [], [], [], []
    for found in samples:
        together, apart = np.zeros(cells), np.zeros(cells)
        for one in found:
            cell.append(one.cell)
            brought.append(one.weight)
            along.append(one.along)
            connected.append(one.connected)
            light += _sums(one.cell, one.weight, cells)
            apart += _sums(one.cell, one.weight**2, cells)
            together += _squares_of_rays(one, cells)
        common.append(np.divide(together, apart, out=np.ones(cells), where=apart > 0))
    where, weight, share, joint = (np.concatenate(parts) for parts in (cell, brought, along, connected))
    square = weight**2
    with_light, against = (factor[where] for factor in common)

    def variance_at(factor: float) -> np.ndarray:
        both = 1 - share + factor * share
        return _sums(where, square * (with_light * factor * share + against * (1 - share)) / both**2, cells)

    variance = np.stack([variance_at(factor) for factor in FACTORS])
    apart = _sums(where, square, cells)
    without = _sums(where, square / np.maximum(1 - joint, LEAST_LEFT), cells)
    gain = np.divide(without, apart, out=np.ones(cells), where=apart > 0)
    return light, np.divide(variance, light**2, out=np.zeros_like(variance), where=light > 0), gain


def _squares_of_rays(samples: Samples, cells: int) -> np.ndarray:
    """(c,) sums over the rays of the square of what each brings to a cell."""
    if not len(samples.weight):
        return np.zeros(cells)
    pair = samples.lane * cells + samples.cell
    order = np.argsort(pair, kind="stable")
    begins = np.flatnonzero(np.diff(pair[order], prepend=-1))
    brought = np.add.reduceat(samples.weight[order], begins)
    return _sums(pair[order][begins] % cells, brought**2, cells)
