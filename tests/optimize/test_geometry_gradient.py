"""
`mistray.gradient` by shapes, positions, indices and coatings, on frozen paths, against central differences in float64.

The oracle follows all rays of the trace through their event lists by itself (tests/oracles/frozen_paths.py). A
derivative is compared relative to itself, or, where it is small, to a tenth of the largest one of its kind (curvatures,
positions along x, …) in that metric: what happens to be small must be right to 1e-4 of what the others of its kind are.
A kind that symmetry makes 0 altogether, such as a turn about the axis, must be 0 to 1e-9 of the metric's own value for a
move by the size of the surface.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from frozen_cases import Case, coated_text, scene_text, step, with_values
from oracles.small_scenes import interface_xml, shape_xml

import mistray

TOLERANCE = 1e-3  # of geometry on frozen paths, and of coatings
SMALL = 0.1
ZERO = 1e-6  # of the metric's value, for a move by the size of the surface
POSE = ("x", "y", "z", "tilt_x", "tilt_y", "tilt_z")
TRACED = {"max_reflections": 2, "flux_threshold": 0.0, "azimuth_deg": 30.0}
METRICS = ("power", "one ghost", "rms radius", "mean y", "image", "peak")


def singlet() -> Case:
    """Ghosts, and light that a cone around the axis reflects; coarse pixels, as the image is of few rays."""
    text = with_values(scene_text("singlet_window_detector"), "detector", half_width=20.0, half_height=20.0)
    for side in ("width", "height"):
        text = text.replace(f'name="{side}" value="240"', f'name="{side}" value="40"')
    wall = shape_xml("frustum", "tube", 0.0, interface_xml(R=0.3), r0=13.0, z0=20.0, r1=15.0, z1=80.0)
    text = text.replace("<!-- Structure -->", wall)
    return Case(text, {"rays": 600, "field_deg": 6.0, "seed": 3, **TRACED})


def triplet() -> Case:
    """Layers on two surfaces, and a lens that is displaced and tilted."""
    text = coated_text(scene_text("cooke_triplet"), "L2_front", "L3_rear")
    moved = {f"L2_{face}.{name}": v for face in ("front", "rear") for name, v in (("tilt_x", 0.8), ("y", 0.1))}
    moved |= {"L2_rear.tilt_y": -0.5, "L2_rear.tilt_z": 20.0, "L2_rear.x": 0.05, "L2_rear.bsdf.n_front_shift": 2e-3}
    return Case(text, {"rays": 500, "field_deg": 5.0, "seed": 4, **TRACED}, moved)


def double_gauss() -> Case:
    return Case(scene_text("double_gauss"), {"rays": 250, "field_deg": 4.0, "seed": 5, **TRACED})


def phone_camera() -> Case:
    """Aspheres; of its 150 ghosts those that carry a tenth of the strongest one's light."""
    settings = {"rays": 150, "field_deg": 6.0, "seed": 6, **TRACED, "flux_threshold": 3e-4}
    return Case(scene_text("phone_camera"), settings)


CASES = {"singlet": singlet, "triplet": triplet, "double Gauss": double_gauss, "phone camera": phone_camera}
# The keys that are looked at one by one; all of them together are in `TestDirections`
KEYS = {
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
        *(f"L3_rear.{name}" for name in (*POSE, "curvature")),
        *("L2_rear.bsdf.n_front_shift", "L1_front.bsdf.n_back_shift"),
        *("L2_front.bsdf.bsdf.thickness_nm", "L3_rear.bsdf.bsdf.n_shift", "L3_rear.bsdf.bsdf.k_shift"),
    ],
    "double Gauss": ["L2_front.curvature", "L4_front.z", "L5_rear.y", "L6_front.tilt_x", "L4_L5.bsdf.n_back_shift"],
    "phone camera": ["L1_front.a6", "L2_rear.a8", "L4_front.conic", "L3_front.y", "L1_rear.tilt_x", "window_rear.z",
                     "L2_front.bsdf.n_back_shift", "L2_front.bsdf.R", "L1_rear.bsdf.T"],
}  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[str, Case]:
    return request.param, CASES[request.param]()


def kind_of(key: str) -> str:
    """Parameters that are compared with each other."""
    name = key.rsplit(".", 1)[-1]
    return "index" if name in ("n_front_shift", "n_back_shift") else name


def deviations(
    found: dict[str, np.ndarray], expected: dict[str, np.ndarray], floor: dict[str, float]
) -> dict[str, float]:
    """Largest deviation of each kind, relative as the module says."""
    largest: dict[str, float] = {}
    for key, values in expected.items():
        largest[kind_of(key)] = max(largest.get(kind_of(key), 0.0), float(np.max(np.abs(values))))
    worst: dict[str, float] = {}
    for key, values in expected.items():
        kind = kind_of(key)
        scale = np.maximum(np.abs(values), max(SMALL * largest[kind], floor[key]))
        worst[kind] = max(worst.get(kind, 0.0), float(np.max(np.abs(found[key] - values) / scale)))
    return worst


class TestEachParameter:
    def test_against_the_oracle(self, case: tuple[str, Case]) -> None:
        """Each kind of parameter and each metric; a gradient that is 1 % too large must fail for each of them."""
        name, scene = case
        metrics = scene.metrics(scene.strongest("ghost"))
        params = mi.traverse(scene.scene)
        keys = KEYS[name]
        expected = {metric: {} for metric in METRICS}
        for key in keys:
            entries = [
                scene.paths.derivatives([metrics[m][1] for m in METRICS], key, step(scene.frozen, key), entry)
                for entry in range(len(scene.frozen.numbers[key]))
            ]
            for m, values in zip(METRICS, np.transpose(entries), strict=True):
                expected[m][key] = values
        for m in METRICS:
            found = mistray.gradient(scene.metric(metrics[m][0]), params, keys=keys, edges=False)
            floor = {key: ZERO * abs(found.value) * 1e-4 / step(scene.frozen, key) for key in keys}
            worst = deviations(found.gradient, expected[m], floor)
            assert max(worst.values()) < TOLERANCE, (m, worst)
            wrong = {key: 1.01 * values for key, values in found.gradient.items()}
            seen = deviations(wrong, expected[m], floor)
            there = {kind_of(key) for key in keys if np.any(np.abs(expected[m][key]) > floor[key])}
            assert {kind for kind, value in seen.items() if value > TOLERANCE} == there, (m, seen)
