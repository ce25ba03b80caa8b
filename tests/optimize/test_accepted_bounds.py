"""Ends of ranges that the model of a scene refuses for the sake of its other numbers."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.optimize.parameters import parameters
from mistray.optimize.tolerances.changes import Ranges
from mistray.optimize.tolerances.rows import LineNumbers, lines_of


@pytest.mark.quick
def test_a_range_ends_before_what_its_model_refuses() -> None:
    """A paint without a glossy lobe refuses the reflectance 0, and with it one at which it scatters more than all."""
    at = mi.ScalarTransform4f().translate
    paint = {"type": "paint", "id": "black_paint", "reflectance": 0.04}
    glossy = {"type": "paint", "id": "glossy", "reflectance": 0.04, "b0": 0.5}
    scene = mistray.load(
        {
            "type": "scene",
            "beam": {"type": "collimated", "radius": 1.0},
            "wall": {"type": "asphere", "semi_diameter": 5.0, "bsdf": {"type": "interface", "R": 0.0, "p": paint}},
            "other": {"type": "asphere", "semi_diameter": 5.0, "to_world": at([0, 0, 5]),
                      "bsdf": {"type": "interface", "R": 0.0, "p": glossy}},
            "detector": {"type": "asphere", "semi_diameter": 5.0, "to_world": at([0, 0, -5]),
                         "bsdf": {"type": "interface", "R": 0.0}, "sensor": {"type": "irradiancemeter"}},
        }
    )  # fmt: skip
    params = mi.traverse(scene)
    known = parameters(scene, params)
    keys = [key for key in known if key.endswith("reflectance")]
    lines = lines_of(scene, params, known, keys)
    value = np.array([float(np.ravel(line.parameter.value)[line.entry]) for line in lines])
    ones = np.ones(len(lines))
    ranges = Ranges(value, 0 * ones, ones, ones, ones, ones)
    table = LineNumbers(lines, ranges, ones, ones, ones, ones, ones[None])
    found = table.accepted(params, ranges, lambda: None)
    ends = {line.parameter.key: (found.low[k], found.high[k]) for k, line in enumerate(lines)}
    assert len(ends) == 2
    low, high = ends[next(key for key in ends if "black_paint" in key or key.startswith("wall"))]
    assert (low, high) == (pytest.approx(0.001 * 0.04), 1.0)
    low, high = ends[next(key for key in ends if "glossy" in key or key.startswith("other"))]
    assert low == 0.0
    assert 0.04 < high < 1.0
    np.testing.assert_allclose([float(np.ravel(params[key])[0]) for key in keys], 0.04, rtol=1e-6)
