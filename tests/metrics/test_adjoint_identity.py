"""⟨J v, w⟩ = ⟨v, Jᵀ w⟩ of the detector's image: forward mode of frozen paths against the two walks in reverse."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from frozen_cases import Case, coated_text, scene_text, step, with_values
from oracles.frozen_scene import read_frozen

import mistray
from mistray.optimize import image_metric

TOLERANCE = 1e-4
SEED = 5
SETTINGS = {"rays": 400, "max_reflections": 2, "flux_threshold": 0.0}
KINDS = {
    "curvature": ["L1_front.curvature", "L2_rear.curvature", "L3_rear.curvature"],
    "asphere": ["L1_rear.conic", "L2_front.a4", "L3_front.a8"],
    "position": ["L2_rear.x", "L3_front.z", "L1_front.y", "detector.z", "detector.x"],
    "tilt": ["L1_rear.tilt_x", "L3_rear.tilt_y", "detector.tilt_x"],
    "index": ["L1_front.bsdf.n_back_shift", "L2_rear.bsdf.n_front_shift"],
    "coating": [
        *("L2_front.bsdf.coating.thickness_nm", "L3_rear.bsdf.coating.n_shift", "L3_rear.bsdf.coating.k_shift"),
        "detector.bsdf.R",
    ],
}


@pytest.fixture(scope="module")
def case() -> Case:
    """The triplet, some faces coated, off its axis, on a coarse detector."""
    text = coated_text(scene_text("cooke_triplet"), "L2_front", "L3_rear")
    text = with_values(text, "detector", bsdf_R=0.2)
    emitter = '<emitter type="collimated" id="source"><float name="field_deg" value="5" />'
    text = text.replace('<emitter type="collimated" id="source">', emitter)
    return Case(text, {**SETTINGS, "seed": SEED})


@pytest.fixture(scope="module")
def weights(case: Case) -> np.ndarray:
    """A smooth function over the pixels."""
    shape = mistray.trace(case.scene, **SETTINGS).irradiance.shape
    y, x = (np.linspace(-1, 1, n) for n in shape)
    return np.cos(3 * x)[None, :] * np.exp(y)[:, None]


def inner_products(case: Case, keys: Iterable[str], weights: np.ndarray, **more: Any) -> tuple[float, np.ndarray]:
    """⟨J v, w⟩, and the terms of ⟨v, Jᵀ w⟩ by key."""
    params, frozen = mi.traverse(case.scene), read_frozen(case.text)
    params.keep(list(keys))
    integrator = mi.load_dict({"type": "straylight", "edges": False, **SETTINGS, **more})
    rng = np.random.default_rng(4)
    moves = {key: step(frozen, key) * rng.choice((-1.0, 1.0), dr.width(params[key])) for key in keys}
    try:
        for key, move in moves.items():
            dr.enable_grad(params[key])
            dr.set_grad(params[key], mi.Float(move))
        params.update()
        change = np.array(integrator.render_forward(case.scene, params, 0, SEED), dtype=np.float64)[:, :, 0]
        for key in keys:
            dr.clear_grad(params[key])
        integrator.render_backward(case.scene, params, mi.TensorXf(weights[:, :, None]), 0, SEED)
        terms = [float(move @ np.array(dr.grad(params[key]), dtype=np.float64)) for key, move in moves.items()]
    finally:
        for key in keys:
            dr.disable_grad(params[key])
        params.update()
    return float(np.sum(change * weights)), np.array(terms)


@pytest.mark.parametrize("kind", [*KINDS, "all"])
def test_identity(case: Case, weights: np.ndarray, kind: str) -> None:
    """Relative to the root of the sum of squares of v_i (Jᵀ w)_i, as terms of either sign cancel."""
    keys = KINDS[kind] if kind in KINDS else [key for own in KINDS.values() for key in own]
    forward, terms = inner_products(case, keys, weights)
    scale = np.sqrt(np.sum(terms**2))
    assert abs(forward - terms.sum()) < TOLERANCE * scale
    largest = int(np.argmax(np.abs(terms)))
    wrong = terms.sum() + 1e-3 * terms[largest]  # one derivative that is 0.1 % too large
    assert abs(forward - wrong) > TOLERANCE * scale


def test_render_is_the_gradient(case: Case, weights: np.ndarray) -> None:
    """With the same seed the derivatives of `mi.render` are those of `mistray.gradient`, to float32."""
    keys = [key for own in KINDS.values() for key in own]
    _, terms = inner_products(case, keys, weights)
    flat = mi.Float64(weights.ravel())
    metric = image_metric(case.scene, lambda e: dr.sum(e * flat), **SETTINGS, seed=SEED)
    found = mistray.gradient(metric, mi.traverse(case.scene), keys, edges=False)
    frozen, rng = read_frozen(case.text), np.random.default_rng(4)
    for key, term in zip(keys, terms, strict=True):
        values = found.gradient[key]
        expected = float(step(frozen, key) * rng.choice((-1.0, 1.0), len(values)) @ values)
        assert term == pytest.approx(expected, rel=2e-5, abs=1e-6 * np.abs(terms).max()), key
