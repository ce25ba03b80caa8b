"""Values of the scatter plugins: against float64, both ways round, and their derivatives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scatter_surfaces import (
    BACK,
    EVENTS,
    FRONT,
    IMPORTANCE,
    MODELS,
    RADIANCE,
    R,
    T,
    context,
    direction,
    interaction,
    surface,
    vectors,
    write_table,
)

from mistray import MistrayError
from mistray.scatter.evaluate import bsdf as float64_bsdf

CASES = [(0.0, True), (30.0, True), (80.0, True), (30.0, False)]
# float32 in a power law that spans 13 decades; of the ratio tables, the distance of their nodes
ACCURACY = {
    "paint": 2e-2, "particulate": 1e-3, "k_correlation": 2e-3, "psd_table": 2e-3, "polynomial": 5e-3, "tabulated": 1e-3,
    "ghs_full": 2e-2, "rayleigh_rice_vector": 2e-2,
}  # fmt: skip
# Directions that may deviate by more: Mie's ripple far behind, and the rim of what refraction can reach, are finer than
# the table
EXCEPTIONS = {"particulate": 0.05}
OTHER = {"type": "k_correlation", "rms_nm": 5.0, "B_um": 20.0, "slope": 3.0}
THEORIES: dict[str, dict[str, Any]] = {
    **{theory: OTHER | {"theory": theory} for theory in ("ghs_full", "rayleigh_rice_vector")},
    "rough": OTHER | {"theory": "ghs_full", "rms_nm": 20.0},
}
NOT_RECIPROCAL = {"particulate"}


def hemisphere(count: int, side: float, seed: int) -> np.ndarray:
    """Directions uniform in the projected solid angle, not next to the horizon."""
    rng = np.random.default_rng(seed)
    sine, phi = np.sqrt(0.98 * rng.random(count)), 2 * np.pi * rng.random(count)
    made = np.stack([sine * np.cos(phi), sine * np.sin(phi), side * np.sqrt(1 - sine**2)], axis=-1)
    return made.astype(np.float32).astype(float)


def host(bsdf: Any, wi: np.ndarray, wo: np.ndarray, event: str) -> np.ndarray:
    """BSDF · cos θo of the first model in float64; x lies along the light's tangential part."""
    front = wi[2] < 0
    n_in, n_out = (FRONT, BACK) if front else (BACK, FRONT)
    along = -wi[:2] / max(np.hypot(*wi[:2]), 1e-12) if np.hypot(*wi[:2]) > 1e-9 else np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    turned = np.stack([wo[:, :2] @ along, wo[:, :2] @ across, np.abs(wo[:, 2])], axis=-1)
    lobes = bsdf.scatter[0].lobes(550.0, n_in, n_out, front)
    share = R if event == "reflection" else T
    return float64_bsdf(lobes, event, abs(wi[2]), turned, n_in, n_out, share) * turned[:, 2]


def value(bsdf: Any, wi: np.ndarray, wo: np.ndarray, mode: Any = IMPORTANCE) -> np.ndarray:
    return np.array(bsdf.eval(context(mode), interaction(wi, len(wo)), vectors(wo)), dtype=float)[0]


@pytest.mark.parametrize("name", [*MODELS, "tabulated", "ghs_full", "rayleigh_rice_vector"])
@pytest.mark.parametrize("event", EVENTS)
def test_eval_is_the_model(name: str, event: str, tmp_path: Path) -> None:
    """Closed forms on the device against the lobes in float64, R = 0.2 and T = 0.4."""
    model = (MODELS | THEORIES).get(name) or write_table(tmp_path)
    bsdf, lit = surface(model), False
    for angle, front in CASES if name not in THEORIES else [(0.0, True), (30.0, True), (60.0, True)]:
        wi = direction(angle, front)
        side = np.sign(wi[2]) * (1 if event == "reflection" else -1)
        wo = hemisphere(400, side, 5)
        expected = host(bsdf, wi, wo, event)
        lit = lit or bool(np.any(expected > 0))
        # A Gaussian falls to 1e-170; tables of ratios are good to the distance of their nodes
        floor = (1e-3 if name in THEORIES else 1e-6) * np.max(expected, initial=0)
        wrong = np.abs(value(bsdf, wi, wo) - expected) > ACCURACY.get(name, 2e-5) * expected + floor
        assert np.mean(wrong) <= EXCEPTIONS.get(name, 0.0), f"{np.sum(wrong)} of 400 directions at {angle}°"
    assert lit == (model.get("event", "both") in ("both", event))


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_radiance_is_adjoint_to_importance(name: str) -> None:
    """What an eye at wi sees of light from wo is what light from wo sends to wi, per projected solid angle."""
    bsdf = surface(MODELS[name])
    for a in hemisphere(8, -1.0, 11):
        for b in (*hemisphere(8, -1.0, 12), *hemisphere(8, 1.0, 13)):
            for wi, wo in ((a, b), (b, a)):
                seen = value(bsdf, wi, wo[None], RADIANCE)[0] / abs(wo[2])
                sent = value(bsdf, wo, wi[None], IMPORTANCE)[0] / abs(wi[2])
                assert seen == pytest.approx(sent, rel=1e-5, abs=1e-30)


GRADIENTS = [
    (name, key)
    for name, keys in {
        "abg": "A B g",
        "harvey_shack": "rms_nm l s",
        "k_correlation": "rms_nm B_um slope",
        "gaussian_lobe": "total width",
        "phong": "b0 exponent",
        "polynomial": "c000 c100 c010 c001 l10 l11 d",
        "psd_table": "scale",
        "particulate": "level slope",
        "paint": "reflectance b0 l s n",
        "rough": "rms_nm B_um",
    }.items()
    for key in keys.split()
]


def moved(name: str, key: str, factor: float) -> Any:
    given = {"slope": 0.926} if name == "particulate" else {}
    model = (MODELS | THEORIES)[name]
    return surface({**model, key: {**given, **model}[key] * factor})


@pytest.mark.long
@pytest.mark.parametrize(("name", "key"), GRADIENTS)
def test_derivative_of_eval(name: str, key: str) -> None:
    """∂(BSDF cos θ) against central differences of the float64 model."""
    model = (MODELS | THEORIES)[name]
    bsdf = surface(model)
    parameters = mi.traverse(bsdf)
    parameter = parameters[f"{model['type']}.{key}"]
    at, step = float(parameter[0]), 1e-3
    wi = direction(50.0 if name == "rough" else 30.0, True)
    wo = np.concatenate([hemisphere(30, -1.0, 8), hemisphere(30, 1.0, 9)])
    dr.enable_grad(parameter)
    values = bsdf.eval(context(IMPORTANCE), interaction(wi, len(wo)), vectors(wo))[0]
    dr.forward(parameter)
    got = np.array(dr.grad(values), dtype=float)
    if name in (
        "k_correlation",
        "paint",
        "polynomial",
        "rough",
    ):  # the lobes have tables where the plugin has equations
        step = 4e-3
        low, high = (value(moved(name, key, 1 + sign * step), wi, wo) for sign in (-1, 1))
    else:
        low, high = (
            np.concatenate([host(at_end, wi, wo[:30], "reflection"), host(at_end, wi, wo[30:], "transmission")])
            for at_end in (moved(name, key, 1 + sign * step) for sign in (-1, 1))
        )
    expected = (high - low) / (2 * step * at)
    accuracy = 1e-2 if name == "rough" else 2e-3  # its shape changes with the roughness, over the angles too
    # Central differences are good to step² of the scale, in float32 to its rounding over the step
    scale = np.abs(np.array(dr.detach(values), dtype=float)) / at
    assert np.all(np.abs(got - expected) <= accuracy * np.maximum(scale, np.abs(expected)) + 1e-12)
    assert np.max(np.abs(expected) / np.maximum(scale, 1e-12)) > 1e-2, "a case that shows nothing"


@pytest.mark.parametrize(
    ("name", "key"),
    [("abg", "A"), ("harvey_shack", "rms_nm"), pytest.param("particulate", "level", marks=pytest.mark.long)],
)
def test_derivative_of_the_specular_beams(name: str, key: str) -> None:
    """What scatter takes from the beams has a derivative too."""
    bsdf = surface(MODELS[name])
    parameter = mi.traverse(bsdf)[f"{name}.{key}"]
    at, step, wi = float(parameter[0]), 1e-2, direction(30.0, True)

    def beams(of: Any) -> mi.Float:
        ctx = context(IMPORTANCE)
        ctx.type_mask = mi.BSDFFlags.Delta
        sample, weight = of.sample(ctx, interaction(wi, 2), mi.Float(0.01, 0.99), mi.Point2f(0.5))
        return weight[0] * sample.pdf

    dr.enable_grad(parameter)
    values = beams(bsdf)
    dr.forward(parameter)
    got = np.array(dr.grad(values), dtype=float)
    low, high = (np.array(beams(moved(name, key, 1 + sign * step)), dtype=float) for sign in (-1, 1))
    np.testing.assert_allclose(got, (high - low) / (2 * step * at), rtol=1e-2)
    assert np.all(got < 0)


def test_no_derivative_where_nothing_scatters() -> None:
    """At A = 0 the model has no lobe; a derivative of 0 would be wrong."""
    bsdf = surface({"type": "abg", "A": 0.0, "B": 0.001, "g": 2.0})
    wi, wo = direction(30.0, True), hemisphere(4, -1.0, 2)
    assert not value(bsdf, wi, wo).any()
    dr.enable_grad(mi.traverse(bsdf)["abg.A"])
    with pytest.raises(MistrayError, match=r"abg 'model': it scatters nothing"):
        value(bsdf, wi, wo)
