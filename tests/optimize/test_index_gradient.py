"""The index of a coated glass, for refraction and for R and T of its layers, against re-traced differences."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.optimize import path_power
from mistray.optimize.gradient import gradient
from mistray.optimize.parameters import groups, parameters

pytestmark = pytest.mark.quick

TOLERANCE = 1e-3  # of the issue, on frozen paths


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    """A coated lens, wide enough that no ray meets a rim; ghosts come from R of both coatings."""
    place = mi.ScalarTransform4d()
    film = {"type": "thinfilm", "layers": "1.38 100, 2.1 60, 1.63 70"}
    return mistray.load(
        {
            "type": "scene",
            "beam": {"type": "collimated", "radius": 3.0, "field_deg": 12.0},
            "front": {
                "type": "asphere", "radius": 40.0, "semi_diameter": 8.0,
                "bsdf": {"type": "interface", "back": "1.6", "coating": film},
            },
            "rear": {
                "type": "asphere", "radius": -60.0, "semi_diameter": 8.0, "to_world": place.translate([0, 0, 4]),
                "bsdf": {"type": "interface", "front": "1.6", "coating": film},
            },
            "detector": {
                "type": "asphere", "semi_diameter": 30.0, "to_world": place.translate([0, 0, 20]),
                "bsdf": {"type": "interface", "R": 0.2},
                "meter": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
            },
        }
    )  # fmt: skip


@pytest.mark.parametrize("selection", ["ghost", "direct"])
def test_coated_glass(scene: mi.Scene, selection: str) -> None:
    params = mi.traverse(scene)
    metric = path_power(scene, selection, rays=1000, wavelength_nm=550.0)
    keys = groups(parameters(scene))["1.6.index"]
    assert keys == ["front.bsdf.n_back_shift", "rear.bsdf.n_front_shift"]
    found = sum(gradient(metric, params, keys, edges=False).gradient[key][0] for key in keys)
    values, step = [], 2.0**-9
    for shift in (-step, step):
        for key in keys:
            params[key] = mi.Float(shift)
        params.update()
        values.append(metric.value())
    for key in keys:
        params[key] = mi.Float(0.0)
    params.update()
    expected = (values[1] - values[0]) / (2 * step)
    assert found == pytest.approx(expected, rel=TOLERANCE)
    assert found * (1 + 2 * TOLERANCE) != pytest.approx(expected, rel=TOLERANCE)
    assert np.sign(found) == (1 if selection == "ghost" else -1)  # more contrast, more reflection
