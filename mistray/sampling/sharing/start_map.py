"""
Start maps: densities of the start rays of distant sources, learned from rays that have arrived.

The start rays of each cell of directions are points of the unit cube of four dimensions, see
`mistray.sampling.plane_wave.wave_rays`. Two are for the position in the cross-section, two for the direction.
Few of them carry light that reaches the detector. A binary tree for each cell halves the cube where that light lies, so
that rays start there more often with a lower throughput each. This is the density tree of Müller, Gross and Novák
(Practical path guiding for efficient light-transport simulation, 2017) in primary sample space. The density is a
mixture,

    p(x) = UNIFORM + (1 - UNIFORM) ∏ 2 s over the halvings that lead to the leaf of x,

where s is the share of rays in the half that holds x: `StartMap.low`, or 1 minus it.

The samples that a map is learned from are shared between neighbouring cells, and weak ones play Russian roulette: a
sample of weight w < w_min survives with the probability q = w/w_min and then has the weight w/q = w_min.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.sampling.strata import curve_points
from mistray.surfaces.upload import upload_rows

SAMPLES_OF_MAP, SAMPLES_LENT = 8000, 2000  # samples of a cell for itself, and for each of its neighbours
SHARE_LENT = 0.3  # weight of the samples of each neighbour, relative to that of a cell's own
DIMENSIONS = 4
CORNERS = 1 << DIMENSIONS
WORD = 32  # bits of a coordinate in the cube, the highest first
# By corner of a node and dimension: 1 where the corner is in the low half
IN_LOW = np.array([[float(not corner >> k & 1) for k in range(DIMENSIONS)] for corner in range(CORNERS)])
LEAF, MOST_DEPTH = -1, 36
MOST_HALVINGS = 20  # most halvings of one dimension
FEWEST = 5.0  # fewest effective samples of a node that is halved
PRIOR = 1.0  # prior of each half, in samples
LEAST_SHARE = 0.04  # least share of a node's rays in either half
# Share of rays that start uniformly in a cell: it bounds the throughput of light that the samples have missed
UNIFORM = 0.4


class MapSamples(NamedTuple):
    """
    Start points of forward rays whose light reaches the detector, weighted by this light.

    Attributes
    ----------
    cell : (s,) int
        Index of each sample's cell of directions.
    points : (s, 4) float64
        Points in the unit cube of the cell, see `mistray.sampling.plane_wave.wave_rays`.
    weights : (s,) float64
        Light of each sample: throughput times MIS weight, in units of a start ray's flux, raised for weak classes of
        light.
    squares : (s,) float64
        Contribution of each sample to ∫ E[F²] over the start points; F is the contribution of a ray from there.
    """

    cell: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    squares: np.ndarray

    @classmethod
    def of(cls, parts: Sequence[MapSamples]) -> MapSamples:
        """Return several sets of samples joined to one."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def times(self, factor: np.ndarray | float) -> MapSamples:
        """Return the samples with the flux that each carries multiplied by `factor`, one for all or (s,)."""
        return self._replace(weights=self.weights * factor, squares=self.squares * np.square(factor))

    def of_rays(self, rays: np.ndarray | float) -> MapSamples:
        """Return the samples as if `rays` rays, a number or (s,), had brought each: weights and squares grow alike."""
        return self._replace(weights=self.weights * rays, squares=self.squares * rays)

    def some(self, chosen: np.ndarray) -> MapSamples:
        """Return the samples that the boolean mask `chosen` selects."""
        return MapSamples(*(values[chosen] for values in self))

    def after_roulette(self, count: int, rng: np.random.Generator) -> MapSamples:
        """Return about `count` samples of each cell, or all if fewer; Russian roulette thins and raises weak ones."""
        # Roulette threshold of each cell
        limit = np.zeros(int(self.cell.max(initial=0)) + 1)
        for number, here in _of_each(self.cell):
            limit[number] = _threshold(self.weights[here], count)
        limits = limit[self.cell]
        # Roulette: a weak sample survives with q = w/w_min
        held = rng.random(len(limits)) * limits < self.weights
        return self.some(held).of_rays(np.maximum(limits[held] / self.weights[held], 1))

    def with_those_beside(self, shape: tuple[int, int]) -> MapSamples:
        """
        Return the samples of each cell together with those of its neighbours, whose light enters at similar places.

        A narrow entrance that no ray of a cell has met may be met in another; both then start rays there. Russian
        roulette limits the number of samples.

        Parameters
        ----------
        shape : tuple of int
            Number of field angles and number of azimuths of the grid; azimuths are periodic.
        """
        rng = np.random.default_rng(len(self.cell))
        total = np.bincount(self.cell, self.weights, shape[0] * shape[1]).astype(np.float64)
        few = self.after_roulette(SAMPLES_LENT, rng)
        row, column = np.divmod(few.cell, shape[1])
        parts = [self.after_roulette(SAMPLES_OF_MAP, rng)]
        around = {-1 % shape[1], 1 % shape[1]} - {0}
        for up, on in [(-1, 0), (1, 0), *((0, on) for on in sorted(around, reverse=True))]:
            to = (row + up) * shape[1] + (column + on) % shape[1]
            there = (row + up >= 0) & (row + up < shape[0])
            there &= total[np.where(there, to, 0)] > 0
            # Borrowed samples are normalised to the light of the cell that borrows
            scale = SHARE_LENT * total[to[there]] / total[few.cell[there]]
            parts.append(few.some(there)._replace(cell=to[there]).times(scale))
        return MapSamples.of(parts)


def _of_each(cell: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield each direction cell that occurs, in ascending order, with the indices of its samples, (n,) int."""
    order = np.argsort(cell, kind="stable")
    numbers, first = np.unique(cell[order], return_index=True)
    yield from zip(numbers.tolist(), np.split(order, first)[1:], strict=True)


def _threshold(weights: np.ndarray, count: int) -> float:
    """
    Return the weight below which Russian roulette thins samples, so that about `count` of them survive.

    It is 0 if there are no more than `count` samples.
    """
    if len(weights) <= count:
        return 0.0
    order = np.sort(weights)[::-1]
    rest = order.sum() - np.concatenate([[0.0], np.cumsum(order)[:-1]])
    # With k samples above it, w_min is the weight of the rest over count - k
    k = np.arange(count)
    limit = rest[k] / (count - k)
    return float(limit[np.argmax(limit >= order[k])])


@dataclass(frozen=True, eq=False)
class StartMap:
    """
    Densities of forward start rays in the unit cubes of all cells of directions, as binary trees.

    Attributes
    ----------
    axis : (n,) int32
        Dimension along which a node is halved; `LEAF`: it is not.
    child : (n,) int32
        Index of the node that is the low half; the high half has the next index.
    low : (n,) float64
        Fraction of the node's rays in the low half.
    root : (c,) int32
        Root node of each cell.
    """

    axis: np.ndarray
    child: np.ndarray
    low: np.ndarray
    root: np.ndarray

    @classmethod
    def uniform(cls, cells: int) -> StartMap:
        """Return a start map of uniform density in all cells."""
        return cls(np.full(1, LEAF, np.int32), np.zeros(1, np.int32), np.zeros(1), np.zeros(cells, np.int32))

    @classmethod
    def of(cls, cells: int, samples: MapSamples) -> StartMap:
        """Return the start map learned from samples of light that has reached the detector, dense where they are."""
        numbers, at = np.unique(samples.cell, return_inverse=True)
        root = np.zeros(cells, np.int32)
        root[numbers] = 1 + np.arange(len(numbers))
        # The first node is a leaf of uniform density, for cells without samples
        axis, child, low = [np.full(1, LEAF)], [np.zeros(1, np.int64)], [np.zeros(1)]
        made, halvings = 1 + len(numbers), np.zeros((len(numbers), DIMENSIONS), np.int64)
        # All nodes of a depth at once; `at` is the node of each sample, `inside` its position there
        top = 2.0**WORD
        inside = np.minimum(samples.points.T * top, top - 1).astype(np.uint32)
        brought = np.array([samples.weights, np.square(samples.weights), samples.squares])
        while len(halvings):
            k, share = _halved(at, inside, brought, halvings)
            number = np.cumsum(k != LEAF) - 1  # index among the nodes that are halved
            axis.append(k)
            child.append(np.where(k != LEAF, made + 2 * number, 0))
            low.append(share)
            # Samples go on to the halves: the highest bit of the coordinate says to which
            there = np.flatnonzero(k[at] != LEAF)
            at, inside, brought = at[there], inside.take(there, axis=1), brought.take(there, axis=1)
            place = inside.ravel()
            along = k[at] * len(at) + np.arange(len(at))
            word = place[along]
            place[along] = word << 1
            at = 2 * number[at] + (word >> (WORD - 1))
            halved = np.flatnonzero(k != LEAF)
            halvings = halvings[halved]
            halvings[np.arange(len(halved)), k[halved]] += 1
            halvings = np.repeat(halvings, 2, axis=0)
            made += len(halvings)
        axes, children = (np.concatenate(parts).astype(np.int32) for parts in (axis, child))
        return cls(axes, children, np.concatenate(low), root)


def _halved(
    at: np.ndarray, inside: np.ndarray, brought: np.ndarray, halvings: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the halving of the tree nodes of one depth, by the mean of two shares: by light, and by least variance.

    With uniform density in either half, the variance is least at densities proportional to √⟨E[F²]⟩, the mean over the
    half (A. Rath et al., Variance-aware path guiding, ACM Trans. Graph. 39, 151 (2020)). Halves in which light is not
    yet resolved get more rays by this than by their light.

    Parameters
    ----------
    at, inside, brought : (s,) int, (4, s) uint32, (3, s) float64
        Node of each sample, its position there (0 … 2^32), its weight, the squared weight, and `MapSamples.squares`.
    halvings : (n, 4) int
        Halvings of each dimension that have led to a node.

    Returns
    -------
    (n,) int, (n,) float64
        Dimension that is halved, `LEAF` where a node stays whole, and the share of its low half.
    """
    # Sums over the low and the high half, for each dimension
    count = len(halvings)
    high = inside >> (WORD - 1)
    corner = CORNERS * at + (high[0] | high[1] << 1 | high[2] << 2 | high[3] << 3)
    of_corners = (np.bincount(corner, values, CORNERS * count).reshape(count, CORNERS) for values in brought)
    (low, high), (low_squares, high_squares), (low_moment, high_moment) = (
        (sums @ IN_LOW, sums @ (1 - IN_LOW)) for sums in of_corners
    )
    # Effective number of samples, (Σw)²/Σw², and shares of the low half
    squares = low_squares[:, 0] + high_squares[:, 0]
    effective = (low[:, 0] + high[:, 0]) ** 2 / np.maximum(squares, 1e-300)
    root_low, root_high = np.sqrt(low_moment), np.sqrt(high_moment)
    shares = 0.5 * (low / np.maximum(low + high, 1e-300) + root_low / np.maximum(root_low + root_high, 1e-300))
    # Choose the dimension whose halves differ most
    lean = np.where(halvings > MOST_HALVINGS, -1.0, np.abs(shares - 0.5))
    nodes = np.arange(count)
    k = np.argmax(lean, axis=1)
    most = lean[nodes, k]
    # Halves that differ by less than their noise are no reason to halve, unless there are many samples
    noise = 1 / np.sqrt(np.maximum(effective, 1e-300))
    whole = (effective < FEWEST) | (halvings.sum(axis=1) >= MOST_DEPTH)
    whole |= (most < 0.5 * noise) & (effective < 16 * FEWEST)
    # A node whose halves hardly differ is halved along its longest side
    k = np.where(most < noise, np.argmin(halvings, axis=1), k)
    share = (shares[nodes, k] * effective + PRIOR) / (effective + 2 * PRIOR)
    share = np.clip(share, LEAST_SHARE, 1 - LEAST_SHARE)
    return np.where(whole, LEAF, k), np.where(whole, 0.0, share)


class DeviceMap:
    """Start map on the device: sampling of start points, and evaluation of their density."""

    def __init__(self, given: StartMap) -> None:
        # One word a node: axis + 1 in three bits, 0 for a leaf, and the number of the low child
        self._word = upload_rows(mi.UInt32, (given.axis + 1).astype(np.uint32) | (given.child.astype(np.uint32) << 3))
        self._low = upload_rows(mi.Float64, given.low)
        self._root = upload_rows(mi.UInt32, given.root.astype(np.uint32))

    def sample(self, cell: mi.UInt32, place: mi.Float64, rng: mi.PCG32) -> tuple[list[mi.Float], mi.Float]:
        """Return start points in the unit cubes of cells, and their density, of mean 1; `place` is uniform in 0 … 1."""
        # Choose the uniform part of the mixture or the tree, and rescale the number
        width = dr.width(cell)
        anywhere = place < UNIFORM
        t = dr.select(anywhere, place / UNIFORM, (place - UNIFORM) / (1 - UNIFORM))
        root = dr.gather(mi.UInt32, self._root, cell)
        node = dr.select(anywhere, 0, root)
        zero, one = dr.zeros(mi.Array4f, width), dr.full(mi.Array4f, 1, width)

        def step(
            node: mi.UInt32, t: mi.Float64, corner: mi.Array4f, size: mi.Array4f, going: mi.Bool
        ) -> tuple[Any, ...]:
            word = dr.gather(mi.UInt32, self._word, node, going)
            low = dr.gather(mi.Float64, self._low, node, going)
            k, first = word & 7, word >> 3
            going = going & (k > 0)
            high = t >= low
            u = dr.select(high, (t - low) / (1 - low), t / low)
            t = dr.select(going, u, t)
            for j in range(DIMENSIONS):
                here = going & (k == j + 1)
                size[j] = dr.select(here, 0.5 * size[j], size[j])
                corner[j] = dr.select(here & high, corner[j] + size[j], corner[j])
            node = dr.select(going, first + dr.select(high, mi.UInt32(1), 0), node)
            return node, t, corner, size, going

        # Descend to a leaf; t is rescaled to 0 … 1 within each half, which uses up its bits: hence double precision
        node, t, corner, size, _ = dr.while_loop(
            (node, mi.Float64(t), zero, one, dr.full(mi.Bool, True, width)),
            lambda *v: v[-1],
            step,
            mode="symbolic",
            labels=("node", "t", "corner", "size", "going"),
        )
        # Position in the leaf: along a space-filling curve, so that stratified numbers stay stratified. Rounded up to
        # the next leaf, where few rays start, it would have a far too small density
        inner = curve_points(dr.clip(t, 0, 1 - 1e-12), DIMENSIONS, rng)
        sides = zip(corner, size, inner, strict=True)
        point = [dr.minimum(low + side * u, (low + side) * (1 - 2.0**-24)) for low, side, u in sides]
        return point, self.density(cell, point, dr.full(mi.Bool, True, width))

    def density(self, cell: mi.UInt32, point: list[mi.Float], active: mi.Bool) -> mi.Float:
        """Return the density of start rays at points of the unit cubes of cells; its mean is 1."""
        width = dr.width(point[0])
        node = dr.gather(mi.UInt32, self._root, cell, active)

        def step(node: mi.UInt32, *rest: Any) -> tuple[Any, ...]:
            *x, density, going = rest
            word = dr.gather(mi.UInt32, self._word, node, going)
            low = mi.Float(dr.gather(mi.Float64, self._low, node, going))
            k, first = word & 7, word >> 3
            going = going & (k > 0)
            value = dr.select(k == 1, x[0], dr.select(k == 2, x[1], dr.select(k == 3, x[2], x[3])))
            high = value >= 0.5
            density = dr.select(going, density * 2 * dr.select(high, 1 - low, low), density)
            for j in range(DIMENSIONS):
                here = going & (k == j + 1)
                x[j] = dr.select(here, 2 * x[j] - dr.select(high, mi.Float(1), 0), x[j])
            node = dr.select(going, first + dr.select(high, mi.UInt32(1), 0), node)
            return node, *x, density, going

        # Descend by position: each halving doubles the density of a half times its share
        *_, density, _ = dr.while_loop(
            (node, *(mi.Float(v) for v in point), dr.full(mi.Float, 1, width), mi.Bool(active)),
            lambda *v: v[-1],
            step,
            mode="symbolic",
            labels=("node", "x", "y", "u", "v", "density", "going"),
        )
        return UNIFORM + (1 - UNIFORM) * density
