"""Gradients by shapes, positions, indices and coatings against float64 differences on frozen paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from frozen_cases import Case, coated_text, compare, scene_text, step, with_shape, with_values
from oracles.frozen_paths import Hits
from oracles.small_scenes import interface_xml, shape_xml
from oracles.small_scenes import scene_text as small_text

import mistray
from mistray.metrics.parameters import parameters

TOLERANCE = 1e-3  # of geometry on frozen paths, and of coatings
ZERO = 1e-6  # of the metric's value, for a move by the size of the surface
POSE = ("x", "y", "z", "tilt_x", "tilt_y", "tilt_z")
TRACED = {"max_reflections": 2, "flux_threshold": 0.0, "azimuth_deg": 30.0}


def singlet() -> Case:
    """Ghosts, and light that a cone around the axis reflects; coarse pixels, as the image is of few rays."""
    text = with_values(scene_text("singlet_window_detector"), "detector", half_width=20.0, half_height=20.0)
    for side in ("width", "height"):
        text = text.replace(f'name="{side}" value="240"', f'name="{side}" value="40"')
    wall = shape_xml("frustum", "tube", 0.0, interface_xml(R=0.3), r0=10.0, z0=20.0, r1=9.0, z1=80.0)
    return Case(with_shape(text, wall), {"rays": 600, "field_deg": 6.0, "seed": 3, **TRACED})


def triplet() -> Case:
    """Layers on two surfaces, and a lens that is displaced and tilted."""
    text = coated_text(scene_text("cooke_triplet"), "L2_front", "L3_rear")
    moved = {f"L2_{face}.{name}": v for face in ("front", "rear") for name, v in (("tilt_x", 0.8), ("y", 0.1))}
    moved |= {"L2_rear.tilt_y": -0.5, "L2_rear.tilt_z": 20.0, "L2_rear.x": 0.05}
    moved |= {"L2_front.bsdf.n_back_shift": 2e-3, "L2_rear.bsdf.n_front_shift": 2e-3}
    return Case(text, {"rays": 500, "field_deg": 5.0, "seed": 4, **TRACED, "flux_threshold": 5e-4}, moved)


def double_gauss() -> Case:
    """Cemented lenses; without the ghosts of their cement."""
    return Case(
        scene_text("double_gauss"), {"rays": 250, "field_deg": 4.0, "seed": 5, **TRACED, "flux_threshold": 2e-3}
    )


def phone_camera() -> Case:
    """Aspheres, ideal coatings, cones and stops that reflect; of its 150 ghosts the strongest."""
    settings = {"rays": 80, "field_deg": 6.0, "seed": 6, **TRACED, "flux_threshold": 1e-3}
    return Case(scene_text("phone_camera"), settings)


def solid() -> Case:
    """A detector cemented to glass that absorbs: each mm takes 2 % of the light."""
    glass = "1.5+1e-6i"
    front = shape_xml(
        "asphere", "front", 0.0, interface_xml("air", glass, R=0.2, T=0.7), radius=30.0, semi_diameter=15.0
    )
    end = interface_xml(glass, "air", R=0.3)
    detector = shape_xml("asphere", "detector", 40.0, end, sensor=True, half_width=20.0, half_height=20.0)
    settings = {"rays": 300, "field_deg": 5.0, "seed": 7, **TRACED, "wavelength_nm": 550.0}
    return Case(small_text(front, detector, radius=8.0), settings)


# Two lens systems of freeforms, by the numbers of each surface's sag
FREEFORMS: dict[str, dict[str, dict[str, float]]] = {
    "freeforms": {
        "biconic": {"curvature": 1 / 60, "conic": 0.3, "curvature_x": 1 / 90, "conic_x": -1.2},
        "toroid": {"curvature": -1 / 90, "toroid_curvature": -1 / 70, "a4": 1e-6},
        "zernike": {
            "curvature": 1 / 80, "zernike_6": 0.02, "zernike_7": -0.01, "zernike_22": 2e-3, "zernike_radius": 13.0
        },
        "fringe": {"curvature": -1 / 90, "fringe_5": 0.02, "fringe_16": 4e-3, "fringe_radius": 13.0},
        "xy": {"curvature": 1 / 80, "xy_2_1": 3e-5, "xy_0_3": -2e-5, "xy_4_2": 1e-8},
        "chebyshev": {"chebyshev_2_0": 0.05, "chebyshev_3_2": 0.01, "chebyshev_x": 14.0, "chebyshev_y": 15.0},
    },
    "more freeforms": {
        "odd": {"curvature": 1 / 60, "r3": 2e-5, "r5": 1e-8, "a4": 1e-6},
        "cylinder": {"curvature": 0.0, "curvature_x": -1 / 90},
        "qcon": {"curvature": 1 / 80, "conic": -0.5, "qcon_0": 0.05, "qcon_3": -0.01, "q_radius": 13.0},
        "qbfs": {"curvature": -1 / 90, "qbfs_0": 0.05, "qbfs_2": -0.01, "q_radius": 13.0},
        "tilted": {"slope_x": 0.05, "slope_y": -0.02, "curvature": 1 / 200},
        "plain": {"curvature": -1 / 150},
    },
    "freeforms on grids": {
        "q2d": {"curvature": 1 / 80, "conic": -0.5, "q2d_cos_1_1": 0.04, "q2d_sin_3_2": -0.01, "q_radius": 13.0},
        "grid": {"curvature": -1 / 90, "grid_scale": 3.0, "grid_x": 0.4, "grid_y": -0.3},
    },
}  # fmt: skip
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
# The keys that are looked at one by one; all of them together are in `TestDirections`
FIXED_NUMBERS = ("zernike_radius", "fringe_radius", "q_radius", "chebyshev_x", "chebyshev_y")
KEYS = {
    **{
        name: [
            *(f"{kind}.{key}" for kind, numbers in system.items() for key in numbers if key not in FIXED_NUMBERS),
            *(f"{kind}.{key}" for kind in list(system)[1::2] for key in POSE),
        ]
        for name, system in FREEFORMS.items()
    },
    "off-axis mirror": [f"mirror.{name}" for name in (*POSE, "curvature", "conic", "zernike_5")],
    "Offner relay": [
        f"{mirror}.{name}" for mirror in ("primary", "secondary") for name in (*POSE, "curvature", "conic")
    ],
    "solid": [
        *(f"{shape}.{name}" for shape in ("front", "detector") for name in (*POSE, "curvature", "conic", "a4")),
        *("front.bsdf.n_back_shift", "front.bsdf.R", "front.bsdf.T", "detector.bsdf.R"),
    ],
    "singlet": [
        *(f"L1_{face}.{name}" for face in ("front", "rear") for name in ("curvature", "conic", "a4")),
        *(f"L1_rear.{name}" for name in POSE),
        *(f"window_rear.{name}" for name in POSE),
        *(f"detector.{name}" for name in (*POSE, "curvature")),
        *(f"tube.{name}" for name in (*POSE, "r0", "z0", "r1", "z1")),
        *("L1_front.bsdf.n_back_shift", "L1_rear.bsdf.n_front_shift", "window_front.bsdf.n_front_shift"),
        *("detector.bsdf.R", "tube.bsdf.R"),
    ],
    "triplet": [
        *(f"L2_rear.{name}" for name in (*POSE, "curvature", "conic", "a6")),
        *(f"L3_rear.{name}" for name in ("y", "z", "tilt_x", "curvature")),
        *("L2_rear.bsdf.n_front_shift", "L1_front.bsdf.n_back_shift"),
        "L2_front.bsdf.coating.thickness_nm",
    ],
}


@pytest.fixture(scope="module")
def cases() -> Callable[[str], Case]:
    """Name → case, made once."""
    return cache(lambda name: CASES[name]())


def kind_of(key: str) -> str:
    """Parameters that are compared with each other."""
    name = key.rsplit(".", 1)[-1]
    return "index" if name in ("n_front_shift", "n_back_shift") else name


@pytest.mark.long
@pytest.mark.parametrize("name", KEYS)
def test_each_parameter(cases: Callable[[str], Case], name: str) -> None:
    """Every kind of parameter and metric; a gradient that is 1 % too large fails for each of them."""
    case, keys = cases(name), KEYS[name]
    metrics = case.metrics(case.strongest("ghost"))
    noticed = compare(case, keys, metrics, kind_of, tolerance=TOLERANCE, wrong=1.01, cancels=0.2, zero=ZERO)
    # A turn about its own axis moves nothing but the detector's frame
    assert noticed >= {kind_of(key) for key in keys} - ({"tilt_z"} if name in ("triplet", "Offner relay") else set())


@pytest.mark.long
@pytest.mark.parametrize("name", ["singlet", "double Gauss", "phone camera"])
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
