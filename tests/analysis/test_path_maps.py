"""Maps in cells: nothing is lost, and a rectangle on the grid holds what the pixels in it hold."""

from __future__ import annotations

import numpy as np
import pytest

from mistray.analysis.maps.path_maps import FieldMaps, PathMap


def spot(shape: tuple[int, int], rows: slice, columns: slice) -> np.ndarray:
    """A map of random powers in a rectangle, dark elsewhere."""
    power = np.zeros(shape)
    power[rows, columns] = 0.1 + np.random.default_rng(3).random(power[rows, columns].shape)
    return power


@pytest.mark.parametrize(
    ("shape", "rows", "columns", "pixels"),
    [
        ((512, 512), slice(200, 230), slice(7, 90), 1),  # 83 columns: full resolution
        ((512, 512), slice(0, 97), slice(0, 96), 2),
        ((512, 512), slice(0, 512), slice(0, 512), 8),  # 512/96 = 5.3
        ((500, 300), slice(1, 499), slice(0, 300), 8),  # cells reach beyond the edge
        ((60, 80), slice(59, 60), slice(79, 80), 1),
    ],
)
def test_cells_are_as_small_as_they_may_be(shape, rows, columns, pixels):
    power = spot(shape, rows, columns)
    found = PathMap.of(power, 96)
    assert found.pixels == pixels
    assert max(found.power_W.shape) <= 96
    assert found.power_W.sum() == pytest.approx(power.sum(), rel=1e-13)
    assert found.row * pixels <= rows.start < (found.row + 1) * pixels
    assert found.column * pixels <= columns.start < (found.column + 1) * pixels


def test_edges():
    """97 pixels from an odd one on touch 49 cells of two, one too many; darkness has none; a grid has the largest."""
    assert PathMap.of(spot((512, 512), slice(1, 98), slice(0, 1)), 48).pixels == 4
    dark = PathMap.of(np.zeros((5, 6)), 96)
    assert (dark.pixels, dark.power_W.shape, dark.within((0, 6), (0, 5))) == (1, (0, 0), 0)
    small, large = PathMap.of(spot((512, 512), slice(3, 5), slice(3, 5)), 96), PathMap.of(np.ones((512, 512)), 96)
    assert FieldMaps(large, large, {0: small}, small, {}).grid == 1
    assert FieldMaps(small, small, {0: small, 1: large}, small, {}).grid == 8


def test_power_in_a_rectangle_is_that_of_its_pixels():
    rng = np.random.default_rng(5)
    power = spot((500, 300), slice(30, 480), slice(11, 270))
    found = PathMap.of(power, 64)
    assert found.pixels == 8
    for _ in range(50):
        c0, c1 = sorted(rng.choice(np.arange(0, 305, 8), 2, replace=False))
        r0, r1 = sorted(rng.choice(np.arange(0, 505, 8), 2, replace=False))
        expected = power[r0:r1, c0:c1].sum()
        assert found.within((c0, c1), (r0, r1)) == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert found.within((c0, c1), (r0, r1 + 8)) != found.within((c0, c1), (r0, r1))  # a wrong box shows
