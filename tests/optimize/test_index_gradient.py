"""The index of a coated glass, for refraction and for R and T of its layers, against re-traced differences."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from oracles.scatter_scenes import scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml

from mistray.optimize import path_power
from mistray.optimize.gradient import gradient
from mistray.optimize.parameters import groups, parameters
from mistray.optimize.scene_values import changed

pytestmark = pytest.mark.quick

TOLERANCE = 1e-3  # of the issue, on frozen paths


FILM = '<bsdf type="thinfilm"><string name="layers" value="1.38 100, 2.1 60, 1.63 70"/></bsdf>'


@pytest.fixture(scope="module")
def scene(load_scene) -> mi.Scene:
    """A coated lens, wide enough that no ray meets a rim; ghosts come from R of both coatings."""
    front, rear = (scattering_xml([FILM], *sides) for sides in (("air", "1.6"), ("1.6", "air")))
    return load_scene(
        scene_text(
            shape_xml("asphere", "front", 0.0, front, radius=40.0, semi_diameter=8.0),
            shape_xml("asphere", "rear", 4.0, rear, radius=-60.0, semi_diameter=8.0),
            shape_xml("asphere", "detector", 20.0, interface_xml(R=0.2), sensor=True, semi_diameter=30.0),
            radius=3.0,
            field_deg=12.0,
        )
    )


@pytest.mark.parametrize("selection", ["ghost", "direct"])
def test_coated_glass(scene: mi.Scene, selection: str) -> None:
    params = mi.traverse(scene)
    metric = path_power(scene, selection, rays=1000, wavelength_nm=550.0)
    keys = groups(parameters(scene))["1.6.index"]
    assert keys == ["front.bsdf.n_back_shift", "rear.bsdf.n_front_shift"]
    found = sum(gradient(metric, params, keys, edges=False).gradient[key][0] for key in keys)
    values, step = [], 2.0**-9
    for shift in (-step, step):
        with changed(params, {key: np.array([shift]) for key in keys}):
            values.append(metric.value())
    expected = (values[1] - values[0]) / (2 * step)
    assert found == pytest.approx(expected, rel=TOLERANCE)
    assert found * (1 + 2 * TOLERANCE) != pytest.approx(expected, rel=TOLERANCE)
    assert np.sign(found) == (1 if selection == "ghost" else -1)  # more contrast, more reflection
