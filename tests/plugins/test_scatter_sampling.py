"""Sampling of the scatter plugins: χ² in fitting charts, what a sample weighs, and how much is scattered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.chi_square import Chart, p_value
from oracles.statistics import assert_z
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

from mistray.scatter.total import totals

SAMPLES = 200_000
# About 70 tests of one sampler: each has this false-alarm probability, all together 1e-3
FALSE_ALARM = 1e-3 / 70
BY_ANGLE = ("particulate", "phong")  # lobes about a direction, not about its direction cosines
OCTAVES = {"abg_narrow": 19}  # of r below 2 that are tested, else 14
TYPES = [
    getattr(mi.BSDFFlags, kind).value
    for kind in ("DeltaReflection", "DeltaTransmission", "GlossyReflection", "GlossyTransmission")
]  # of components
CASES = [
    (name, event, angle, True, IMPORTANCE)
    for name, model in MODELS.items()
    for event in EVENTS
    for angle in (0.0, 45.0, 85.0)
    if model.get("event", "both") in ("both", event)
] + [
    (name, event, 30.0, False, mode)
    for name, model in MODELS.items()
    for event, mode in (("transmission", IMPORTANCE), ("transmission", RADIANCE), ("reflection", RADIANCE))
    if model.get("event", "both") in ("both", event)
    and (name, event) != ("particulate", "reflection")  # they lie in front
]


def specular(wi: np.ndarray, event: str) -> np.ndarray:
    """The reflected or refracted direction."""
    if event == "reflection":
        return np.array([-wi[0], -wi[1], wi[2]])
    eta = FRONT / BACK if wi[2] < 0 else BACK / FRONT
    xy = -eta * wi[:2]
    return np.array([*xy, -np.sign(wi[2]) * np.sqrt(1 - xy @ xy)])


def charts(name: str, wi: np.ndarray, event: str) -> list[Chart]:
    centre, flat, octaves = specular(wi, event), name not in BY_ANGLE, OCTAVES.get(name, 14)
    if name == "abg_lambertian":  # it has no peak, and the horizon is an edge of cells about the normal
        centre = np.array([0.0, 0.0, np.sign(centre[2])])
    made = [Chart(centre, np.sign(centre[2]), flat, octaves)]
    if name == "particulate" and event == "reflection" and np.linalg.norm(centre - wi) > 1e-3:
        made.append(Chart(wi, np.sign(wi[2]), flat, octaves))
    return made


def draw(bsdf: Any, wi: np.ndarray, ctx: mi.BSDFContext, count: int, seed: int) -> tuple[Any, np.ndarray]:
    rng = mi.PCG32(count, seed)
    u = rng.next_float32()
    v = mi.Point2f(rng.next_float32(), rng.next_float32())
    sample, weight = bsdf.sample(ctx, interaction(wi, count), u, v)
    return sample, np.array(weight, dtype=float)[0]


def density(bsdf: Any, wi: np.ndarray, ctx: mi.BSDFContext) -> Any:
    def of(directions: np.ndarray) -> np.ndarray:
        return np.array(bsdf.pdf(ctx, interaction(wi, len(directions)), vectors(directions)), dtype=float)

    return of


def scatter_p(
    name: str, drawn_by: Any, claimed_by: Any, event: str, angle: float, front: bool, mode: Any, seed: int = 1
) -> float:
    wi, ctx = direction(angle, front), context(mode, event)
    sample, _ = draw(drawn_by, wi, ctx, SAMPLES, seed)
    wo = np.array(sample.wo, dtype=float).T[np.array(sample.pdf) > 0]
    return p_value(wo, SAMPLES, density(claimed_by, wi, ctx), charts(name, wi, event))


@pytest.mark.long
@pytest.mark.parametrize(("name", "event", "angle", "front", "mode"), CASES)
def test_chi_square(name: str, event: str, angle: float, front: bool, mode: Any) -> None:
    bsdf = surface(MODELS[name])
    p = scatter_p(name, bsdf, bsdf, event, angle, front, mode)
    assert p > FALSE_ALARM, f"{name}, {event} at {angle}°: p = {p:.2g}"


def test_chi_square_of_a_table_and_of_several_models(tmp_path: Path) -> None:
    table = surface(write_table(tmp_path), R=0.0, T=0.0)
    for angle in (0.0, 45.0, 85.0):
        assert scatter_p("tabulated", table, table, "reflection", angle, True, IMPORTANCE) > FALSE_ALARM
    both = {"type": "interface", "front": "1", "back": "1.5", "R": 0.2, "T": 0.4}
    bsdf = mi.load_dict({**both, "a": MODELS["abg"], "b": MODELS["gaussian_lobe"], "c": MODELS["harvey_shack"]})
    for event in EVENTS:
        assert scatter_p("harvey_shack", bsdf, bsdf, event, 45.0, True, IMPORTANCE) > FALSE_ALARM


@pytest.mark.parametrize(
    ("name", "key", "factor"),
    [
        ("abg", "B", 1.3),
        ("abg_narrow", "B", 1.3),
        ("k_correlation", "B_um", 1.3),
        ("gaussian_lobe", "width", 1.1),
        ("phong", "exponent", 1.1),
        ("polynomial", "l10", 1.3),
        ("particulate", "slope", 1.1),
        ("paint", "l", 1.3),
    ],
)
def test_a_wrong_density_fails(name: str, key: str, factor: float) -> None:
    """The same test with a density that is off by a tenth or a third."""
    model = MODELS[name]
    given = {"particulate": 0.926}.get(name, model.get(key))
    wrong = surface({**model, key: given * factor})
    event = "transmission" if model.get("event") == "transmission" else "reflection"
    p = scatter_p(name, surface(model), wrong, event, 45.0, True, IMPORTANCE)
    assert p < 1e-9, f"a wrong {key} went unnoticed: p = {p:.2g}"


def assert_agree(bsdf: Any, wi: np.ndarray, mode: Any, count: int = 20_000) -> None:
    """Weight · pdf = eval, pdf as in `pdf` and `eval_pdf`, for every direction that was drawn; on the right side."""
    ctx, si = context(mode), interaction(wi, count)
    sample, weight = draw(bsdf, wi, ctx, count, 3)
    kind, wo = np.array(sample.sampled_component), np.array(sample.wo, dtype=float)
    value, pdf = bsdf.eval_pdf(ctx, si, sample.wo)
    np.testing.assert_array_equal(np.array(pdf), np.array(bsdf.pdf(ctx, si, sample.wo)))
    np.testing.assert_array_equal(np.array(value), np.array(bsdf.eval(ctx, si, sample.wo)))
    scattered = (kind >= 2) & (weight > 0)
    np.testing.assert_allclose(np.array(sample.pdf)[scattered], np.array(pdf)[scattered], rtol=1e-5)
    values = np.array(value, dtype=float)[0]
    np.testing.assert_allclose((weight * np.array(sample.pdf))[scattered], values[scattered], rtol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(wo, axis=0)[weight > 0], 1, atol=1e-6)
    side = np.where(kind % 2 == 0, np.sign(wi[2]), -np.sign(wi[2]))
    assert np.all((np.sign(wo[2]) == side)[weight > 0])
    assert np.array_equal(np.array(sample.sampled_type), np.array(TYPES)[kind])


@pytest.mark.parametrize("name", MODELS)
def test_every_component_scatters_its_share(name: str) -> None:
    """
    Mean weights are R (1 - loss), T (1 - loss) and the scattered shares of the float64 totals, and do not exceed 1.

    False-alarm probability 1e-3 over all comparisons of one model.
    """
    bsdf, count = surface(MODELS[name]), 200_000
    got, want, errors, names = [], [], [], []
    for angle, front in ((0.0, True), (45.0, True), (85.0, True), (30.0, False)):
        wi = direction(angle, front)
        n_in, n_out = (FRONT, BACK) if front else (BACK, FRONT)
        sums = totals(bsdf.scatter[0].lobes(550.0, n_in, n_out, front), np.abs(wi[2:]), n_in, n_out)
        shares = [
            R * (1 - sums.loss["reflection"][0]),
            T * (1 - sums.loss["transmission"][0]),
            sums.scattered("reflection", np.array(R))[0],
            sums.scattered("transmission", np.array(T))[0],
        ]
        for mode in (IMPORTANCE, RADIANCE):
            assert_agree(bsdf, wi, mode)
        sample, weight = draw(bsdf, wi, context(IMPORTANCE), count, 7)
        kind = np.array(sample.sampled_component)
        for component, share in enumerate(shares):
            each = np.where(kind == component, weight, 0.0)
            got.append(each.mean())
            want.append(share)
            errors.append(each.std() / np.sqrt(count))
            names.append(f"component {component} at {angle}°, front {front}")
        assert weight.mean() <= 1 + 5 * weight.std() / np.sqrt(count)
    # Tables of totals are interpolated in the angle, 1e-4 of the share
    assert_z(name, got, want, np.array(errors), floor=1e-4 * R, names=names)


def test_masks_choose_components() -> None:
    bsdf, wi = surface(MODELS["abg"]), direction(30.0, True)
    everything = mi.BSDFContext(IMPORTANCE)
    wo = vectors(np.array([specular(wi, event) for event in EVENTS]) + np.array([0.01, 0, 0]))
    si = interaction(wi, 2)
    for event in EVENTS:
        ctx = context(IMPORTANCE, event)
        values = np.array(bsdf.eval(ctx, si, wo))[0]
        lit = np.array([event == "reflection", event == "transmission"])
        np.testing.assert_array_equal(values > 0, lit)
        np.testing.assert_array_equal(values[lit], np.array(bsdf.eval(everything, si, wo))[0][lit])
        sample, weight = draw(bsdf, wi, ctx, 1000, 2)
        assert set(np.array(sample.sampled_component)[weight > 0]) == {2 + EVENTS.index(event)}
    delta = mi.BSDFContext(IMPORTANCE)
    delta.type_mask = mi.BSDFFlags.Delta
    sample, weight = draw(bsdf, wi, delta, 1000, 2)
    assert set(np.array(sample.sampled_component)) == {0, 1}
    assert dr.all(bsdf.eval(delta, si, wo) == 0, axis=None)
    assert dr.all(bsdf.pdf(delta, si, wo) == 0)
    off = mi.Mask(False)
    assert dr.all(bsdf.sample(everything, si, mi.Float(0.5), mi.Point2f(0.5), off)[1] == 0, axis=None)
    assert dr.all(bsdf.eval(everything, si, wo, off) == 0, axis=None)
    assert dr.all(bsdf.pdf(everything, si, wo, off) == 0)
