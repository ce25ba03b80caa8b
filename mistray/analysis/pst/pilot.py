"""A pilot for backward runs: which ways the light takes, and which direction of tracing samples each better.

Rays of its own search in both directions, forward and backward, and list what they find by way and cell of
directions. A way that backward rays find by chance only, and that forward rays find easily, is then
counted forwards; all others are counted against it. Since the pilot is independent of the run, the sum of both
parts has the same mean as either direction alone. The same lists tell how many rays a run needs, so that nothing has to
be decided on the samples that are averaged, and which ways a run has sampled too seldom.

The variance of a way that was hit by a share p of the rays with a mean w̄ is at least w̄²/p per ray (Cauchy-Schwarz), so
that a way which one direction has hardly seen, but whose light is known from the other, has a variance all the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mistray.execute.backward import BackwardTrace
from mistray.recorders.path_key import ABSORBED, EVENT_BITS, host_keys
from mistray.recorders.path_sums import join_sums
from mistray.trace.all_cells import AllCells, whole_batches

FORWARD, BACKWARD = 0, 1
BETTER = 0.5  # variance × cost, with the light over against it, below which a way is counted forwards
KNOWN_HITS = 8  # of a way in a cell, above which it is judged there, below by all cells together
WORTH = 0.05  # share of a cell's variance that ways must bring to be counted forwards
PILOT_SHARE = 16  # a run to an error takes about so many times the rays of its pilot
LEAST_SEGMENTS = 1e6  # of a pilot in each direction
FIRST_ROUND, LARGEST_ROUND = 1 << 13, 1 << 19  # rays
SEEN = 3  # hits in the one direction after which a way must not be missing in the other
SELDOM = 16  # hits of a way in a cell below which a run has sampled it seldom
RESERVE = 1.2  # rays above what the pilot's variances ask for

Book = dict[str, np.ndarray]


def forward_events(events: np.ndarray, lengths: np.ndarray, detector: int) -> tuple[np.ndarray, np.ndarray]:
    """Event lists of backward rays as those of the light, the absorption in the detector at their ends."""
    order = lengths[:, None] - 1 - np.arange(events.shape[1] + 1)
    turned = np.take_along_axis(np.pad(events, ((0, 0), (0, 1))), np.maximum(order, 0), axis=1)
    turned = np.where(order >= 0, turned, 0).astype(np.uint32)
    turned[np.arange(len(turned)), lengths] = (detector << EVENT_BITS) | ABSORBED
    return turned, lengths + 1


def backward_events(events: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Event lists of the light as those of rays against it, which start on the detector."""
    order = lengths[:, None] - 2 - np.arange(events.shape[1])
    turned = np.take_along_axis(events, np.maximum(order, 0), axis=1)
    return np.where(order >= 0, turned, 0).astype(np.uint32), lengths - 1


@dataclass(frozen=True, kw_only=True)
class Plan:
    """
    What a pilot has found, by pairs of a way and a cell; the first index of two is `FORWARD` or `BACKWARD`.

    Attributes
    ----------
    events : (w, k) uint32
    lengths : (w,) int
        Ways, in the order of the light with the absorption in the detector at their ends.
    way, cell : (p,) int
        Pairs.
    forward : (p,) bool
        Whether the pair is counted forwards.
    hits : (2, p) float64
        Of the pilot.
    mean : (2, p) float64
        PST_normal that each direction has found.
    second : (2, p) float64
        Second moment of PST_normal of one ray in each direction, see the module.
    rays : (2, c) float64
        Of the pilot, by cell; those backwards serve all cells.
    cost : (2,) float64
        Segments of a ray.
    """

    events: np.ndarray
    lengths: np.ndarray
    way: np.ndarray
    cell: np.ndarray
    forward: np.ndarray
    hits: np.ndarray
    mean: np.ndarray
    second: np.ndarray
    rays: np.ndarray
    cost: np.ndarray

    def with_forward_pairs(self, way: np.ndarray, cell: np.ndarray) -> Plan:
        """The plan with further pairs that are counted forwards, of which the pilot has seen nothing."""
        nothing = np.zeros((2, len(way)))
        return replace(
            self,
            way=np.concatenate([self.way, way]),
            cell=np.concatenate([self.cell, cell]),
            forward=np.concatenate([self.forward, np.full(len(way), True)]),
            hits=np.concatenate([self.hits, nothing], axis=1),
            mean=np.concatenate([self.mean, nothing], axis=1),
            second=np.concatenate([self.second, nothing], axis=1),
        )

    @property
    def light(self) -> np.ndarray:
        """(c,) PST_normal of each cell: of every pair from the direction that counts it."""
        return self._by_cell(np.where(self.forward, self.mean[FORWARD], self.mean[BACKWARD]))

    def rays_for(self, relative_error: float, counts: np.ndarray) -> int:
        """
        Backward rays that a relative error takes at the least cost of both directions.

        Parameters
        ----------
        relative_error : float
        counts : (c,) bool
            Cells whose error counts; those without light are left out.
        """
        light = self.light
        wanted = np.square(relative_error * light) / RESERVE
        counts = counts & (light > 0)
        if not counts.any():
            return 0
        forward, backward = (part[counts] for part in self._variances())
        wanted = wanted[counts]
        fewest = float(np.max(backward / wanted, initial=0.0))
        if not forward.any():
            return int(np.ceil(fewest))
        tried = max(fewest, 1.0) * np.geomspace(1.02, 1e3, 60)
        left = wanted[:, None] - backward[:, None] / tried
        cost = tried * self.cost[BACKWARD] + self.cost[FORWARD] * np.sum(forward[:, None] / left, axis=0)
        return int(np.ceil(tried[np.argmin(cost)]))

    def forward_rays(self, rays: float, relative_error: float | None) -> np.ndarray:
        """
        (c,) forward rays beside so many against it; 0 in cells that count nothing forwards.

        Without an error that is wanted both parts of a cell get the same variance, at no more than twice the cost of
        the backward rays alone; a cell has at least the rays of the pilot.
        """
        forward, backward = self._variances()
        used = np.bincount(self.cell[self.forward], minlength=len(forward)) > 0
        least = self.rays[FORWARD]
        left = backward / rays
        if relative_error is not None:
            wanted = np.square(relative_error * self.light) / RESERVE
            left = np.maximum(wanted - left, 0.02 * wanted)
        most = rays * self.cost[BACKWARD] / self.cost[FORWARD] / max(int(used.sum()), 1)
        found = np.divide(forward, left, out=np.full(len(forward), np.inf), where=left > 0)
        if relative_error is None:
            found = np.minimum(found, most)
        found = np.where(np.isfinite(found), found, most)
        # Powers of two, so that a scene and a slightly changed one are lit by the same rays
        wanted = np.exp2(np.ceil(np.log2(np.maximum(found, least))))
        return whole_batches(np.where(used, wanted, 0))

    def widening(self, hits: np.ndarray, variance: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """
        Variance that the pairs of a run are missing.

        Rare rays of a large weight are what a run misses together with their variance, so that a low value has a small
        error. A pair that the pilot has seen brings the variance of its rays and those of the run together; where the
        run's own is less, the difference is missing. One that the run has sampled seldom and the other direction has
        seen brings at least the variance that its light, known from there, has at the share of rays that hit it.

        Parameters
        ----------
        hits, variance : (p,) float64
            Of the run: hits of each pair and the variance of its PST_normal.
        rays : (p,) float64
            Of the run, in the direction that counts the pair.

        Returns
        -------
        (p,) float64
        """
        own = np.where(self.forward, FORWARD, BACKWARD)
        pair = np.arange(len(own))
        seen, light = self.hits[1 - own, pair], self.mean[1 - own, pair]
        before, pilot = self.hits[own, pair], self.rays[own, self.cell]
        share = (hits + before + 1) / (rays + pilot)
        of_one = np.maximum(self.second[own, pair] - self.mean[own, pair] ** 2, 0.0)
        together = (of_one * pilot + variance * rays**2) / (rays + pilot)
        known = np.where((seen >= SEEN) & (hits < SELDOM), light**2 / share, 0.0)
        second = np.maximum(known, np.where(before >= SEEN, together, 0.0))
        missing = np.divide(second, rays, out=np.zeros(len(own)), where=rays > 0) - variance
        return np.maximum(missing, 0.0)

    def _variances(self) -> tuple[np.ndarray, np.ndarray]:
        """(c,) each: variance per ray of what is counted forward and backward."""
        forward = self._by_cell(np.where(self.forward, self.second[FORWARD], 0.0))
        return forward, self._by_cell(np.where(self.forward, 0.0, self.second[BACKWARD]))

    def _by_cell(self, values: np.ndarray) -> np.ndarray:
        return np.bincount(self.cell, values, self.rays.shape[1])


class Pilot:
    """
    Searches in both directions.

    Parameters
    ----------
    trace : BackwardTrace
    cells : AllCells
        Of the same scene, grid and wavelengths.
    """

    def __init__(self, trace: BackwardTrace, cells: AllCells) -> None:
        self._trace, self._cells = trace, cells
        self._sums: list[Book] = []
        self._rounds = 0
        self.rays = np.zeros((2, cells.areas.size))
        self._segments = np.zeros(2)

    def search(self, rays: float) -> None:
        """Go on to so many backward rays, and as many with it as cost the same, but to a least size."""
        if not self._rounds:
            self._round(FIRST_ROUND, FIRST_ROUND)
        while True:
            cost = self._segments / self._done
            wanted = max(rays * cost[BACKWARD], LEAST_SEGMENTS) / cost
            missing = np.minimum(wanted - self._done, LARGEST_ROUND)
            if np.all(missing < FIRST_ROUND):
                return
            self._round(*(int(max(count, FIRST_ROUND)) for count in missing))

    @property
    def _done(self) -> np.ndarray:
        """(2,) rays, those with the light of all cells together."""
        return np.array([self.rays[FORWARD].sum(), self.rays[BACKWARD, 0]])

    def _round(self, forward: int, backward: int) -> None:
        shape = self._cells.areas.shape
        spread = whole_batches(np.full(shape, max(1, round(forward / np.prod(shape)))))
        found, segments = self._cells.find(spread, self._rounds)
        other, other_segments = self._trace.find(backward, self._rounds)
        events, lengths = forward_events(other["events"], other["lengths"], self._trace.table.detector)
        sums = [found, other | {"events": events, "lengths": lengths}]
        self._sums = [join_sums(*pair) for pair in zip(self._sums, sums, strict=True)] if self._sums else sums
        self.rays += np.stack([spread.ravel(), np.full(spread.size, backward)])
        self._segments += segments, other_segments
        self._rounds += 1

    def plan(self) -> Plan:
        """What has been found, and which direction counts it."""
        events, lengths, pairs = _together(*self._sums)
        way, cell = pairs[0]
        count = len(way)
        grid, trace = self._trace.grid, self._trace
        units = np.stack(
            [
                self._cells.areas.ravel() / trace.area,
                np.repeat(np.pi / grid.solid_angle, grid.shape[1]),
            ]
        )
        hits, mean, second = np.zeros((3, 2, count))
        for k, (one, place) in enumerate(zip(self._sums, pairs[1:], strict=True)):
            unit = units[k][one["cell"]]
            rays = self.rays[k][one["cell"]]
            hits[k, place] = one["hits"]
            mean[k, place] = unit * one["weight"] / rays
            second[k, place] = unit**2 * one["squares"] / rays
        rays = self.rays[:, cell]
        light = np.where(hits[FORWARD] >= hits[BACKWARD], mean[FORWARD], mean[BACKWARD])
        second = np.maximum(second, light**2 * rays / (hits + 1))
        cost = self._segments / self._done
        # A backward ray serves all cells, one with the light its own
        effort = second * (cost * [self._cells.areas.size, 1])[:, None]
        forward = self._choose(way, cell, hits, light, effort)
        plan = Plan(
            events=events, lengths=lengths, way=way, cell=cell, forward=forward, hits=hits, mean=mean, second=second,
            rays=self.rays.copy(), cost=cost,
        )  # fmt: skip
        return _widened(plan, len(lengths), self._way_level)

    def _choose(
        self, way: np.ndarray, cell: np.ndarray, hits: np.ndarray, light: np.ndarray, effort: np.ndarray
    ) -> np.ndarray:
        """(p,) bool: what is counted forwards."""
        cells = self.rays.shape[1]
        total = np.bincount(cell, light, cells)[cell]
        relative = np.divide(effort, total**2, out=np.zeros_like(effort), where=total > 0)
        known = hits.sum(axis=0) >= KNOWN_HITS
        # A way is judged by the cells that know it, where there are any
        trusted = known | ~(np.bincount(way, known) > 0)[way]
        pooled = np.stack([np.bincount(way, np.where(trusted, part, 0.0)) for part in relative])
        self._way_level = pooled[FORWARD] < BETTER * pooled[BACKWARD]
        forward = np.where(known, effort[FORWARD] < BETTER * effort[BACKWARD], self._way_level[way])
        spared = np.bincount(cell, np.where(forward, effort[BACKWARD] - effort[FORWARD], 0.0), cells)
        whole = np.bincount(cell, effort[BACKWARD], cells)
        return np.asarray(forward & (spared > WORTH * whole)[cell])


def _together(
    forward: Book, backward: Book
) -> tuple[np.ndarray, np.ndarray, tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]]:
    """Ways of two sums, and their pairs: way and cell of each, and the places of the sums' entries among them."""
    longest = max(forward["events"].shape[1], backward["events"].shape[1])
    events = np.concatenate(
        [np.pad(one["events"], ((0, 0), (0, longest - one["events"].shape[1]))) for one in (forward, backward)]
    )
    lengths = np.concatenate([forward["lengths"], backward["lengths"]])
    _, chosen, place = np.unique(host_keys(events, lengths), return_index=True, return_inverse=True)
    ways = place[forward["path"]], place[backward["path"] + len(forward["lengths"])]
    both = np.stack([np.concatenate(ways), np.concatenate([forward["cell"], backward["cell"]])], axis=1)
    pairs, number = np.unique(both, axis=0, return_inverse=True)
    number = number.ravel()
    entries = len(forward["path"])
    return events[chosen], lengths[chosen], ((pairs[:, 0], pairs[:, 1]), number[:entries], number[entries:])


def _widened(plan: Plan, ways: int, forward: np.ndarray) -> Plan:
    """The plan with ways that are counted forwards also in cells that saw none of them, where others are."""
    cells = np.unique(plan.cell[plan.forward])
    chosen = np.unique(plan.way[plan.forward])
    chosen = chosen[forward[chosen]]
    wanted = (chosen[:, None] * plan.rays.shape[1] + cells).ravel()
    new = np.setdiff1d(wanted, plan.way * plan.rays.shape[1] + plan.cell)
    way, cell = np.divmod(new, plan.rays.shape[1])
    return plan.with_forward_pairs(way, cell)
