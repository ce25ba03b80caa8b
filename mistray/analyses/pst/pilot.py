"""
Pilot of a PST: short forward and backward traces that learn where light gets in and how many rays it takes.

Its rays contribute to no result, so that the mean of a run is that of either direction alone, whatever the pilot finds.
With the light f along a path and the density q of all rays, forward and backward, the variance of a cell is ∫ f²/q.
Each sample yields f/q; the MIS weight of forward rays in its path determines how q changes with their number.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mistray.analyses.pst.plan import (
    Plan,
    factors_of_equal_errors,
    factors_of_least_variance,
    variances_together,
)
from mistray.execute.all_cells import AllCells
from mistray.execute.backward import BackwardTrace
from mistray.recorders.direction_recorder import SINGLE
from mistray.recorders.start_samples import Samples
from mistray.sampling.sharing.cell_waves import whole_batches
from mistray.sampling.sharing.mis_weights import Sharing
from mistray.sampling.sharing.path_classes import PathClassVariances
from mistray.sampling.sharing.start_map import MapSamples, StartMap
from mistray.time_budget import time_is_up

FIRST_ROUND, LEAST_ROUNDS = 1 << 12, 5  # most rays of the first round; each further round has twice as many
# Least rays of the first round, and rays of all rounds over those of the run
SMALLEST_ROUND, SHARE_OF_RUN = 1 << 9, 0.5
ROUNDS_AFTER = 2  # of a pilot that goes on from another one, whose last round counts among `REMEMBERED`
ROUNDS_TO_AN_ERROR = 6  # least number: light that the pilot misses makes the run too short
REMEMBERED = 3  # rounds whose samples the start map is made of
SAMPLES_OF_CELL = 16000  # samples of a cell that are kept of a round
ENDS_KEPT = 64000  # samples of starts of backward rays that are kept of a round
FACTORS = 2.0 ** np.arange(-4, 5.5, 0.5)  # factors of the forward rays of a cell that are compared
LEAST_RAYS = 1 / 4  # least cost of the forward rays of a cell in a pilot, over its even part of the backward cost
# Least forward rays of a cell in a run, and of all cells, per backward ray: without them light that the pilot has
# missed would come in few strong rays
LEAST_OF_CELL, LEAST_OF_ALL = 1 / 256, 1 / 6
STEP = 4.0  # largest factor by which the rays of a cell change between rounds
# Rounds after which the gain of connections is compared with their cost: the time, 1.5 to 3, and what weight windows
# win without them. At gains of 1.2 to 1.9 (a Cassegrain, tubes with baffles) runs with connections were 2 to 3 times
# worse in variance × time, at 260 to 460 (a tube with two vanes) 100 times better
JUDGED_AFTER, COST_OF_CONNECTIONS = 3, 3.0
LEAST_REST = 1e-6  # least MIS weight of the techniques other than connections that is resolved
# Rays for unscattered light alone per other forward ray: at first and at least, at most; the cost of their segments
LEAST_UNSCATTERED, MOST_UNSCATTERED, COST_UNSCATTERED = 4.0, 16.0, 1 / 3
BOUND = 3.0  # standard errors between the mean contribution of a weight and its upper confidence bound
SMALLEST_MIS = 1e-9  # least MIS weight of either direction
CLASS_SHARE = 0.1  # fraction of a map's weights that is spread evenly over the classes of light


class Pilot:
    """
    Pilot of a PST: rounds of forward and backward rays that learn where light enters and how many rays it takes.

    Parameters
    ----------
    trace : BackwardTrace
        Backward trace of the run, which the pilot samples.
    points : (p, 3) float64
        Hull of the illuminated volume, mm, from `mistray.sampling.plane_wave.hull_points`.
    counts : (c,) bool
        Cells whose error is taken into account.
    to_an_error : bool
        Whether the run aims at the same error in all cells; else its number of rays is given.
    run_rays : float
        Backward rays of the run, or the most that it may have: the pilot of a short one is short.
    earlier : Pilot, optional
        Pilot of the same scene and cells with other limits of paths, from which this one goes on: it has fewer rounds.
    """

    def __init__(
        self,
        trace: BackwardTrace,
        points: np.ndarray,
        counts: np.ndarray,
        to_an_error: bool = False,
        run_rays: float = math.inf,
        earlier: Pilot | None = None,
    ) -> None:
        self._trace, self._points, self._counts, self._to_an_error = trace, points, counts, to_an_error
        self._least_rounds = ROUNDS_TO_AN_ERROR if to_an_error else LEAST_ROUNDS if earlier is None else ROUNDS_AFTER
        # A power of two, so that rounds divide into batches
        asked = SHARE_OF_RUN * run_rays / ((1 << self._least_rounds) - 1)
        self._first_round = 1 << round(math.log2(min(max(asked, SMALLEST_ROUND), FIRST_ROUND)))
        count = int(np.prod(trace.grid.shape))
        starts_per_connection = np.full(count, 1 / count) if trace.may_connect else np.zeros(count)
        unscattered = np.full(count, LEAST_UNSCATTERED) if trace.scatters else None
        self._sharing = Sharing(
            points,
            StartMap.uniform(count),
            np.full(count, 1 / count),
            starts_per_connection,
            unscattered=unscattered,
            ends=StartMap.uniform(1),
        )
        self._rounds = 0
        self._kept: list[tuple[MapSamples, float]] = []  # and the rays of their round
        self._ends: list[tuple[MapSamples, float]] = []  # the same of the starts of backward rays
        self._seen: list[tuple[np.ndarray, ...]] = []  # cells, classes, path classes, weights, density ratios
        self._rays = np.zeros(2)
        self._plan: Plan | None = None
        self._light = np.zeros(count)  # of the round before
        self._parts: list[np.ndarray] = []  # see `_unscattered`
        self._variances: list[tuple[float, np.ndarray, np.ndarray]] = []  # see `variances_together`
        # See `_windows`, of backward and of forward rays
        self._importance: dict[bool, list[tuple[np.ndarray, np.ndarray]]] = {False: [], True: []}
        self._pace = np.zeros(2)  # s for a forward ray, and for a backward ray
        self.took = 0.0  # s of the last round
        if earlier is not None:
            self._sharing = replace(earlier._sharing, starts_per_connection=starts_per_connection)
            self._kept, self._seen, self._light, self._parts = (
                earlier._kept,
                earlier._seen,
                earlier._light,
                earlier._parts,
            )
            self._variances, self._ends = earlier._variances, earlier._ends
            self._importance = dict(earlier._importance)
        trace.share_paths(self._sharing)
        self._cells = AllCells(trace)

    @property
    def rays(self) -> float:
        """Number of backward rays that this pilot has traced so far."""
        return float(self._rays[1])

    @property
    def lit(self) -> bool:
        """True if the last pilot round found light in every cell of `counts`."""
        return bool(np.all(self._light[self._counts] > 0))

    def seconds_for(self, plan: Plan, rays: float) -> float:
        """Return the estimated time, s, for `rays` backward rays and the forward rays that the plan pairs with them."""
        return float(self._pace @ (plan.forward_rays(rays).sum(), rays))

    def search(self, rays: float) -> Plan:
        """
        Run rounds until at least `rays` backward rays are traced, and return the resulting plan.

        There are at least `LEAST_ROUNDS` rounds; `ROUNDS_TO_AN_ERROR` if an error is requested, else `ROUNDS_AFTER` if
        it continues an earlier pilot. A time budget ends the search after any round.
        """
        while self._plan is None or (not time_is_up() and (self._rounds < self._least_rounds or self.rays < rays)):
            self._plan = self._round(self._first_round << self._rounds)
        # Path classes, from the samples of the latest rounds
        sharing = self._plan.sharing
        cell, kind, path_class, weight, odds = (np.concatenate(column) for column in zip(*self._seen, strict=True))
        odds = odds * np.maximum(sharing.rays[cell], SMALLEST_MIS)
        mis = odds / (1 + odds)
        path_classes = PathClassVariances.of(len(sharing.rays), (cell, kind, path_class), weight, mis)
        return replace(self._plan, sharing=replace(sharing, path_classes=path_classes))

    def _round(self, rays: int) -> Plan:
        """Trace one pilot round of `rays` backward rays, and return the plan based on all rounds so far."""
        trace, sharing, cells = self._trace, self._sharing, self._cells
        # Trace both directions; the weight windows learn from the relative value of light
        forward_rays = whole_batches(sharing.rays * rays)
        counts = self._counts & (self._light > 0)
        values = np.divide(trace.unit.ravel(), self._light, out=np.zeros(len(counts)), where=counts)
        forward_values = np.where(counts, self._values(sharing.rays, self._light), 0)
        began = time.perf_counter()
        backward = trace.samples(rays, self._rounds, values)
        then = time.perf_counter()
        forward = cells.samples(forward_rays, self._rounds, forward_values)
        # Pace of the last round, which is the longest and compiles nothing
        now = time.perf_counter()
        self._pace, self.took = (
            np.array([(now - then) / max(forward_rays.sum(), 1), (then - began) / rays]),
            now - began,
        )
        self._rounds += 1
        self._rays += forward_rays.sum(), rays
        count = cells.cells
        windows = self._windows(False, backward, values, rays)
        # Forward rays rarely find the detector, so that paths of backward rays count, too. A backward ray brings as
        # much as `ratio` forward rays
        ratio = float(forward_rays.sum()) / rays
        by_forward, by_backward = (np.sum([one.importance[2] for one in part], axis=0) for part in (forward, backward))
        shared = by_forward + np.stack((ratio * by_backward[0], ratio**2 * by_backward[1]))
        forward_windows = self._windows(True, forward, forward_values, float(forward_rays.sum()), shared)
        costs_forward = self._costs_forward(forward)
        cost_forward = costs_forward.sum(axis=0)
        cost_backward = sum(float(one.segments.sum()) for one in backward)
        # Light and variance of the cells
        per_ray = cells.unit.ravel() / np.maximum(forward_rays, 1), trace.unit.ravel() / rays
        pair = [_together(parts).times(unit) for parts, unit in zip((forward, backward), per_ray, strict=True)]
        both = _together(pair)
        light, relative, gain = _relative_variances(pair, both, count)
        # Several rounds together: by the variance of one, a cell would lose the rays that find rare light, and get
        # them back later
        self._variances = [*self._variances, (rays, sharing.rays, relative)][-REMEMBERED:]
        relative = variances_together(self._variances, FACTORS)
        relative[:, ~self._counts] = 0.0
        self._remember(both, light, rays)
        self._note_path_classes(both)
        total = sum(rays for _, rays in self._kept)
        samples = MapSamples.of([kept.of_rays(rays / total) for kept, rays in self._kept])
        # Start map: the next round, and the run, start where this one has found light
        starts = StartMap.of(count, samples.with_those_beside(trace.grid.shape))
        ends = StartMap.of(1, MapSamples.of([kept.of_rays(rays / total) for kept, rays in self._ends]))

        costs = cost_backward, cost_forward
        # Numbers of forward rays of the run
        even = factors_of_least_variance(relative, FACTORS, *costs, even=True)
        best = (factors_of_equal_errors if self._to_an_error else factors_of_least_variance)(relative, FACTORS, *costs)
        variance = np.array(
            [np.interp(np.log(f), np.log(FACTORS), column) for f, column in zip(best, relative.T, strict=True)]
        )
        least = np.where(self._counts, min(LEAST_OF_CELL, LEAST_OF_ALL / count), 0)
        rays_of_run = np.maximum(sharing.rays * best, least)
        plan = Plan(
            sharing=replace(
                sharing,
                starts=starts,
                ends=ends,
                rays=rays_of_run,
                starts_per_connection=self._starts_per_connection(light, relative, gain),
                windows=windows,
                forward_windows=forward_windows,
                values=self._values(rays_of_run, light),
            ),
            light=light,
            variance=variance * light**2 * rays,
            pilot_rays=self._rays.copy(),
            samples=samples,
        )
        # Numbers of forward rays of the next round: a map is learned from rays of both directions alike
        fewest = LEAST_RAYS * cost_backward / np.maximum(cost_forward, 1e-300) / count
        rays_of_cell = sharing.rays * np.clip(np.maximum(even, fewest), 1 / STEP, STEP)
        self._light = light
        self._sharing = replace(
            plan.sharing,
            rays=rays_of_cell,
            values=self._values(rays_of_cell, light),
            unscattered=self._unscattered(both, light, costs_forward),
        )
        trace.share_paths(self._sharing)
        return plan

    def _costs_forward(self, forward: Sequence[Samples]) -> np.ndarray:
        """
        Return the cost of forward rays, (2, c), in ray segments: for scattered light and for unscattered light.

        `forward` are the samples of a round. The second row is 0 if all forward rays serve both kinds of light.
        """
        if self._sharing.unscattered is None:
            return np.array([np.sum([one.segments for one in forward], axis=0), np.zeros(len(self._light))])
        parts = [np.sum([one.segments for one in part], axis=0) for part in (forward[::2], forward[1::2])]
        return np.array([parts[0], COST_UNSCATTERED * parts[1]])

    def _unscattered(self, samples: Samples, light: np.ndarray, costs: np.ndarray) -> np.ndarray | None:
        """
        Return the number of extra rays for unscattered light per other forward ray, (c,), for the next round.

        The result is None if there are no such rays. With m rays for scattered light, n extra ones and their relative
        cost c, the variance is a/m + b/n. At a given cost m + c n it is least for n/m = √(b/(a c)). `light` is the
        PST_normal of each cell, (c,); for `costs` see `_costs_forward`.
        """
        now = self._sharing.unscattered
        if now is None:
            return None
        # Variance of forward rays: scattered and unscattered light
        here, scattered = samples.forward * samples.weight**2, samples.kind >= SINGLE
        parts = np.array([_sums(samples.cell, np.where(of, here, 0), len(light)) for of in (scattered, ~scattered)])
        # a and b: variances for one ray of each kind
        rays = self._sharing.rays
        parts = np.divide(parts * [rays, rays * now], light**2, out=np.zeros_like(parts), where=light > 0)
        self._parts = [*self._parts, parts][-REMEMBERED:]
        scattered, clear = np.sum(self._parts, axis=0)
        # c: cost of a ray of the second kind over one of the first
        price = np.divide(costs[1] / now, costs[0], out=np.ones(len(light)), where=costs[0] > 0)
        best = np.sqrt(clear / np.maximum(scattered * np.maximum(price, 1e-3), 1e-300))
        best = np.where(clear + scattered > 0, np.clip(best, now / STEP, now * STEP), now)
        return np.clip(best, LEAST_UNSCATTERED, MOST_UNSCATTERED)

    def _windows(
        self,
        forward: bool,
        samples: Sequence[Samples],
        values: np.ndarray,
        rays: float,
        shared: np.ndarray | None = None,
    ) -> np.ndarray:
        """
        Return the inverse bounds of the weight windows of one direction, upper and lower, (2, n, WAYS).

        They come from the latest rounds.

        Let F be the contribution of a ray per unit of throughput at a surface, and F₀ that of a start ray. The inverse
        upper bound is the larger of √(E[F²]/E[F₀²]) (A. Rath et al., EARS: efficiency-aware Russian roulette and
        splitting, ACM Trans. Graph. 41, 81 (2022), with the same cost for all rays) and the lower confidence bound of
        E[F]/E[F₀]. The inverse lower bound is no less than the upper confidence bound of E[F]/E[F₀], since rare strong
        rays may not have been found. Both are 0 if no ray has brought light.

        Parameters
        ----------
        forward : bool
            Whether the windows are those of forward rays.
        samples : sequence of Samples
            Samples of this round.
        values : (c,) float64
            Value of a unit of contribution by cell.
        rays : float
            Number of start rays of this round.
        shared : (2, n, WAYS) float64, optional
            Contributions by row, and their squares, for the confidence bounds; None: those of `samples`.
        """
        # Moments of F₀ of this round, and sums of F by row
        brought = [one.weight * values[one.cell] for one in samples]
        sums = np.array([sum(part.sum() for part in brought), sum(np.square(part).sum() for part in brought), rays])
        arrived, follows, _ = np.sum([one.importance for one in samples], axis=0)
        importance = np.array([arrived, follows, follows if shared is None else shared])
        self._importance[forward] = [*self._importance[forward], (importance, sums)][-REMEMBERED:]
        found, (all_brought, all_squares, all_rays) = (
            np.sum(column, axis=0) for column in zip(*self._importance[forward], strict=True)
        )
        (weight, weight_squares), (_, squares), (follows, shared_squares) = found
        if not all_brought > 0:
            return np.zeros((2, *weight.shape))
        mean, moment = all_brought / all_rays, all_squares / all_rays
        # Confidence bounds of E[F]/E[F₀]
        error = np.sqrt(shared_squares)
        least, most = (_ratio(follows + errors * error, weight) / mean for errors in (-1, BOUND))
        inverse_upper = np.maximum(np.sqrt(_ratio(squares, weight_squares) / moment), least)
        # Forward rays are split only: roulette would take those that matter to derivatives by faint scatterers
        by_roulette = (shared_squares > 0) & (not forward)
        lower = np.where(by_roulette, np.maximum(most, inverse_upper), 0)
        return _rounded(np.stack([inverse_upper, lower])).astype(np.float32)

    def _values(self, rays: np.ndarray, light: np.ndarray) -> np.ndarray:
        """
        Return the value of a unit of throughput of forward rays by cell, (c,), relative to the cell's light.

        `rays` are the forward rays of each cell per backward ray, (c,), and `light` is its PST_normal, (c,). Cells
        without light so far are as valuable as the most valuable one.
        """
        lit = self._counts & (light > 0) & (rays > 0)
        if not lit.any():
            return np.ones(len(light))
        value = np.divide(self._cells.unit.ravel(), light * rays, out=np.zeros(len(light)), where=lit)
        return _rounded(np.where(lit, value, value.max()) * rays.sum())

    def _note_path_classes(self, samples: Samples) -> None:
        """Store this round's samples to derive MIS weights of path classes; the last `REMEMBERED` rounds are kept."""
        cell, kind, mis = samples.cell, samples.kind, np.clip(samples.forward, SMALLEST_MIS, 1 - SMALLEST_MIS)
        # Density ratio of forward to backward rays, if each cell had as many forward as there are backward rays
        forward = self._sharing.rays[cell]
        if self._sharing.unscattered is not None:  # derivatives have no additional rays for unscattered light
            forward = forward * np.where(kind < SINGLE, self._sharing.unscattered[cell], 1)
        odds = mis / (1 - mis) / np.maximum(forward, SMALLEST_MIS)
        self._seen = [*self._seen, (cell, kind, samples.path_class, samples.weight, odds)][-REMEMBERED:]

    def _starts_per_connection(self, light: np.ndarray, relative: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """
        Return the number of forward start rays per path connected to a source, by cell, (c,); 0 if none pay.

        For the arguments see the results of `_relative_variances`.
        """
        starts_per_connection, counts = self._sharing.starts_per_connection, self._counts & (light > 0)
        if self._rounds == 1:  # one light vertex for each connection
            return starts_per_connection / max(self._trace.vertices_per_ray, 1e-3)
        if self._rounds != min(JUDGED_AFTER, self._least_rounds) or not starts_per_connection.any():
            return starts_per_connection
        # Variance without connections over that with them, against the cost in time
        now = relative[np.searchsorted(FACTORS, 1.0)][counts]
        without = gain[counts] * now
        if self._to_an_error:
            gained = without.max(initial=0.0) / now.max(initial=np.finfo(float).tiny)
        else:
            gained = np.exp(np.mean(np.log(gain[counts]))) if counts.any() else 0.0
        return starts_per_connection if gained > COST_OF_CONNECTIONS else np.zeros_like(starts_per_connection)

    def _remember(self, samples: Samples, light: np.ndarray, rays: int) -> None:
        """
        Store samples of a round of `rays` backward rays for the maps of forward and of backward ray starts.

        `light` is PST_normal by cell, (c,). At most `SAMPLES_OF_CELL` forward starts per cell are kept, and `ENDS_KEPT`
        backward ones.
        """
        rng = np.random.default_rng(self._rounds)
        cell, kind, weights = samples.cell, samples.kind, samples.weight
        # Weak classes of light get more weight, so that their errors are reliable, too
        classes = int(kind.max(initial=0)) + 1
        of_class = _sums(kind * len(light) + cell, weights, classes * len(light)).reshape(classes, -1)
        present = np.maximum(np.count_nonzero(of_class, axis=0), 1)
        total = of_class.sum(axis=0)
        share = np.divide(of_class, total, out=np.ones_like(of_class), where=total > 0)
        factor = 1 - CLASS_SHARE + CLASS_SHARE / (present[cell] * np.maximum(share[kind, cell], 1e-6))
        # Part of ∫ f²/q that the density of start rays decides: derivative with respect to its logarithm, times it
        resolved = np.square(weights) * (samples.forward * samples.density) * rays
        found = MapSamples(cell, samples.points, weights, resolved).times(factor)
        self._kept = [*self._kept, (found.after_roulette(SAMPLES_OF_CELL, rng), float(rays))][-REMEMBERED:]
        # The starts of backward rays serve all cells, whose light counts alike
        lit = (samples.ends[:, 0] >= 0) & self._counts[cell] & (samples.start_weight > 0)
        value = np.divide(factor, light[cell], out=np.zeros(len(cell)), where=light[cell] > 0)
        density = np.divide(1.0, samples.start_weight, out=np.zeros(len(cell)), where=lit)
        resolved = np.square(weights) * (1 - samples.forward) * density * rays
        found = MapSamples(np.zeros_like(cell), samples.ends, weights, resolved).times(value).some(lit)
        self._ends = [*self._ends, (found.after_roulette(ENDS_KEPT, rng), float(rays))][-REMEMBERED:]


def _rounded(values: np.ndarray) -> np.ndarray:
    """Return values rounded to 8 significant bits, so that the order of sums in parallel threads does not matter."""
    mantissa, exponent = np.frexp(values)
    return np.asarray(np.ldexp(np.round(256 * mantissa) / 256, exponent))


def _ratio(sums: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return `sums` over `weights`, 0 where the weight is 0."""
    return np.divide(sums, weights, out=np.zeros_like(sums), where=weights > 0)


def _together(parts: Sequence[Samples]) -> Samples:
    """Return the samples of several traces as one set, start rays numbered through; importance is left out."""
    lanes = 1 + max(int(one.lane.max(initial=0)) for one in parts)
    return Samples.together([replace(one, segments=np.zeros(1), importance=np.zeros(1)) for one in parts], lanes)


def _sums(place: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return sums of `values` grouped by the indices `place`, (count,) float64."""
    return np.bincount(place, values, count).astype(np.float64)


def _relative_variances(
    pair: Sequence[Samples], both: Samples, cells: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the light of the cells, its relative variance, and what connections gain.

    With the light f along a path and the density q of all rays, the variance is ∫ f²/q. Each sample yields f/q, and the
    weight s of forward rays in its path. With a factor k of the forward rays q becomes q (1 - s + k s). Samples of one
    ray in a cell are correlated, which multiplies the variance of each direction by a factor of its own.

    Parameters
    ----------
    pair : sequence of Samples
        Samples of forward rays, and of backward rays.
    both : Samples
        All of these, in this order.
    cells : int
        Number of cells.

    Returns
    -------
    light : (c,) float64
        PST_normal of the cells.
    relative : (k, c) float64
        Relative variance, for each of `FACTORS` of the forward rays.
    gain : (c,) float64
        Variance without connections over that with them.
    """
    where, mis, square = both.cell, both.forward, both.weight**2
    light, apart = (_sums(where, values, cells) for values in (both.weight, square))
    # Squares of sums by ray over sums of squares
    common = []
    for one in pair:
        alone = _sums(one.cell, one.weight**2, cells)
        common.append(np.divide(_squares_of_rays(one, cells), alone, out=np.ones(cells), where=alone > 0))
    forward_rays, backward = (factor[where] for factor in common)

    def variance_at(factor: float) -> np.ndarray:
        density = 1 - mis + factor * mis
        return _sums(where, square * (forward_rays * factor * mis + backward * (1 - mis)) / density**2, cells)

    # Variance by factor, and without connections
    variance = np.stack([variance_at(factor) for factor in FACTORS])
    without = _sums(where, square / np.maximum(1 - both.connected, LEAST_REST), cells)
    gain = np.divide(without, apart, out=np.ones(cells), where=apart > 0)
    return light, np.divide(variance, light**2, out=np.zeros_like(variance), where=light > 0), gain


def _squares_of_rays(samples: Samples, cells: int) -> np.ndarray:
    """Return, for each direction cell, the sum over start rays of the squared PST_normal that each brings, (c,)."""
    if not len(samples.weight):
        return np.zeros(cells)
    pair = samples.lane * cells + samples.cell
    order = np.argsort(pair, kind="stable")
    begins = np.flatnonzero(np.diff(pair[order], prepend=-1))
    brought = np.add.reduceat(samples.weight[order], begins)
    return _sums(pair[order][begins] % cells, brought**2, cells)
