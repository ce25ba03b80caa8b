"""Statistics block, log10 images and the mirror test of irradiance maps."""

import numpy as np
import pytest

from mistray.analysis.irradiance import log10_image, log_range, mirror_asymmetry, pixel_size, statistics
from mistray.errors import MistrayError

EXTENT = (-2.0, 2.0, -1.5, 1.5)


@pytest.fixture
def noisy():
    counts = np.random.default_rng(3).poisson(50, (60, 80)).astype(float)
    return counts, np.sqrt(counts)


def test_statistics_are_those_of_numpy(noisy):
    image, se = noisy
    got = statistics(image, se, EXTENT, incident_rays=1234)
    assert (got.minimum, got.maximum, got.mean) == (image.min(), image.max(), image.mean())
    assert got.rms == pytest.approx(np.linalg.norm(image) / np.sqrt(image.size), rel=1e-12)
    assert got.flux_W == pytest.approx(image.sum() * 0.05**2, rel=1e-12)
    assert got.maximum_se == se.flat[np.argmax(image)]
    assert got.incident_rays == 1234
    assert pixel_size(np.zeros((3, 8)), EXTENT) == (0.5, 1.0)


def test_log_range_spans_all_maps_within_the_decades():
    assert log_range([np.array([[2e-4, 3e-2]]), np.array([[0.0, 50.0]])], decades=12) == (-4.0, 2.0)
    assert log_range([np.array([[1e-15, 50.0]])], decades=12) == (-10.0, 2.0)
    assert log_range([np.array([[1.0, 1.0]])]) == (-1.0, 0.0)
    assert log_range([np.zeros((2, 2))]) is None
    assert log_range([]) is None
    # An image hides what is below the floor
    image = log10_image(np.array([[0.0, 1e-9], [1e-3, 100.0]]), floor=1e-6)
    assert np.isnan(image[0]).all()
    np.testing.assert_allclose(image[1], [-3.0, 2.0], rtol=1e-15)
    with pytest.raises(MistrayError, match="floor is 0 W/mm²"):
        log10_image(np.ones((2, 2)), 0.0)


def test_asymmetry_of_noise_is_the_expected_one(noisy):
    measured, expected = mirror_asymmetry(*noisy)
    # 2400 independent pairs: the mean of |N| has a relative error of 0.76/sqrt(2400) = 1.5 %
    assert measured == pytest.approx(expected, rel=4 * 0.0155)
    noisy[0][:, :40] *= 1.5  # lopsided
    measured, expected = mirror_asymmetry(*noisy)
    assert measured > 1.5 * expected
    assert np.isnan(mirror_asymmetry(np.zeros((2, 2)), np.zeros((2, 2)))).all()

    for width in (4, 5):  # a symmetric map
        row = np.minimum(np.arange(width), np.arange(width)[::-1]) + 1.0
        measured, expected = mirror_asymmetry(np.tile(row, (3, 1)), np.ones((3, width)))
        assert measured == 0
        assert expected == pytest.approx(2 / np.sqrt(np.pi) * (width - width % 2) / (2 * row.sum()))
