"""Start rays spread evenly over a source: ratios of variances of 60 runs, false alarm 6e-5 each."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import scene_text, shape_xml, write

import mistray
from mistray.recorders.start_rays import generators
from mistray.sampling.space_filling import stratified_points

BEAM, DISC, APART = 5.0, 3.0, 4.0  # radii and distance of the axes, mm
SEEDS = 60


def overlap(a: float, b: float, d: float) -> float:
    u, v = (d * d + a * a - b * b) / (2 * d * a), (d * d + b * b - a * a) / (2 * d * b)
    triangle = 0.5 * np.sqrt((a + b - d) * (d + a - b) * (d - a + b) * (d + a + b))
    return float(a * a * np.arccos(u) + b * b * np.arccos(v) - triangle)


@pytest.mark.long
def test_a_clipped_beam(tmp_path: Path) -> None:
    """The closed form within the errors, which are those of the spread and fall faster than with random rays."""
    disc = shape_xml("asphere", "detector", 10.0, sensor=True, semi_diameter=DISC)
    beside = disc.replace("<translate", f'<translate y="{APART}"/><translate', 1)
    scene = mistray.load(write(tmp_path, scene_text(beside, radius=BEAM)))
    exact, errors = overlap(BEAM, DISC, APART), []
    for rays in (1 << 12, 1 << 18):
        found = [mistray.trace(scene, rays=rays, seed=seed).energy for seed in range(SEEDS)]
        power, se = np.array([(e.detected_W, e.detected_se_W) for e in found]).T
        assert abs(power.mean() - exact) < 4 * power.std(ddof=1) / np.sqrt(SEEDS)
        assert np.abs(power - exact).max() < 5 * se.max()
        mean_square = np.mean(se**2)
        assert 0.24 < power.var(ddof=1) / mean_square < 1.76
        errors.append(np.sqrt(mean_square))
    assert errors[0] / errors[1] > 64**0.65  # random rays: 64^0.5; what an edge cuts in two: 64^0.75
    share = exact / (np.pi * BEAM**2)
    assert errors[1] < 0.2 * np.pi * BEAM**2 * np.sqrt(share * (1 - share) / (1 << 18))


def test_groups_of_any_size() -> None:
    """One point in each of as many equal parts of the curve: cells of a grid of 4^k hold as many points each."""
    sizes = np.array([64, 1, 16, 4])
    group = mi.UInt32(np.repeat(np.arange(4), sizes).astype(np.uint32))
    rng, _ = generators(3, dr.arange(mi.UInt32, int(sizes.sum())))
    x, y = (np.array(v) for v in stratified_points(group, rng))
    for number, size in enumerate(sizes):
        here = np.array(group) == number
        side = round(np.sqrt(size))
        cells = (x[here] * side).astype(int) * side + (y[here] * side).astype(int)
        assert sorted(cells) == list(range(size))
