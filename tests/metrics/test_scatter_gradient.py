"""Coating gradients of scattered light, against central differences; with common random numbers where they can be."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import scene_text, shape_xml
from oracles.statistics import z_limit, z_score

import mistray
from mistray.metrics.scene_values import changed
from mistray.optimize import gradient, path_power

BOTH = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8)
THROUGH = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8, event="transmission")
BACK = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8, event="reflection")
DUST = bsdf_xml("particulate", level=500.0)
PAINT = bsdf_xml("paint", reflectance=0.05, b0=0.3, l=0.1, s=-2.0)


def scene_of(*models: str, detector: str | None = None) -> str:
    """A coated window that scatters, and a detector that may scatter, too."""
    return scene_text(
        shape_xml("asphere", "front", 0.0, scattering_xml(models, "air", "1.5", R=0.1, T=0.8), semi_diameter=50.0),
        shape_xml("asphere", "rear", 5.0, scattering_xml(models, "1.5", "air", R=0.15, T=0.7), semi_diameter=50.0),
        shape_xml("asphere", "detector", 60.0, detector, sensor=True, half_width=10.0, half_height=10.0),
    )


CASES = {
    "transmission": ((THROUGH,), None),
    "reflection": ((BACK,), None),
    "a detector that scatters": ((THROUGH,), scattering_xml((PAINT,), R=0.2)),
}
SETTINGS = {"rays": 4096, "max_reflections": 2, "flux_threshold": 0.0, "scatter_threshold": 0.0, "aim": "auto"}


def scattered_power(scene: mi.Scene):
    return path_power(scene, lambda row: row.scatters > 0, **SETTINGS)


def central_difference(scene: mi.Scene, key: str, step: float = 2e-3) -> float:
    params, values = mi.traverse(scene), []
    start = float(params[key][0])
    for sign in (1, -1):
        with changed(params, {key: np.array([start + sign * step])}):
            trace = mistray.trace(scene, **SETTINGS)
        values.append(sum(row.power_W for row in trace.paths if row.scatters) / trace.energy.launched_W)
    return (values[0] - values[1]) / (2 * step)


@pytest.mark.parametrize("case", CASES)
def test_against_central_differences(load_scene, case: str) -> None:
    models, detector = CASES[case]
    scene = load_scene(scene_of(*models, detector=detector))
    keys = [f"{part}.bsdf.{what}" for part in ("front", "rear") for what in "RT"]
    keys += ["detector.bsdf.R"] if detector else []
    found = gradient(scattered_power(scene), mi.traverse(scene), keys)  # coatings alone: the walk in reverse
    largest = max(abs(found.gradient[key][0]) for key in keys)
    for key in keys:
        expected = central_difference(scene, key)
        assert found.gradient[key][0] == pytest.approx(expected, rel=1e-3, abs=1e-4 * largest), key


@pytest.mark.long
@pytest.mark.parametrize(("model", "key"), [(BOTH, "front.bsdf.T"), (BOTH, "rear.bsdf.R"), (DUST, "rear.bsdf.R")])
def test_where_choices_depend_on_the_coating(load_scene, model: str, key: str) -> None:
    """Particles scatter by T, 2 R and 1 + R²; false alarm 1e-3 for the three cases."""
    scene = load_scene(scene_of(model))
    settings = {**SETTINGS, "rays": 200_000}
    found = gradient(path_power(scene, lambda row: row.scatters > 0, **settings), mi.traverse(scene), [key])
    start, step, powers = float(mi.traverse(scene)[key][0]), 0.04, []
    for seed, sign in ((1, 1), (2, -1)):
        with changed(mi.traverse(scene), {key: np.array([start + sign * step])}):
            trace = mistray.trace(scene, **settings, seed=seed)
        power = trace.paths.power([row.path_id for row in trace.paths if row.scatters])
        powers.append([value / trace.energy.launched_W for value in power])
    expected = (powers[0][0] - powers[1][0]) / (2 * step)
    se = np.hypot(np.hypot(powers[0][1], powers[1][1]) / (2 * step), found.standard_error[key][0])
    assert se < 0.1 * abs(expected) + 0.02 * powers[0][0]
    assert abs(z_score(found.gradient[key][0], expected, se)) < z_limit(3)
