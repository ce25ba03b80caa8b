"""The whole derivative of a detected power, what rims cut included, against differences of full traces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.metrics.scene_values import changed
from mistray.optimize import path_power
from mistray.recorders.sampled import batch_error
from mistray.settings import BATCHES

LIMIT = 3.0  # combined standard errors: a false alarm of 0.3 % a comparison, 2 % for all eight; seeds are fixed
FIELD_DEG = 6.0
TRACED = {"max_reflections": 0, "seed": 11}
RAYS, RETRACED = 200_000, 400_000
FRONT_GROUP = ("L1_front", "L1_rear", "L2_front", "L2_L3", "L3_rear")
# Directions: keys that move together, the step of the difference, mm or 1/mm; the power curves by less than its noise
DIRECTIONS = {
    "stop radius": (("stop_front.r1",), 0.04),
    "stop position": (("stop_front.z",), 0.15),
    "curvature": (("L1_front.curvature",), 1.5e-4),
    "distance of the front group": (tuple(f"{name}.z" for name in FRONT_GROUP), 0.15),
}
KEYS = tuple(dict.fromkeys(key for keys, _ in DIRECTIONS.values() for key in keys))


@pytest.fixture(scope="module")
def scene() -> Any:
    return mistray.load("double_gauss")


def by_batch(scene: Any) -> np.ndarray:
    """Detected power over the launched one, by batch of start rays."""
    trace = mistray.trace(scene, rays=RETRACED, field_deg=FIELD_DEG, **TRACED)
    only_power = np.tile([1.0, 0.0, 0.0, 0.0], (len(trace.paths), 1))
    return trace.paths.by_batch(only_power) / trace.energy.launched_W


@pytest.fixture(scope="module")
def differences(scene: Any) -> dict[str, tuple[float, float]]:
    """Name of a direction → difference of traces over twice the step, and its standard error."""
    found, params = {}, mi.traverse(scene)
    for name, (keys, step) in DIRECTIONS.items():
        powers, places = [], []
        for sign in (1, -1):
            with changed(params, {key: np.array([float(params[key][0]) + sign * step]) for key in keys}):
                powers.append(by_batch(scene))
                places.append(float(params[keys[0]][0]))
        slopes = (powers[0] - powers[1]) / (places[0] - places[1])
        found[name] = float(slopes.sum()), float(batch_error(slopes, np.ones(BATCHES)))
    return found


def along(gradient: mistray.optimize.Gradient, keys: tuple[str, ...]) -> tuple[float, float]:
    """Sum of derivatives by some keys and its standard error."""
    batches = sum(gradient.batches[key][:, 0] for key in keys)
    return float(batches.sum()), float(batch_error(batches, np.ones(BATCHES)))


def off(gradient: mistray.optimize.Gradient, differences: dict[str, tuple[float, float]]) -> dict[str, float]:
    """Direction → distance in combined standard errors."""
    found = {}
    for name, (keys, _) in DIRECTIONS.items():
        (value, error), (expected, noise) = along(gradient, keys), differences[name]
        found[name] = (value - expected) / np.hypot(error, noise)
    return found


@pytest.mark.long
@pytest.mark.parametrize("edge_width", [0.1, 0.05])
def test_geometry_and_edges(scene: Any, differences: dict[str, tuple[float, float]], edge_width: float) -> None:
    metric = path_power(scene, "all", rays=RAYS, field_deg=FIELD_DEG, **TRACED)
    gradient = mistray.gradient(metric, mi.traverse(scene), keys=KEYS, edge_width=edge_width)
    away = off(gradient, differences)
    assert all(abs(z) < LIMIT for z in away.values()), away
    wrong = replace(gradient, batches={key: 1.5 * batches for key, batches in gradient.batches.items()})
    assert all(abs(z) > LIMIT for z in off(wrong, differences).values())
    for name, (keys, _) in DIRECTIONS.items():  # both sides know their numbers well enough to say something
        assert np.hypot(along(gradient, keys)[1], differences[name][1]) < 0.15 * abs(differences[name][0]), name
    if edge_width == 0.1:  # with visibility held it is another derivative
        metric = path_power(scene, "all", rays=RAYS // 10, field_deg=FIELD_DEG, **TRACED)
        gradient = mistray.gradient(metric, mi.traverse(scene), keys=KEYS, edges=False)
        assert gradient.gradient["stop_front.r1"][0] == 0
        assert all(abs(z) > 2 * LIMIT for z in off(gradient, differences).values())
