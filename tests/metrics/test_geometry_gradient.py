"""Derivatives by geometry against the float64 oracle and differences, and what a new value compiles: nothing."""

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import vectors
from frozen_cases import Case, Metrics, coated_text, compare, scene_text, step, with_shape, with_values
from oracles.frozen_paths import Hits, power, rms_radius
from oracles.frozen_scene import read_frozen
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import interface_xml, shape_xml
from oracles.small_scenes import scene_text as small_text
from oracles.statistics import z_limit, z_score
from scene_dicts import at, detector, load

import mistray
from mistray.optimize import Metric, image_metric, match, optimize, parameters

TRIPLET = scene_text("cooke_triplet")
COATED = coated_text(TRIPLET, "L2_front", "L3_rear")
TOLERANCE = 1e-3  # of geometry on frozen paths, and of coatings
ZERO = 1e-6  # of the metric's value, for a move by the size of the surface
POSE = ("x", "y", "z", "tilt_x", "tilt_y", "tilt_z")
TRACED = {"max_reflections": 2, "flux_threshold": 0.0, "azimuth_deg": 30.0}

# A cone, and a cylinder whose numbers run against the light
WALLS = {"tube": {"r0": 10.0, "z0": 20.0, "r1": 9.5, "z1": 50.0}, "end": {"r0": 9.5, "z0": 80.0, "r1": 9.5, "z1": 50.0}}


def singlet() -> Case:
    """Ghosts, and light that a cone around the axis reflects; coarse pixels, as the image is of few rays."""
    text = with_values(scene_text("singlet_window_detector"), "detector", half_width=20.0, half_height=20.0)
    for side in ("width", "height"):
        text = text.replace(f'name="{side}" value="240"', f'name="{side}" value="40"')
    for name, numbers in WALLS.items():
        text = with_shape(text, shape_xml("frustum", name, 0.0, interface_xml(R=0.3), **numbers))
    return Case(text, {"rays": 600, "field_deg": 6.0, "seed": 3, **TRACED})


def triplet() -> Case:
    """Layers on two surfaces, and a lens that is displaced and tilted."""
    moved = {f"L2_{face}.{name}": v for face in ("front", "rear") for name, v in (("tilt_x", 0.8), ("y", 0.1))}
    moved |= {"L2_rear.tilt_y": -0.5, "L2_rear.tilt_z": 20.0, "L2_rear.x": 0.05}
    moved |= {"L2_front.bsdf.n_back_shift": 2e-3, "L2_rear.bsdf.n_front_shift": 2e-3}
    return Case(COATED, {"rays": 500, "field_deg": 5.0, "seed": 4, **TRACED, "flux_threshold": 5e-4}, moved)


def double_gauss() -> Case:
    """Cemented lenses; without the ghosts of their cement."""
    return Case(scene_text("double_gauss"), {"rays": 250, "field_deg": 4, "seed": 5, **TRACED, "flux_threshold": 2e-3})


def phone_camera() -> Case:
    """Aspheres, ideal coatings, cones and stops that reflect; of its 150 ghosts the strongest."""
    return Case(scene_text("phone_camera"), {"rays": 80, "field_deg": 6.0, "seed": 6, **TRACED, "flux_threshold": 1e-3})


def solid() -> Case:
    """A detector cemented to glass that absorbs: each mm takes 2 % of the light."""
    glass = "1.5+1e-6i"
    front = shape_xml("asphere", "front", 0.0, interface_xml("air", glass, R=0.2, T=0.7), radius=30, semi_diameter=15)
    end = interface_xml(glass, "air", R=0.3)
    detector = shape_xml("asphere", "detector", 40.0, end, sensor=True, half_width=20.0, half_height=20.0)
    settings = {"rays": 300, "field_deg": 5.0, "seed": 7, **TRACED, "wavelength_nm": 550.0}
    return Case(small_text(front, detector, radius=8.0), settings)


# Two lens systems of freeforms, by the numbers of each surface's sag
FREEFORMS: dict[str, dict[str, dict[str, float]]] = vectors.toml("freeform_systems.toml")
FIGURE_ERROR = Path(__file__).parents[1] / "data" / "figure_error.dat"
OUTLINES = (
    {"semi_diameter": 12.0},
    {"half_width": 10.0, "half_height": 11.0},
    {"clip_1": "+ellipse", "clip_1_half_width": 12.0, "clip_1_half_height": 10.5, "clip_1_angle_deg": 20.0,
     "clip_2": "-circle", "clip_2_x": 3.0, "clip_2_radius": 0.5},
)  # fmt: skip


def freeforms(name: str) -> Case:
    """Three lenses, all of whose surfaces are freeforms within all kinds of outlines."""
    shapes = []
    for k, (kind, numbers) in enumerate(FREEFORMS[name].items()):
        sides = ("air", "1.6") if k % 2 == 0 else ("1.6", "air")
        outline = {key: value for key, value in OUTLINES[k % 3].items() if not isinstance(value, str)}
        shape = shape_xml("freeform", kind, 8.0 * k, interface_xml(*sides), **numbers, **outline)
        words = "".join(
            f'<string name="{key}" value="{value}"/>'
            for key, value in OUTLINES[k % 3].items()
            if isinstance(value, str)
        )
        words += f'<string name="grid" value="{FIGURE_ERROR}"/>' if "grid_scale" in numbers else ""
        shapes.append(shape.replace("<transform", words + "<transform", 1))
    detector = shape_xml("asphere", "detector", 70.0, sensor=True, half_width=30.0, half_height=30.0)
    settings = {"rays": 300, "field_deg": 3.0, "seed": 8, **TRACED, "flux_threshold": 2e-4}
    return Case(small_text(*shapes, detector, radius=7.0), settings)


def off_axis_mirror() -> Case:
    """A piece of a paraboloid far beside its axis, with Zernikes and a tilt on it, and a detector near its focus."""
    mirror = shape_xml(
        "freeform", "mirror", 0.0, interface_xml(R=0.9, mirror=True), curvature=-1 / 2000, conic=-1.0, zernike_5=1e-3,
        zernike_radius=400.0, clip_1_x=140.0, clip_1_y=300.0, clip_1_radius=60.0,
    )  # fmt: skip
    mirror = mirror.replace("<transform", '<string name="clip_1" value="+circle"/><transform', 1)
    glass = [
        shape_xml("asphere", f"window_{k}", -900.0 - 5 * k, interface_xml(*sides), semi_diameter=60.0)
        for k, sides in enumerate((("1.5", "air"), ("air", "1.5")))
    ]
    detector = shape_xml("asphere", "detector", -960.0, sensor=True, half_width=40.0, half_height=40.0)
    text = small_text(mirror, *glass, detector, radius=50.0)
    place = '<transform name="to_world"><translate x="140" y="300" z="-1500"/></transform></emitter>'
    return Case(text.replace("</emitter>", place), {"rays": 400, "seed": 9, **TRACED, "azimuth_deg": 0.0})


def offner_relay() -> Case:
    """A mirror that is met twice, and a source that is near: its rays have weights of their own."""
    return Case(scene_text("offner_relay"), {"rays": 1500, "field_deg": 1.0, "seed": 10, **TRACED})


CASES = {
    **{name: partial(freeforms, name) for name in FREEFORMS},
    "off-axis mirror": off_axis_mirror,
    "Offner relay": offner_relay,
    "solid": solid,
    "singlet": singlet,
    "triplet": triplet,
    "double Gauss": double_gauss,
    "phone camera": phone_camera,
}
MANY = ("singlet", "double Gauss", "phone camera")  # all keys of which are looked at together
# The keys that are looked at one by one
FIXED_NUMBERS = ("zernike_radius", "fringe_radius", "q_radius", "chebyshev_x", "chebyshev_y")
KEYS = {
    name: [
        *(f"{kind}.{key}" for kind, numbers in system.items() for key in numbers if key not in FIXED_NUMBERS),
        *(f"{kind}.{key}" for kind in list(system)[1::2] for key in POSE),
    ]
    for name, system in FREEFORMS.items()
} | {name: patterns.split() for name, patterns in vectors.toml("gradient_keys.toml").items()}


@pytest.fixture(scope="module")
def cases() -> Callable[[str], Case]:
    """Name → case, made once."""
    return cache(lambda name: (CASES | SCATTERING)[name]())


def kind_of(key: str) -> str:
    """Parameters that are compared with each other."""
    name = key.rsplit(".", 1)[-1]
    return "index" if name in ("n_front_shift", "n_back_shift") else name


@pytest.mark.parametrize("name", [name for name in KEYS if name in CASES])
def test_each_parameter(cases: Callable[[str], Case], name: str) -> None:
    """Every kind of parameter and metric; a gradient that is 1 % too large fails for each of them."""
    assert set(KEYS) | set(MANY) == set(CASES) | set(SCATTERING)
    case = cases(name)
    keys = match(parameters(case.scene), KEYS[name])
    metrics = case.metrics(case.strongest("ghost"))
    noticed = compare(case, keys, metrics, kind_of, tolerance=TOLERANCE, wrong=1.01, cancels=0.2, zero=ZERO)
    # A turn about its own axis moves nothing but the detector's frame
    assert noticed >= {kind_of(key) for key in keys} - ({"tilt_z"} if name in ("triplet", "Offner relay") else set())


@pytest.mark.parametrize("name", MANY)
def test_directions(cases: Callable[[str], Case], name: str) -> None:
    """All parameters of a kind move at once, at random; the metric is a sum of moments of all paths, at random."""
    case, rng = cases(name), np.random.default_rng(8)
    params = mi.traverse(case.scene)
    known = {
        key: p
        for key, p in parameters(case.scene, params).items()
        if p.kind not in ("scatter", "coating") and set(p.shapes) & set(case.met)
    }
    fixed = {key for key, p in known.items() if p.kind == "rim" and key not in case.frozen.numbers}
    events = list(dict.fromkeys(bundle.text for bundle in case.paths.bundles))
    extent = case.trace.extent[1]
    weights = rng.normal(size=(len(events), 4)) / [1, extent, extent, extent**2]
    takes = [case.select([text]) for text in events]

    def function(observation: Any) -> Any:  # Python's numbers: one of NumPy's on the left takes the derivative away
        total = mi.Float64(0)
        for text, (a, b, c, e) in zip(events, weights.tolist(), strict=True):
            m = observation.moments(text)
            total += m.power * (a + b * m.x + c * m.y + e * (m.variance + m.x * m.x + m.y * m.y))
        return total

    def oracle(hits: Sequence[Hits]) -> float:
        total = 0.0
        for take, (a, b, c, e) in zip(takes, weights, strict=True):
            total += sum(h.flux @ (a + b * h.x + c * h.y + e * (h.x**2 + h.y**2)) for h in take(hits))
        return float(total)

    found = mistray.gradient(case.metric(function), params, keys=known, edges=False)
    for key in fixed:
        assert not found.gradient[key].any(), key
    groups: dict[str, list[str]] = {}
    for key, p in known.items():
        if key not in fixed:
            groups.setdefault(p.kind, []).append(key)
    assert set(groups) >= {"curvature", "conic", "asphere", "position", "tilt", "index"}
    for kind, keys in groups.items():
        direction = {key: rng.choice((-0.1, 0.1), 1) * step(case.frozen, key) for key in keys}
        parts = np.array([float(direction[key] @ found.gradient[key]) for key in keys])
        (expected,) = case.paths.along([oracle], direction)
        scale = max(abs(expected), np.sqrt(np.sum(parts**2)))
        assert abs(parts.sum() - expected) <= TOLERANCE * scale, (kind, parts.sum(), expected)
        if abs(expected) > 0.2 * scale:
            assert abs(1.01 * parts.sum() - expected) > TOLERANCE * scale


OF_SCATTER = 1e-2  # of BSDF parameters
LIMITS = {"max_reflections": 1, "flux_threshold": 0.0, "scatter_threshold": 0.0, "field_deg": 3.0, "azimuth_deg": 20.0}
ABG = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8)
POLISH = bsdf_xml("harvey_shack", rms_nm=4.0, l=0.01, s=-1.5)
SHACK = bsdf_xml("harvey_shack", b0=0.4, l=0.03, s=-1.8)
PAINT = bsdf_xml("paint", reflectance=0.2, b0=0.3, l=0.2, s=-2.5)


def lens(front: Sequence[str], rear: Sequence[str], *more: str, detector: str | None = None) -> str:
    """A lens whose faces scatter, other shapes, and a detector near its focus."""
    faces = (("front", 0.0, 30.0, "air", "1.6", front), ("rear", 4.0, -40.0, "1.6", "air", rear))
    shapes = [
        shape_xml("asphere", name, z, scattering_xml(models, a, b, R=0.1, T=0.8), radius=radius, semi_diameter=8.0)
        for name, z, radius, a, b, models in faces
    ]
    end = shape_xml("asphere", "detector", 30.0, detector, sensor=True, half_width=4.0, half_height=4.0)
    return small_text(*shapes, *more, end, radius=4.0)


TUBE = shape_xml("frustum", "tube", 0.0, scattering_xml((PAINT,), R=0.3), r0=4.5, z0=8.0, r1=4.0, z1=26.0)
GLOSS = scattering_xml((bsdf_xml("paint", reflectance=0.1, b0=0.2, l=0.3, s=-2.0),), R=0.2)
SCATTERING = {
    "polished lens": lambda: Case(lens((ABG,), (POLISH,)), {**LIMITS, "rays": 400, "seed": 1}),
    "painted tube": lambda: Case(lens((), (), TUBE), {**LIMITS, "rays": 400, "seed": 5, "field_deg": 12.0}),
    "detector that scatters": lambda: Case(lens((SHACK,), (), detector=GLOSS), {**LIMITS, "rays": 400, "seed": 3}),
    "two scatters": lambda: Case(
        lens((SHACK,), (ABG,)), {**LIMITS, "rays": 150, "seed": 4, "max_scatters": 2, "max_reflections": 0}
    ),
}


def is_scattered(row: Any) -> bool:
    return bool(row.scatters > 0)


def is_specular(row: Any) -> bool:
    return not is_scattered(row)


def metrics_of(case: Case) -> Metrics:
    scattered = [bundle.text for bundle in case.paths.bundles if bundle.scatters]
    straight = [bundle.text for bundle in case.paths.bundles if not bundle.scatters]
    stray, direct, launched = case.select(scattered), case.select(straight), case.launched_W
    return {
        "scattered": (lambda o: o.power(is_scattered) / o.launched_W, lambda h: power(stray(h)) / launched),
        "specular": (lambda o: o.power(is_specular) / o.launched_W, lambda h: power(direct(h)) / launched),
        "rms radius": (lambda o: o.moments(is_scattered).rms_radius, lambda h: rms_radius(stray(h))),
    }


def kind_by_model(key: str) -> str:
    return key if ".bsdf." in key else key.rsplit(".", 1)[-1]


@pytest.mark.parametrize("name", SCATTERING)
def test_scatter_models(cases: Callable[[str], Case], name: str) -> None:
    """A gradient that is 5 % too large must fail for each kind."""
    case = cases(name)
    keys = match(parameters(case.scene), KEYS[name])
    assert any(bundle.scatters for bundle in case.paths.bundles)
    noticed = compare(case, keys, metrics_of(case), kind_by_model, tolerance=OF_SCATTER, wrong=1.05, cancels=0.25)
    assert noticed >= {kind_by_model(key) for key in keys}


def test_what_is_left_out_is_named(cases: Callable[[str], Case]) -> None:
    """The roughness lobe of a glass depends on its index; that derivative is not there, and is not silently so."""
    case = cases("polished lens")
    metric = case.metric(lambda o: o.power("all"))
    found = mistray.gradient(metric, mi.traverse(case.scene), ["rear.bsdf.n_front_shift"], edges=False)
    assert any("scatter with the index" in text for text in found.left_out)


def test_cleanliness_level() -> None:
    """Dust, whose random choices change with its level: two traces, other seeds, 20 % apart; false alarm 1e-3."""
    case = Case(lens((bsdf_xml("particulate", level=400.0),), ()), {**LIMITS, "rays": 20_000, "seed": 5})
    params, key = mi.traverse(case.scene), "front.bsdf.particulate.level"

    found = mistray.gradient(case.metric(lambda o: o.power(is_scattered)), params, [key], edges=False)
    values, errors = [], []
    for seed, level in ((6, 440.0), (7, 360.0)):
        params[key] = mi.Float(level)
        params.update()
        paths = mistray.trace(case.scene, **{**case.settings, "seed": seed}).paths
        value, error = paths.power([row.path_id for row in paths if row.scatters])
        values.append(value)
        errors.append(error)
    expected = (values[0] - values[1]) / 80.0
    se = np.hypot(np.hypot(*errors) / 80.0, found.standard_error[key][0])
    assert se < 0.1 * expected
    assert abs(z_score(found.gradient[key][0], expected, se)) < z_limit()


OF_IDENTITY = 1e-4
SEED = 5
COARSE = {"rays": 400, "max_reflections": 2, "flux_threshold": 0.0}
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
    text = with_values(COATED, "detector", bsdf_R=0.2)
    emitter = '<emitter type="collimated" id="source"><float name="field_deg" value="5" />'
    text = text.replace('<emitter type="collimated" id="source">', emitter)
    return Case(text, {**COARSE, "seed": SEED})


@pytest.fixture(scope="module")
def smooth(case: Case) -> np.ndarray:
    """A smooth function over the pixels."""
    y, x = (np.linspace(-1, 1, n) for n in mistray.trace(case.scene, **COARSE).irradiance.shape)
    return np.cos(3 * x)[None, :] * np.exp(y)[:, None]


def inner_products(case: Case, keys: Iterable[str], smooth: np.ndarray, **more: Any) -> tuple[float, np.ndarray]:
    """⟨J v, w⟩, and the terms of ⟨v, Jᵀ w⟩ by key."""
    params, frozen = mi.traverse(case.scene), read_frozen(case.text)
    params.keep(list(keys))
    integrator = mi.load_dict({"type": "straylight", "edges": False, **COARSE, **more})
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
        integrator.render_backward(case.scene, params, mi.TensorXf(smooth[:, :, None]), 0, SEED)
        terms = [float(move @ np.array(dr.grad(params[key]), dtype=np.float64)) for key, move in moves.items()]
    finally:
        for key in keys:
            dr.disable_grad(params[key])
        params.update()
    return float(np.sum(change * smooth)), np.array(terms)


@pytest.mark.parametrize("kind", [*KINDS, "all"])
def test_identity(case: Case, smooth: np.ndarray, kind: str) -> None:
    """Relative to the root of the sum of squares of v_i (Jᵀ w)_i, as terms of either sign cancel."""
    keys = KINDS[kind] if kind in KINDS else [key for own in KINDS.values() for key in own]
    forward, terms = inner_products(case, keys, smooth)
    scale = np.sqrt(np.sum(terms**2))
    assert abs(forward - terms.sum()) < OF_IDENTITY * scale
    wrong = terms.sum() + 1e-3 * terms[int(np.argmax(np.abs(terms)))]  # one derivative that is 0.1 % too large
    assert abs(forward - wrong) > OF_IDENTITY * scale


@pytest.mark.long
def test_identity_of_scatter() -> None:
    """Light that a mirror scatters beside its beam: as it turns, and as its coating hides more of the dust."""
    aside, mirror = mi.ScalarTransform4d().translate([0, 10, 20]), {"type": "asphere", "semi_diameter": 10.0}
    for key, model in (
        ("mirror.tilt_x", {"type": "abg", "A": 1e-3, "B": 1e-2, "g": 2.0}),
        ("mirror.bsdf.R", {"type": "particulate", "level": 500.0}),
    ):
        scene = load(
            source={"type": "collimated", "radius": 5.0},
            mirror=mirror | {"to_world": at(50.0), "bsdf": {"type": "interface", "R": 0.5, "scatter": model}},
            detector=detector(0.0, to_world=aside, half_width=4.0, half_height=4.0),
        )
        params = mi.traverse(scene)
        integrator = mi.load_dict({"type": "straylight", "edges": False, "rays": 1000, "max_scatters": 1})
        dr.enable_grad(params[key])
        dr.set_grad(params[key], 1.0)
        forward = float(np.array(integrator.render_forward(scene, params), dtype=np.float64).sum())
        dr.clear_grad(params[key])
        integrator.render_backward(scene, params, mi.TensorXf(np.ones((8, 8, 1), dtype=np.float32)))
        assert forward == pytest.approx(float(dr.grad(params[key])[0]), rel=1e-5)


def test_render_is_the_gradient(case: Case, smooth: np.ndarray) -> None:
    """With the same seed the derivatives of `mi.render` are those of `mistray.gradient`, to float32."""
    keys = [key for own in KINDS.values() for key in own]
    _, terms = inner_products(case, keys, smooth)
    flat = mi.Float64(smooth.ravel())
    metric = image_metric(case.scene, lambda e: dr.sum(e * flat), **COARSE, seed=SEED)
    found = mistray.gradient(metric, mi.traverse(case.scene), keys, edges=False)
    frozen, rng = read_frozen(case.text), np.random.default_rng(4)
    for key, term in zip(keys, terms, strict=True):
        values = found.gradient[key]
        expected = float(step(frozen, key) * rng.choice((-1.0, 1.0), len(values)) @ values)
        assert term == pytest.approx(expected, rel=2e-5, abs=1e-6 * np.abs(terms).max()), key


WINDOW = small_text(
    shape_xml("asphere", "front", 0.0, scattering_xml((ABG,), "air", "1.5", R=0.1, T=0.8), radius=60, semi_diameter=9),
    shape_xml("asphere", "rear", 5.0, scattering_xml((POLISH,), "1.5", "air", R=0.1, T=0.8), semi_diameter=9.0),
    shape_xml("asphere", "detector", 60.0, sensor=True, half_width=10.0, half_height=10.0),
    radius=5.0,
)
LIGHT = {"rays": 1000, "max_reflections": 2, "azimuth_deg": 20.0}


def new_kernels() -> int:
    """Kernels that are new to this process since the last call; one found in the disk cache counts too."""
    return sum(not entry["cache_hit"] or entry["cache_disk"] for entry in dr.kernel_history([dr.KernelType.JIT]))


def changing(scene: Any, metric: Metric, keys: list[str], **more: Any) -> list[int]:
    """Kernels that are new in each of five gradients, between which all the numbers change."""
    params = mi.traverse(scene)
    before = {key: np.array(params[key], dtype=np.float64) for key in keys}
    rng, counts = np.random.default_rng(1), []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for _ in range(5):
            for key, values in before.items():
                tiny = 1e-3 if key.endswith(("x", "y", "z")) else 0.0
                params[key] = mi.Float(values * rng.uniform(0.99, 1.01, len(values)) + tiny * rng.uniform())
            params.update()
            dr.kernel_history_clear()
            mistray.gradient(metric, params, keys, **more)
            counts.append(new_kernels())
    return counts


# Scenes and metrics of one observation, and what changes
METRICS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "coatings": (COATED, lambda o: o.power("ghost")),
    "geometry": (TRIPLET, lambda o: o.power("ghost") / o.power("direct") + 1e-3 * o.moments("ghost").rms_radius),
    "image": (TRIPLET, lambda o: o.peak("ghost") + dr.sum(dr.square(o.irradiance))),
    "scatter": (WINDOW, lambda o: o.power(is_scattered)),
}
CHANGES = {
    "coatings": "L2_front.bsdf.coating.thickness_nm L3_rear.bsdf.coating.n_shift",
    "geometry": "L1_front.curvature L2_front.z L3_rear.y L2_rear.tilt_x detector.z L1_edge.r0 L3_rear.a4",
    "image": "L1_front.curvature L3_rear.y L2_front.semi_diameter",
    "scatter": "front.bsdf.abg.A front.bsdf.abg.g rear.bsdf.harvey_shack.rms_nm rear.bsdf.R front.curvature",
}


@pytest.mark.usefixtures("no_kernels")
@pytest.mark.parametrize("name", CHANGES)
def test_numbers_are_data(load_scene: Callable[[str], Any], name: str) -> None:
    """The first two gradients may compile: in the second, numbers that were 0 are there for the first time."""
    text, function = METRICS[name]
    scene = load_scene(text)
    metric = Metric(scene, lambda observations: function(observations[0]), (4.0,), settings=LIGHT)
    counts = changing(scene, metric, CHANGES[name].split())
    assert counts[0] > 0
    assert counts[2:] == [0, 0, 0], counts


@pytest.mark.parametrize("how", [{}, {"method": "adam", "seeds": "fresh"}])
def test_no_step_of_a_search_compiles(how: dict[str, Any]) -> None:
    """On the Cooke triplet: two terms of light at two fields, one of layers; none after the second step."""
    given = {
        "trace": {"field_deg": [0, 15], "wavelength_nm": [550], "rays": 200},
        "term": [
            {"kind": "path_power", "goal": "minimise"},
            {"kind": "transmission", "goal": "at_least", "limit_of_start": 0.9},
            {"kind": "total_thickness", "goal": "at_most", "limit": 300},
        ],
        "coating": [{"surfaces": "all", "preset": "bbar3", "thickness_nm": [10, 250]}],
        "optimizer": {"starts": 1, "steps": 4, "tolerance": 0, **how},
    }
    new: list[int] = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        optimize("cooke_triplet", given, verification_seeds=2, progress=lambda step, start: new.append(new_kernels()))
        dr.kernel_history_clear()
    assert len(new) == 5
    assert new[3:] == [0, 0], new
