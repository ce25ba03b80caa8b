"""Densities of start rays that are learned from light: they integrate to one, and rays come as they say."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mistray.recorders.start_rays import generators
from mistray.sampling.sharing.start_map import UNIFORM, DeviceMap, StartMap

COUNT = 1 << 18


@pytest.fixture(scope="module")
def learned() -> StartMap:
    """Two cells: light from a slanted slab in the first, none known in the second."""
    rng = np.random.default_rng(1)
    points = rng.random((200_000, 4))
    points = points[np.abs(points[:, 0] - 0.3 - 0.4 * points[:, 2]) < 0.01]
    return StartMap.of(2, np.zeros(len(points), dtype=int), points, np.ones(len(points)))


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


def test_starts_are_where_the_light_was_and_sometimes_elsewhere(learned: StartMap) -> None:
    """A slab of 2 % of the cube gets most of the rays; the floor keeps 30 % of them anywhere."""
    points, density = sampled(DeviceMap(learned), 0)
    inside = np.abs(points[:, 0] - 0.3 - 0.4 * points[:, 2]) < 0.01
    assert inside.mean() > 0.25
    assert density.min() >= UNIFORM
    assert (~inside).mean() > UNIFORM * 0.97


def test_a_cell_without_light_is_even(learned: StartMap) -> None:
    np.testing.assert_allclose(sampled(DeviceMap(learned), 1)[1], 1.0, rtol=1e-6)
