"""The worked example of the phone camera's coatings, reduced: two fields, three layers, few rays."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from example_scripts import script

from mistray.analyses.optimize.reflectance_weights import reflectance_weights
from mistray.coatings import preset
from mistray.scene.recoat import SharedCoating

RAYS = 320
# With 31 degrees of freedom a false pass of a gain that is not there has a probability of 4.5e-5; the seeds are fixed
ERRORS = 4.5


@pytest.fixture(scope="module", name="script")
def reduced() -> Any:
    """The example for two fields, with few rays and one round."""
    module = script("phone_camera_ar")
    module.FIELDS_DEG, module.SEARCH_NM, module.SEARCH_RAYS = (0, 10), (470, 550, 630), 96
    module.BAND_NM, module.ROUNDS = (450, 510, 590, 650), 1
    return module


@pytest.fixture(scope="module")
def found(script: Any) -> Any:
    """The three-layer preset on all surfaces, the same made a quarter too thick, and the design for each glass."""
    given = preset("bbar3")
    thick = tuple(dataclasses.replace(layer, thickness_nm=1.25 * layer.thickness_nm) for layer in given.layers)
    start = [SharedCoating("AR", given, script.SURFACES)]
    wrong = [SharedCoating("AR", dataclasses.replace(given, layers=thick), script.SURFACES)]
    known = reflectance_weights(script.ghost_metric(start, script.SEARCH_NM, script.SEARCH_RAYS))
    designed = script.search(script.GLASSES, script.STARTS[3], known)
    return [
        script.measured("bbar3", 3, start, RAYS),
        script.measured("glass", 3, designed, RAYS),
        script.measured("surface", 3, wrong, RAYS),  # stands for a design that is none
    ]


@pytest.mark.long
def test_better_than_the_preset_with_as_many_layers(script, found):
    textbook, designed, wrong = found
    assert [len(coating.stack.layers) for coating in designed.coatings] == [3] * len(script.GLASSES)
    thickness = [layer.thickness_nm for coating in designed.coatings for layer in coating.stack.layers]
    assert script.LOW_NM <= min(thickness) <= max(thickness) <= script.HIGH_NM

    def at_least_as_good(design: Any) -> bool:
        gain, gain_se = design.gain(script.rival(design, found))
        return bool(gain - ERRORS * gain_se >= 1)

    assert at_least_as_good(designed)
    assert not at_least_as_good(wrong)
    assert script.rival(designed, found) is textbook
    rows = script.table(found).set_index("design")
    assert rows.loc["glass", "preset"] == "bbar3"
    assert np.isnan(rows.loc["bbar3", "gain"])
    assert len(script.curve_figure(found).axes) == 1
    curves = script.reflectance_figure(found[:2]).axes
    assert [len(axes.lines) for axes in curves] == [2] * len(script.GLASSES)


@pytest.mark.long
def test_errors_of_gains(script):
    """Powers that differ by noise of known size: the error of a gain is that of the part that they do not share."""
    rng = np.random.default_rng(4)
    common = 1 + 0.5 * rng.standard_normal((8, 32))
    above = 2 * common + 0.01 * rng.standard_normal((8, 32))
    gain, gain_se = script.Design("glass", 1, (), common).gain(script.Design("bbar3", 3, (), above))
    assert abs(gain - 2) < 5 * gain_se
    # sqrt(256) · 0.01 over a sum of 256 numbers about 1; with 248 degrees of freedom the estimate is known to 4.5 %
    assert gain_se == pytest.approx(16 * 0.01 / common.sum(), rel=0.2)
