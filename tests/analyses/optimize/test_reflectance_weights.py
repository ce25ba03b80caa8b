"""Derivatives by reflectances, against those by thicknesses, and designs that are found with them on the host."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.analyses.optimize.reflectance_weights import best_thicknesses, reflectance_weights
from mistray.coatings import preset
from mistray.errors import MistrayError
from mistray.optimize import path_power
from mistray.scene.load import find
from mistray.scene.recoat import SharedCoating, write_recoated

GROUPS = {"crown": ("L1_front", "L1_rear", "L3_front", "L3_rear"), "flint": ("L2_front", "L2_rear")}
STACK = preset("bbar3")
THICKNESS_NM = np.array([layer.thickness_nm for layer in STACK.layers])
TOLERANCE = 1e-2  # R between the cosines is interpolated: its slope by a thickness is wrong by h²/8 R''
STEP_NM = 0.01


@pytest.fixture(scope="module")
def metric(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Ghost power of the Cooke triplet with a preset on all surfaces."""
    coatings = [SharedCoating(name, STACK, surfaces) for name, surfaces in GROUPS.items()]
    file = write_recoated(find("cooke_triplet"), coatings, tmp_path_factory.mktemp("scene") / "scene.xml")
    scene = mistray.load(file)
    return path_power(scene, "ghost", field_deg=(0, 15), wavelength_nm=(480, 600), rays=256, flux_threshold=0)


@pytest.fixture(scope="module")
def weights(metric: Any) -> Any:
    return reflectance_weights(metric)


def by_thickness(cost: Any) -> np.ndarray:
    """Central differences of a cost by the thicknesses of the preset."""
    steps = STEP_NM * np.eye(len(THICKNESS_NM))
    return np.array((cost(THICKNESS_NM + steps) - cost(THICKNESS_NM - steps)) / (2 * STEP_NM))


def test_chain_rule_gives_the_gradient_by_thicknesses(metric, weights):
    params = mi.traverse(metric.scene)
    expected = mistray.gradient(metric, params, ["crown.thickness_nm", "flint.thickness_nm"])
    assert weights.value == pytest.approx(expected.value, rel=1e-9)
    for name, surfaces in GROUPS.items():
        slopes = expected.gradient[f"{name}.thickness_nm"]
        found = by_thickness(weights.cost(surfaces, STACK))
        assert np.max(np.abs(found - slopes)) < TOLERANCE * np.max(np.abs(slopes)), name
        other = by_thickness(weights.cost(GROUPS["flint" if name == "crown" else "crown"], STACK))
        assert np.max(np.abs(other - slopes)) > TOLERANCE * np.max(np.abs(slopes)), "the other glass is wrong"


def test_surfaces_add_up(weights):
    cost = weights.cost(GROUPS["crown"], STACK)(THICKNESS_NM[None])
    single = [weights.cost([surface], STACK)(THICKNESS_NM[None]) for surface in GROUPS["crown"]]
    assert sum(single) == pytest.approx(cost, rel=1e-12)
    with pytest.raises(MistrayError, match="surface 'L9_front' has no layers"):
        weights.cost(["L9_front"], STACK)
    bare = path_power(mistray.load("cooke_triplet"), "ghost", rays=64, flux_threshold=0)
    with pytest.raises(MistrayError, match="no surface that the light meets has layers"):
        reflectance_weights(bare)


def test_the_deepest_minimum_is_found():
    """A function with many minima, known in closed form: the sum of (d/20)² and of 1 - cos(d), about 100 nm."""

    def cost(d: np.ndarray) -> np.ndarray:
        return np.array(np.sum(((d - 100) / 20) ** 2 + 1 - np.cos(d - 100), axis=1) + 0.1)

    found = best_thicknesses(cost, [5, 5], [260, 260], [np.array([40.0, 200.0]), np.array([101.0, 99.0])])
    assert found == pytest.approx([100, 100], abs=0.01)
    bound = best_thicknesses(cost, [110, 5], [260, 260], [])
    assert bound[0] >= 110
