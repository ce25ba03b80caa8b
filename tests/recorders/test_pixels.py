"""How far the errors of pixels may be trusted."""

from __future__ import annotations

import numpy as np
import pytest
from lit_detector import lit, square

import mistray
from mistray.recorders.film import Pixels
from mistray.settings import BATCHES

SIZE = 24


def image(draw: object, mean: float, seed: int = 0) -> Pixels:
    """An image of as many rays in a pixel in the mean, of weights that `draw` gives."""
    rng = np.random.default_rng(seed)
    film = np.zeros((BATCHES + 3, SIZE, SIZE))
    count = rng.poisson(mean, (SIZE, SIZE))
    y, x = (np.repeat(place.ravel(), count.ravel()) for place in np.indices(count.shape))
    weight = draw(rng, len(y))  # type: ignore[operator]
    np.add.at(film, (rng.integers(0, BATCHES, len(y)), y, x), weight)
    for number, power in enumerate((0, 2, 4), BATCHES):
        np.add.at(film[number], (y, x), weight**power)
    return Pixels.of_film(film, np.full(BATCHES, 1000.0), 0.37)


def even(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.ones(count)


def uneven(rng: np.random.Generator, count: int) -> np.ndarray:
    """One ray in a hundred brings ten times as much light as all others."""
    return np.where(rng.random(count) < 0.01, 1000.0, 1.0)


def test_rays_of_equal_weight_are_counted() -> None:
    found = image(even, 10.0)
    np.testing.assert_array_equal(found.few_rays, found.weights[0] < 10)
    np.testing.assert_array_equal(np.isnan(found.se), found.weights[0] < 10)


def test_a_pixel_is_judged_by_those_around_it() -> None:
    """Most pixels of 40 rays lack the heavy ones, and would have a small error without their neighbours."""
    found = image(uneven, 40.0)
    assert np.mean(found.value < 0.37 * 1000) > 0.5
    assert found.few_rays.mean() > 0.97  # some squares of the corners lack them, too


@pytest.mark.parametrize(("draw", "mean"), [(even, 14.0), (even, 40.0), (uneven, 2500.0)])
def test_errors_hold(draw: object, mean: float) -> None:
    """Of pixels 1.5 % at most are off by 3 errors: of 20 images of 576, above it by chance below once in 10⁹ times."""
    expected = 0.37 * mean * (1.0 if draw is even else 0.99 + 0.01 * 1000.0)
    z = np.concatenate(
        [((one.value - expected) / one.se)[~one.few_rays] for one in (image(draw, mean, seed) for seed in range(20))]
    )
    assert z.size > 0.5 * 20 * SIZE**2
    assert np.mean(np.abs(z) > 3) < 0.015
    assert 0.6 < np.mean(np.abs(z) < 1) < 0.8


def test_squares_of_pixels_have_the_rays_of_all() -> None:
    found = image(even, 4.0)
    assert found.few_rays.mean() > 0.95
    assert not found.few_in_squares(4).any()


def test_a_trace_counts_its_hits() -> None:
    beam = {"type": "collimated", "radius": 1.0, "irradiance": 2.0 / np.pi}
    detector = square(2.0, 6, z=5.0, bsdf={"type": "interface", "R": 0.25})
    t = mistray.trace(lit(beam, detector=detector), rays=512)
    rays, squares, fourths = t.light.weights
    one = 2.0 * 0.75 / 512 / (4.0 / 6) ** 2  # W/mm² of a ray
    assert rays.sum() == 512
    np.testing.assert_allclose(t.irradiance, rays * one, rtol=1e-6)
    np.testing.assert_allclose(squares, rays * one**2, rtol=1e-6)
    np.testing.assert_allclose(fourths, rays * one**4, rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(t.irradiance_se), rays < 10)
