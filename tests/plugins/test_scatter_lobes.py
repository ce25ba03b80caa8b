"""The scatter plugins: lobes against float64, samples by χ² and by what they weigh; nesting, messages, integrators."""

import gc
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scatter_surfaces
import scene_dicts
from oracles.chi_square import Chart, p_value
from oracles.small_scenes import write
from oracles.statistics import assert_z
from refusals import each_refused
from scatter_surfaces import EVENTS, IMPORTANCE, MODELS, RADIANCE, context, direction, interaction, surface, vectors
from vectors import toml

from mistray import MistrayError
from mistray.gradients.scatter_gradient import quotient
from mistray.scatter.evaluate import bsdf as float64_bsdf
from mistray.scatter.kinds import OWN_KINDS
from mistray.scatter.total import totals

BACK, FRONT, R, T = scatter_surfaces.BACK, scatter_surfaces.FRONT, scatter_surfaces.R, scatter_surfaces.T
CASES = [(0.0, True), (30.0, True), (80.0, True), (30.0, False)]
# float32 in a power law that spans 13 decades; of ratios, the distance of their nodes. Profiles are power laws between
# nodes h = ln 2/64 apart, with an error of h²/8 |d² ln f/d(ln r)²|. That is 8e-4 of a Gaussian where it has fallen to
# 1e-6 of its peak, below which `floor` counts; ln cosⁿ is curved up to twice as much
ACCURACY = {
    **dict.fromkeys(("gaussian_lobe", "particulate", "tabulated"), 1e-3),
    **dict.fromkeys(("phong", "k_correlation", "psd_table"), 2e-3),
    **dict.fromkeys(("paint", "ghs_full", "rayleigh_rice_vector"), 2e-2),
    "polynomial": 5e-3,
}
# Directions that may deviate by more: Mie's ripple far behind, and the rim of what refraction can reach, are finer than
# the table
EXCEPTIONS = {"particulate": 0.05}
OTHER = {"type": "k_correlation", "rms_nm": 5.0, "B_um": 20.0, "slope": 3.0}
THEORIES: dict[str, dict[str, Any]] = {
    **{theory: OTHER | {"theory": theory} for theory in ("ghs_full", "rayleigh_rice_vector")},
    "rough": OTHER | {"theory": "ghs_full", "rms_nm": 20.0},
}


def hemisphere(count: int, side: float, seed: int) -> np.ndarray:
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
    """Tables on the device against the lobes in float64, R = 0.2 and T = 0.4."""
    model = (MODELS | THEORIES).get(name) or scatter_surfaces.write_table(tmp_path)
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


@pytest.mark.parametrize("name", MODELS)
def test_radiance_is_adjoint_to_importance(name: str) -> None:
    bsdf = surface(MODELS[name])
    for a in hemisphere(8, -1.0, 11):
        for b in (*hemisphere(8, -1.0, 12), *hemisphere(8, 1.0, 13)):
            for wi, wo in ((a, b), (b, a)):
                seen = value(bsdf, wi, wo[None], RADIANCE)[0] / abs(wo[2])
                sent = value(bsdf, wo, wi[None], IMPORTANCE)[0] / abs(wi[2])
                assert seen == pytest.approx(sent, rel=1e-5, abs=1e-30)


NUMBERS = """abg A B g, harvey_shack rms_nm l s, k_correlation rms_nm B_um slope, gaussian_lobe total width,
phong b0 exponent, polynomial c000 c100 c010 c001 l10 l11 d, psd_table scale, particulate level slope,
paint reflectance b0 l s n, rough rms_nm B_um"""
GRADIENTS = [(name, key) for name, *keys in map(str.split, NUMBERS.split(",")) for key in keys]


def moved(name: str, key: str, factor: float) -> Any:
    given = {"slope": 0.926} if name == "particulate" else {}
    model = (MODELS | THEORIES)[name]
    return surface({**model, key: {**given, **model}[key] * factor})


@pytest.mark.parametrize(("name", "key"), GRADIENTS)
def test_derivative_of_eval(name: str, key: str) -> None:
    """∂(BSDF cos θ) against central differences of the float64 model."""
    model = (MODELS | THEORIES)[name]
    bsdf = surface(model)
    parameter = mi.traverse(bsdf)[f"{model['type']}.{key}"]
    at = float(parameter[0])
    wi = direction(50.0 if name == "rough" else 30.0, True)
    wo = np.concatenate([hemisphere(30, -1.0, 8), hemisphere(30, 1.0, 9)])
    dr.enable_grad(parameter)
    values = bsdf.eval(context(IMPORTANCE), interaction(wi, len(wo)), vectors(wo))[0]
    dr.forward(parameter)
    got = np.array(dr.grad(values), dtype=float)
    # Ratios have tables, whose slopes are not those of the equations
    tabled = name in ("k_correlation", "paint", "polynomial", "rough")
    step = 4e-3 if tabled else 1e-3
    ends = [moved(name, key, 1 + sign * step) for sign in (-1, 1)]
    parts = list(zip((wo[:30], wo[30:]), EVENTS, strict=True))
    low, high = (value(end, wi, wo) if tabled else np.hstack([host(end, wi, *part) for part in parts]) for end in ends)
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
    bsdf = surface({"type": "abg", "A": 0.0, "B": 0.001, "g": 2.0})
    wi, wo = direction(30.0, True), hemisphere(4, -1.0, 2)
    assert not value(bsdf, wi, wo).any()
    dr.enable_grad(mi.traverse(bsdf)["abg.A"])
    with pytest.raises(MistrayError, match=r"abg 'model': it scatters nothing"):
        value(bsdf, wi, wo)


SAMPLES = 200_000
# About 70 tests of one sampler: each has this false-alarm probability, all together 1e-3
FALSE_ALARM = 1e-3 / 70
BY_ANGLE = ("particulate", "phong")  # lobes about a direction, not about its direction cosines
OCTAVES = {"abg_narrow": 19}  # of r below 2 that are tested, else 14
KINDS = ("DeltaReflection", "DeltaTransmission", "GlossyReflection", "GlossyTransmission")  # of components
DRAWN = [
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
    if event == "reflection":
        return np.array([-wi[0], -wi[1], wi[2]])
    eta = FRONT / BACK if wi[2] < 0 else BACK / FRONT
    xy = -eta * wi[:2]
    return np.array([*xy, -np.sign(wi[2]) * np.sqrt(1 - xy @ xy)])


def draw(bsdf: Any, wi: np.ndarray, ctx: mi.BSDFContext, count: int, seed: int) -> tuple[Any, np.ndarray]:
    rng = mi.PCG32(count, seed)
    u = rng.next_float32()
    v = mi.Point2f(rng.next_float32(), rng.next_float32())
    sample, weight = bsdf.sample(ctx, interaction(wi, count), u, v)
    return sample, np.array(weight, dtype=float)[0]


def scatter_p(name: str, drawn_by: Any, claimed_by: Any, event: str, angle: float, front: bool, mode: Any) -> float:
    wi, ctx = direction(angle, front), context(mode, event)
    sample, _ = draw(drawn_by, wi, ctx, SAMPLES, 1)
    wo = np.array(sample.wo, dtype=float).T[np.array(sample.pdf) > 0]
    centre, flat, octaves = specular(wi, event), name not in BY_ANGLE, OCTAVES.get(name, 14)
    if name == "abg_lambertian":  # it has no peak, and the horizon is an edge of cells about the normal
        centre = np.array([0.0, 0.0, np.sign(centre[2])])
    charts = [Chart(centre, np.sign(centre[2]), flat, octaves)]
    if name == "particulate" and event == "reflection" and np.linalg.norm(centre - wi) > 1e-3:
        charts.append(Chart(wi, np.sign(wi[2]), flat, octaves))

    def density(directions: np.ndarray) -> np.ndarray:
        return np.array(claimed_by.pdf(ctx, interaction(wi, len(directions)), vectors(directions)), dtype=float)

    return p_value(wo, SAMPLES, density, charts)


@pytest.mark.parametrize(("name", "event", "angle", "front", "mode"), DRAWN)
def test_chi_square(name: str, event: str, angle: float, front: bool, mode: Any) -> None:
    bsdf = surface(MODELS[name])
    p = scatter_p(name, bsdf, bsdf, event, angle, front, mode)
    assert p > FALSE_ALARM, f"{name}, {event} at {angle}°: p = {p:.2g}"


def test_chi_square_of_a_table_and_of_several_models(tmp_path: Path) -> None:
    table = surface(scatter_surfaces.write_table(tmp_path), R=0.0, T=0.0)
    for angle in (0.0, 45.0, 85.0):
        assert scatter_p("tabulated", table, table, "reflection", angle, True, IMPORTANCE) > FALSE_ALARM
    both = {"type": "interface", "front": "1", "back": "1.5", "R": 0.2, "T": 0.4}
    bsdf = mi.load_dict({**both, "a": MODELS["abg"], "b": MODELS["gaussian_lobe"], "c": MODELS["harvey_shack"]})
    for event in EVENTS:
        assert scatter_p("harvey_shack", bsdf, bsdf, event, 45.0, True, IMPORTANCE) > FALSE_ALARM


@pytest.mark.parametrize(("name", "key", "factor"), toml("tables.toml")["wrong densities"])
def test_a_wrong_density_fails(name: str, key: str, factor: float) -> None:
    model = MODELS[name]
    wrong = surface({**model, key: {"particulate": 0.926}.get(name, model.get(key)) * factor})
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
    types = [getattr(mi.BSDFFlags, name).value for name in KINDS]
    assert np.array_equal(np.array(sample.sampled_type), np.array(types)[kind])


@pytest.mark.parametrize("name", MODELS)
def test_every_component_scatters_its_share(name: str) -> None:
    """Mean weights are R (1 - loss), T (1 - loss) and the totals of the scatter; false alarm 1e-3 of one model."""
    bsdf, count = surface(MODELS[name]), 200_000
    got, want, errors, names = [], [], [], []
    for angle, front in ((0.0, True), (45.0, True), (85.0, True), (30.0, False)):
        wi = direction(angle, front)
        n_in, n_out = (FRONT, BACK) if front else (BACK, FRONT)
        sums = totals(bsdf.scatter[0].lobes(550.0, n_in, n_out, front), np.abs(wi[2:]), n_in, n_out)
        coating = dict(zip(EVENTS, (R, T), strict=True))
        shares = [share * (1 - sums.loss[event][0]) for event, share in coating.items()]
        shares += [sums.scattered(event, np.array(share))[0] for event, share in coating.items()]
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


SHAPE = {"type": "asphere", "semi_diameter": 5.0}


class TestScene:
    def test_every_model_has_its_plugin(self, tmp_path: Path) -> None:
        given = [*MODELS.values(), scatter_surfaces.write_table(tmp_path)]
        assert {values["type"] for values in given} == set(OWN_KINDS)
        for values in given:
            plugin = mi.load_dict(values)
            (model,) = plugin.scatter
            assert plugin.model is model
            assert type(model) is OWN_KINDS[values["type"]]
            held = vars(model) | dict(getattr(model, "coefficients", ()))
            for key, value in values.items():
                if key not in ("type", "file"):
                    assert held[key] == (pytest.approx(value, rel=1e-6) if isinstance(value, float) else value)

    def test_two_of_a_kind_and_a_shared_one(self) -> None:
        polish = {"type": "ref", "id": "polish"}
        second = {"type": "interface", "s": polish, "t": MODELS["abg"], "u": {**MODELS["abg"], "A": 0.001}}
        scene = scene_dicts.load(
            polish=MODELS["harvey_shack"],
            a={**SHAPE, "bsdf": {"type": "interface", "s": polish}},
            b={**SHAPE, "z": 5.0, "bsdf": second},
        )
        first, second = ({shape.id(): shape.bsdf() for shape in scene.shapes()}[name] for name in "ab")
        assert first.scatterers[0] is second.scatterers[0]
        parameters = mi.traverse(scene)
        parameters["b.bsdf.abg_2.A"] = mi.Float(0.002)
        polish = [key for key in parameters.keys() if key.endswith("rms_nm")]  # noqa: SIM118
        assert len(polish) == 1, "a shared model has one set of parameters"
        parameters[polish[0]] = mi.Float(2.0)
        parameters.update()
        assert [round(model.A, 6) for model in second.scatter[1:]] == [0.0025, 0.002]
        assert (first.scatter[0].rms_nm, second.scatter[0].rms_nm) == (2.0, 2.0)

    def test_particles_of_a_material_and_digits_of_the_scene(self, tmp_path: Path) -> None:
        dust = write(tmp_path, "wavelength_nm,n,k\n400,1.6,0.01\n800,1.6,0.01\n", "dust.csv")
        values = '<float name="level" value="300"/><string name="particle" value="dust.csv"/>'
        scene = write(tmp_path, f'<bsdf version="3.0.0" type="particulate">{values}</bsdf>')
        assert mi.load_file(str(scene)).model.particle == str(dust)
        # In single precision the level would lie below the greatest diameter
        bsdf = mi.load_dict({"type": "particulate", "level": 400.3, "max_um": 400.3})
        assert bsdf.model.level == 400.3
        assert [model.level >= 400.3 for _, model in quotient(bsdf, "level")] == [True] * 3
        assert [model.level for _, model in quotient(bsdf, "slope")] == [400.3] * 2

    def test_alone_update_and_refusal(self) -> None:
        """By itself it is an interface with R = 1, or R = 0 where the scatter is absolute."""
        mirror = mi.load_dict({**MODELS["abg"], "back": "1.5", "R": 0.9, "T": 0.05})
        assert set(mi.traverse(mirror).keys()) == {"R", "T", "A", "B", "g", "n_front_shift", "n_back_shift"}
        assert (float(mirror.R[0]), float(mirror.T[0])) == pytest.approx((0.9, 0.05))
        assert mirror.indices(550.0) == (1.0, 1.5)
        for name, reflectance in (("harvey_shack", 1.0), ("paint", 0.0)):
            bsdf = mi.load_dict(MODELS[name])
            assert (float(bsdf.R[0]), float(bsdf.T[0])) == (reflectance, 0.0)
        bsdf = surface(MODELS["abg"])
        parameters, si = mi.traverse(bsdf), interaction(direction(20.0, True), 1)
        wo = vectors(np.array([[0.5, 0.3, -np.sqrt(1 - 0.34)]]))
        before = float(bsdf.eval(context(IMPORTANCE), si, wo)[0][0])
        parameters["abg.A"] = mi.Float(0.005)
        parameters.update()
        assert float(bsdf.eval(context(IMPORTANCE), si, wo)[0][0]) == pytest.approx(2 * before, rel=1e-5)
        parameters["abg.B"] = mi.Float(-1.0)
        with pytest.raises(MistrayError, match="B is -1"):
            parameters.update()
        assert (float(parameters["abg.B"][0]), bsdf.scatter[0].B) == pytest.approx((0.001, 0.001))
        parameters["abg.B"] = mi.Float(0.001, 0.002)
        with pytest.raises(MistrayError, match="B has 2 entries"):
            parameters.update()
        parameters = mi.traverse(mirror)
        parameters["R"], parameters["n_back_shift"] = mi.Float(0.3), mi.Float(0.1)
        parameters["g"] = mi.Float(-1.0)
        with pytest.raises(MistrayError, match="g is -1"):
            parameters.update()
        assert (float(mirror.R[0]), mirror.coating.R) == pytest.approx((0.9, 0.9))
        assert mirror.indices(550.0) == (1.0, 1.5)

    def test_errors_name_the_shape(self) -> None:
        each_refused(
            ({"type": "abg", "A": 1.0, "B": 0.1}, "g is missing; give A, B, g"),
            ({"type": "tabulated", "file": "nowhere.bsdf"}, "nowhere.bsdf"),
            by=lambda values: scene_dicts.load(wall={**SHAPE, "bsdf": {"type": "interface", "model": values}}),
            pattern="wall.*{}",
        )

    def test_an_impossible_sum(self) -> None:
        """R + T + scatter > 1 is refused when light is to be scattered, by surface and angle."""
        wall = {"type": "interface", "id": "wall", "R": 0.5, "p": {"type": "paint", "reflectance": 0.6}}
        si = interaction(direction(0.0, True), 1)
        with pytest.raises(MistrayError, match=r"'wall', light from the front: at .*° .*more than 1"):
            mi.load_dict(wall).sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5))
        gc.collect()  # Dr.Jit traces every BSDF that is alive, also for other scenes

    def test_events_and_sides(self) -> None:
        wi = {True: direction(20.0, True), False: direction(20.0, False)}
        wo = {side: vectors(np.array([[0.3, 0.2, side * np.sqrt(1 - 0.13)]])) for side in (-1, 1)}
        for event in ("reflection", "transmission"):
            for side in ("front", "back"):
                bsdf = surface({**MODELS["abg"], "event": event, "side": side})
                for from_front, light in wi.items():
                    for z, out in wo.items():
                        value = float(bsdf.eval(context(IMPORTANCE), interaction(light, 1), out)[0][0])
                        reflected = (z < 0) == from_front
                        assert (value > 0) == (from_front == (side == "front") and reflected == (event == "reflection"))
