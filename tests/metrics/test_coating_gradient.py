"""Derivatives by layers, shares, and the index beside them, against central differences with common random numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from oracles.statistics import z_limit, z_score

import mistray
from mistray.metrics.parameters import groups
from mistray.metrics.scene_values import changed
from mistray.optimize import Metric, ghost_to_signal, gradient, image_metric, parameters, path_power
from mistray.prescription import Coating, Prescription
from mistray.scenes.cooke_triplet.prescription import build as build_triplet
from mistray.scenes.phone_camera.prescription import build as build_phone

TOLERANCE = 1e-3
STEPS = {"thickness_nm": 0.5, "n_shift": 2e-3, "k_shift": 1e-3, "R": 1e-3, "T": 1e-3}
TRACED = {"max_reflections": 2, "flux_threshold": 0.0}


def coated(prescription: Prescription, layers: str, first: str = "outside") -> Any:
    """The prescription with one stack on every refracting surface of its own, as a scene."""
    surfaces = tuple(
        s if s.mirror or s.front == s.back else replace(s, coating=Coating(layers=layers, first=first))
        for s in prescription.surfaces
    )
    return replace(prescription, surfaces=surfaces).to_scene()


def central_difference(metric: Metric, params: Any, key: str, index: int) -> float:
    """Four-point central difference (one-sided for k, which cannot be negative); steps as float32 represents them."""
    before = np.array(params[key], dtype=np.float32)
    name = key.rsplit(".", 1)[-1]
    values, places = [], []
    factors = (0, 1, 2, 3, 4) if name == "k_shift" else (-2, -1, 1, 2)
    for factor in factors:
        moved = before.copy()
        moved[index] += np.float32(factor * STEPS[name])
        with changed(params, {key: moved}):
            values.append(metric.value())
        places.append(float(moved[index]) - float(before[index]))
    # derivative at 0 of the polynomial through the points
    return float(np.polyfit(places, values, len(factors) - 1)[-2])


def compare(metric: Metric, params: Any, count: int, seed: int) -> float:
    """Largest deviation over `count` random parameters, relative to the parameter's own scale of derivatives."""
    found = gradient(metric, params)
    entries = [(key, k) for key, values in found.gradient.items() for k in range(len(values))]
    rng = np.random.default_rng(seed)
    worst = 0.0
    for number in rng.choice(len(entries), count, replace=False):
        key, k = entries[number]
        expected = central_difference(metric, params, key, k)
        name = key.rsplit(".", 1)[-1]
        # derivatives of one kind; one that happens to vanish is held to the size of the others
        scale = np.median([np.abs(v).max() for other, v in found.gradient.items() if other.endswith(name)])
        worst = max(worst, abs(found.gradient[key][k] - expected) / max(abs(expected), 0.1 * scale))
    return worst


def keep_coatings(scene: Any) -> Any:
    params = mi.traverse(scene)
    layers = ("thickness_nm", "n_shift", "k_shift")
    params.keep([key for key in list(params.keys()) if key.rsplit(".", 1)[-1] in layers])
    return params


@pytest.fixture(scope="module")
def triplet() -> Any:
    return coated(build_triplet(), "1.38 95, 2.1 120, 1.63+0.002i 80")


@pytest.mark.long
@pytest.mark.parametrize("kind", ["ghost", "ratio", "image", "one path"])
def test_ten_random_parameters(triplet, kind) -> None:
    more = {"rays": 3000, "field_deg": (0.0, 12.0), "wavelength_nm": [480.0, 600.0], **TRACED}
    metric = {
        "ghost": lambda: path_power(triplet, "ghost", **more),
        "ratio": lambda: ghost_to_signal(triplet, **more),
        "image": lambda: image_metric(triplet, lambda e: dr.sum(dr.square(e)), **more),
        "one path": lambda: path_power(triplet, lambda row: (row.ghost_1, row.ghost_2) == ("L2_front", "L1_front"),
                                       **more),
    }[kind]()  # fmt: skip
    assert compare(metric, keep_coatings(triplet), 10, seed=1) < TOLERANCE


@pytest.mark.long
def test_ideal_coatings_elsewhere_and_a_shared_design() -> None:
    """On the lenses of a phone camera, and on all surfaces of a triplet: one key, the sum over the surfaces."""
    scene = coated(build_phone(), "1.38 95, 2.1 120, 1.63 80")
    metric = path_power(scene, "ghost", rays=1500, field_deg=10.0, **TRACED)
    assert compare(metric, keep_coatings(scene), 10, seed=2) < TOLERANCE
    ar, prescription = Coating(layers="1.38 95, 2.1 120, 1.63 80", name="ar"), build_triplet()
    shared = replace(prescription, surfaces=tuple(replace(s, coating=ar) for s in prescription.surfaces)).to_scene()
    params = mi.traverse(shared)
    params.keep(["ar.thickness_nm", "ar.n_shift"])
    metric = path_power(shared, "ghost", rays=3000, field_deg=(0.0, 12.0), **TRACED)
    assert compare(metric, params, 6, seed=5) < TOLERANCE


def film(layers: str, more: str = "") -> str:
    return f'<bsdf type="thinfilm"><string name="layers" value="{layers}"/>{more}</bsdf>'


def turned(shape: str, angle: int, y: float = 0.0) -> str:
    return shape.replace("<translate", f'<rotate x="1" angle="{angle}"/><translate y="{y}"')


METAL = film("1.46 80, 0.6+3i 25", '<boolean name="opaque" value="true"/><string name="first" value="front"/>')
WIDE = {"half_width": 25.0, "half_height": 25.0}


def second_surface_mirror(glass: str) -> str:
    """An opaque coating behind a glass that may absorb a little; the glass is no metal."""
    return scene_text(
        shape_xml("asphere", "entrance", 0.0, interface_xml("air", glass), semi_diameter=20.0),
        shape_xml("asphere", "mirror", 5.0, scattering_xml([METAL], glass, "air"), semi_diameter=20.0),
        shape_xml("asphere", "detector", -10.0, sensor=True, **WIDE),
        distance=2.0,
    )


def total_reflection() -> str:
    """The absorbing film takes part of the total reflection, from inside the glass and near the critical angle."""
    face = scattering_xml([film("1.5+0.05i 60, 2.0 40")], "1.6", "air")
    return scene_text(
        shape_xml("asphere", "entrance", 0.0, interface_xml("air", "1.6"), semi_diameter=20.0),
        turned(shape_xml("asphere", "face", 20.0, face, half_width=40.0, half_height=40.0), 45),
        turned(shape_xml("asphere", "detector", 20.0, sensor=True, **WIDE), 90, y=20.0),
        radius=2.0,
    )


def pellicle() -> str:
    sheet = scattering_xml([film("1.38 100, 2.1+0.01i 70, 1.63 50")], "air", "air")
    end = shape_xml("asphere", "detector", 20.0, interface_xml(R=0.2), sensor=True, **WIDE)
    return scene_text(shape_xml("asphere", "sheet", 0.0, sheet, semi_diameter=20.0), end, radius=3.0)


def lens() -> str:
    """So wide that no ray meets a rim; ghosts come from R of both coatings."""
    layers = film("1.38 100, 2.1 60, 1.63 70")
    front, rear = (scattering_xml([layers], *sides) for sides in (("air", "1.6"), ("1.6", "air")))
    return scene_text(
        shape_xml("asphere", "front", 0.0, front, radius=40.0, semi_diameter=8.0),
        shape_xml("asphere", "rear", 4.0, rear, radius=-60.0, semi_diameter=8.0),
        shape_xml("asphere", "detector", 20.0, interface_xml(R=0.2), sensor=True, semi_diameter=30.0),
        radius=3.0,
    )


# Scene, what is measured, where, and materials whose index changes
SPECIAL: dict[str, tuple[str, str, Any, tuple[str, ...]]] = {
    "mirror": (second_surface_mirror("1.5"), "all", 20.0, ("1.5", "air")),
    "mirror behind grey glass": (second_surface_mirror("1.5+1e-7i"), "all", 20.0, ()),
    "total reflection": (total_reflection(), "all", (-12.0, -5.0, 0.0, 5.0), ("1.6", "air")),
    "pellicle": (pellicle(), "all", 20.0, ("air",)),
    "ghosts of a lens": (lens(), "ghost", 12.0, ("1.6", "air")),
    "image of a lens": (lens(), "direct", 12.0, ("1.6", "air")),
}


@pytest.mark.long
@pytest.mark.parametrize("name", SPECIAL)
def test_special_places(load_scene, name: str) -> None:
    """Where tables have their special places: by layers, and by the indices on both sides of the surfaces."""
    text, selection, field_deg, materials = SPECIAL[name]
    scene = load_scene(text)
    metric, known = path_power(scene, selection, rays=500, field_deg=field_deg, **TRACED), parameters(scene)
    assert metric.value() > 0
    assert compare(metric, keep_coatings(scene), 6, seed=4) < TOLERANCE
    params, step = mi.traverse(scene), 2.0**-10
    for material in materials:
        keys = groups(known)[f"{material}.index"]
        found = sum(gradient(metric, params, keys, edges=False).gradient[key][0] for key in keys)
        ends = []
        for shift in (-step, step):
            with changed(params, {key: np.array([shift]) for key in keys}):
                ends.append(metric.value())
        expected = (ends[1] - ends[0]) / (2 * step)
        assert found == pytest.approx(expected, rel=TOLERANCE)


BOTH = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8)
THROUGH = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8, event="transmission")
BACK = bsdf_xml("abg", A=2e-3, B=1e-3, g=1.8, event="reflection")
DUST = bsdf_xml("particulate", level=500.0)
PAINT = bsdf_xml("paint", reflectance=0.05, b0=0.3, l=0.1, s=-2.0)


def window(*models: str, detector: str | None = None) -> str:
    """A coated window that scatters, and a detector that may scatter, too."""
    return scene_text(
        shape_xml("asphere", "front", 0.0, scattering_xml(models, "air", "1.5", R=0.1, T=0.8), semi_diameter=50.0),
        shape_xml("asphere", "rear", 5.0, scattering_xml(models, "1.5", "air", R=0.15, T=0.7), semi_diameter=50.0),
        shape_xml("asphere", "detector", 60.0, detector, sensor=True, half_width=10.0, half_height=10.0),
    )


SCATTERING = {
    "transmission": ((THROUGH,), None),
    "reflection": ((BACK,), None),
    "a detector that scatters": ((THROUGH,), scattering_xml((PAINT,), R=0.2)),
}
SETTINGS = {"rays": 4096, "max_reflections": 2, "flux_threshold": 0.0, "scatter_threshold": 0.0, "aim": "auto"}


def scattered_power(scene: mi.Scene, **more: int) -> Metric:
    return path_power(scene, lambda row: row.scatters > 0, **(SETTINGS | more))


@pytest.mark.parametrize("case", SCATTERING)
def test_against_central_differences(load_scene, case: str) -> None:
    models, detector = SCATTERING[case]
    scene = load_scene(window(*models, detector=detector))
    keys = [f"{part}.bsdf.{what}" for part in ("front", "rear") for what in "RT"]
    keys += ["detector.bsdf.R"] if detector else []
    metric, params = scattered_power(scene), mi.traverse(scene)
    found = gradient(metric, params, keys)  # coatings alone: the walk in reverse
    largest = max(abs(found.gradient[key][0]) for key in keys)
    for key in keys:
        expected = central_difference(metric, params, key, 0)
        assert found.gradient[key][0] == pytest.approx(expected, rel=1e-3, abs=1e-4 * largest), key


@pytest.mark.long
@pytest.mark.parametrize(("model", "key"), [(BOTH, "front.bsdf.T"), (BOTH, "rear.bsdf.R"), (DUST, "rear.bsdf.R")])
def test_where_choices_depend_on_the_coating(load_scene, model: str, key: str) -> None:
    """Particles scatter by T, 2 R and 1 + R²; false alarm 1e-3 for the three cases."""
    scene = load_scene(window(model))
    many = {"rays": 200_000}
    found = gradient(scattered_power(scene, **many), mi.traverse(scene), [key])
    start, step, powers = float(mi.traverse(scene)[key][0]), 0.04, []
    for seed, sign in ((1, 1), (2, -1)):
        with changed(mi.traverse(scene), {key: np.array([start + sign * step])}):
            trace = mistray.trace(scene, **(SETTINGS | many), seed=seed)
        power = trace.paths.power([row.path_id for row in trace.paths if row.scatters])
        powers.append([value / trace.energy.launched_W for value in power])
    expected = (powers[0][0] - powers[1][0]) / (2 * step)
    se = np.hypot(np.hypot(powers[0][1], powers[1][1]) / (2 * step), found.standard_error[key][0])
    assert se < 0.1 * abs(expected) + 0.02 * powers[0][0]
    assert abs(z_score(found.gradient[key][0], expected, se)) < z_limit(3)
