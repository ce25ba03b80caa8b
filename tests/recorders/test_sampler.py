"""Random numbers of the ray tree: points of scrambled Sobol' sequences, independent from pair to pair."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.statistics import assert_z, mean_and_error
from scipy.stats import kstest, qmc

import mistray
from mistray.recorders import sampler as module
from mistray.recorders.sampler import Sampler, tree_seeds
from mistray.surfaces.upload import upload

BLOCK = 64  # points of an aligned block, 2^6
SEEDS = 4000


@pytest.fixture(autouse=True, scope="module")
def variant() -> None:
    mistray.ensure_variant()


def points(seed: int, pair: int = 0, first: int = 0, count: int = BLOCK) -> np.ndarray:
    index = dr.arange(mi.UInt32, count) + first
    return np.array(Sampler(index, dr.opaque(mi.UInt32, seed, count)).pair(pair)).T


def drawn(pair: int, child: int | None = None, rays: int = 16) -> np.ndarray:
    """First numbers of a pair, (seeds, rays), at start nodes or at a child, of as many trees of neighbouring rays."""
    seed, index = np.repeat(np.arange(SEEDS), rays), np.tile(np.arange(rays), SEEDS)
    node = Sampler(upload(mi.UInt32, index), tree_seeds(7, upload(mi.UInt32, seed)))
    if child is not None:
        node = node.child(mi.UInt32(child))
    return np.array(node.pair(pair)[0]).reshape(SEEDS, rays)


@pytest.mark.parametrize("seed", [0, 1, 0xFFFFFFFF, 20_000])
@pytest.mark.parametrize("first", [0, 3 * BLOCK, 2**32 - BLOCK])
def test_a_block_has_one_point_in_every_elementary_interval(seed: int, first: int) -> None:
    x, y = points(seed, first=first).T
    assert 0 <= min(x.min(), y.min()) <= max(x.max(), y.max()) < 1
    for columns in 2 ** np.arange(7):
        cells = np.floor(x * columns) * (BLOCK // columns) + np.floor(y * (BLOCK // columns))
        assert np.array_equal(np.sort(cells), np.arange(BLOCK))


def test_without_hashes_they_are_those_of_sobol(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_scrambled", lambda bits, seed: bits)
    number = np.arange(1024)  # SciPy's points are in the order of the Gray code
    ours, theirs = points(5, count=1024)[number ^ (number >> 1)], qmc.Sobol(2, scramble=False).random(1024)
    assert np.array_equal(ours, theirs)


def test_each_number_is_uniform() -> None:
    # One number of each tree, so that they are independent: three tests at 1e-5, false alarm 3e-5
    for numbers in (drawn(0), drawn(2), drawn(1, child=3)):
        assert kstest(numbers[:, 5], "uniform").pvalue > 1e-5


@pytest.mark.parametrize("second", [(1, None), (0, 0), (0, 5), (2, 1)])
def test_pairs_and_children_are_independent_of_the_node(second: tuple[int, int | None]) -> None:
    # Rays that survive roulette of one in eight draw again, from all places alike: with one order for all pairs they
    # all fall into one eighth of the places, and the variance of the mean of two would be 1/12, twice as large
    survives, numbers = drawn(0) < 0.125, drawn(*second)
    sums, counts = (numbers * survives).sum(axis=1), survives.sum(axis=1)
    assert np.all(counts == 2)
    means = sums / counts - 0.5
    mean, error = mean_and_error(means)
    assert_z("numbers of the survivors", mean, 0.0, error, false_alarm=2.5e-4)
    assert np.mean(means**2) < 1.15 / 24  # its error is 1.4 % where they are independent


def test_means_of_many_rays_vary_less() -> None:
    # A smooth function of two numbers: the variance of its mean over 64 points falls by more than ten; by 1 if they
    # were independent, with an error of 5 % from 800 trees
    means = np.array([np.mean(np.exp(-np.sum(points(seed * 77 + 5, pair=2) ** 2, axis=1))) for seed in range(800)])
    one = np.exp(-np.sum(np.random.default_rng(0).random((100_000, 2)) ** 2, axis=1))
    assert means.var() < one.var() / BLOCK / 10
    mean, error = mean_and_error(means)
    assert_z("mean", mean, 0.7468241328**2, error)  # (√π/2 erf 1)²
