"""Densities of start rays that are learned from light: they integrate to one, and rays come as they say."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mistray.recorders.start_rays import generators
from mistray.sampling.sharing.map_samples import SHARE_LENT, MapSamples
from mistray.sampling.sharing.start_map import UNIFORM, DeviceMap, StartMap

COUNT = 1 << 18


@pytest.fixture(scope="module")
def learned() -> StartMap:
    """Two cells: light from a slanted slab in the first, none known in the second."""
    rng = np.random.default_rng(1)
    points = rng.random((200_000, 4))
    points = points[np.abs(points[:, 0] - 0.3 - 0.4 * points[:, 2]) < 0.01]
    return StartMap.of(2, even(points))


def even(points: np.ndarray, cell: int = 0, brings: np.ndarray | float = 1.0) -> MapSamples:
    """Samples of a cell from rays that start anywhere, by what each of them brings."""
    brought = np.broadcast_to(brings, len(points)) / len(points)
    return MapSamples(np.full(len(points), cell), points, brought, brought**2 * len(points))


def sampled(device: DeviceMap, cell: int) -> tuple[np.ndarray, np.ndarray]:
    lane = dr.arange(mi.UInt32, COUNT)
    rng, _ = generators(5, lane)
    place = (mi.Float64(lane) + mi.Float64(rng.next_float32())) / COUNT
    point, density = device.sample(dr.full(mi.UInt32, cell, COUNT), dr.minimum(place, 1 - 1e-12), rng)
    return np.stack([np.array(x) for x in point], axis=1), np.array(density)


@pytest.mark.parametrize("cell", [0, 1])
def test_densities_are_those_of_the_samples(learned: StartMap, cell: int) -> None:
    """The mean of 1/density is the volume 1, and of f/density the integral of f, within 5 errors (false alarm 4e-6)."""
    points, density = sampled(DeviceMap(learned), cell)
    assert points.min() >= 0
    assert points.max() < 1
    for f, integral in ((np.ones(COUNT), 1.0), (np.prod(points, axis=1), 1 / 16), (points[:, 0] ** 3, 1 / 4)):
        found = f / density
        assert abs(found.mean() - integral) < 5 * found.std() / np.sqrt(COUNT) + 1e-6
    if cell == 1:  # without light
        np.testing.assert_allclose(density, 1.0, rtol=1e-6)
    else:  # a slab of 2 % of the cube gets most of the rays; the floor keeps 40 % of them anywhere
        inside = np.abs(points[:, 0] - 0.3 - 0.4 * points[:, 2]) < 0.01
        assert 0.25 < inside.mean() < 1 - UNIFORM * 0.97
        assert density.min() >= UNIFORM


def test_light_that_arrives_by_chance_gets_more_rays() -> None:
    """With E[F²] 100 times as large √100 times as many rays are best; the share is the mean of 1/11 and 1/2."""
    rng = np.random.default_rng(2)
    points = rng.random((200_000, 4))
    brings = np.where(points[:, 0] < 0.5, 1.0, np.where(rng.random(len(points)) < 0.01, 100.0, 0.0))
    learned = StartMap.of(1, even(points[brings > 0], brings=brings[brings > 0]))
    root = learned.root[0]
    assert learned.axis[root] == 0
    assert learned.low[root] == pytest.approx((1 / 11 + 1 / 2) / 2, abs=0.01)


def test_cells_lend_what_they_have_met() -> None:
    """Of field angles 0 to 2: each has a quarter of the cube, and none of them but the middle has met a narrow way."""
    rng = np.random.default_rng(3)
    narrow = rng.random((50, 4)) * [1e-2, 1, 1, 1]
    own = [even(0.5 * rng.random((5000, 4)) + [0.5, 0.5, 0, 0], cell) for cell in range(3)]
    samples = MapSamples.of([*own, even(narrow, 1)])
    there = samples.with_those_beside((3, 1))
    for cell, lenders in ((0, 1), (1, 2), (2, 1)):
        here = there.cell == cell
        light = samples.weights[samples.cell == cell].sum()
        assert there.weights[here].sum() == pytest.approx(light * (1 + SHARE_LENT * lenders), rel=0.05)
    alone, both = (DeviceMap(StartMap.of(3, found)) for found in (samples, there))
    point = [mi.Float(list(column)) for column in narrow.T]
    cell = dr.full(mi.UInt32, 0, len(narrow))
    densities = [np.array(one.density(cell, list(point), dr.full(mi.Bool, True, len(narrow)))) for one in (alone, both)]
    assert np.median(densities[1]) > 5 * np.median(densities[0])

    there = samples.with_those_beside((1, 3))  # azimuths go round
    assert [np.count_nonzero(there.cell == cell) > np.count_nonzero(samples.cell == cell) for cell in range(3)] == [
        True
    ] * 3


def test_samples_after_roulette_stand_for_all() -> None:
    """Strong ones are kept; sums stay the same within 5 errors (false alarm 6e-7)."""
    rng = np.random.default_rng(5)
    brings = rng.lognormal(0, 2, 20_000)
    samples = even(rng.random((len(brings), 4)), brings=brings)
    few = samples.after_roulette(1000, rng)
    assert 800 < len(few.cell) < 1200
    assert few.weights.sum() == pytest.approx(samples.weights.sum(), rel=0.1)
    assert few.squares.sum() == pytest.approx(samples.squares.sum(), rel=0.05)
    assert few.weights.max() == samples.weights.max()
