"""HEALPix by what defines it: equal areas, rings from north to south, four parts in a row, known centres."""

import numpy as np
import pytest

from mistray.physics.geometry.healpix import pixel, sides

pytestmark = pytest.mark.quick


def fine(count: int = 200_000) -> np.ndarray:
    """Directions that cover the sphere evenly: a Fibonacci lattice."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)


def test_rings_go_south() -> None:
    """The mean of cos θ falls from ring to ring: 4, 8, …, 4 N pixels, then 4 N in each of the belt."""
    side = 8
    d = fine()
    number = pixel(side, d, False)
    z = np.bincount(number, d[:, 2]) / np.bincount(number)
    rings = np.split(z, np.cumsum([4 * min(k, side, 4 * side - k) for k in range(1, 4 * side)])[:-1])
    assert max(float(np.ptp(ring)) for ring in rings) < 0.01
    assert np.all(np.diff([ring.mean() for ring in rings]) < 0)


@pytest.mark.parametrize("side", [1, 2, 4, 8, 16])
def test_equal_areas_and_nested_parts(side: int) -> None:
    """Of an even cover each pixel has as many points but for those along its rim; both numbers are of one pixel."""
    d = fine()
    ring, nested = (pixel(side, d, which) for which in (False, True))
    each = len(d) / (12 * side * side)
    for numbers in (ring, nested):
        count = np.bincount(numbers)
        assert len(count) == 12 * side * side
        assert np.max(np.abs(count - each)) < 3 * np.sqrt(each)
    assert np.array_equal(pixel(2 * side, d, True) // 4, nested)
    assert len(np.unique(12 * side**2 * ring + nested)) == 12 * side * side


def test_the_twelve_faces() -> None:
    """Centres at cos θ = 2/3, 0, -2/3 and azimuths of 45°, 0°, 45° plus quarters of a turn."""
    turn = np.radians([45, 135, 225, 315, 0, 90, 180, 270, 45, 135, 225, 315])
    z = np.repeat([2 / 3, 0, -2 / 3], 4)
    d = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    for nested in (False, True):
        assert pixel(1, d, nested).tolist() == list(range(12))
    assert (sides(12), sides(48), sides(3072), sides(13), sides(0)) == (1, 2, 16, 0, 0)
